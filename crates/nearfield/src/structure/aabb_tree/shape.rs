//! The shape of the tree: which node has which children and which points, by arithmetic alone. `layout.wesl` is the twin.
//!
//! Level l has 2^l nodes; node j of them holds the places ⌊j·n/2^l⌋ … ⌊(j+1)·n/2^l⌋ of the tree's order. Its two halves
//! differ by at most one point, so every node is split at its median.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};

/// A complete binary tree over `n_points` points, whose leaves all stand on level `depth`.
///
/// Nodes are numbered in breadth-first order: 0 is the root, the children of i are 2i + 1 and 2i + 2. Without points there
/// is no node.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct TreeShape {
    n_points: u32,
    depth: u32,
}

impl TreeShape {
    /// The least depth at which no leaf holds more than `bucket_size` points, which must be at least 1.
    pub(super) fn new(n_points: u32, bucket_size: u32) -> Self {
        let buckets = n_points.div_ceil(bucket_size.max(1)).max(1);
        Self { n_points, depth: buckets.next_power_of_two().ilog2() }
    }

    /// Number of points.
    pub fn n_points(&self) -> usize {
        self.n_points as usize
    }

    /// The level of the leaves; 0 where the root is the leaf.
    pub fn depth(&self) -> u32 {
        self.depth
    }

    /// Number of nodes: 2^(depth + 1) − 1, or none without points.
    pub fn n_nodes(&self) -> usize {
        if self.n_points == 0 { 0 } else { (2usize << self.depth) - 1 }
    }

    /// Number of leaves.
    pub fn n_leaves(&self) -> usize {
        if self.n_points == 0 { 0 } else { 1 << self.depth }
    }

    /// The nodes of a level, which stand side by side.
    pub fn level(&self, level: u32) -> Range<usize> {
        if self.n_points == 0 || level > self.depth {
            return 0..0;
        }
        (1 << level) - 1..(2 << level) - 1
    }

    /// The leaves.
    pub fn leaves(&self) -> Range<usize> {
        self.level(self.depth)
    }

    /// Whether a node is a leaf.
    #[inline(always)]
    pub fn is_leaf(&self, node: usize) -> bool {
        node + 1 >= 1 << self.depth
    }

    /// Places of a node's points in the tree's order.
    #[inline(always)]
    pub fn points(&self, node: usize) -> Range<usize> {
        let level = (node + 1).ilog2();
        let number = node + 1 - (1 << level);
        self.start(level, number)..self.start(level, number + 1)
    }

    /// First place of node `number` of a level.
    #[inline(always)]
    pub(super) fn start(&self, level: u32, number: usize) -> usize {
        ((number as u64 * u64::from(self.n_points)) >> level) as usize
    }

    /// The leaf that holds the point at a place.
    #[inline(always)]
    pub fn leaf_of(&self, place: usize) -> usize {
        let number = (((place as u64 + 1) << self.depth) - 1) / u64::from(self.n_points);
        (1 << self.depth) - 1 + number as usize
    }

    /// The node behind a node and its descendants in depth-first order; none behind the last.
    #[inline(always)]
    pub fn rope(node: usize) -> Option<usize> {
        let next = node + 2;
        let next = next >> next.trailing_zeros();
        (next > 1).then(|| next - 1)
    }

    /// The parent of a node; none above the root.
    #[inline(always)]
    pub fn parent(node: usize) -> Option<usize> {
        (node > 0).then(|| (node - 1) / 2)
    }

    /// The other child of the parent; none for the root.
    #[inline(always)]
    pub fn sibling(node: usize) -> Option<usize> {
        (node > 0).then(|| ((node + 1) ^ 1) - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_tiles_the_points_and_halves_differ_by_one() {
        for n in 1..300u32 {
            for bucket in [1, 2, 3, 20] {
                let shape = TreeShape::new(n, bucket);
                let sizes = || shape.leaves().map(|leaf| shape.points(leaf).len());
                assert!(sizes().max().unwrap() <= bucket as usize);
                if shape.depth() > 0 {
                    let above = shape.level(shape.depth() - 1).map(|node| shape.points(node).len());
                    assert!(above.max().unwrap() > bucket as usize, "one level less should not be enough");
                }
                for level in 0..=shape.depth() {
                    let mut place = 0;
                    for node in shape.level(level) {
                        assert_eq!(shape.points(node).start, place);
                        place = shape.points(node).end;
                        if level < shape.depth() {
                            let [left, right] = [2 * node + 1, 2 * node + 2].map(|child| shape.points(child));
                            assert_eq!(
                                [left.start, left.end, right.end],
                                [shape.points(node).start, right.start, place]
                            );
                            assert!(left.len().abs_diff(right.len()) <= 1);
                        }
                    }
                    assert_eq!(place, n as usize);
                }
                for leaf in shape.leaves() {
                    assert!(shape.points(leaf).all(|place| shape.leaf_of(place) == leaf));
                }
            }
        }
    }

    #[test]
    fn ropes_go_along_the_tree_in_depth_first_order() {
        let shape = TreeShape::new(1000, 20);
        let mut expected = Vec::new();
        fn descend(shape: &TreeShape, node: usize, order: &mut Vec<usize>) {
            order.push(node);
            if !shape.is_leaf(node) {
                descend(shape, 2 * node + 1, order);
                descend(shape, 2 * node + 2, order);
            }
        }
        descend(&shape, 0, &mut expected);
        let (mut node, mut walked) = (Some(0), Vec::new());
        while let Some(at) = node {
            walked.push(at);
            node = if shape.is_leaf(at) { TreeShape::rope(at) } else { Some(2 * at + 1) };
        }
        assert_eq!(walked, expected);
        assert_eq!(walked.len(), shape.n_nodes());
    }

    #[test]
    fn the_largest_tree_does_not_overflow() {
        let shape = TreeShape::new(u32::MAX - 1, 20);
        let last = shape.n_nodes() - 1;
        assert_eq!(shape.points(last).end, u32::MAX as usize - 1);
        assert_eq!(shape.leaf_of(u32::MAX as usize - 2), last);
    }
}
