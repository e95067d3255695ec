//! The fast list: one walk that counts and keeps hits as masks, starts of rows, and an expansion with dense stores.
//!
//! A row's cost is in its stores: written one index at a time by the query's own invocation they scatter over memory.
//! Masks of 32 candidates a word are an eighth of the bytes, and a team of 32 invocations writes a row's neighbours
//! side by side. Queries with more words than the masks hold are filled by a second walk.

use super::loops::VisitorRounds;
use super::on_device::{GpuNeighborRows, GpuNeighbors, ListSize};
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Workgroups};
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::query::{FixedRadius, Report, RowOrder};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Invocations of a workgroup that expands masks: four teams.
const EXPAND_WORKGROUP: u32 = 128;

/// Rows of a workgroup that reserves places.
const RESERVE_WORKGROUP: u32 = 256;

const FIND: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::row_masks"),
    features: &[("masks", true)],
    accesses: &[Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::Uniform],
    rounds: VisitorRounds { each: 0, finish: 0 },
    combines: false,
};

const FILL_OVERFLOWED: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::fill_overflowed"),
    features: &[],
    accesses: &[Access::Read, Access::ReadWrite, Access::Read, Access::Uniform],
    rounds: VisitorRounds { each: 0, finish: 0 },
    combines: false,
};

/// The indices of the structure's points, where this question can be answered with masks: only indices, in the order
/// in which they are found, and masks of all queries within one binding. Candidate lists have no runs to make masks of.
pub(super) fn applies<'a, S: GpuStructure>(structure: &'a S, question: &FixedRadius<'_>) -> Option<&'a Buffer<u32>> {
    let plain = !question.distances && question.order == RowOrder::Unspecified;
    let mask_bytes = question.len(structure.len()) as u64 * u64::from(structure.mask_words()) * 8;
    let walks = structure.coherent_tree().is_none();
    structure.ids().filter(|_| walks && plain && mask_bytes <= structure.gpu().limits().binding_bytes)
}

/// The list by masks, rows in query order. `accept` sees the size before memory is taken for the entries; rows have no
/// order within.
pub(super) fn list_on_device<S: GpuStructure>(
    structure: &S,
    ids: &Buffer<u32>,
    question: &FixedRadius<'_>,
    accept: impl FnOnce(ListSize) -> Result<RowOrder>,
) -> Result<GpuNeighbors> {
    let gpu = structure.gpu();
    let n = question.len(structure.len());
    let offsets = gpu.buffer("row offsets", n + 1)?;
    let mut search = MaskSearch::new(structure, question)?;
    let total = search.find(&offsets, |commands, counts, sum| {
        GpuScan::new(gpu, n)?.record(commands, counts, &offsets, n)?;
        GpuReduce::new(gpu)?.record_sum(commands, counts, n, sum)
    })?;
    accept(ListSize { entries: total, longest_row: 0 })?;
    let indices = search.write_rows(ids, &offsets, total)?;
    Ok(GpuNeighbors { offsets, indices, dist2: None, report: search.report })
}

/// The list by masks, rows in the order in which their workgroups reserve places.
pub(super) fn rows_on_device<S: GpuStructure>(
    structure: &S,
    ids: &Buffer<u32>,
    question: &FixedRadius<'_>,
) -> Result<GpuNeighborRows> {
    let gpu = structure.gpu();
    let n = question.len(structure.len());
    let starts = gpu.buffer("row starts", n)?;
    let mut search = MaskSearch::new(structure, question)?;
    search.report.search = "row-masks, completion order";
    search.report.kernels.push("package::query::reserve_rows".to_owned());
    let kernel = Kernel {
        constants: &[("WORKGROUP", f64::from(RESERVE_WORKGROUP))],
        ..Kernel::new(
            "package::query::reserve_rows",
            "reserve_rows",
            &[Access::Uniform, Access::Read, Access::ReadWrite, Access::ReadWrite],
            RESERVE_WORKGROUP,
        )
    };
    let reserve = gpu.pipeline(&kernel)?;
    let n_rows = gpu.uniform("reservation parameters", &[n as u32, 0, 0, 0])?;
    let taken: Buffer<u32> = gpu.buffer("reserved places", 1)?;
    let total = search.find(&starts, |commands, counts, sum| {
        commands.clear(&taken).dispatch(
            &reserve,
            &[(&n_rows).into(), counts.into(), (&starts).into(), (&taken).into()],
            Workgroups::Covering(n as u64),
        );
        GpuReduce::new(gpu)?.record_sum(commands, counts, n, sum)
    })?;
    let indices = search.write_rows(ids, &starts, total)?;
    Ok(GpuNeighborRows { starts, lengths: search.counts, indices, report: search.report })
}

