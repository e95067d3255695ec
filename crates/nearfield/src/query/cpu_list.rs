//! Lists of neighbours on the CPU: every query's neighbours are found, the rows' places follow from their lengths, and rows
//! are written there.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64};
use std::time::Instant;

use rayon::prelude::*;

use super::cpu::report;
use super::found_rows::FoundRows;
use super::rows::{self, LIST, Room};
use super::visit::Visits;
use super::{CutRow, FixedRadius, NeighborRows, NeighborSearch, Neighbors, Report, RowOrder};
use crate::Result;
use crate::parallel::rows_to_fill::RowsToFill;
use crate::parallel::scan;
use crate::structure::CpuStructure;

/// Neighbours of every query as compressed sparse rows.
///
/// # Errors
/// As `NeighborSearch::list`.
pub(super) fn list<S: CpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let n_queries = question.len(structure.points().len());
    let mut report = list_report(structure, question);
    let start = Instant::now();
    let mut visits = Visits::prepare(structure, question)?;
    let tasks = find_rows(structure, &mut visits)?;
    visits.add_times(&mut report, start);

    let start = Instant::now();
    let offsets = scan::exclusive_u64(&lengths(&tasks, &visits, n_queries));
    let indices = RowsToFill::new(LIST, &offsets)?;
    let distances = question.distances.then(|| RowsToFill::new("the distances of the list", &offsets)).transpose()?;
    let mut cut = match needs_distances(question) {
        true => write_rows::<S, true>(structure, tasks, &visits, &indices, distances.as_ref()),
        false => write_rows::<S, false>(structure, tasks, &visits, &indices, None),
    };
    let (indices, distances) = (indices.finish(), distances.map(RowsToFill::finish));
    cut.sort_unstable_by_key(|c| c.query);
    report.host_stage("assemble", start);
    Ok(Neighbors { offsets, indices, distances, cut, report })
}

/// The report of a list, without its times.
fn list_report<S: CpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Report {
    if question.max_neighbors.is_some() {
        return report(structure, "row_simd::collect");
    }
    let mut report = report(structure, "row_simd::mark");
    report.kernels.push("row_simd::collect_marked".to_owned());
    report
}

/// Whether rows without a cap cannot be made without distances.
fn needs_distances(question: &FixedRadius<'_>) -> bool {
    question.distances || question.order == RowOrder::Distance
}

/// The rows of all queries, task by task.
///
/// # Errors
/// `OutOfMemory` where the rows, or they and what holds them until they are written, pass the memory that the answer may take.
fn find_rows<S: CpuStructure>(structure: &S, visits: &mut Visits<'_, S>) -> Result<Vec<FoundRows>> {
    let (points, question) = (structure.points(), visits.question);
    let room = Room::of(question, points.len());
    let (entries, bytes) = (AtomicU64::new(0), AtomicU64::new(0));
    let stopped = AtomicBool::new(false);
    let tell = |more_entries: u64, more_bytes: u64| {
        let entries = entries.fetch_add(more_entries, Relaxed) + more_entries;
        let fine = room.fits(entries, bytes.fetch_add(more_bytes, Relaxed) + more_bytes);
        if !fine {
            stopped.store(true, Relaxed);
        }
        fine
    };
    let tasks =
        visits.each_part(FoundRows::new, |visits, rows, places, spans| rows.find(visits, points, places, spans, tell));
    let (entries, bytes) = tasks.iter().map(FoundRows::sizes).fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    if stopped.into_inner() || !room.fits(entries, bytes) {
        drop(tasks);
        // With the size that the list would have.
        let counts = structure.count(question)?;
        let cap = question.max_neighbors.unwrap_or(u32::MAX);
        let entries: u64 = counts.as_slice().iter().map(|&c| u64::from(c.min(cap))).sum();
        return Err(room.too_large(entries, bytes));
    }
    Ok(tasks)
}

/// `[q]` length of every row.
fn lengths<S: CpuStructure>(tasks: &[FoundRows], visits: &Visits<'_, S>, n_queries: usize) -> Vec<u32> {
    let lengths: Vec<AtomicU32> = all_zero(n_queries);
    tasks.par_iter().for_each(|task| {
        task.lengths(visits).for_each(|(query, length)| lengths[query as usize].store(length, Relaxed));
    });
    lengths.into_iter().map(AtomicU32::into_inner).collect()
}

/// Words that threads share, first touched by all of them.
fn all_zero<T: Default + Send>(len: usize) -> Vec<T> {
    (0..len).into_par_iter().with_min_len(1 << 14).map(|_| T::default()).collect()
}

