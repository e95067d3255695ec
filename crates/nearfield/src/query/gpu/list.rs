//! The list read back to the host: at once where it fits the device, else in batches.

use std::ops::Range;
use std::time::Instant;

use rayon::prelude::*;

use super::answers::{add_stages, row_lengths};
use super::batch::{halving, windows};
use super::capped_list::capped_list;
use super::loops;
use super::on_device::{list_on_device, record_fill, report_two_passes};
use super::visit::QueryBuffers;
use crate::query::rows::Room;
use crate::query::{FixedRadius, Neighbors, Report, RowOrder};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Neighbours of every query, on the host.
pub(super) fn list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    question.validate(structure.len())?;
    let start = Instant::now();
    let mut neighbors = match question.max_neighbors {
        Some(cap) => capped_list(structure, question, cap)?,
        None => whole_list(structure, question)?,
    };
    neighbors.report.host_stage("total", start);
    Ok(neighbors)
}

/// Checks that a list of so many entries fits the host.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn check_host_memory<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    entries: u64,
) -> Result<()> {
    let room = Room::of(question, structure.len());
    // A part that was read may stand beside the list that it is appended to.
    let beside = room.bytes(entries);
    if room.fits(entries, beside) { Ok(()) } else { Err(room.too_large(entries, beside)) }
}

/// All neighbours of every query.
pub(super) fn whole_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let (mut neighbors, order) = match list_at_once(structure, question) {
        Err(Error::OutOfDeviceMemory { .. }) => list_in_batches(structure, question)?,
        listed => listed?,
    };
    if order != question.order {
        let sort = Instant::now();
        order_rows(&mut neighbors, question.order);
        neighbors.report.notes.push("rows were too long for the device to sort; the host did".to_owned());
        neighbors.report.host_stage("sort rows on the host", sort);
    }
    neighbors.distances = neighbors.distances.filter(|_| question.distances).map(square_roots);
    Ok(neighbors)
}

/// The order that the device gives rows of at most this length: that of the question, or none where its loops would
/// end before such rows are sorted.
fn order_on_device<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, longest_row: u32) -> RowOrder {
    if loops::can_sort(structure.gpu(), longest_row) { question.order } else { RowOrder::Unspecified }
}

/// Whether the host needs squared distances of rows that the device gave this order.
fn reads_distances(question: &FixedRadius<'_>, order: RowOrder) -> bool {
    question.distances || (question.order == RowOrder::Distance && order != question.order)
}

/// The list with squared distances where they are needed, and the order of its rows.
fn list_at_once<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<(Neighbors, RowOrder)> {
    let gpu = structure.gpu();
    let mut order = question.order;
    let list = list_on_device(structure, question, |size| {
        check_host_memory(structure, question, size.entries)?;
        order = order_on_device(structure, question, size.longest_row);
        Ok(order)
    })?;
    let mut report = list.report;
    let read = Instant::now();
    let offsets = gpu.read_as(&list.offsets, u64::from)?;
    let indices = gpu.read(&list.indices)?;
    let dist2 = list.dist2.filter(|_| reads_distances(question, order));
    let distances = dist2.map(|dist2| gpu.read(&dist2)).transpose()?;
    report.host_stage("read back", read);
    Ok((Neighbors { offsets, indices, distances, cut: Vec::new(), report }, order))
}

/// Sorts rows whose distances, if any, are squared.
fn order_rows(neighbors: &mut Neighbors, order: RowOrder) {
    let Neighbors { offsets, indices, distances, .. } = neighbors;
    let mut sorted: Vec<(u32, f32)> = Vec::new();
    for row in offsets.windows(2).map(|ends| ends[0] as usize..ends[1] as usize) {
        let ids = &mut indices[row.clone()];
        let Some(dist2) = distances.as_mut().map(|dist2| &mut dist2[row]) else {
            ids.sort_unstable();
            continue;
        };
        sorted.clear();
        sorted.extend(ids.iter().copied().zip(dist2.iter().copied()));
        match order {
            RowOrder::Distance => sorted.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0))),
            RowOrder::Index | RowOrder::Unspecified => sorted.sort_unstable_by_key(|&(id, _)| id),
        }
        for ((id, d2), &(sorted_id, sorted_d2)) in ids.iter_mut().zip(dist2).zip(&sorted) {
            (*id, *d2) = (sorted_id, sorted_d2);
        }
    }
}

