//! Hits on their way to rows in query order.

use std::ops::Range;

use rayon::prelude::*;

use super::answers::SearchWork;
use super::{FixedRadiusN, NeighborsN};
use crate::geometry::Scalar;
use crate::parallel::scan;
use crate::query::{RowOrder, rows};
use crate::{Error, Result};

/// A neighbour of a query of the pack at hand.
#[derive(Debug, Clone, Copy)]
struct Hit<T> {
    slot: u32,
    index: u32,
    dist2: T,
}

/// What the searches add neighbours to.
#[derive(Debug)]
pub(super) struct Hits<T> {
    /// Neighbours of each query of the pack.
    counts: Vec<u32>,
    hits: Vec<Hit<T>>,
    keeps: bool,
    pub(super) work: SearchWork,
}

impl<T: Scalar> Hits<T> {
    /// Counts, and keeps the neighbours themselves where they are asked for.
    pub(super) fn new(keeps: bool) -> Self {
        Self { counts: Vec::new(), hits: Vec::new(), keeps, work: SearchWork::default() }
    }

    pub(super) fn begin_pack(&mut self, n_queries: usize) {
        self.counts.clear();
        self.counts.resize(n_queries, 0);
        self.hits.clear();
    }

    /// Adds a neighbour to query `slot` of the pack.
    #[inline(always)]
    pub(super) fn add(&mut self, slot: usize, index: u32, dist2: T) {
        self.counts[slot] += 1;
        if self.keeps {
            self.hits.push(Hit { slot: slot as u32, index, dist2 });
        }
    }
}

/// Rows that one task found, in searching order.
#[derive(Debug, Default)]
pub(super) struct TaskRows<T> {
    queries: Vec<u32>,
    lengths: Vec<u32>,
    indices: Vec<u32>,
    dist2: Vec<T>,
}

impl<T: Scalar> TaskRows<T> {
    /// Closes the rows of the pack, whose queries have these indices.
    pub(super) fn finish_pack(&mut self, queries: &[u32], found: &Hits<T>) {
        let first = self.indices.len();
        self.queries.extend_from_slice(queries);
        self.lengths.extend_from_slice(&found.counts);
        if !found.keeps {
            return;
        }
        self.indices.resize(first + found.hits.len(), 0);
        self.dist2.resize(first + found.hits.len(), T::of(0.0));
        let mut next = first;
        let mut places: Vec<usize> = Vec::with_capacity(found.counts.len());
        for &count in &found.counts {
            places.push(next);
            next += count as usize;
        }
        for hit in &found.hits {
            let place = &mut places[hit.slot as usize];
            (self.indices[*place], self.dist2[*place]) = (hit.index, hit.dist2);
            *place += 1;
        }
    }

    /// Number of neighbours kept.
    pub(super) fn len(&self) -> usize {
        self.indices.len()
    }
}

/// `[q]` number of neighbours of every query; queries in no task have none.
pub(super) fn lengths<T>(tasks: &[TaskRows<T>], n_queries: usize) -> Vec<u32> {
    let mut lengths = vec![0; n_queries];
    for task in tasks {
        for (&query, &length) in task.queries.iter().zip(&task.lengths) {
            lengths[query as usize] = length;
        }
    }
    lengths
}

/// Bytes of an answer of so many entries.
fn bytes<T>(n_queries: usize, entries: u64) -> u64 {
    8 * (n_queries as u64 + 1) + entries * (size_of::<T>() + size_of::<u32>()) as u64
}

/// The error for an answer of so many entries.
pub(in crate::query) fn too_large<T: Scalar, const D: usize>(
    question: &FixedRadiusN<'_, T, D>,
    n_queries: usize,
    entries: u64,
) -> Error {
    let available = question.max_bytes.unwrap_or(u64::MAX).min(rows::available_memory() / 2);
    Error::OutOfMemory { what: "the list of neighbours", needed: bytes::<T>(n_queries, entries), available }
}

