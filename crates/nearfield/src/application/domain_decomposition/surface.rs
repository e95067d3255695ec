//! Who owns the leaves of a tree, and which leaves lie at the surface of a part.

use rayon::prelude::*;

use super::Partition;
use crate::structure::LinearOctree;

/// The owner of a leaf or node whose points live in several parts.
pub(super) const MIXED: u32 = u32::MAX;

/// Owners of everything in a tree.
pub(super) struct Owners {
    /// `[n]` of the points in the tree's order.
    pub(super) of_points: Vec<u32>,
    /// `[n_nodes]` of all points of each node; [`MIXED`] where there are several.
    pub(super) of_nodes: Vec<u32>,
    /// The leaves along the curve.
    pub(super) leaves: Vec<u32>,
}

impl Owners {
    pub(super) fn new(tree: &LinearOctree, partition: &Partition) -> Self {
        let points = tree.ordered_points();
        let owner = |place| partition.owner(points.position(place));
        let of_points: Vec<u32> = (0..points.len()).into_par_iter().with_min_len(1 << 12).map(owner).collect();
        let mut of_nodes = vec![MIXED; tree.nodes().len()];
        // Children stand behind their parents.
        for (i, node) in tree.nodes().iter().enumerate().rev() {
            let parts = if node.is_leaf() { &of_points[node.points()] } else { &of_nodes[node.children()] };
            of_nodes[i] = if parts.iter().all(|&part| part == parts[0]) { parts[0] } else { MIXED };
        }
        Self { of_points, of_nodes, leaves: tree.leaves().collect() }
    }

    /// The parts with points in a leaf, each once.
    pub(super) fn in_leaf(&self, tree: &LinearOctree, leaf: u32) -> Vec<u32> {
        let mut parts = match self.of_nodes[leaf as usize] {
            MIXED => self.of_points[tree.nodes()[leaf as usize].points()].to_vec(),
            part => vec![part],
        };
        parts.sort_unstable();
        parts.dedup();
        parts
    }

    /// Whether a leaf, or one that touches it, has points of another part than this leaf's.
    fn is_at_surface(&self, tree: &LinearOctree, leaf: u32) -> bool {
        let own = self.of_nodes[leaf as usize];
        own == MIXED || tree.any_leaf_touching(leaf, |other| self.of_nodes[other as usize] != own)
    }
}

/// Leaves of each part, and those of them at its surface `[p]`.
pub(super) fn count_leaves(tree: &LinearOctree, owners: &Owners, parts: u32) -> (Vec<u64>, Vec<u64>) {
    let at_surface: Vec<bool> =
        owners.leaves.par_iter().with_min_len(64).map(|&leaf| owners.is_at_surface(tree, leaf)).collect();
    let (mut leaves, mut surface) = (vec![0; parts as usize], vec![0; parts as usize]);
    for (&leaf, &outer) in owners.leaves.iter().zip(&at_surface) {
        for part in owners.in_leaf(tree, leaf) {
            leaves[part as usize] += 1;
            surface[part as usize] += u64::from(outer);
        }
    }
    (leaves, surface)
}
