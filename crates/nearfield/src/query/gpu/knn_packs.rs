//! The nearest points from a tree of boxes by packs: the queries of a subgroup go through the tree together.
//!
//! That takes 0.4 to 0.6 of the time of a search query by query where queries are as dense as the points. Sparse ones have little
//! in common, and those in any order nothing: each would wait for the ways of all others.

use super::knn_boxes::{ACCESSES, MOST_PLACES, NearestRun};
use super::visit::Dealing;
use crate::Result;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel};
use crate::structure::{GpuAabbTree, GpuStructure};

/// Invocations of a workgroup where the structure does not ask for parts. For 16 of uniform-1m on an H200: 1.62 ms, and 1.77 with 32.
const WORKGROUP: u32 = 64;

/// Points that the kernel tests together, a span of them: a tree has at least so many.
pub const KNN_SPAN_POINTS: usize = 16;

/// `PACKS` of knn_packs.wesl: of a workgroup, usual ones and under `crowded`.
const MOST_PACKS: u32 = 2;
const MOST_CROWDED_PACKS: u32 = 8;

/// Other queries go in packs if there are at least this part of the points.
const LEAST_QUERIES: f64 = 0.25;

/// The smallest subgroup that the kernel can work with.
const SMALLEST_PACK: u32 = 4;

/// Packs for a question that suits them.
pub(super) struct Packs {
    dealing: Dealing,
    /// Most packs of a workgroup.
    in_workgroup: u32,
}

/// Queries that packs leave to another kernel.
pub(super) struct LeftQueries {
    number: Buffer<u32>,
    places: Buffer<u32>,
}

impl LeftQueries {
    /// Memory for so many, of which there are none yet.
    pub(super) fn none_of(commands: &mut Commands, gpu: &Gpu, n: usize) -> Result<Self> {
        let number = gpu.buffer("number of queries left", 1)?;
        commands.clear(&number);
        Ok(Self { number, places: gpu.buffer("queries left", n)? })
    }

    /// The number and the places.
    pub(super) fn binds(&self) -> [Bind; 2] {
        [(&self.number).into(), (&self.places).into()]
    }
}

impl Packs {
    /// Module of the kernel.
    pub(super) const KERNEL: &'static str = "package::query::knn_packs";

    /// Packs where rows, queries, tree and device suit them.
    pub(super) fn suiting(run: &NearestRun<'_>) -> Option<Self> {
        let (tree, queries, limits) = (run.tree, run.queries, run.tree.gpu().limits());
        let n = GpuStructure::len(tree);
        let are_dense = queries.are_points() || queries.len() as f64 >= LEAST_QUERIES * n as f64;
        let (smallest, _) = limits.subgroup.filter(|&(smallest, _)| smallest >= SMALLEST_PACK)?;
        let dealing = Dealing::of(tree, queries, WORKGROUP);
        let in_workgroup = dealing.workgroup.div_ceil(smallest);
        let suits = run.places <= MOST_PLACES
            && n >= KNN_SPAN_POINTS
            && queries.are_near()
            && are_dense
            && in_workgroup <= MOST_CROWDED_PACKS
            && limits.loop_rounds.is_none_or(|limit| most_rounds(tree) <= u64::from(limit));
        suits.then_some(Self { dealing, in_workgroup })
    }

    /// Records the search; the rows of those left are not filled.
    pub(super) fn record(&self, commands: &mut Commands, run: &NearestRun<'_>) -> Result<LeftQueries> {
        let gpu = run.tree.gpu();
        let left = LeftQueries::none_of(commands, gpu, run.queries.len())?;
        let mut accesses = ACCESSES.to_vec();
        accesses.extend([Access::ReadWrite; 2]);
        let mut features = run.features(0);
        features.push(("crowded", self.in_workgroup > MOST_PACKS));
        let kernel = Kernel {
            features: &features,
            constants: &[("WORKGROUP", f64::from(self.dealing.workgroup))],
            ..Kernel::new(Self::KERNEL, "find_nearest", &accesses, self.dealing.workgroup)
        };
        let mut binds = run.binds(0, &self.dealing)?;
        binds.extend(left.binds());
        commands.dispatch(&gpu.prepare(&kernel)?, &binds, self.dealing.covering());
        Ok(left)
    }
}

/// Rounds that all loops of an invocation take together at most.
fn most_rounds(tree: &GpuAabbTree) -> u64 {
    // With two levels at a time and more: 5/3 steps a leaf. In a leaf 2 rounds more than it has full spans of 16 points, and for each
    // span that is not full or is 4 to put hits into words and 4 as its share of giving numbers again.
    (12 * tree.shape().n_leaves() + GpuStructure::len(tree)) as u64 + 256
}
