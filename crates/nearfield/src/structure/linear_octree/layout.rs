//! The node of an octree: the same bytes on both sides. `layout.wesl` is the twin of this file.

use bytemuck::{Pod, Zeroable};

use crate::curve::{MAX_LEVEL, Octant};

/// No node: the parent of the root, the first child of a leaf, the rope of the last nodes.
pub const NONE: u32 = u32::MAX;

/// A node of an octree.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct OctreeNode {
    /// Smallest cell inside, at level 21.
    pub low: [u32; 3],
    /// Level: 0 for the root.
    pub level: u32,
    /// First point in the tree's order.
    pub first_point: u32,
    /// End of its points.
    pub end_point: u32,
    /// First of its children, which stand side by side; [`NONE`] for a leaf.
    pub first_child: u32,
    /// The node that follows in pre-order once this one's descendants are left out; [`NONE`] behind the last.
    pub rope: u32,
    /// The octant.
    pub octant: Octant,
    /// The parent; [`NONE`] for the root.
    pub parent: u32,
    /// Bit i is set where child i along the curve has points; 0 for a leaf.
    pub child_mask: u32,
}

impl OctreeNode {
    /// Whether it has no children.
    #[inline(always)]
    pub fn is_leaf(&self) -> bool {
        self.first_child == NONE
    }

    /// Places of its points in the tree's order.
    #[inline(always)]
    pub fn points(&self) -> std::ops::Range<usize> {
        self.first_point as usize..self.end_point as usize
    }

    /// Number of points.
    #[inline(always)]
    pub fn n_points(&self) -> u32 {
        self.end_point - self.first_point
    }

    /// Its children.
    #[inline(always)]
    pub fn children(&self) -> std::ops::Range<usize> {
        if self.is_leaf() {
            return 0..0;
        }
        let first = self.first_child as usize;
        first..first + self.child_mask.count_ones() as usize
    }

    /// The child with this index along the curve; `None` where that octant has no points, and for a leaf.
    #[inline(always)]
    pub fn child(&self, index: u32) -> Option<u32> {
        let bit = 1u32 << index;
        (self.child_mask & bit != 0).then(|| self.first_child + (self.child_mask & (bit - 1)).count_ones())
    }

    /// Largest cell inside, at level 21.
    #[inline(always)]
    pub fn high(&self) -> [u32; 3] {
        self.low.map(|low| low + ((1 << (MAX_LEVEL - self.level)) - 1))
    }
}