/// One search by masks: its buffers and its report.
struct MaskSearch<'a, S> {
    structure: &'a S,
    question: &'a FixedRadius<'a>,
    queries: QueryBuffers,
    counts: Buffer<u32>,
    words: Buffer<u32>,
    /// Two words an element.
    masks: Buffer<[u32; 4]>,
    overflowed: Buffer<u32>,
    capacity: Buffer<[u32; 4]>,
    report: Report,
}

impl<'a, S: GpuStructure> MaskSearch<'a, S> {
    fn new(structure: &'a S, question: &'a FixedRadius<'a>) -> Result<Self> {
        let gpu = structure.gpu();
        let n = question.len(structure.len());
        Ok(Self {
            structure,
            question,
            queries: QueryBuffers::in_search_order(structure, question)?,
            counts: gpu.buffer("neighbour counts", n)?,
            words: gpu.buffer("words of queries", n)?,
            masks: gpu.buffer("neighbour masks", n * structure.mask_words() as usize / 2)?,
            overflowed: gpu.buffer("overflowed queries", 1)?,
            capacity: gpu.uniform("mask capacity", &[structure.mask_words(), n as u32, 0, 0])?,
            report: visit::report(structure, "row-masks", &["package::query::row_masks"]),
        })
    }

    /// Counts, keeps masks, and places rows with `place(commands, counts, sum)`, which also records the sum of the
    /// counts. Returns the sum.
    fn find(
        &mut self,
        starts: &Buffer<u32>,
        place: impl FnOnce(&mut Commands, &Buffer<u32>, &Buffer<u64>) -> Result<()>,
    ) -> Result<u64> {
        let gpu = self.structure.gpu();
        let sum: Buffer<u64> = gpu.buffer("number of entries", 1)?;
        let binds: [Bind; 5] = [
            (&self.counts).into(),
            (&self.words).into(),
            (&self.masks).into(),
            (&self.overflowed).into(),
            (&self.capacity).into(),
        ];
        let mut commands = gpu.commands("find neighbours");
        commands.stage("count").clear(&self.overflowed);
        visit::record(&mut commands, self.structure, self.question, &self.queries, &FIND, &binds)?;
        commands.stage("scan");
        place(&mut commands, &self.counts, &sum)?;
        super::answers::add_stages(&mut self.report, &commands.run()?);
        let total = gpu.read(&sum)?[0];
        let available = gpu.limits().binding_bytes;
        if total * 4 > available {
            let what = format!("neighbour indices ({} rows)", starts.len());
            return Err(Error::OutOfDeviceMemory { what, needed: total * 4, available });
        }
        Ok(total)
    }

    /// Writes all rows where `starts` says.
    fn write_rows(&mut self, ids: &Buffer<u32>, starts: &Buffer<u32>, total: u64) -> Result<Buffer<u32>> {
        let gpu = self.structure.gpu();
        let n_rows = self.counts.len() as u64;
        let indices: Buffer<u32> = gpu.buffer("neighbour indices", total as usize)?;
        self.report.kernels.push("package::query::expand_masks".to_owned());
        let kernel = Kernel {
            constants: &[("WORKGROUP", f64::from(EXPAND_WORKGROUP))],
            ..Kernel::new(
                "package::query::expand_masks",
                "expand_masks",
                &[
                    Access::Uniform,
                    Access::Read,
                    Access::Read,
                    Access::Read,
                    Access::Read,
                    Access::Read,
                    Access::ReadWrite,
                ],
                EXPAND_WORKGROUP,
            )
        };
        let binds: [Bind; 7] = [
            (&self.capacity).into(),
            (&self.words).into(),
            (&self.masks).into(),
            starts.into(),
            (&self.counts).into(),
            ids.into(),
            (&indices).into(),
        ];
        let mut commands = gpu.commands("write rows");
        commands.stage("fill");
        if total > 0 {
            // A team of 32 invocations a row.
            commands.dispatch(&gpu.pipeline(&kernel)?, &binds, Workgroups::Covering(32 * n_rows));
        }
        if gpu.read(&self.overflowed)?[0] > 0 {
            self.report.kernels.push("package::query::fill_overflowed".to_owned());
            commands.stage("fill long rows");
            let binds: [Bind; 4] = [starts.into(), (&indices).into(), (&self.words).into(), (&self.capacity).into()];
            let (structure, question) = (self.structure, self.question);
            visit::record(&mut commands, structure, question, &self.queries, &FILL_OVERFLOWED, &binds)?;
        }
        super::answers::add_stages(&mut self.report, &commands.run()?);
        Ok(indices)
    }
}
