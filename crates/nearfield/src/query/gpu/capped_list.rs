//! The list with a cap: the nearest neighbours of every query.

use std::time::Instant;

use super::answers::{add_stages, in_batches};
use super::list::{check_host_memory, square_roots, whole_list};
use super::loops;
use super::visit::{self, VisitorCode};
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer};
use crate::query::{CutRow, FixedRadius, Neighbors, RowOrder};
use crate::structure::GpuStructure;

/// The nearest `cap` neighbours of every query: rows of `cap` places on the device, packed on the host.
pub(super) fn capped_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, cap: u32) -> Result<Neighbors> {
    // No row is longer than the points, so a larger cap needs no more places.
    let places = cap.min(structure.len() as u32);
    let rounds = loops::of_nearest_k(places);
    if !loops::can_visit(structure, question, rounds)? {
        return cut_whole_list(structure, question, cap);
    }
    let gpu = structure.gpu();
    let mut report = visit::report(structure, "nearest-k", &["package::query::nearest_k"]);
    let visitor = VisitorCode {
        source: Fill::Module("package::query::nearest_k"),
        features: &[("by_index", false)],
        accesses: &[Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::Uniform],
        rounds,
        combines: false,
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
    for (i, &found) in counts.iter().enumerate() {
        let start = i * places as usize;
        let row = start..start + found.min(places) as usize;
        append_row(made, distances, question.order, first_query + i as u32, found, (&ids[row.clone()], &dist2[row]));
    }
}

/// Appends the kept part of a row, in ascending distance, of which `found` neighbours were found.
fn append_row(
    made: &mut Neighbors,
    distances: &mut Vec<f32>,
    order: RowOrder,
    query: u32,
    found: u32,
    (ids, new_distances): (&[u32], &[f32]),
) {
    let mut row: Vec<(u32, f32)> = ids.iter().copied().zip(new_distances.iter().copied()).collect();
    if order == RowOrder::Index {
        row.sort_unstable_by_key(|&(id, _)| id);
    }
    made.indices.extend(row.iter().map(|&(id, _)| id));
    distances.extend(row.iter().map(|&(_, distance)| distance));
    made.offsets.push(made.indices.len() as u64);
    let kept = ids.len() as u32;
    if kept < found {
        made.cut.push(CutRow { query, missing: found - kept });
    }
}

/// The same from the whole list, where the device's loops would end before the nearest are found.
fn cut_whole_list<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, cap: u32) -> Result<Neighbors> {
    let whole = FixedRadius { max_neighbors: None, order: RowOrder::Distance, max_bytes: None, ..question.distances() };
    let list = whole_list(structure, &whole)?;
    let cut = Instant::now();
    let found: Vec<u32> = list.offsets.windows(2).map(|ends| (ends[1] - ends[0]) as u32).collect();
    check_host_memory(structure, question, found.iter().map(|&found| u64::from(found.min(cap))).sum())?;
    let mut made = Neighbors { offsets: vec![0], report: list.report, ..Neighbors::default() };
    let (mut distances, whole_distances) = (Vec::new(), list.distances.unwrap_or_default());
    for (query, (&start, &found)) in list.offsets.iter().zip(&found).enumerate() {
        let kept = start as usize..start as usize + found.min(cap) as usize;
        let row = (&list.indices[kept.clone()], &whole_distances[kept]);
        append_row(&mut made, &mut distances, question.order, query as u32, found, row);
    }
    made.distances = question.distances.then_some(distances);
    made.report.notes.push("the host cut the rows: the device cannot keep the nearest of so many".to_owned());
    made.report.host_stage("cut rows on the host", cut);
    Ok(made)
}
