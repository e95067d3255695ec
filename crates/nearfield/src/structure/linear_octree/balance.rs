//! 2:1 balance: leaves that touch differ by at most one level. `balance.wesl` holds the kernels.
//!
//! An octant of level m that is cut has children that ask the octants around it to be there: so the parents of its 26
//! neighbours must be cut. Taken from the deepest level up, that gives every octant to cut in one sweep, however far the
//! ripple goes. Octants without points count on the way, as in a complete octree, which makes the result unique; only
//! leaves with points are kept. Source: Sundar2008. Differs: one sweep over the cut octants instead of the leaves.

use rayon::prelude::*;

use super::LinearOctree;
use super::build::{self, CurveKey, LeafHead};
use crate::Result;
use crate::curve::{Curve, MAX_LEVEL, Octant};

impl LinearOctree {
    /// The coarsest refinement in which leaves that share a face, an edge or a corner differ by at most one level, with
    /// octants without points counted as leaves. Points keep their order.
    ///
    /// # Errors
    /// `TooMany` where the nodes' numbers do not fit 32 bits.
    pub fn balanced(&self) -> Result<Self> {
        let cut = self.octants_to_cut();
        let keys: Vec<u64> =
            (0..self.points.len()).into_par_iter().with_min_len(1 << 12).map(|i| self.key_at(i)).collect();
        let heads = cut_heads(self, &keys, &cut);
        let mut tree = self.clone().with_nodes(build::link(&keys, &heads, self.curve())?);
        tree.is_balanced = true;
        Ok(tree)
    }

    /// The first pair of leaves that touch and differ by more than one level.
    pub fn unbalanced_pair(&self) -> Option<[u32; 2]> {
        let leaves: Vec<u32> = self.leaves().collect();
        leaves.par_iter().find_map_first(|&leaf| {
            let level = self.nodes()[leaf as usize].level;
            let mut pair = None;
            self.any_leaf_touching(leaf, |other| {
                let too_large = self.nodes()[other as usize].level + 1 < level;
                pair = too_large.then_some([leaf, other]);
                too_large
            });
            pair
        })
    }

    /// The octants of each level that have children once the tree is balanced, ascending.
    fn octants_to_cut(&self) -> Vec<Vec<Octant>> {
        let inner = |level: u32| {
            let nodes = &self.nodes()[self.level(level)];
            nodes.iter().filter(|node| !node.is_leaf()).map(|node| node.octant).collect()
        };
        let mut cut: Vec<Vec<Octant>> = (0..self.n_levels() as u32).map(inner).collect();
        for level in (1..cut.len()).rev() {
            let (above, below) = cut.split_at_mut(level);
            let asked = below[0].par_iter().flat_map_iter(|&octant| parents_around(self.curve(), octant));
            above[level - 1].par_extend(asked);
            above[level - 1].par_sort_unstable();
            above[level - 1].dedup();
        }
        cut
    }
}

/// The parents of an octant and of its 26 neighbours: eight, fewer at the border of the domain.
fn parents_around(curve: Curve, octant: Octant) -> impl Iterator<Item = Octant> {
    let (cell, level) = (octant.cell(curve), octant.level() - 1);
    (0..8u32).filter_map(move |side| {
        let mut parent = cell.map(|c| c >> 1);
        for axis in 0..3 {
            if side >> axis & 1 == 1 {
                // Odd cells lie at the high side of their parent.
                parent[axis] = parent[axis].checked_add_signed(if cell[axis] & 1 == 1 { 1 } else { -1 })?;
            }
        }
        Octant::of_cell(curve, parent, level)
    })
}

/// The heads of the leaves once these octants are cut.
fn cut_heads(tree: &LinearOctree, keys: &[u64], cut: &[Vec<Octant>]) -> Vec<LeafHead> {
    let is_cut =
        |octant: Octant| cut.get(octant.level() as usize).is_some_and(|octants| octants.binary_search(&octant).is_ok());
    let mut heads = Vec::new();
    for leaf in tree.leaves() {
        let node = &tree.nodes()[leaf as usize];
        let mut end = node.first_point as usize;
        while end < node.end_point as usize {
            let i = end;
            let top = if i == 0 { 0 } else { keys[i - 1].common_levels(keys[i]) + 1 };
            let mut level = node.level;
            while level < MAX_LEVEL && is_cut(Octant::of_key(keys[i], level)) {
                level += 1;
            }
            heads.push(LeafHead { point: i as u32, top, level });
            let inside = |key: &u64| key.common_levels(keys[i]) >= level;
            end = i + keys[i..node.end_point as usize].partition_point(inside);
        }
    }
    heads
}

