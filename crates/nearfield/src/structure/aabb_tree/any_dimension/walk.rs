//! Ways through the tree on the CPU. `nodes.wesl` is the twin of this file.

use std::ops::Range;

use super::AabbTreeN;
use super::distance::dist2_to_box;
use crate::geometry::Scalar;
use crate::structure::aabb_tree::{BoxN, TreeShape};

/// Nodes that wait: one a level at most, and the one at hand.
const DEEPEST: usize = 34;

impl<T: Scalar, const D: usize> AabbTreeN<T, D> {
    /// A leaf whose box is within the squared distance of the query, found by a depth-first search that takes the nearer
    /// child first; `None` where no leaf is. `visited` grows by the nodes looked at.
    pub(crate) fn touching_leaf(&self, query: &[T; D], reach2: T, visited: &mut u64) -> Option<usize> {
        let mut touching = None;
        *visited += self.nearest_first(query, reach2, |leaf| {
            touching = Some(leaf);
            // Nothing is nearer than this: the search ends.
            T::of(-1.0)
        });
        touching
    }

    /// The leaf that a descent ends in that always takes the child whose box is nearer, the first of equals.
    pub(crate) fn nearest_leaf(&self, query: &[T; D]) -> usize {
        let mut node = 0;
        while !self.shape.is_leaf(node) {
            let [left, right] = [2 * node + 1, 2 * node + 2];
            let is_right = dist2_to_box(query, &self.boxes[right]) < dist2_to_box(query, &self.boxes[left]);
            node = if is_right { right } else { left };
        }
        node
    }

    /// Visits `leaf`, and then, for each node from it up to the root, the leaves below the other child of its parent whose
    /// box and all boxes between `meets` holds for. Returns the number of nodes looked at.
    pub(crate) fn back_traverse(
        &self,
        leaf: usize,
        meets: impl Fn(&BoxN<T, D>) -> bool,
        mut visit: impl FnMut(usize),
    ) -> u64 {
        visit(leaf);
        let (mut current, mut visited) = (leaf, 1);
        while let Some(sibling) = TreeShape::sibling(current) {
            visited += self.descend(sibling, &meets, &mut visit);
            current = (current - 1) / 2;
        }
        visited
    }

    /// Visits the leaves below `top` whose box and all boxes from `top` on `meets` holds for, in depth-first order. Returns
    /// the number of nodes looked at.
    #[inline(always)]
    pub(crate) fn descend(&self, top: usize, meets: impl Fn(&BoxN<T, D>) -> bool, mut visit: impl FnMut(usize)) -> u64 {
        self.descend_while(top, meets, |leaf| {
            visit(leaf);
            true
        })
    }

    /// The same until `visit` has had enough and says false.
    #[inline(always)]
    pub(crate) fn descend_while(
        &self,
        top: usize,
        meets: impl Fn(&BoxN<T, D>) -> bool,
        mut visit: impl FnMut(usize) -> bool,
    ) -> u64 {
        let (mut next, end, mut visited) = (Some(top), TreeShape::rope(top), 0);
        while let Some(node) = next.filter(|_| next != end) {
            visited += 1;
            next = TreeShape::rope(node);
            if meets(&self.boxes[node]) {
                match self.shape.is_leaf(node) {
                    true if !visit(node) => break,
                    true => {}
                    false => next = Some(2 * node + 1),
                }
            }
        }
        visited
    }

    /// Hands leaves to `test`, near ones first, until nothing that is left can lie within the squared distance that `test`
    /// returned last, or the one given. Returns the number of nodes looked at.
    pub(crate) fn nearest_first(&self, query: &[T; D], reach2: T, mut test: impl FnMut(usize) -> T) -> u64 {
        if self.boxes.is_empty() {
            return 0;
        }
        let below = |node: usize| dist2_to_box(query, &self.boxes[node]);
        let mut reach2 = reach2;
        let mut waiting = [(0usize, T::of(0.0)); DEEPEST];
        waiting[0] = (0, below(0));
        let (mut n_waiting, mut visited) = (1, 1);
        while n_waiting > 0 {
            n_waiting -= 1;
            let (mut node, mut bound) = waiting[n_waiting];
            while bound <= reach2 && !self.shape.is_leaf(node) {
                let [left, right] = [2 * node + 1, 2 * node + 2];
                let [mut near, mut far] = [(left, below(left)), (right, below(right))];
                visited += 2;
                if far.1 < near.1 {
                    (near, far) = (far, near);
                }
                if far.1 <= reach2 {
                    waiting[n_waiting] = far;
                    n_waiting += 1;
                }
                (node, bound) = near;
            }
            if bound <= reach2 {
                reach2 = test(node).smaller(reach2);
            }
        }
        visited
    }

    /// Places of a leaf's points.
    #[inline(always)]
    pub(crate) fn places(&self, leaf: usize) -> Range<usize> {
        self.shape.points(leaf)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::aabb_tree::any_dimension::AabbTreeNSettings;

    fn tree() -> AabbTreeN<f64, 2> {
        let points: Vec<[f64; 2]> = (0..900u32).map(|i| [f64::from(i % 30), f64::from(i / 30)]).collect();
        AabbTreeN::build(&points, &AabbTreeNSettings::default().bucket_size(3)).unwrap()
    }

    #[test]
    fn all_ways_meet_the_same_leaves() {
        let tree = tree();
        for (query, reach2) in [([3.2, 8.9], 4.0), ([-5.0, 12.0], 36.0), ([50.0, 50.0], 9.0), ([15.0, 15.0], 1e9)] {
            let meets = |node: &BoxN<f64, 2>| dist2_to_box(&query, node) <= reach2;
            let expected: Vec<usize> = tree.shape.leaves().filter(|&leaf| meets(&tree.boxes[leaf])).collect();
            let mut met = Vec::new();
            tree.descend(0, meets, |leaf| met.push(leaf));
            assert_eq!(met, expected);
            met.clear();
            tree.nearest_first(&query, reach2, |leaf| {
                met.push(leaf);
                reach2
            });
            met.sort_unstable();
            assert_eq!(met, expected);
            let touching = tree.touching_leaf(&query, reach2, &mut 0);
            assert_eq!(touching.is_some(), !expected.is_empty());
            if let Some(leaf) = touching {
                met.clear();
                tree.back_traverse(leaf, meets, |leaf| met.push(leaf));
                assert_eq!(met[0], leaf);
                met.sort_unstable();
                assert_eq!(met, expected);
            }
        }
    }
}
