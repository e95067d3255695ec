//! Rows of neighbours on their way to an answer: order and cap within a row, and the assembly of tasks into one list.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicU32, AtomicU64};

use rayon::prelude::*;

use super::{CutRow, FixedRadius, NeighborRows, Neighbors, RowOrder};
use crate::geometry::row_simd::Hits;
use crate::parallel::scan;
use crate::{Error, Result};

/// Rows that one task found, in searching order.
#[derive(Debug, Default)]
pub(super) struct TaskRows {
    queries: Vec<u32>,
    lengths: Vec<u32>,
    pub(super) hits: Hits,
    cut: Vec<CutRow>,
    keys: Vec<u64>,
    reported: usize,
}

/// Entries a task adds between two looks at the shared total.
const REPORT_STEP: usize = 1 << 18;

impl TaskRows {
    pub(super) fn new(n_queries: usize) -> Self {
        let (queries, lengths) = (Vec::with_capacity(n_queries), Vec::with_capacity(n_queries));
        Self { queries, lengths, ..Self::default() }
    }

    /// Closes the row of `query`, whose hits stand from `start` on: leaves out the query itself, caps and orders.
    #[inline]
    pub(super) fn finish_row<const DIST2: bool>(&mut self, query: u32, start: usize, question: &FixedRadius<'_>) {
        if question.exclude_self
            && let Some(own) = self.hits.ids[start..].iter().position(|&id| id == query)
        {
            self.hits.ids.remove(start + own);
            if DIST2 {
                self.hits.dist2.remove(start + own);
            }
        }
        let found = self.hits.ids.len() - start;
        let kept = question.max_neighbors.map_or(found, |cap| found.min(cap as usize));
        if DIST2 && (kept < found || question.order != RowOrder::Unspecified) {
            self.order_row(start, kept, question.order);
        } else if question.order == RowOrder::Index {
            self.hits.ids[start..].sort_unstable();
        }
        if kept < found {
            self.cut.push(CutRow { query, missing: (found - kept) as u32 });
        }
        self.queries.push(query);
        self.lengths.push(kept as u32);
    }

    /// Keeps the nearest `kept` hits from `start` on, and orders them.
    fn order_row(&mut self, start: usize, kept: usize, order: RowOrder) {
        // Squared distances are not negative, so their bits order like numbers; ties fall to the lower index.
        let by_distance = |(&id, d2): (&u32, &f32)| u64::from(d2.to_bits()) << 32 | u64::from(id);
        self.keys.clear();
        self.keys.extend(self.hits.ids[start..].iter().zip(&self.hits.dist2[start..]).map(by_distance));
        if kept < self.keys.len() {
            if kept > 0 {
                self.keys.select_nth_unstable(kept - 1);
            }
            self.keys.truncate(kept);
        }
        match order {
            RowOrder::Index => self.keys.sort_unstable_by_key(|&key| key as u32),
            RowOrder::Distance | RowOrder::Unspecified => self.keys.sort_unstable(),
        }
        self.hits.ids.truncate(start);
        self.hits.dist2.truncate(start);
        self.hits.ids.extend(self.keys.iter().map(|&key| key as u32));
        self.hits.dist2.extend(self.keys.iter().map(|&key| f32::from_bits((key >> 32) as u32)));
    }

    /// Entries added since the last non-zero answer, once they are many.
    #[inline]
    pub(super) fn take_unreported(&mut self) -> u64 {
        let added = self.hits.ids.len() - self.reported;
        if added < REPORT_STEP {
            return 0;
        }
        self.reported = self.hits.ids.len();
        added as u64
    }
}

/// Bytes of one entry of a list.
fn entry_bytes(question: &FixedRadius<'_>) -> u64 {
    if question.distances { 8 } else { 4 }
}

/// Entries that the answer may have: by the caller's limit, and by what the host has left.
pub(super) fn entry_limit(question: &FixedRadius<'_>, n_points: usize) -> u64 {
    let bytes = entry_bytes(question);
    let offsets = 8 * (question.len(n_points) as u64 + 1);
    // While the answer is assembled, the tasks' rows stand beside it.
    let by_host = available_memory().saturating_sub(offsets) / (2 * bytes);
    let by_caller = question.max_bytes.map_or(u64::MAX, |limit| limit.saturating_sub(offsets) / bytes);
    by_host.min(by_caller)
}

/// The error for a list of `entries`.
pub(super) fn too_large(entries: u64, question: &FixedRadius<'_>, n_points: usize) -> Error {
    let offsets = 8 * (question.len(n_points) as u64 + 1);
    Error::OutOfMemory {
        what: "the list of neighbours",
        needed: entries * entry_bytes(question) + offsets,
        available: entry_limit(question, n_points) * entry_bytes(question) + offsets,
    }
}

/// Bytes of memory the host has left; no limit where that is not known.
pub(crate) fn available_memory() -> u64 {
    let known = || {
        let info = std::fs::read_to_string("/proc/meminfo").ok()?;
        let line = info.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
        let kilobytes: u64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
        // A tenth is left to the rest of the machine.
        Some(kilobytes * 1024 / 10 * 9)
    };
    known().unwrap_or(u64::MAX)
}

/// Where the row of each query stands: the task that found it above, the place in that task's hits below.
struct RowPlaces(Vec<AtomicU64>);