/// Fills the row of every query, tasks in parallel, each of which is given back then; returns the rows that the cap made shorter.
fn write_rows<S: CpuStructure, const DIST2: bool>(
    structure: &S,
    tasks: Vec<FoundRows>,
    visits: &Visits<'_, S>,
    indices: &RowsToFill<'_, u32>,
    distances: Option<&RowsToFill<'_, f32>>,
) -> Vec<CutRow> {
    let write_task = |mut task: FoundRows| {
        let mut cut = Vec::new();
        let queries: Vec<u32> = task.lengths(visits).map(|(query, _)| query).collect();
        let mut indices = indices.take(&queries).into_iter();
        let mut distances = distances.map(|distances| distances.take(&queries).into_iter());
        task.each_row::<S, DIST2>(visits, structure.points(), |query, hits, missing| {
            if missing > 0 {
                cut.push(CutRow { query: query.id, missing });
            }
            let row = indices.next().expect("every query should have a row");
            row.copy_from_slice(&hits.ids);
            if let Some(row) = distances.as_mut().and_then(Iterator::next) {
                row.iter_mut().zip(&hits.dist2).for_each(|(to, from)| *to = from.sqrt());
            }
        });
        cut
    };
    tasks.into_par_iter().flat_map_iter(write_task).collect()
}

/// Lists whose rows stand in the order in which they were finished.
///
/// Implemented for every CPU structure; `SearchOnDevice::list_rows_on_device` is its twin on the GPU.
pub trait ListRows: CpuStructure {
    /// Neighbours of every query as rows of start and length; order and cap of the question hold within a row.
    ///
    /// # Errors
    /// As [`NeighborSearch::list`].
    fn list_rows(&self, question: &FixedRadius<'_>) -> Result<NeighborRows>
    where
        Self: Sized,
    {
        question.validate(self.points().len())?;
        let n_queries = question.len(self.points().len());
        let mut report = list_report(self, question);
        let start = Instant::now();
        let mut visits = Visits::prepare(self, question)?;
        let tasks = find_rows(self, &mut visits)?;
        visits.add_times(&mut report, start);
        let start = Instant::now();
        let lengths = lengths(&tasks, &visits, n_queries);
        let (starts, n_entries) = starts(&tasks, &visits, n_queries);
        let mut indices = rows::zeroed(n_entries as usize)?;
        match needs_distances(question) {
            true => write_in_turn::<Self, true>(self, tasks, &visits, &mut indices),
            false => write_in_turn::<Self, false>(self, tasks, &visits, &mut indices),
        }
        report.host_stage("assemble", start);
        Ok(NeighborRows { starts, lengths, indices, report })
    }
}

impl<S: CpuStructure> ListRows for S {}

/// Starts of the rows where they stand in searching order, and the number of entries.
fn starts<S: CpuStructure>(tasks: &[FoundRows], visits: &Visits<'_, S>, n_queries: usize) -> (Vec<u64>, u64) {
    let starts: Vec<AtomicU64> = all_zero(n_queries);
    let mut n_entries = 0;
    let first = |task: &FoundRows| {
        let first = n_entries;
        n_entries += task.sizes().0;
        first
    };
    let firsts: Vec<u64> = tasks.iter().map(first).collect();
    tasks.par_iter().zip(firsts).for_each(|(task, mut start)| {
        for (query, length) in task.lengths(visits) {
            starts[query as usize].store(start, Relaxed);
            start += u64::from(length);
        }
    });
    (starts.into_iter().map(AtomicU64::into_inner).collect(), n_entries)
}

/// Writes the rows of all tasks one after the other; each task is given back then.
fn write_in_turn<S: CpuStructure, const DIST2: bool>(
    structure: &S,
    tasks: Vec<FoundRows>,
    visits: &Visits<'_, S>,
    mut indices: &mut [u32],
) {
    let mut parts = Vec::with_capacity(tasks.len());
    for task in &tasks {
        let (part, rest) = indices.split_at_mut(task.sizes().0 as usize);
        parts.push(part);
        indices = rest;
    }
    tasks.into_par_iter().zip(parts).for_each(|(mut task, mut part)| {
        task.each_row::<S, DIST2>(visits, structure.points(), |_, hits, _| {
            let row = part.split_off_mut(..hits.ids.len()).expect("a task should have room for its rows");
            row.copy_from_slice(&hits.ids);
        });
    });
}
