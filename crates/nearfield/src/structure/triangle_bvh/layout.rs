//! Nodes and leaves as the CPU searches them: eight boxes, eight triangles, coordinate by coordinate.

use glam::Vec3;

use super::collapse::{WIDTH, WideNode};
use super::settings::BLOCK;
use crate::geometry::{Aabb, PreparedTriangle};

/// What a child of a node is, in 32 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(transparent)]
pub(super) struct Child(u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    /// No child: its box is empty.
    pub(super) const NONE: Self = Self(u32::MAX);
    /// The node that every walk begins with.
    pub(super) const ROOT: Self = Self(0);

    pub(super) fn node(index: usize) -> Self {
        Self(index as u32)
    }

    pub(super) fn leaf(block: usize) -> Self {
        Self(block as u32 | Self::LEAF)
    }

    #[inline(always)]
    pub(super) fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    /// The node, or the block of a leaf.
    #[inline(always)]
    pub(super) fn index(self) -> usize {
        (self.0 & !Self::LEAF) as usize
    }
}

/// Eight boxes and what is in them.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Smallest x, y, z, largest x, y, z. A box without a child is from +∞ to −∞.
    pub(super) planes: [[f32; WIDTH]; 6],
    pub(super) children: [Child; WIDTH],
}

impl Node {
    pub(super) const EMPTY: Self = Self {
        planes: {
            let (high, low) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
            [high, high, high, low, low, low]
        },
        children: [Child::NONE; WIDTH],
    };

    /// A node of the wide tree; the blocks of its leaves go behind the others.
    pub(super) fn new(wide: &WideNode, blocks: &mut Vec<Block>, triangle: impl Fn(u32) -> PreparedTriangle) -> Self {
        let mut node = Self::EMPTY;
        for (slot, child) in wide.children().iter().enumerate() {
            node.set_bounds(slot, &child.bounds);
            node.children[slot] = if child.n_triangles == 0 {
                Child::node(child.first as usize)
            } else {
                blocks.push(Block::new((child.first..child.first + child.n_triangles).map(&triangle)));
                Child::leaf(blocks.len() - 1)
            };
        }
        node
    }

    pub(super) fn set_bounds(&mut self, slot: usize, aabb: &Aabb) {
        for axis in 0..3 {
            self.planes[axis][slot] = aabb.min[axis];
            self.planes[axis + 3][slot] = aabb.max[axis];
        }
    }

    pub(super) fn bounds(&self, slot: usize) -> Aabb {
        let corner = |first: usize| Vec3::from_array(std::array::from_fn(|axis| self.planes[first + axis][slot]));
        Aabb::new(corner(0), corner(3))
    }

    /// The union of the children's boxes.
    pub(super) fn all_bounds(&self) -> Aabb {
        (0..WIDTH).fold(Aabb::EMPTY, |all, slot| all.union(self.bounds(slot)))
    }

    /// The children with their slots.
    pub(super) fn children(&self) -> impl Iterator<Item = (usize, Child)> + '_ {
        self.children.iter().copied().enumerate().filter(|(_, child)| *child != Child::NONE)
    }
}

/// The triangles of a leaf.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// x, y, z of the low, the middle and the high corner, as in [`PreparedTriangle`].
    pub(super) corners: [[[f32; BLOCK]; 3]; 3],
    /// The caller's indices.
    pub(super) indices: [u32; BLOCK],
    /// [`PreparedTriangle::corners`].
    pub(super) order: [u32; BLOCK],
    /// Lanes that hold a triangle, one bit each from the lowest on.
    pub(super) lanes: u32,
}

impl Block {
    fn new(triangles: impl Iterator<Item = PreparedTriangle>) -> Self {
        let mut block =
            Self { corners: [[[0.0; BLOCK]; 3]; 3], indices: [u32::MAX; BLOCK], order: [0; BLOCK], lanes: 0 };
        for (lane, triangle) in triangles.enumerate() {
            block.set(lane, &triangle);
            block.lanes |= 1 << lane;
        }
        block
    }

    pub(super) fn set(&mut self, lane: usize, triangle: &PreparedTriangle) {
        for (corner, place) in [triangle.low, triangle.middle, triangle.high].into_iter().enumerate() {
            for axis in 0..3 {
                self.corners[corner][axis][lane] = place[axis];
            }
        }
        self.indices[lane] = triangle.index;
        self.order[lane] = triangle.corners;
    }

    /// The triangle of a lane, as it was prepared.
    #[inline(always)]
    pub(super) fn triangle(&self, lane: usize) -> PreparedTriangle {
        let corner = |corner: usize| Vec3::from_array(std::array::from_fn(|axis| self.corners[corner][axis][lane]));
        PreparedTriangle {
            low: corner(0),
            index: self.indices[lane],
            middle: corner(1),
            corners: self.order[lane],
            high: corner(2),
            padding: 0,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.lanes.count_ones() as usize
    }
}
