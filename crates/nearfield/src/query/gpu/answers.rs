//! Count and nearest on the device, read back in the caller's order; and the search trait of the GPU structures.

use std::time::Instant;

use super::batch::halving;
use super::list;
use super::loops::VisitorRounds;
use super::pairs::Pairs;
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, StageTime};
use crate::query::{Clock, Counts, FixedRadius, Nearest, NeighborSearch, Neighbors, Report, Stage};
use crate::structure::{GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuStructure, GpuUniformGrid};

const COUNT: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::count"),
    features: &[],
    accesses: &[Access::ReadWrite],
    rounds: VisitorRounds { each: 0, finish: 0 },
    combines: false,
};

const COUNT_MASKS: VisitorCode<'static> = VisitorCode { features: &[("masks", true)], ..COUNT };

/// The visitor that counts for this structure.
fn counter<S: GpuStructure>(structure: &S) -> &'static VisitorCode<'static> {
    if structure.counts_by_masks() && structure.coherent_tree().is_none() { &COUNT_MASKS } else { &COUNT }
}

/// Records the counts of these queries by slot: in pairs, which are returned, or one by one.
///
/// # Errors
/// As [`Pairs::of`] and [`visit::record`].
pub(super) fn record_counts<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    question: &FixedRadius<'_>,
    queries: &QueryBuffers,
    counts: &Buffer<u32>,
) -> Result<Option<Pairs>> {
    let pairs = Pairs::of(structure, question, queries)?;
    match &pairs {
        Some(pairs) => pairs.record_counts(commands, counts)?,
        None => record_row_lengths(commands, structure, question, queries, counts)?,
    }
    Ok(pairs)
}

/// The same for rows that `fill` is to fill: by the same walk, which rounds each distance alike.
///
/// # Errors
/// As [`visit::record`].
pub(super) fn record_row_lengths<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    question: &FixedRadius<'_>,
    queries: &QueryBuffers,
    counts: &Buffer<u32>,
) -> Result<()> {
    visit::record(commands, structure, question, queries, counter(structure), &[counts.into()])
}

const NEAREST: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::nearest"),
    features: &[],
    accesses: &[Access::ReadWrite, Access::ReadWrite],
    rounds: VisitorRounds { each: 0, finish: 0 },
    combines: false,
};

/// Adds the device's stage times to a report.
pub(in crate::query) fn add_stages(report: &mut Report, times: &[StageTime]) {
    for time in times {
        if let Some(milliseconds) = time.milliseconds {
            report.stages.push(Stage { name: time.name, milliseconds, clock: Clock::Device });
        }
    }
}

/// Fewest queries of a batch where each has an answer of a few bytes: with no memory for that, there is none for
/// anything.
pub(super) const FEW_QUERIES: usize = 64;

/// Runs `ask` over all queries: at once in the structure's order, or where memory is short in halves of at least
/// `smallest` queries in the caller's order. `ask` gets the queries and the report; it must not keep parts of an answer
/// when it fails.
pub(super) fn in_batches<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    smallest: usize,
    report: &mut Report,
    mut ask: impl FnMut(&QueryBuffers, &mut Report) -> Result<()>,
) -> Result<()> {
    let n = question.len(structure.len());
    report.batches = halving(n, smallest, |range| {
        let n_stages = report.stages.len();
        let queries = if range.len() == n {
            QueryBuffers::in_search_order(structure, question)
        } else {
            QueryBuffers::in_caller_order(structure, question, range)
        };
        let asked = queries.and_then(|queries| {
            queries.add_stages_to(report);
            ask(&queries, report)
        });
        if asked.is_err() {
            // Times of a batch that is tried again would count its work twice.
            report.stages.truncate(n_stages);
        }
        asked
    })?;
    Ok(())
}

/// Number of neighbours of every query, on the host.
fn count<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Counts> {
    count_by(structure, question, record_counts)
}

/// The same for rows that `fill` is to fill.
pub(super) fn row_lengths<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Counts> {
    count_by(structure, question, |commands, structure, question, queries, counts| {
        record_row_lengths(commands, structure, question, queries, counts).map(|()| None)
    })
}

