//! Nodes and leaves as the CPU searches them: eight boxes, eight triangles, coordinate by coordinate.

use bytemuck::Zeroable;
use glam::Vec3;
use rayon::prelude::*;

use super::collapse::{WIDTH, WideNode, WideTree};
use super::settings::BLOCK;
use crate::Result;
use crate::geometry::{Aabb, PreparedTriangle};
use crate::host_memory::zeroed;

/// Nodes that a thread lays out at once.
const CHUNK: usize = 1 << 8;

/// The nodes of the wide tree, and the blocks of its leaves in the order of the nodes.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn lay_out(
    wide: &WideTree,
    triangle: impl Fn(u32) -> PreparedTriangle + Sync,
) -> Result<(Vec<Node>, Vec<Block>)> {
    let n_leaves = |node: &WideNode| node.children().iter().filter(|child| child.n_triangles > 0).count();
    let mut nodes: Vec<Node> = zeroed("nodes of a BVH", wide.nodes.len())?;
    let mut blocks: Vec<Block> = zeroed("leaves of a BVH", wide.nodes.iter().map(n_leaves).sum())?;
    // Each chunk with its blocks, and the number of the first one.
    let mut parts = Vec::with_capacity(nodes.len().div_ceil(CHUNK));
    let (mut behind, mut first) = (blocks.as_mut_slice(), 0);
    for (from, to) in wide.nodes.chunks(CHUNK).zip(nodes.chunks_mut(CHUNK)) {
        let (own, others) = behind.split_at_mut(from.iter().map(n_leaves).sum());
        behind = others;
        let n_own = own.len();
        parts.push((from, to, first, own));
        first += n_own;
    }
    parts.into_par_iter().for_each(|(from, to, mut first, mut blocks)| {
        for (wide, node) in from.iter().zip(to) {
            let (own, others) = blocks.split_at_mut(n_leaves(wide));
            *node = Node::new(wide, own, first, &triangle);
            (first, blocks) = (first + own.len(), others);
        }
    });
    Ok((nodes, blocks))
}

/// What a child of a node is, in 32 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Zeroable)]
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
#[derive(Debug, Clone, Zeroable)]
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

    /// A node of the wide tree, the first block of whose leaves, which go into `blocks`, is number `first`.
    fn new(wide: &WideNode, blocks: &mut [Block], first: usize, triangle: impl Fn(u32) -> PreparedTriangle) -> Self {
        let mut node = Self::EMPTY;
        let mut n_leaves = 0;
        for (slot, child) in wide.children().iter().enumerate() {
            node.set_bounds(slot, &child.bounds);
            node.children[slot] = if child.n_triangles == 0 {
                Child::node(child.first as usize)
            } else {
                blocks[n_leaves] = Block::new((child.first..child.first + child.n_triangles).map(&triangle));
                n_leaves += 1;
                Child::leaf(first + n_leaves - 1)
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
#[derive(Debug, Clone, Zeroable)]
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
