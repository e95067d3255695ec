//! The fast list: one walk that counts and keeps hits as masks, a scan, and an expansion with dense stores.
//!
//! A row's cost is in its stores: written one index at a time by the query's own invocation they scatter over memory.
//! Masks of 32 candidates a word are an eighth of the bytes, and a team of 32 invocations writes a word's neighbours
//! side by side. Queries with more words than the masks hold are filled by a second walk.

use super::loops::VisitorRounds;
use super::on_device::{GpuNeighbors, ListSize};
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Kernel, Workgroups};
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::query::{FixedRadius, RowOrder};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Words kept a query. A ball of one cell's radius touches at most 9 rows, most of which fit one word.
const WORDS: u32 = 16;

/// Invocations of a workgroup that expands masks: four teams.
const WORKGROUP: u32 = 128;

/// Whether this question can be answered with masks: only indices, in the order in which they are found.
pub(super) fn applies<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> bool {
    structure.ids().is_some() && !question.distances && question.order == RowOrder::Unspecified
}

/// The list by masks. `accept` sees the size before memory is taken for the entries; rows have no order.
pub(super) fn list_on_device<S: GpuStructure>(
    structure: &S,
    ids: &Buffer<u32>,
    question: &FixedRadius<'_>,
    accept: impl FnOnce(ListSize) -> Result<RowOrder>,
) -> Result<GpuNeighbors> {
    let gpu = structure.gpu();
    let n = question.len(structure.len());
    let visitors = ["package::query::row_masks", "package::query::fill_overflowed"];
    let mut report = visit::report(structure, "row-masks", &visitors[..1]);
    report.kernels.push("package::query::expand_masks".to_owned());
    let queries = QueryBuffers::in_search_order(structure, question)?;
    let offsets = gpu.buffer("row offsets", n + 1)?;
    let words: Buffer<u32> = gpu.buffer("words of queries", n)?;
    let capacity = gpu.uniform("mask capacity", &[WORDS, n as u32, 0, 0])?;
    // [total, overflowed queries], read back together.
    let sums: Buffer<u64> = gpu.buffer("number of entries", 1)?;
    let overflowed: Buffer<u32> = gpu.buffer("overflowed queries", 1)?;
    let masks: Buffer<[u32; 2]> = gpu.buffer("neighbour masks", n * WORDS as usize)?;
    {
        let counts: Buffer<u32> = gpu.buffer("neighbour counts", n)?;
        let visitor = VisitorCode {
            source: Fill::Module(visitors[0]),
            features: &[("masks", true)],
            accesses: &[Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::Uniform],
            rounds: VisitorRounds::default(),
        };
        let binds: [Bind; 5] =
            [(&counts).into(), (&words).into(), (&masks).into(), (&overflowed).into(), (&capacity).into()];
        let mut commands = gpu.commands("find neighbours");
        commands.stage("count").clear(&overflowed);
        visit::record(&mut commands, structure, question, &queries, &visitor, &binds)?;
        commands.stage("scan");
        GpuScan::new(gpu, n)?.record(&mut commands, &counts, &offsets, n)?;
        GpuReduce::new(gpu)?.record_sum(&mut commands, &counts, n, &sums)?;
        super::answers::add_stages(&mut report, &commands.run()?);
    }
    let (total, overflowed) = (gpu.read(&sums)?[0], gpu.read(&overflowed)?[0]);
    accept(ListSize { entries: total, longest_row: 0 })?;
    let available = gpu.limits().binding_bytes;
    if total * 4 > available {
        return Err(Error::OutOfDeviceMemory { what: "neighbour indices".into(), needed: total * 4, available });
    }
    let indices: Buffer<u32> = gpu.buffer("neighbour indices", total as usize)?;
    let accesses = [Access::Uniform, Access::Read, Access::Read, Access::Read, Access::Read, Access::ReadWrite];
    let constants = [("WORKGROUP", f64::from(WORKGROUP))];
    let kernel = Kernel {
        constants: &constants,
        ..Kernel::new("package::query::expand_masks", "expand_masks", &accesses, WORKGROUP)
    };
    let batch = gpu.uniform("expansion batch", &[WORDS, n as u32, 0, 0])?;
    let binds: [Bind; 6] =
        [(&batch).into(), (&words).into(), (&masks).into(), (&offsets).into(), ids.into(), (&indices).into()];
    let mut commands = gpu.commands("write rows");
    commands.stage("fill");
    if total > 0 {
        commands.dispatch(&gpu.pipeline(&kernel)?, &binds, Workgroups::Covering(32 * n as u64));
    }
    if overflowed > 0 {
        report.kernels.push(visitors[1].to_owned());
        commands.stage("fill long rows");
        let visitor = VisitorCode {
            source: Fill::Module(visitors[1]),
            features: &[],
            accesses: &[Access::Read, Access::ReadWrite, Access::Read, Access::Uniform],
            rounds: VisitorRounds::default(),
        };
        let binds: [Bind; 4] = [(&offsets).into(), (&indices).into(), (&words).into(), (&capacity).into()];
        visit::record(&mut commands, structure, question, &queries, &visitor, &binds)?;
    }
    super::answers::add_stages(&mut report, &commands.run()?);
    Ok(GpuNeighbors { offsets, indices, dist2: None, report })
}
