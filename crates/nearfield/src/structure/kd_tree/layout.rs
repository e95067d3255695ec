//! Nodes and leaves of a kd-tree: the same bytes on CPU and GPU. `ropes.wesl` has their twins.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::geometry::Aabb;

/// No node: the rope of a face on the border of the tree.
pub const NO_NODE: u32 = u32::MAX;
/// The axis of leaves.
pub(super) const LEAF: u32 = 3;

/// A node in 8 bytes. Its two children stand side by side, the one with smaller coordinates first.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct KdNode {
    /// Where an inner node is cut; 0 for a leaf.
    pub split: f32,
    /// Two bits from the lowest on: the axis of the cut, 3 for a leaf. The rest: index of the first child among the
    /// nodes, or of the leaf among the leaves.
    pub link: u32,
}

impl KdNode {
    /// An inner node that is cut across `axis` at `split`.
    pub(super) fn inner(axis: usize, split: f32, first_child: u32) -> Self {
        debug_assert!(axis < 3 && first_child < 1 << 30);
        Self { split, link: first_child << 2 | axis as u32 }
    }

    /// A leaf.
    pub(super) fn leaf(leaf: u32) -> Self {
        debug_assert!(leaf < 1 << 30);
        Self { split: 0.0, link: leaf << 2 | LEAF }
    }

    /// Whether it has no children.
    #[inline(always)]
    pub fn is_leaf(&self) -> bool {
        self.link & 3 == LEAF
    }

    /// The axis of the cut, 0 to 2; 3 for a leaf.
    #[inline(always)]
    pub fn axis(&self) -> usize {
        (self.link & 3) as usize
    }

    /// Index of the first child, or of the leaf.
    #[inline(always)]
    pub fn index(&self) -> u32 {
        self.link >> 2
    }
}

/// A leaf in 64 bytes: what a ray needs to pass it stands in one line of a cache.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct KdLeaf {
    /// Smallest corner of its box.
    pub min: Vec3,
    /// Place of the first of its references.
    pub first: u32,
    /// Largest corner of its box.
    pub max: Vec3,
    /// Number of its references.
    pub count: u32,
    /// The node behind each face: x smallest, x largest, y smallest …; [`NO_NODE`] on the border of the tree.
    pub ropes: [u32; 6],
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
}

impl KdLeaf {
    /// A leaf whose box and ropes are not known yet.
    pub(super) fn of_references(first: u32, count: u32) -> Self {
        Self { first, count, ropes: [NO_NODE; 6], ..Self::zeroed() }
    }

    /// Places of its references.
    #[inline(always)]
    pub fn references(&self) -> std::ops::Range<usize> {
        self.first as usize..(self.first + self.count) as usize
    }

    /// Its box.
    pub fn cell(&self) -> Aabb {
        Aabb::new(self.min, self.max)
    }
}

/// A cell cut in two.
pub(super) fn halves(cell: &Aabb, axis: usize, split: f32) -> [Aabb; 2] {
    let (mut left, mut right) = (*cell, *cell);
    left.max[axis] = split;
    right.min[axis] = split;
    [left, right]
}

/// The arrays of a tree; the first node is the root.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct KdArrays {
    pub(super) nodes: Vec<KdNode>,
    /// In depth-first order, smaller coordinates first.
    pub(super) leaves: Vec<KdLeaf>,
    /// Triangles of the leaves, leaf after leaf.
    pub(super) references: Vec<u32>,
}

impl KdArrays {
    /// Bytes held.
    pub(super) fn bytes(&self) -> u64 {
        let sizes = [size_of_val(&*self.nodes), size_of_val(&*self.leaves), size_of_val(&*self.references)];
        sizes.into_iter().sum::<usize>() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_take_8_bytes_and_leaves_64() {
        assert_eq!((size_of::<KdNode>(), size_of::<KdLeaf>()), (8, 64));
    }

    #[test]
    fn a_node_keeps_what_it_was_made_of() {
        let most = (1 << 30) - 1;
        let inner = KdNode::inner(2, -0.5, most);
        assert_eq!((inner.axis(), inner.index(), inner.is_leaf()), (2, most, false));
        let leaf = KdNode::leaf(most);
        assert_eq!((leaf.index(), leaf.is_leaf()), (most, true));
    }
}
