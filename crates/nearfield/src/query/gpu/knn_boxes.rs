//! The nearest points from a tree of boxes on the device: packs of queries go through the tree together where they suit
//! (`knn_packs`), and what they leave, or everything, is searched query by query, a run of the kernel for each 32 places of a row.

use bytemuck::{Pod, Zeroable};

use super::knn::{NearestOnDevice, Rows};
use super::knn_packs::{LeftQueries, Packs};
use super::loops;
use super::visit::{Dealing, QueryBuffers};
use crate::Result;
use crate::gpu::{Access, Bind, Commands, Kernel};
use crate::query::{FixedRadius, Knn};
use crate::structure::{GpuAabbTree, GpuStructure};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;

/// Places of a row that one run fills at most, and the sizes that the kernels are made for.
pub(super) const MOST_PLACES: u32 = 32;
const SIZES: [(&str, u32); 4] = [("few", 4), ("some", 8), ("many", 16), ("most", MOST_PLACES)];

/// Conditions of kernels that keep so many neighbours in registers, at most [`MOST_PLACES`].
pub(super) fn size_features(places: u32) -> impl Iterator<Item = (&'static str, bool)> {
    let size = SIZES.iter().position(|&(_, size)| places <= size).expect("the largest size should hold a run");
    SIZES.iter().enumerate().map(move |(i, &(name, _))| (name, i == size))
}

/// How the kernels use what they have bound from 0 to 7.
pub(super) const ACCESSES: [Access; 8] = {
    use Access::{Read, ReadWrite, Uniform};
    [Uniform, Read, Read, Uniform, Read, Read, ReadWrite, ReadWrite]
};

/// `KnnRun` in knn_run.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct KnnRun {
    /// Number of queries.
    pub count: u32,
    /// The caller's index that has slot 0.
    pub first_id: u32,
    /// 1 to leave out the query itself.
    pub exclude_self: u32,
    /// 1 where each query has its own radius.
    pub own_radius: u32,
    /// The radius where all have one.
    pub radius: f32,
    /// Places of a row, at least 1.
    pub k: u32,
    /// First place of this run.
    pub first: u32,
    /// 1 where 2^level workgroups share the queries evenly.
    pub in_parts: u32,
    /// See `in_parts`.
    pub level: u32,
    /// 1 where queries are the points in the tree's order.
    pub are_points: u32,
    /// Unused.
    pub padding: [u32; 2],
}

/// Rows that are to be filled, and what the kernels that fill them have in common.
pub(super) struct NearestRun<'a> {
    pub(super) tree: &'a GpuAabbTree,
    pub(super) within: &'a FixedRadius<'a>,
    pub(super) queries: &'a QueryBuffers,
    /// Places of a row, at least 1.
    pub(super) places: u32,
    rows: &'a Rows,
}

impl NearestRun<'_> {
    /// Conditions of a kernel that fills the places of rows from `first` on.
    pub(super) fn features(&self, first: u32) -> Vec<(&'static str, bool)> {
        let mut features = vec![("periodic", self.tree.settings().period.is_periodic())];
        features.extend(size_features((self.places - first).min(MOST_PLACES)));
        features.extend([("fours", self.places.is_multiple_of(4)), ("excludes", self.within.exclude_self)]);
        features
    }

    /// What a kernel has bound from 0 to 7.
    pub(super) fn binds(&self, first: u32, dealing: &Dealing) -> Result<Vec<Bind>> {
        let (own_radius, radius) = self.within.radius.parameters();
        let run = KnnRun {
            count: self.queries.len() as u32,
            first_id: self.queries.first_id(),
            exclude_self: u32::from(self.within.exclude_self),
            own_radius,
            radius,
            k: self.places,
            first,
            in_parts: dealing.in_parts,
            level: dealing.level,
            are_points: u32::from(self.queries.are_points()),
            padding: [0; 2],
        };
        let run = self.tree.gpu().uniform("nearest run", &run)?;
        let mut binds: Vec<Bind> = vec![(&run).into(), self.queries.points().into(), self.queries.radii().into()];
        binds.extend(self.tree.bindings().into_iter().map(|(_, bind)| bind));
        binds.extend([Bind::from(&self.rows.ids), Bind::from(&self.rows.dist2)]);
        Ok(binds)
    }

    /// Records a search query by query for the places of rows from `first` on: of all, or of those that packs left.
    fn record(&self, commands: &mut Commands, first: u32, left: Option<&LeftQueries>) -> Result<()> {
        // Only those that go together gain from staying within a node.
        let together = self.tree.rounds_in_step() == 1;
        let dealing = match left {
            None if together => Dealing::of(self.tree, self.queries, WORKGROUP),
            _ => Dealing::fixed(self.queries.len(), WORKGROUP),
        };
        let mut features = self.features(first);
        features.extend([("packed", together), ("listed", left.is_some())]);
        let mut accesses = ACCESSES.to_vec();
        let mut binds = self.binds(first, &dealing)?;
        if let Some(left) = left {
            accesses.extend([Access::Read; 2]);
            binds.extend(left.binds());
        }
        let kernel = Kernel {
            features: &features,
            constants: &[("WORKGROUP", f64::from(dealing.workgroup))],
            ..Kernel::new(GpuAabbTree::KERNEL, "find_nearest", &accesses, dealing.workgroup)
        };
        commands.dispatch(&self.tree.gpu().prepare(&kernel)?, &binds, dealing.covering());
        Ok(())
    }
}

impl NearestOnDevice for GpuAabbTree {
    const NEAREST: &'static str = "nearest-boxes";
    const KERNEL: &'static str = "package::query::knn_boxes";

    fn record_nearest(
        &self,
        commands: &mut Commands,
        within: &FixedRadius<'_>,
        queries: &QueryBuffers,
        places: u32,
        rows: &Rows,
    ) -> Result<&'static [&'static str]> {
        let run = NearestRun { tree: self, within, queries, places, rows };
        if let Some(packs) = Packs::suiting(&run) {
            let left = packs.record(commands, &run)?;
            run.record(commands, 0, Some(&left))?;
            return Ok(&[Packs::KERNEL]);
        }
        for first in (0..places).step_by(MOST_PLACES as usize) {
            run.record(commands, first, None)?;
        }
        Ok(&[])
    }

    fn check_loops(&self, _: &Knn<'_>, places: usize) -> Result<()> {
        let Some(limit) = self.gpu().limits().loop_rounds.filter(|_| places > 0) else { return Ok(()) };
        // Two steps a leaf; in it the looks that end three loops, and rounds that are not full; every point as one of eight, as
        // one of 32 and as one in reach; a query's leaf and its row.
        let rounds = (8 * self.shape().n_leaves() + self.len() + self.len() / 8 + self.len() / 32) as u64 + 128;
        let in_step = self.rounds_in_step();
        if rounds * in_step <= u64::from(limit) {
            return Ok(());
        }
        Err(loops::too_long_for_nearest(self, places, limit, "use the CPU or fewer points"))
    }
}
