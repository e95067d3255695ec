//! The binary tree: triangles split by surface area down to single ones. Source: Wald2007.

use glam::{Vec3, Vec3A, Vec4};
use rayon::prelude::*;

use super::split::{Split, best_split};
use super::{BvhSettings, MOST_SPLIT_LEVELS};
use crate::geometry::{Aabb, PreparedTriangle};
use crate::structure::PreparedTriangles;

/// Subtrees of fewer triangles are built by one thread.
const PARALLEL: usize = 1 << 12;

/// A triangle as the build sees it: its widened box.
#[derive(Debug, Clone, Copy)]
pub(super) struct Primitive {
    /// Smallest corner, and the index of the triangle as bits.
    low: Vec4,
    high: Vec4,
}

impl Primitive {
    fn new(aabb: &Aabb, index: u32) -> Self {
        Self { low: aabb.min.extend(f32::from_bits(index)), high: aabb.max.extend(0.0) }
    }

    pub(super) fn index(&self) -> u32 {
        self.low.w.to_bits()
    }

    pub(super) fn min(&self) -> Vec3A {
        Vec3A::from_vec4(self.low)
    }

    pub(super) fn max(&self) -> Vec3A {
        Vec3A::from_vec4(self.high)
    }

    /// The centre of the box, halved coordinate by coordinate.
    pub(super) fn center(&self) -> Vec3A {
        0.5 * self.min() + 0.5 * self.max()
    }
}

/// The triangles that can be hit.
pub(super) fn primitives(triangles: &PreparedTriangles) -> Vec<Primitive> {
    let space = triangles.space();
    let primitive = |t: &PreparedTriangle| t.has_area().then(|| Primitive::new(&space.widened(&t.bounds()), t.index));
    triangles.as_slice().par_iter().with_min_len(PARALLEL).filter_map(primitive).collect()
}

/// A node of the binary tree. The left child stands behind it, the right one behind the whole left subtree.
#[derive(Debug, Clone, Copy)]
pub(super) struct BinaryNode {
    pub(super) bounds: Aabb,
    /// Triangles below.
    pub(super) n: u32,
    /// Those on the left; 0 where there is one triangle in all.
    pub(super) n_left: u32,
}

impl BinaryNode {
    const NONE: Self = Self { bounds: Aabb::EMPTY, n: 0, n_left: 0 };

    /// Nodes of a tree over `n` triangles.
    pub(super) const fn count(n: usize) -> usize {
        2 * n - 1
    }
}

/// The nodes over the triangles, which are brought into the order of the leaves. At least one triangle.
pub(super) fn binary_tree(primitives: &mut [Primitive], settings: &BvhSettings) -> Vec<BinaryNode> {
    let mut nodes = vec![BinaryNode::NONE; BinaryNode::count(primitives.len())];
    build(primitives, &mut nodes, 0, settings);
    nodes
}

fn build(primitives: &mut [Primitive], nodes: &mut [BinaryNode], level: u32, settings: &BvhSettings) {
    let n = primitives.len();
    if n == 1 {
        let (min, max) = (primitives[0].min(), primitives[0].max());
        nodes[0] = BinaryNode { bounds: Aabb::new(min.into(), max.into()), n: 1, n_left: 0 };
        return;
    }
    let n_left = if level < MOST_SPLIT_LEVELS {
        match best_split(primitives, settings) {
            Split::Sorted { n_left } => n_left,
            Split::Bins(plane) => partition(primitives, |p| plane.is_left(p)),
            // All in one place: any halves are as good.
            Split::None => n / 2,
        }
    } else {
        halve(primitives)
    };
    let (left, right) = primitives.split_at_mut(n_left);
    let (node, below) = nodes.split_first_mut().expect("there should be a node for every subtree");
    let (left_nodes, right_nodes) = below.split_at_mut(BinaryNode::count(n_left));
    if n > PARALLEL {
        rayon::join(|| build(left, left_nodes, level + 1, settings), || build(right, right_nodes, level + 1, settings));
    } else {
        build(left, left_nodes, level + 1, settings);
        build(right, right_nodes, level + 1, settings);
    }
    let bounds = left_nodes[0].bounds.union(right_nodes[0].bounds);
    *node = BinaryNode { bounds, n: n as u32, n_left: n_left as u32 };
}

/// Brings the primitives that are on the left to the front; their number.
fn partition(primitives: &mut [Primitive], is_left: impl Fn(&Primitive) -> bool) -> usize {
    let (mut low, mut high) = (0, primitives.len());
    loop {
        while low < high && is_left(&primitives[low]) {
            low += 1;
        }
        while low < high && !is_left(&primitives[high - 1]) {
            high -= 1;
        }
        if low >= high {
            return low;
        }
        primitives.swap(low, high - 1);
    }
}

/// Splits at the median of the axis along which the centres spread most.
fn halve(primitives: &mut [Primitive]) -> usize {
    let grow = |(low, high): (Vec3A, Vec3A), p: &Primitive| (low.min(p.center()), high.max(p.center()));
    let (low, high) = primitives.iter().fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), grow);
    let axis = Vec3::from(high - low).max_position();
    let middle = primitives.len() / 2;
    primitives.select_nth_unstable_by(middle, |a, b| a.center()[axis].total_cmp(&b.center()[axis]));
    middle
}
