//! 2:1 balance: leaves that touch differ by at most one level. `balance.wesl` holds the kernels.
//!
//! A leaf that is touched by one more than a level deeper is cut into its children that have points; that may disturb its
//! own neighbours, so it is repeated until no leaf is cut. At most as many rounds as levels. Source: Sundar2008 for the
//! condition and the ripple. Differs: octants without points are no leaves, so nothing is cut on their behalf.

use rayon::prelude::*;

use super::LinearOctree;
use super::build::{self, CurveKey, LeafHead};

impl LinearOctree {
    /// The coarsest tree that has every leaf of this one, or its parts, and in which leaves that share a face, an edge or
    /// a corner differ by at most one level. Points keep their order.
    pub fn balanced(&self) -> Self {
        let mut tree = self.clone();
        loop {
            let is_cut = tree.leaves_to_cut();
            if !is_cut.iter().any(|&cut| cut) {
                tree.is_balanced = true;
                return tree;
            }
            let keys: Vec<u64> =
                (0..tree.points.len()).into_par_iter().with_min_len(1 << 12).map(|i| tree.key_at(i)).collect();
            let heads = cut_heads(&tree, &keys, &is_cut);
            let nodes = build::link(&keys, &heads, tree.curve());
            tree = tree.with_nodes(nodes);
        }
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

    /// For each node, whether it is a leaf that a leaf more than one level deeper touches.
    fn leaves_to_cut(&self) -> Vec<bool> {
        let leaf_is_cut = |(i, node): (usize, &super::OctreeNode)| {
            node.is_leaf()
                && self.any_leaf_touching(i as u32, |other| self.nodes()[other as usize].level > node.level + 1)
        };
        self.nodes().par_iter().enumerate().with_min_len(64).map(leaf_is_cut).collect()
    }
}

/// The heads of the leaves with some of them cut once.
fn cut_heads<K: CurveKey>(tree: &LinearOctree, keys: &[K], is_cut: &[bool]) -> Vec<LeafHead> {
    let mut heads = Vec::new();
    for leaf in tree.leaves() {
        let node = &tree.nodes()[leaf as usize];
        let level = node.level + u32::from(is_cut[leaf as usize]);
        for i in node.points() {
            let top = if i == 0 { 0 } else { keys[i - 1].common_levels(keys[i]) + 1 };
            if i == node.first_point as usize || top <= level {
                heads.push(LeafHead { point: i as u32, top, level });
            }
        }
    }
    heads
}

#[cfg(feature = "gpu")]
mod on_gpu {
    use crate::Result;
    use crate::gpu::{Access, Buffer, Kernel, Workgroups};
    use crate::structure::linear_octree::GpuLinearOctree;

    const WORKGROUP: u32 = 128;

    impl GpuLinearOctree {
        /// For each node 1 if it is a leaf that a leaf more than one level deeper touches, and whether any is.
        pub(in crate::structure::linear_octree) fn leaves_to_cut(&self) -> Result<(Buffer<u32>, bool)> {
            use Access::{Read, ReadWrite, Uniform};
            self.check_walk("walking to the leaves around each leaf")?;
            let gpu = &self.gpu;
            let is_cut = gpu.buffer("whether leaves are cut", self.nodes.len())?;
            let any = gpu.upload("whether any leaf is cut", &[0u32])?;
            let kernel = Kernel {
                constants: &[("WORKGROUP", f64::from(WORKGROUP))],
                ..Kernel::new(
                    "package::structure::linear_octree::balance",
                    "mark_leaves",
                    &[Uniform, Read, ReadWrite, ReadWrite],
                    WORKGROUP,
                )
            };
            let mut commands = gpu.commands("leaves to cut");
            commands.dispatch(
                &gpu.pipeline(&kernel)?,
                &[(&self.layout_buffer).into(), (&self.nodes).into(), (&is_cut).into(), (&any).into()],
                Workgroups::Covering(self.nodes.len() as u64),
            );
            commands.submit()?;
            let any = gpu.read(&any)?[0] != 0;
            Ok((is_cut, any))
        }
    }
}