pub(super) fn square_roots(mut dist2: Vec<f32>) -> Vec<f32> {
    dist2.par_iter_mut().with_min_len(1 << 14).for_each(|d| *d = d.sqrt());
    dist2
}

/// As [`list_at_once`]: counts all, then fills windows of rows that fit.
fn list_in_batches<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<(Neighbors, RowOrder)> {
    let gpu = structure.gpu();
    let counted = row_lengths(structure, question)?;
    let counts = counted.as_slice();
    let entries = counts.iter().map(|&c| u64::from(c)).sum();
    check_host_memory(structure, question, entries)?;
    let order = order_on_device(structure, question, counts.iter().copied().max().unwrap_or(0));
    let mut report = report_two_passes(structure, order);
    report.stages = counted.report.stages.iter().filter(|s| s.name != "total").cloned().collect();
    let mut neighbors = Neighbors::default();
    let per_entry = if super::on_device::needs_distances(question) { 8 } else { 4 };
    let mut batches = 0;
    // One window of rows; halved further where its memory cannot be had.
    for window in windows(counts, gpu.limits().binding_bytes / per_entry) {
        batches += halving(window.len(), 1, |part| {
            let part = window.start + part.start..window.start + part.end;
            let n_stages = report.stages.len();
            let filled =
                fill_part(structure, question, order, (part.clone(), &counts[part]), &mut neighbors, &mut report);
            if filled.is_err() {
                report.stages.truncate(n_stages);
            }
            filled
        })?;
    }
    report.batches = batches;
    let mut offsets = Vec::with_capacity(counts.len() + 1);
    let mut end = 0u64;
    offsets.push(0);
    offsets.extend(counts.iter().map(|&c| {
        end += u64::from(c);
        end
    }));
    neighbors.distances = reads_distances(question, order).then(|| neighbors.distances.take().unwrap_or_default());
    Ok((Neighbors { offsets, report, ..neighbors }, order))
}

/// Fills the rows of these queries, whose lengths are `counts`, and appends them to `neighbors`, or nothing on failure.
fn fill_part<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    order: RowOrder,
    (window, counts): (Range<usize>, &[u32]),
    neighbors: &mut Neighbors,
    report: &mut Report,
) -> Result<()> {
    let gpu = structure.gpu();
    let mut offsets = Vec::with_capacity(counts.len() + 1);
    let mut total = 0u64;
    offsets.push(0);
    for &count in counts {
        total += u64::from(count);
        offsets.push(total as u32);
    }
    let available = gpu.limits().binding_bytes;
    if total * 4 > available {
        return Err(Error::OutOfDeviceMemory { what: "neighbour indices".into(), needed: total * 4, available });
    }
    let offsets = gpu.upload("row offsets", &offsets)?;
    let queries = QueryBuffers::in_caller_order(structure, question, window)?;
    queries.add_stages_to(report);
    let mut commands = gpu.commands("fill rows");
    let rows = record_fill(&mut commands, structure, question, order, &queries, (&offsets, total as usize))?;
    add_stages(report, &commands.run()?);
    let read = Instant::now();
    let indices = gpu.read(&rows.indices)?;
    if let (true, Some(dist2)) = (reads_distances(question, order), &rows.dist2) {
        let dist2 = gpu.read(dist2)?;
        neighbors.distances.get_or_insert_default().extend(dist2);
    }
    neighbors.indices.extend(indices);
    report.host_stage("read back", read);
    Ok(())
}
