//! Lists of neighbours on the CPU: every query's neighbours are marked, the rows' places follow from their lengths, and rows
//! are written there.

#![allow(unsafe_code, reason = "that no two queries have a row in common is not to be seen by the compiler")]

use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64};
use std::time::Instant;

use rayon::prelude::*;

use super::cpu::report;
use super::marks::TaskMarks;
use super::rows::{self, RowMaker};
use super::visit::Visits;
use super::{CutRow, FixedRadius, NeighborRows, NeighborSearch, Neighbors, Report, RowOrder};
use crate::geometry::row_simd::Hits;
use crate::parallel::rows_to_fill::{RowPlace, RowsToFill};
use crate::parallel::scan;
use crate::structure::CpuStructure;
use crate::{Error, Result};

/// Neighbours of every query as compressed sparse rows.
///
/// # Errors
/// As `NeighborSearch::list`.
pub(super) fn list<S: CpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let n_queries = question.len(structure.points().len());
    let mut report = list_report(structure);
    let start = Instant::now();
    let mut visits = Visits::prepare(structure, question)?;
    let tasks = mark_all(structure, &mut visits)?;
    visits.add_times(&mut report, start);

    let start = Instant::now();
    let offsets = scan::exclusive_u64(&lengths(&tasks, &visits, n_queries));
    let indices = RowsToFill::new("the list of neighbours", &offsets)?;
    let mut cut: Vec<CutRow>;
    let distances = match question.distances {
        true => {
            let distances = RowsToFill::new("the distances of the list", &offsets)?;
            cut = write_rows::<S, true>(structure, &tasks, &visits, &indices, |place, hits| {
                // SAFETY: as that of the indices; the offsets are the same.
                let row = unsafe { distances.row(place) };
                row.iter_mut().zip(&hits.dist2).for_each(|(to, from)| *to = from.sqrt());
            });
            Some(distances.finish())
        }
        false => {
            cut = match needs_distances(question) {
                true => write_rows::<S, true>(structure, &tasks, &visits, &indices, |_, _| {}),
                false => write_rows::<S, false>(structure, &tasks, &visits, &indices, |_, _| {}),
            };
            None
        }
    };
    let indices = indices.finish();
    cut.sort_unstable_by_key(|c| c.query);
    report.host_stage("assemble", start);
    Ok(Neighbors { offsets, indices, distances, cut, report })
}

/// The report of a list, without its times.
fn list_report<S: CpuStructure>(structure: &S) -> Report {
    let mut report = report(structure, "row_simd::mark");
    report.kernels.push("row_simd::collect_marked".to_owned());
    report
}

/// Whether rows cannot be made without distances.
fn needs_distances(question: &FixedRadius<'_>) -> bool {
    question.distances || question.max_neighbors.is_some() || question.order == RowOrder::Distance
}

/// The marks of all queries, task by task.
///
/// # Errors
/// `OutOfMemory` where the rows, or they and the marks, pass the memory that the answer may take.
fn mark_all<S: CpuStructure>(structure: &S, visits: &mut Visits<'_, S>) -> Result<Vec<TaskMarks>> {
    let (points, question) = (structure.points(), visits.question);
    let limit = rows::entry_limit(question, points.len());
    let bytes_left = rows::bytes_for_entries(question, points.len());
    let fits = |entries: u64, marks: u64| {
        entries <= limit && entries.saturating_mul(rows::entry_bytes(question)).saturating_add(marks) <= bytes_left
    };
    let (entries, bytes) = (AtomicU64::new(0), AtomicU64::new(0));
    let stopped = AtomicBool::new(false);
    let tell = |more_entries: u64, more_bytes: u64| {
        let entries = entries.fetch_add(more_entries, Relaxed) + more_entries;
        let fine = fits(entries, bytes.fetch_add(more_bytes, Relaxed) + more_bytes);
        if !fine {
            stopped.store(true, Relaxed);
        }
        fine
    };
    let tasks = visits
        .each_part(TaskMarks::new, |visits, marks, places, spans| marks.mark(visits, points, places, spans, tell));
    let sizes = tasks.iter().map(TaskMarks::sizes).fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    if stopped.into_inner() || !fits(sizes.0, sizes.1) {
        drop(tasks);
        return Err(too_large(structure, question)?);
    }
    Ok(tasks)
}

/// The error for a list that does not fit, with the size it would have.
fn too_large<S: CpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Error> {
    let counts = structure.count(question)?;
    let cap = question.max_neighbors.unwrap_or(u32::MAX);
    let entries: u64 = counts.as_slice().iter().map(|&c| u64::from(c.min(cap))).sum();
    Ok(rows::too_large(entries, question, structure.points().len()))
}

