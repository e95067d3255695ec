//! The list read back to the host: at once where it fits the device, else in batches; and the capped list.

use std::ops::Range;
use std::time::Instant;

use rayon::prelude::*;

use super::answers::{add_stages, count, in_batches};
use super::batch::{halving, windows};
use super::on_device::{GpuNeighbors, list_on_device, record_fill, report_two_passes};
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, AdapterKind, Bind, Buffer, Gpu};
use crate::query::{CutRow, FixedRadius, Neighbors, Report, RowOrder, rows};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Neighbours of every query, on the host.
pub(super) fn list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    question.validate(structure.len())?;
    let start = Instant::now();
    let mut neighbors = match question.max_neighbors {
        _ if has_rows_too_long_to_order(structure, question)? => ordered_on_host(structure, question)?,
        Some(cap) => capped_list(structure, question, cap)?,
        None => whole_list(structure, question)?,
    };
    neighbors.report.host_stage("total", start);
    Ok(neighbors)
}

/// Longest row that a software device orders: its invocations end their loops after 65,535 rounds in all, and a heap of
/// L neighbours takes about 1.5 L · log₂ L of them beside the walk.
const LONGEST_ORDERED_ROW_ON_SOFTWARE: u32 = 1024;

fn has_rows_too_long_to_order<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<bool> {
    let is_ordered = question.order != RowOrder::Unspecified || question.max_neighbors.is_some();
    if !is_ordered || structure.gpu().kind() != AdapterKind::Software {
        return Ok(false);
    }
    Ok(count(structure, question)?.summary().max > LONGEST_ORDERED_ROW_ON_SOFTWARE)
}

/// Rows as found on the device; ordered and cut on the host.
fn ordered_on_host<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let unordered = FixedRadius { order: RowOrder::Unspecified, max_neighbors: None, distances: true, ..*question };
    let mut found = whole_list(structure, &unordered)?;
    let mut made = Neighbors { offsets: vec![0], ..Neighbors::default() };
    let (mut distances, mut row) = (Vec::new(), Vec::new());
    for query in 0..found.len() {
        row.clear();
        row.extend(
            found.row(query).iter().copied().zip(found.row_distances(query).unwrap_or_default().iter().copied()),
        );
        row.sort_unstable_by(|a: &(u32, f32), b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let kept = question.max_neighbors.map_or(row.len(), |cap| row.len().min(cap as usize));
        if kept < row.len() {
            made.cut.push(CutRow { query: query as u32, missing: (row.len() - kept) as u32 });
            row.truncate(kept);
        }
        if question.order == RowOrder::Index {
            row.sort_unstable_by_key(|&(id, _)| id);
        }
        made.indices.extend(row.iter().map(|&(id, _)| id));
        distances.extend(row.iter().map(|&(_, distance)| distance));
        made.offsets.push(made.indices.len() as u64);
    }
    made.distances = question.distances.then_some(distances);
    found.report.notes.push("rows too long for a software device were ordered on the host".into());
    Ok(Neighbors { report: found.report, ..made })
}

fn check_host_memory<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, entries: u64) -> Result<()> {
    if entries > rows::entry_limit(question, structure.len()) {
        return Err(rows::too_large(entries, question, structure.len()));
    }
    Ok(())
}

fn whole_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let accept = |entries| check_host_memory(structure, question, entries);
    match list_on_device(structure, question, accept).and_then(|list| read_list(structure.gpu(), list, question)) {
        Err(Error::OutOfDeviceMemory { .. }) => batched_list(structure, question),
        listed => listed,
    }
}

fn read_list(gpu: &Gpu, list: GpuNeighbors, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let mut report = list.report;
    let read = Instant::now();
    let offsets = gpu.read(&list.offsets)?.into_par_iter().map(u64::from).collect();
    let indices = gpu.read(&list.indices)?;
    let distances = match (question.distances, &list.dist2) {
        (true, Some(dist2)) => Some(square_roots(gpu.read(dist2)?)),
        _ => None,
    };
    report.host_stage("read back", read);
    Ok(Neighbors { offsets, indices, distances, cut: Vec::new(), report })
}

fn square_roots(mut dist2: Vec<f32>) -> Vec<f32> {
    dist2.par_iter_mut().with_min_len(1 << 14).for_each(|d| *d = d.sqrt());
    dist2
}

