//! Phase I on the device: queries in the order of their leaves, and where packs begin.

use super::back_traverse::kernel;
use crate::Result;
use crate::gpu::{Access, Bind, Buffer, Gpu, StageTime, Workgroups};
use crate::parallel::compact::GpuCompact;
use crate::parallel::radix_sort::GpuRadixSort;
use crate::structure::{DevicePoint, GpuAabbTree, GpuStructure};

pub(in crate::query) const MODULE: &str = "package::query::coherent::pack";

/// Most queries of a pack.
///
/// The loops of phases II and III go over a pack's queries, and a leaf that most queries are nearest to would keep a few
/// invocations busy alone. Packs are cut at multiples of this place, which splits at most one leaf in so many queries.
pub(super) const MOST_QUERIES: u32 = 4096;

/// Queries in packs.
#[derive(Debug)]
pub(super) struct Packs {
    /// `[n]` in the order of their leaves.
    pub(super) queries: Buffer<DevicePoint>,
    /// `[n]` number of the leaf of each.
    pub(super) leaves: Buffer<u32>,
    /// `[n]`, of which the first `len` are the first query of each pack.
    pub(super) first: Buffer<u32>,
    /// Number of packs.
    pub(super) len: usize,
    pub(super) stages: Vec<StageTime>,
}

/// Packs queries by the leaf that each is nearest to on the way down; `own` queries are the points of the tree in its
/// order, whose leaves are known.
///
/// There must be a point and a query.
pub(super) fn pack(tree: &GpuAabbTree, queries: &Buffer<DevicePoint>, own: bool) -> Result<Packs> {
    use Access::{Read, ReadWrite, Uniform};
    let gpu = GpuStructure::gpu(tree);
    let n = queries.len();
    let bindings = tree.bindings();
    let [(_, layout), _, (_, nodes)] = &bindings[..] else { unreachable!("a tree should have three bindings") };
    let parameters = Bind::from(&gpu.uniform("pack parameters", &[n as u32, MOST_QUERIES, 0, 0])?);
    let features = tree.features();
    let made = |entry: &str, accesses: &[Access]| kernel(gpu, (MODULE, entry), accesses, &features);
    let leaves: Buffer<u32> = gpu.buffer("leaves of queries", n)?;
    let flags: Buffer<u32> = gpu.buffer("first queries of packs", n)?;
    let first: Buffer<u32> = gpu.buffer("packs", n)?;
    let count: Buffer<u32> = gpu.buffer("number of packs", 1)?;
    let covering = Workgroups::Covering(n as u64);
    let mut commands = gpu.commands("pack queries");
    commands.stage("pack");
    let (queries, leaves) = if own {
        let own_leaves = made("own_leaves", &[Uniform, Uniform, Read, ReadWrite])?;
        let n_leaves = Workgroups::Covering(tree.shape().n_leaves() as u64);
        let binds = [parameters.clone(), layout.clone(), nodes.clone(), (&leaves).into()];
        commands.dispatch(&own_leaves, &binds, n_leaves);
        (queries.clone(), leaves)
    } else {
        let find_leaves = made("find_leaves", &[Uniform, Uniform, Read, ReadWrite, Read])?;
        let binds = [parameters.clone(), layout.clone(), nodes.clone(), (&leaves).into(), queries.into()];
        commands.dispatch(&find_leaves, &binds, covering.clone());
        sorted_by_leaf(gpu, &mut commands, tree, &parameters, queries, &leaves)?
    };
    let mark_packs = made("mark_packs", &[Uniform, Read, ReadWrite])?;
    commands.dispatch(&mark_packs, &[parameters, (&leaves).into(), (&flags).into()], covering);
    GpuCompact::new(gpu, n)?.record(&mut commands, &flags, &first, &count, n)?;
    let stages = commands.run()?;
    let len = gpu.read(&count)?[0] as usize;
    Ok(Packs { queries, leaves, first, len, stages })
}

/// Records sorting queries by their leaves; returns both in that order.
fn sorted_by_leaf(
    gpu: &Gpu,
    commands: &mut crate::gpu::Commands,
    tree: &GpuAabbTree,
    parameters: &Bind,
    queries: &Buffer<DevicePoint>,
    leaves: &Buffer<u32>,
) -> Result<(Buffer<DevicePoint>, Buffer<u32>)> {
    use Access::{Read, ReadWrite, Uniform};
    let n = queries.len();
    let sorted_leaves: Buffer<u32> = gpu.buffer("sorted leaves of queries", n)?;
    let order: Buffer<u32> = gpu.buffer("order of queries", n)?;
    let sorted: Buffer<DevicePoint> = gpu.buffer("queries by leaf", n)?;
    let bits = 0..tree.shape().depth().max(1);
    GpuRadixSort::new(gpu, n)?.record_from(commands, leaves, None, &sorted_leaves, &order, n, bits)?;
    let gather = kernel(gpu, (MODULE, "gather_queries"), &[Uniform, Read, Read, ReadWrite], &tree.features())?;
    let binds = [parameters.clone(), (&order).into(), queries.into(), (&sorted).into()];
    commands.dispatch(&gather, &binds, Workgroups::Covering(n as u64));
    Ok((sorted, sorted_leaves))
}