/// `[q]` length of every row.
fn lengths<S: CpuStructure>(tasks: &[TaskMarks], visits: &Visits<'_, S>, n_queries: usize) -> Vec<u32> {
    let lengths: Vec<AtomicU32> = all_zero(n_queries);
    tasks.par_iter().for_each(|task| {
        task.each_length(visits, |query, length| lengths[query as usize].store(length, Relaxed));
    });
    lengths.into_iter().map(AtomicU32::into_inner).collect()
}

/// Words that threads share, first touched by all of them.
fn all_zero<T: Default + Send>(len: usize) -> Vec<T> {
    (0..len).into_par_iter().with_min_len(1 << 14).map(|_| T::default()).collect()
}

/// Fills the row of every query, tasks in parallel, and calls `fill_beside` with its place and its neighbours; returns the rows
/// that the cap made shorter.
fn write_rows<S: CpuStructure, const DIST2: bool>(
    structure: &S,
    tasks: &[TaskMarks],
    visits: &Visits<'_, S>,
    indices: &RowsToFill<'_, u32>,
    fill_beside: impl Fn(&RowPlace, &Hits) + Sync,
) -> Vec<CutRow> {
    let write_task = |task: &TaskMarks| {
        let (mut hits, mut maker, mut cut) = (Hits::default(), RowMaker::default(), Vec::new());
        // Places of all rows at once: in random order each is a cache miss, and these misses do not wait for each other.
        let mut places = Vec::with_capacity(task.len());
        task.each_length(visits, |query, _| places.push(indices.place(query as usize)));
        let mut places = places.iter();
        task.each_row::<S, DIST2>(visits, structure.points(), &mut hits, |query, hits| {
            cut.extend(maker.make_row::<DIST2>(query.id, hits, visits.question));
            let place = places.next().expect("every query should have a place");
            // SAFETY: ids of queries are a permutation (`OrderedPoints`), each stands in one task, so nobody else has this row.
            unsafe { indices.row(place) }.copy_from_slice(&hits.ids);
            fill_beside(place, hits);
        });
        cut
    };
    tasks.par_iter().flat_map_iter(write_task).collect()
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
        let mut report = list_report(self);
        let start = Instant::now();
        let mut visits = Visits::prepare(self, question)?;
        let tasks = mark_all(self, &mut visits)?;
        visits.add_times(&mut report, start);
        let lengths = lengths(&tasks, &visits, n_queries);
        let (starts, n_entries) = starts(&tasks, &visits, n_queries);
        let mut indices = rows::zeroed(n_entries as usize)?;
        match needs_distances(question) {
            true => write_in_turn::<Self, true>(self, &tasks, &visits, &mut indices),
            false => write_in_turn::<Self, false>(self, &tasks, &visits, &mut indices),
        }
        Ok(NeighborRows { starts, lengths, indices, report })
    }
}

impl<S: CpuStructure> ListRows for S {}

/// Starts of the rows where they stand in searching order, and the number of entries.
fn starts<S: CpuStructure>(tasks: &[TaskMarks], visits: &Visits<'_, S>, n_queries: usize) -> (Vec<u64>, u64) {
    let starts: Vec<AtomicU64> = all_zero(n_queries);
    let mut n_entries = 0;
    let first = |task: &TaskMarks| {
        let first = n_entries;
        n_entries += task.sizes().0;
        first
    };
    let firsts: Vec<u64> = tasks.iter().map(first).collect();
    tasks.par_iter().zip(firsts).for_each(|(task, mut start)| {
        task.each_length(visits, |query, length| {
            starts[query as usize].store(start, Relaxed);
            start += u64::from(length);
        });
    });
    (starts.into_iter().map(AtomicU64::into_inner).collect(), n_entries)
}

/// Writes the rows of all tasks one after the other.
fn write_in_turn<S: CpuStructure, const DIST2: bool>(
    structure: &S,
    tasks: &[TaskMarks],
    visits: &Visits<'_, S>,
    mut indices: &mut [u32],
) {
    let mut parts = Vec::with_capacity(tasks.len());
    for task in tasks {
        let (part, rest) = indices.split_at_mut(task.sizes().0 as usize);
        parts.push((task, part));
        indices = rest;
    }
    parts.into_par_iter().for_each(|(task, mut part)| {
        let (mut hits, mut maker) = (Hits::default(), RowMaker::default());
        task.each_row::<S, DIST2>(visits, structure.points(), &mut hits, |query, hits| {
            maker.make_row::<DIST2>(query.id, hits, visits.question);
            let row = part.split_off_mut(..hits.ids.len()).expect("a task should have room for its rows");
            row.copy_from_slice(&hits.ids);
        });
    });
}