/// Counts all, then fills windows of rows that fit.
fn batched_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Neighbors> {
    let gpu = structure.gpu();
    let counted = count(structure, question)?;
    let counts = counted.as_slice();
    let entries = counts.iter().map(|&c| u64::from(c)).sum();
    check_host_memory(structure, question, entries)?;
    let mut report = report_two_passes(structure, question);
    report.stages = counted.report.stages.iter().filter(|s| s.name != "total").cloned().collect();
    let mut neighbors = Neighbors::default();
    let per_entry = if super::on_device::needs_distances(question) { 8 } else { 4 };
    let mut batches = 0;
    // One window of rows; halved further where its memory cannot be had.
    for window in windows(counts, gpu.limits().binding_bytes / per_entry) {
        batches += halving(window.len(), 1, |part| {
            let part = window.start + part.start..window.start + part.end;
            let n_stages = report.stages.len();
            let filled = fill_part(structure, question, part.clone(), &counts[part], &mut neighbors, &mut report);
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
    neighbors.distances = question.distances.then(|| neighbors.distances.take().unwrap_or_default());
    Ok(Neighbors { offsets, report, ..neighbors })
}

/// Fills the rows of these queries, whose lengths are `counts`, and appends them to `neighbors`, or nothing on failure.
fn fill_part<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    window: Range<usize>,
    counts: &[u32],
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
    let mut commands = gpu.commands("fill rows");
    let rows = record_fill(&mut commands, structure, question, &queries, &offsets, total as usize)?;
    add_stages(report, &commands.run()?);
    let read = Instant::now();
    let indices = gpu.read(&rows.indices)?;
    if let (true, Some(dist2)) = (question.distances, &rows.dist2) {
        let distances = square_roots(gpu.read(dist2)?);
        neighbors.distances.get_or_insert_default().extend(distances);
    }
    neighbors.indices.extend(indices);
    report.host_stage("read back", read);
    Ok(())
}

/// The nearest `cap` neighbours of every query: rows of `cap` places on the device, packed on the host.
fn capped_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, cap: u32) -> Result<Neighbors> {
    let gpu = structure.gpu();
    let mut report = visit::report(structure, "nearest-k", &["package::query::nearest_k"]);
    // No row is longer than the points, so a larger cap needs no more places.
    let places = cap.min(structure.len() as u32);
    let visitor = VisitorCode {
        source: Fill::Module("package::query::nearest_k"),
        features: &[("by_index", false)],
        accesses: &[Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::Uniform],
    };
    let mut made = Neighbors { offsets: vec![0], ..Neighbors::default() };
    let mut distances = Vec::new();
    in_batches(structure, question, 1, &mut report, |queries, report| {
        let n = queries.len();
        let ids: Buffer<u32> = gpu.buffer("nearest indices", n * places as usize)?;
        let dist2: Buffer<f32> = gpu.buffer("nearest distances", n * places as usize)?;
        let counts: Buffer<u32> = gpu.buffer("neighbour counts", n)?;
        let cap_uniform = gpu.uniform("cap", &[places, 0, 0, 0])?;
        let binds: [Bind; 4] = [(&ids).into(), (&dist2).into(), (&counts).into(), (&cap_uniform).into()];
        let mut commands = gpu.commands("nearest neighbours");
        commands.stage("query");
        visit::record(&mut commands, structure, question, queries, &visitor, &binds)?;
        add_stages(report, &commands.run()?);
        let read = Instant::now();
        let (ids, dist2, counts) = (gpu.read(&ids)?, gpu.read(&dist2)?, gpu.read(&counts)?);
        let entries = counts.iter().map(|&c| u64::from(c.min(places))).sum::<u64>() + made.indices.len() as u64;
        check_host_memory(structure, question, entries)?;
        append_capped(&mut made, &mut distances, question, queries.first_id(), places, (&ids, &dist2, &counts));
        report.host_stage("read back", read);
        Ok(())
    })?;
    made.distances = question.distances.then(|| square_roots(distances));
    Ok(Neighbors { report, ..made })
}

/// Appends rows of `places` places, of which each uses as many as it has neighbours.
fn append_capped(
    made: &mut Neighbors,
    distances: &mut Vec<f32>,
    question: &FixedRadius<'_>,
    first_query: u32,
    places: u32,
    (ids, dist2, counts): (&[u32], &[f32], &[u32]),
) {
    let mut row: Vec<(u32, f32)> = Vec::new();
    for (i, &count) in counts.iter().enumerate() {
        let kept = count.min(places);
        let start = i * places as usize;
        let range = start..start + kept as usize;
        row.clear();
        row.extend(ids[range.clone()].iter().copied().zip(dist2[range].iter().copied()));
        if question.order == RowOrder::Index {
            row.sort_unstable_by_key(|&(id, _)| id);
        }
        made.indices.extend(row.iter().map(|&(id, _)| id));
        distances.extend(row.iter().map(|&(_, d2)| d2));
        made.offsets.push(made.indices.len() as u64);
        if kept < count {
            made.cut.push(CutRow { query: first_query + i as u32, missing: count - kept });
        }
    }
}