impl RowPlaces {
    /// Bits of a place: so many hits of one task would be 4 TiB. Tasks have at least 4,096 queries each, so their numbers fit above.
    const BITS: u32 = 40;

    fn put(&self, query: u32, task: usize, start: usize) {
        self.0[query as usize].store((task as u64) << Self::BITS | start as u64, Relaxed);
    }

    fn get(&self, query: usize) -> (usize, usize) {
        let place = self.0[query].load(Relaxed);
        ((place >> Self::BITS) as usize, (place & ((1 << Self::BITS) - 1)) as usize)
    }
}

/// Brings the tasks' rows into query order.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn assemble(tasks: Vec<TaskRows>, n_queries: usize, distances: bool) -> Result<Neighbors> {
    // Only length and place of the rows are scattered, by all threads: no two tasks have a query in common.
    let lengths: Vec<AtomicU32> = all_zero(n_queries);
    let places = RowPlaces(all_zero(n_queries));
    tasks.par_iter().enumerate().for_each(|(number, task)| {
        let mut start = 0;
        for (&query, &length) in task.queries.iter().zip(&task.lengths) {
            lengths[query as usize].store(length, Relaxed);
            places.put(query, number, start);
            start += length as usize;
        }
    });
    let lengths: Vec<u32> = lengths.into_iter().map(AtomicU32::into_inner).collect();
    let offsets = scan::exclusive_u64(&lengths);
    let mut cut: Vec<CutRow> = tasks.iter().flat_map(|t| t.cut.iter().copied()).collect();
    cut.sort_unstable_by_key(|c| c.query);
    let indices = gather(&offsets, &places, |task| &tasks[task].hits.ids)?;
    let distances = match distances {
        true => {
            let mut values = gather(&offsets, &places, |task| &tasks[task].hits.dist2)?;
            values.par_iter_mut().with_min_len(1 << 14).for_each(|d| *d = d.sqrt());
            Some(values)
        }
        false => None,
    };
    // Giving back the pages takes the system as long as it took to find some of the rows.
    tasks.into_par_iter().for_each(drop);
    Ok(Neighbors { offsets, indices, distances, cut, ..Neighbors::default() })
}

/// Words that threads share, first touched by all of them.
fn all_zero<T: Default + Send>(len: usize) -> Vec<T> {
    (0..len).into_par_iter().with_min_len(1 << 14).map(|_| T::default()).collect()
}

/// The tasks' rows one after the other, as they stand.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn concatenate(tasks: &[TaskRows], n_queries: usize) -> Result<NeighborRows> {
    let (mut starts, mut lengths) = (vec![0; n_queries], vec![0; n_queries]);
    let mut start = 0;
    for task in tasks {
        for (&query, &length) in task.queries.iter().zip(&task.lengths) {
            starts[query as usize] = start;
            lengths[query as usize] = length;
            start += u64::from(length);
        }
    }
    let mut indices = zeroed(start as usize)?;
    let mut parts = Vec::with_capacity(tasks.len());
    let mut rest = &mut indices[..];
    for task in tasks {
        let (part, after) = rest.split_at_mut(task.hits.ids.len());
        parts.push((part, &task.hits.ids));
        rest = after;
    }
    parts.into_par_iter().for_each(|(part, ids)| part.copy_from_slice(ids));
    Ok(NeighborRows { starts, lengths, indices, ..NeighborRows::default() })
}

/// Zeros that the machine's memory is only touched for where they are written first.
pub(super) fn zeroed<T: bytemuck::Zeroable>(len: usize) -> Result<Vec<T>> {
    bytemuck::allocation::try_zeroed_vec(len).map_err(|()| no_memory::<T>(len))
}

/// The error where there is no memory for so many values.
pub(super) fn no_memory<T>(len: usize) -> Error {
    Error::OutOfMemory {
        what: "the list of neighbours",
        needed: (len * size_of::<T>()) as u64,
        available: available_memory(),
    }
}

/// Queries whose rows one thread copies.
const GATHER_QUERIES: usize = 1 << 13;

/// Copies the rows of all queries, which stand at `places`, to where `offsets` says.
fn gather<'a, T: bytemuck::Pod + Send + Sync>(
    offsets: &[u64],
    places: &RowPlaces,
    column: impl Fn(usize) -> &'a Vec<T> + Sync,
) -> Result<Vec<T>> {
    let n_queries = offsets.len() - 1;
    let mut values: Vec<T> = zeroed(offsets[n_queries] as usize)?;
    let mut parts = Vec::new();
    let mut rest = &mut values[..];
    for first in (0..n_queries).step_by(GATHER_QUERIES) {
        let end = n_queries.min(first + GATHER_QUERIES);
        let (part, after) = rest.split_at_mut((offsets[end] - offsets[first]) as usize);
        parts.push((first..end, part));
        rest = after;
    }
    parts.into_par_iter().for_each(|(queries, part)| {
        let mut rest = part;
        for query in queries {
            let (task, start) = places.get(query);
            let (to, after) = rest.split_at_mut((offsets[query + 1] - offsets[query]) as usize);
            to.copy_from_slice(&column(task)[start..start + to.len()]);
            rest = after;
        }
    });
    Ok(values)
}