/// Entries that the answer may have: by the limit of the question and by the memory of the host.
pub(in crate::query) fn entry_limit<T: Scalar, const D: usize>(
    question: &FixedRadiusN<'_, T, D>,
    n_queries: usize,
) -> u64 {
    // While the answer is put together, the rows that were found stand beside it.
    let available = question.max_bytes.unwrap_or(u64::MAX).min(rows::available_memory() / 2);
    available.saturating_sub(bytes::<T>(n_queries, 0)) / (size_of::<T>() + size_of::<u32>()) as u64
}

/// Queries whose rows one thread copies.
const COPIED_BY_ONE: usize = 1 << 11;

/// Brings the tasks' rows into query order.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn assemble<T: Scalar>(tasks: &[TaskRows<T>], n_queries: usize) -> Result<NeighborsN<T>> {
    let mut row_of = vec![(0u32, 0usize); n_queries];
    for (number, task) in tasks.iter().enumerate() {
        let mut start = 0;
        for (&query, &length) in task.queries.iter().zip(&task.lengths) {
            row_of[query as usize] = (number as u32, start);
            start += length as usize;
        }
    }
    let offsets = scan::exclusive_u64(&lengths(tasks, n_queries));
    let total = offsets[n_queries] as usize;
    let (mut indices, mut dist2) = (rows::zeroed(total)?, rows::zeroed(total)?);
    let parts = split(&offsets, &mut indices).into_par_iter().zip(split(&offsets, &mut dist2));
    parts.for_each(|((queries, indices), (_, dist2))| {
        let first = offsets[queries.start] as usize;
        for query in queries {
            let (task, start) = row_of[query];
            let row = offsets[query] as usize - first..offsets[query + 1] as usize - first;
            if row.is_empty() {
                continue;
            }
            let (task, from) = (&tasks[task as usize], start..start + row.len());
            indices[row.clone()].copy_from_slice(&task.indices[from.clone()]);
            dist2[row].copy_from_slice(&task.dist2[from]);
        }
    });
    Ok(NeighborsN { offsets, indices, dist2, ..NeighborsN::default() })
}

/// Parts of consecutive queries with their part of a column.
fn split<'a, T>(offsets: &[u64], mut column: &'a mut [T]) -> Vec<(Range<usize>, &'a mut [T])> {
    let (n_queries, mut parts) = (offsets.len() - 1, Vec::new());
    for first in (0..n_queries).step_by(COPIED_BY_ONE) {
        let end = n_queries.min(first + COPIED_BY_ONE);
        let (part, rest) = column.split_at_mut((offsets[end] - offsets[first]) as usize);
        parts.push((first..end, part));
        column = rest;
    }
    parts
}

/// Orders the neighbours within each row.
pub(in crate::query) fn order_rows<T: Scalar>(neighbors: &mut NeighborsN<T>, order: RowOrder) {
    if order == RowOrder::Unspecified {
        return;
    }
    let NeighborsN { offsets, indices, dist2, .. } = neighbors;
    let parts = split(offsets, indices).into_par_iter().zip(split(offsets, dist2));
    parts.for_each(|((queries, indices), (_, dist2))| {
        let first = offsets[queries.start] as usize;
        let mut sorted: Vec<(T, u32)> = Vec::new();
        for query in queries {
            let row = offsets[query] as usize - first..offsets[query + 1] as usize - first;
            let (indices, dist2) = (&mut indices[row.clone()], &mut dist2[row]);
            sorted.clear();
            sorted.extend(dist2.iter().copied().zip(indices.iter().copied()));
            match order {
                RowOrder::Distance => sorted.sort_unstable_by(|a, b| a.0.compare(b.0).then(a.1.cmp(&b.1))),
                RowOrder::Index | RowOrder::Unspecified => sorted.sort_unstable_by_key(|hit| hit.1),
            }
            for ((index, dist2), &hit) in indices.iter_mut().zip(dist2).zip(&sorted) {
                (*dist2, *index) = hit;
            }
        }
    });
}
