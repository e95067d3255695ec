//! Leaves that touch each other.

use super::{LinearOctree, OctreeNode};

impl LinearOctree {
    /// The other leaves that share a face, an edge or a corner with this leaf, along the curve. Octants without points
    /// are no leaves; across the border of the domain there is nothing.
    ///
    /// # Panics
    /// If there is no node `leaf`.
    pub fn leaves_touching(&self, leaf: u32) -> Vec<u32> {
        let mut touching = vec![];
        self.any_leaf_touching(leaf, |other| {
            touching.push(other);
            false
        });
        touching
    }

    /// Whether `test` holds for one of [`LinearOctree::leaves_touching`]; later ones are not tested.
    pub(crate) fn any_leaf_touching(&self, leaf: u32, mut test: impl FnMut(u32) -> bool) -> bool {
        let nodes = self.nodes();
        // In whole cells: what overlaps the leaf's cells and one more on each side, and is not the leaf, touches it.
        let (low, high) = (nodes[leaf as usize].low, nodes[leaf as usize].high());
        let (low, high) = (low.map(|c| c.saturating_sub(1)), high.map(|c| c + 1));
        let overlaps = |node: &OctreeNode| {
            let last = node.high();
            (0..3).all(|axis| node.low[axis] <= high[axis] && last[axis] >= low[axis])
        };
        let mut next = 0;
        while let Some(node) = nodes.get(next as usize) {
            let current = next;
            next = node.rope;
            if !overlaps(node) {
                continue;
            }
            if !node.is_leaf() {
                next = node.first_child;
            } else if current != leaf && test(current) {
                return true;
            }
        }
        false
    }
}
