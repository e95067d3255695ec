//! Count and nearest on the device, read back in the caller's order; and the search trait of the GPU structures.

use std::time::Instant;

use super::batch::halving;
use super::list;
use super::visit::{self, QueryBuffers, VisitorCode, Window};
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, StageTime};
use crate::query::{Clock, Counts, FixedRadius, Nearest, NeighborSearch, Neighbors, Report, Stage};
use crate::structure::{GpuBruteForce, GpuStructure, GpuUniformGrid};

pub(super) const COUNT: VisitorCode<'static> =
    VisitorCode { source: Fill::Module("package::query::count"), features: &[], accesses: &[Access::ReadWrite] };

const NEAREST: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::nearest"),
    features: &[],
    accesses: &[Access::ReadWrite, Access::ReadWrite],
};

/// Adds the device's stage times to a report.
pub(super) fn add_stages(report: &mut Report, times: &[StageTime]) {
    for time in times {
        if let Some(milliseconds) = time.milliseconds {
            report.stages.push(Stage { name: time.name, milliseconds, clock: Clock::Device });
        }
    }
}

/// Runs `ask` over all queries: at once in the structure's order, or where memory is short in halves in the caller's
/// order. `ask` gets the queries, the window, and the report.
pub(super) fn in_batches<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    report: &mut Report,
    mut ask: impl FnMut(&QueryBuffers, Window, &mut Report) -> Result<()>,
) -> Result<()> {
    let n = question.len(structure.len());
    let mut caller_order = None;
    let mut ordered = None;
    report.batches = halving(n, |range| {
        if range.len() == n {
            let queries = QueryBuffers::in_search_order(structure, question)?;
            let window = queries.whole();
            return ask(ordered.insert(queries), window, report);
        }
        ordered = None;
        if caller_order.is_none() {
            caller_order = Some(QueryBuffers::in_caller_order(structure, question)?);
        }
        let first = range.start as u32;
        let window = Window { first, count: range.len() as u32, first_id: first };
        match &caller_order {
            Some(queries) => ask(queries, window, report),
            None => Ok(()),
        }
    })?;
    Ok(())
}

pub(super) fn count<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Counts> {
    question.validate(structure.len())?;
    let gpu = structure.gpu();
    let start = Instant::now();
    let mut report = visit::report(structure, "thread-a-query", &["package::query::count"]);
    let mut counts = Vec::with_capacity(question.len(structure.len()));
    in_batches(structure, question, &mut report, |queries, window, report| {
        let buffer: Buffer<u32> = gpu.buffer("neighbour counts", window.count as usize)?;
        let mut commands = gpu.commands("count neighbours");
        commands.stage("query");
        visit::record(&mut commands, structure, question, queries, window, &COUNT, &[(&buffer).into()])?;
        add_stages(report, &commands.run()?);
        let read = Instant::now();
        counts.extend(gpu.read(&buffer)?);
        report.host_stage("read back", read);
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
    in_batches(structure, question, &mut report, |queries, window, report| {
        let index_buffer: Buffer<u32> = gpu.buffer("nearest indices", window.count as usize)?;
        let dist2_buffer: Buffer<f32> = gpu.buffer("nearest distances", window.count as usize)?;
        let binds: [Bind; 2] = [(&index_buffer).into(), (&dist2_buffer).into()];
        let mut commands = gpu.commands("nearest neighbour");
        commands.stage("query");
        visit::record(&mut commands, structure, question, queries, window, &NEAREST, &binds)?;
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

search_on_gpu!(GpuBruteForce, GpuUniformGrid);