fn count_by<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    record: impl Fn(&mut Commands, &S, &FixedRadius<'_>, &QueryBuffers, &Buffer<u32>) -> Result<Option<Pairs>>,
) -> Result<Counts> {
    question.validate(structure.len())?;
    let gpu = structure.gpu();
    let start = Instant::now();
    let mut report = visit::report(structure, "thread-a-query", &["package::query::count"]);
    let mut counts = Vec::with_capacity(question.len(structure.len()));
    in_batches(structure, question, FEW_QUERIES, &mut report, |queries, report| {
        let buffer: Buffer<u32> = gpu.buffer("neighbour counts", queries.len())?;
        let mut commands = gpu.commands("count neighbours");
        commands.stage("query");
        let pairs = record(&mut commands, structure, question, queries, &buffer)?;
        add_stages(report, &commands.run()?);
        let read = Instant::now();
        counts.extend(gpu.read(&buffer)?);
        report.host_stage("read back", read);
        if let Some(pairs) = pairs {
            pairs.name_in(report);
        }
        Ok(())
    })?;
    report.host_stage("total", start);
    Ok(Counts { counts, report })
}

pub(super) fn nearest<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Nearest> {
    question.validate(structure.len())?;
    let gpu = structure.gpu();
    let start = Instant::now();
    let mut report = visit::report(structure, "thread-a-query", &["package::query::nearest"]);
    let n = question.len(structure.len());
    let (mut indices, mut dist2) = (Vec::with_capacity(n), Vec::with_capacity(n));
    in_batches(structure, question, FEW_QUERIES, &mut report, |queries, report| {
        let index_buffer: Buffer<u32> = gpu.buffer("nearest indices", queries.len())?;
        let dist2_buffer: Buffer<f32> = gpu.buffer("nearest distances", queries.len())?;
        let binds: [Bind; 2] = [(&index_buffer).into(), (&dist2_buffer).into()];
        let mut commands = gpu.commands("nearest neighbour");
        commands.stage("query");
        visit::record(&mut commands, structure, question, queries, &NEAREST, &binds)?;
        add_stages(report, &commands.run()?);
        let read = Instant::now();
        let (new_indices, new_dist2) = (gpu.read(&index_buffer)?, gpu.read(&dist2_buffer)?);
        indices.extend(new_indices);
        dist2.extend(new_dist2);
        report.host_stage("read back", read);
        Ok(())
    })?;
    for (d2, _) in dist2.iter_mut().zip(&indices).filter(|(_, index)| **index == Nearest::NONE) {
        *d2 = f32::INFINITY;
    }
    report.host_stage("total", start);
    Ok(Nearest { indices, dist2, report })
}

/// The search trait for a GPU structure, by the functions of this folder. (A blanket implementation would overlap
/// with that for CPU structures.)
macro_rules! search_on_gpu {
    ($($structure:ty),*) => {$(
        impl NeighborSearch for $structure {
            fn structure(&self) -> &'static str {
                <$structure as GpuStructure>::NAME
            }

            fn device(&self) -> String {
                self.gpu().name().to_owned()
            }

            fn len(&self) -> usize {
                GpuStructure::len(self)
            }

            fn memory_bytes(&self) -> u64 {
                GpuStructure::memory_bytes(self)
            }

            fn build_stages(&self) -> Vec<Stage> {
                GpuStructure::build_stages(self).iter().map(Stage::from).collect()
            }

            fn count(&self, question: &FixedRadius<'_>) -> Result<Counts> {
                count(self, question)
            }

            fn list(&self, question: &FixedRadius<'_>) -> Result<Neighbors> {
                list::list(self, question)
            }

            fn nearest(&self, question: &FixedRadius<'_>) -> Result<Nearest> {
                nearest(self, question)
            }
        }
    )*};
}

search_on_gpu!(GpuBruteForce, GpuUniformGrid, GpuLinearOctree, GpuAabbTree);
