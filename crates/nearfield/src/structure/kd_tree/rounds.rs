//! How long a walk can get: for devices that end loops early.

use super::KdTree;
use super::layout::{KdLeaf, NO_NODE};

/// Steps of the kernel for a leaf beside its triangles: to enter it, and to leave it.
const STEPS_A_LEAF: u64 = 2;
/// Steps of a round of its loop.
const STEPS_A_ROUND: u64 = 4;

impl KdTree {
    /// An upper bound of the rounds of one walk on a device that ends loops (ropes.wesl); a
    /// step is a cut, a triangle, or the way into or out of a leaf.
    ///
    /// A ray keeps its direction, so it goes through a leaf only to leaves that lie ahead in at least one axis and
    /// behind in none. For each of the eight signs of a direction these steps have no cycle, and the longest way along them
    /// is found from the last leaf back to the first.
    pub(super) fn most_rounds_of_a_walk(&self) -> u64 {
        let longest = |signs: u32| self.longest_way([signs & 1 == 1, signs & 2 == 2, signs & 4 == 4]);
        let steps = (0..8).map(longest).max().unwrap_or(0) + u64::from(self.stats().depth);
        steps.div_ceil(STEPS_A_ROUND) + 1
    }

    fn longest_way(&self, is_ascending: [bool; 3]) -> u64 {
        let mut steps = vec![0u64; self.leaves().len()];
        let mut longest = 0;
        // From the last leaf to the first, as any ray with these signs meets them.
        let mut stack = vec![0u32];
        while let Some(at) = stack.pop() {
            let node = self.nodes()[at as usize];
            if !node.is_leaf() {
                let ahead = u32::from(is_ascending[node.axis()]);
                stack.extend([node.index() + 1 - ahead, node.index() + ahead]);
                continue;
            }
            let leaf = &self.leaves()[node.index() as usize];
            let ways = (0..3).map(|axis| {
                let rope = leaf.ropes[2 * axis + usize::from(is_ascending[axis])];
                if rope == NO_NODE { 0 } else { self.longest_behind(rope, leaf, axis, is_ascending, &steps) }
            });
            let here = STEPS_A_LEAF + u64::from(leaf.count) + ways.max().unwrap_or(0);
            steps[node.index() as usize] = here;
            longest = longest.max(here);
        }
        longest
    }

    /// The longest way from a rope's node on, to leaves that a ray through the face can come to.
    fn longest_behind(&self, rope: u32, from: &KdLeaf, exit: usize, is_ascending: [bool; 3], steps: &[u64]) -> u64 {
        let mut longest = 0;
        let mut stack = vec![(rope, 0u64)];
        while let Some((at, cuts)) = stack.pop() {
            let node = self.nodes()[at as usize];
            if node.is_leaf() {
                longest = longest.max(cuts + steps[node.index() as usize]);
                continue;
            }
            let axis = node.axis();
            let (left, right) = if axis == exit {
                (is_ascending[axis], !is_ascending[axis])
            } else if is_ascending[axis] {
                (node.split > from.min[axis], node.split <= from.max[axis])
            } else {
                (node.split >= from.min[axis], node.split < from.max[axis])
            };
            if left {
                stack.push((node.index(), cuts + 1));
            }
            if right {
                stack.push((node.index() + 1, cuts + 1));
            }
        }
        longest
    }
}