#[cfg(feature = "gpu")]
mod on_gpu {
    use crate::Result;
    use crate::curve::{Curve, MAX_LEVEL};
    use crate::gpu::{Access, Buffer, Commands, DeviceElement, Gpu, Kernel, Workgroups};
    use crate::parallel::compact::GpuCompact;
    use crate::parallel::radix_sort::GpuRadixSort;
    use crate::structure::linear_octree::linker::{
        self, NodeLinker, OctreeSummary, SortedKeys, SortedPoints, WORKGROUP, features,
    };
    use crate::structure::linear_octree::settings::NARROW_LEVELS;
    use crate::structure::linear_octree::{GpuLinearOctree, OctreeNode};

    const MODULE: &str = "package::structure::linear_octree::balance";

    impl GpuLinearOctree {
        /// As [`super::LinearOctree::balanced`], with the same tree to the bit.
        ///
        /// # Errors
        /// `OutOfDeviceMemory`, `DeviceLost`.
        pub fn balanced(&self) -> Result<Self> {
            let octants = self.octants_to_cut()?;
            if self.sorted_levels <= NARROW_LEVELS {
                return self.cut::<u32>(NARROW_LEVELS, &octants);
            }
            self.cut::<u64>(MAX_LEVEL, &octants)
        }

        /// The nodes once these octants are cut, by keys of so many levels.
        fn cut<K: DeviceElement>(&self, key_levels: u32, octants: &Buffer<u64>) -> Result<Self> {
            use Access::{Read, ReadWrite, Uniform};
            let (gpu, n, curve) = (&self.gpu, self.points.len(), self.curve());
            let linker = NodeLinker::new(gpu, n, &self.settings, self.layout.domain)?;
            let keys = SortedKeys::<K>::new(gpu, n, curve, self.sorted_levels, key_levels)?;
            let (features, accesses) = (features(curve, key_levels), [Uniform, Read, Read, Read, ReadWrite]);
            let count_cut_nodes =
                gpu.prepare(&linker::kernel(MODULE, "count_cut_nodes", &features, &accesses, WORKGROUP))?;
            let parameters = gpu.uniform("leaf parameters", &[n as u32, 0, keys.levels, 0])?;
            let cut_parameters = gpu.uniform("cut parameters", &[n as u32, 0, octants.len() as u32, 0])?;
            let summary: Buffer<OctreeSummary> = gpu.buffer("octree summary", 1)?;
            let mut commands = gpu.commands("cut leaves");
            commands.stage("cut leaves");
            // The points stand in order: so do their keys.
            let shared = [(&parameters).into(), (&linker.domain_buffer).into(), (&summary).into()];
            keys.record_keys(&mut commands, shared, &self.points, &keys.keys);
            commands.dispatch(
                &count_cut_nodes,
                &[
                    (&cut_parameters).into(),
                    (&self.nodes).into(),
                    octants.into(),
                    (&keys.keys).into(),
                    (&linker.node_counts).into(),
                ],
                Workgroups::Covering(n as u64),
            );
            linker.record_totals(&mut commands, &keys, [(&parameters).into(), (&summary).into()])?;
            let stages = commands.run()?;
            let sorted = SortedPoints { points: self.points.clone(), ids: self.ids.clone() };
            let tree = linker.link(&keys, sorted, gpu.read(&summary)?[0], stages)?;
            Ok(Self { is_balanced: true, ..tree })
        }

        /// The octants that have children once the tree is balanced, ascending: level after level.
        fn octants_to_cut(&self) -> Result<Buffer<u64>> {
            let gpu = &self.gpu;
            let mut by_level: Vec<Buffer<u64>> = Vec::new();
            let mut below = gpu.buffer("octants to cut", 0)?;
            for level in (0..self.level_starts.len().saturating_sub(1)).rev() {
                below = self.octants_to_cut_above(level, &below)?;
                by_level.push(below.clone());
            }
            by_level.reverse();
            let all = gpu.buffer("octants to cut", by_level.iter().map(Buffer::len).sum())?;
            let mut commands = gpu.commands("join octants to cut");
            let mut first = 0;
            for octants in &by_level {
                record(&mut commands, gpu, "join_octants", self.curve(), [octants.len(), first], &[octants, &all])?;
                first += octants.len();
            }
            commands.submit()?;
            Ok(all)
        }

        /// The octants of `level` to cut: the tree's own nodes with children, and what the cut ones below ask for.
        fn octants_to_cut_above(&self, level: usize, below: &Buffer<u64>) -> Result<Buffer<u64>> {
            let gpu = &self.gpu;
            let (first, end) = (self.level_starts[level] as usize, self.level_starts[level + 1] as usize);
            let n = end - first + 8 * below.len();
            let asked: Buffer<u64> = gpu.buffer("octants asked for", n)?;
            let sorted: Buffer<u64> = gpu.buffer("sorted octants", n)?;
            let places: Buffer<u32> = gpu.buffer("places of octants", n)?;
            let flags: Buffer<u32> = gpu.buffer("whether octants are new", n)?;
            let count: Buffer<u32> = gpu.buffer("number of octants to cut", 1)?;
            let mut commands = gpu.commands("octants to cut");
            self.record_inner(&mut commands, first..end, &asked)?;
            let parameters = [below.len(), end - first];
            record(&mut commands, gpu, "ask_parents", self.curve(), parameters, &[below, &asked])?;
            // A 1 bit and three bits a level; what is no octant has a bit more. No octant of the last level is cut.
            let bits = 0..(3 * level as u32 + 2).min(64);
            GpuRadixSort::<u64>::new(gpu, n)?.record_from(&mut commands, &asked, None, &sorted, &places, n, bits)?;
            let kernel = kernel("flag_new", self.curve(), &[Access::Uniform, Access::Read, Access::ReadWrite]);
            let parameters = gpu.uniform("balance parameters", &[n as u32, level as u32, 0, 0])?;
            commands.dispatch(
                &gpu.prepare(&kernel.as_kernel())?,
                &[(&parameters).into(), (&sorted).into(), (&flags).into()],
                Workgroups::Covering(n as u64),
            );
            GpuCompact::new(gpu, n)?.record(&mut commands, &flags, &places, &count, n)?;
            commands.submit()?;
            let n_cut = gpu.read(&count)?[0] as usize;
            let cut = gpu.buffer("octants to cut", n_cut)?;
            let mut commands = gpu.commands("gather octants");
            let kernel = self::kernel(
                "gather_octants",
                self.curve(),
                &[Access::Uniform, Access::Read, Access::ReadWrite, Access::Read],
            );
            let parameters = gpu.uniform("balance parameters", &[n_cut as u32, 0, 0, 0])?;
            commands.dispatch(
                &gpu.prepare(&kernel.as_kernel())?,
                &[(&parameters).into(), (&sorted).into(), (&cut).into(), (&places).into()],
                Workgroups::Covering(n_cut as u64),
            );
            commands.submit()?;
            Ok(cut)
        }

        /// The octants of some nodes; all bits set where a node has no children.
        fn record_inner(
            &self,
            commands: &mut Commands,
            nodes: std::ops::Range<usize>,
            octants: &Buffer<u64>,
        ) -> Result<()> {
            let kernel = kernel("inner_octants", self.curve(), &[Access::Uniform, Access::Read, Access::ReadWrite]);
            let parameters = [nodes.len() as u32, nodes.start as u32, 0, 0];
            let parameters = self.gpu.uniform("balance parameters", &parameters)?;
            let all: &Buffer<OctreeNode> = &self.nodes;
            commands.dispatch(
                &self.gpu.prepare(&kernel.as_kernel())?,
                &[(&parameters).into(), all.into(), octants.into()],
                Workgroups::Covering(nodes.len() as u64),
            );
            Ok(())
        }
    }

    /// Records a kernel from one list of octants to another: a number of octants, and a place in the second list.
    fn record(
        commands: &mut Commands,
        gpu: &Gpu,
        entry: &'static str,
        curve: Curve,
        [count, first]: [usize; 2],
        [from, to]: &[&Buffer<u64>; 2],
    ) -> Result<()> {
        let kernel = kernel(entry, curve, &[Access::Uniform, Access::Read, Access::ReadWrite]);
        let parameters = gpu.uniform("balance parameters", &[count as u32, first as u32, 0, 0])?;
        commands.dispatch(
            &gpu.prepare(&kernel.as_kernel())?,
            &[(&parameters).into(), (*from).into(), (*to).into()],
            Workgroups::Covering(count as u64),
        );
        Ok(())
    }

    struct Named<'a> {
        entry: &'static str,
        features: [(&'static str, bool); 2],
        accesses: &'a [Access],
    }

    fn kernel<'a>(entry: &'static str, curve: Curve, accesses: &'a [Access]) -> Named<'a> {
        Named { entry, features: [("hilbert", curve == Curve::Hilbert), ("wide", true)], accesses }
    }

    impl Named<'_> {
        fn as_kernel(&self) -> Kernel<'_> {
            const CONSTANTS: &[(&str, f64)] = &[("WORKGROUP", WORKGROUP as f64)];
            let plain = Kernel::new(MODULE, self.entry, self.accesses, WORKGROUP);
            Kernel { features: &self.features, constants: CONSTANTS, ..plain }
        }
    }
}
