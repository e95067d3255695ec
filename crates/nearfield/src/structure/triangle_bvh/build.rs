//! The binary tree: triangles split by surface area down to single ones. Source: Wald2007.
//!
//! Primitives of 32 bytes stand in the order of the tree's leaves as far as it is split. Many are split by several threads, in
//! chunks that depend on their number only: what comes out is the same for any number of threads.

use bytemuck::Zeroable;
use glam::{Vec3, Vec3A, Vec4};
use rayon::prelude::*;

use super::collapse::{Costs, LeafCost, Shares};
use super::split::{BinPlane, Filled, best_split, best_split_of, fill};
use super::sweep::sweep;
use super::{BvhSettings, MOST_SPLIT_LEVELS};
use crate::Result;
use crate::geometry::{Aabb, PreparedTriangle};
use crate::host_memory::zeroed;
use crate::structure::PreparedTriangles;

/// Subtrees of fewer triangles are built by one thread.
pub(super) const PARALLEL: usize = 1 << 12;
/// Nodes of more triangles are split by several threads.
const SHARED: usize = 1 << 15;
/// Fewest triangles that a thread takes of such a node, and most chunks.
const CHUNK: usize = 1 << 13;
const MOST_CHUNKS: usize = 64;

/// A triangle as the build sees it: its widened box.
#[derive(Debug, Clone, Copy, Zeroable)]
#[repr(C)]
pub(super) struct Primitive {
    /// Smallest corner, and the low 23 bits of the triangle's index as those of a number from 1 to 2: arithmetic of vectors
    /// takes this coordinate along, and many processors need a hundred cycles for one with a subnormal number.
    pub(super) low: Vec4,
    /// Largest corner, and the other bits.
    pub(super) high: Vec4,
}

impl Primitive {
    pub(super) fn new(aabb: &Aabb, index: u32) -> Self {
        let number = |bits: u32| f32::from_bits(1.0f32.to_bits() | bits);
        let high_bits = index >> Self::LOW_BITS;
        Self { low: aabb.min.extend(number(index & Self::LOW_MASK)), high: aabb.max.extend(number(high_bits)) }
    }

    const LOW_BITS: u32 = f32::MANTISSA_DIGITS - 1;
    const LOW_MASK: u32 = (1 << Self::LOW_BITS) - 1;

    pub(super) fn index(&self) -> u32 {
        let [low, high] = [self.low.w, self.high.w].map(|w| w.to_bits() & Self::LOW_MASK);
        low | high << Self::LOW_BITS
    }

    pub(super) fn min(&self) -> Vec3A {
        Vec3A::from_vec4(self.low)
    }

    pub(super) fn max(&self) -> Vec3A {
        Vec3A::from_vec4(self.high)
    }

    /// Twice the centre of the box.
    pub(super) fn center(&self) -> Vec3A {
        self.min() + self.max()
    }

    pub(super) fn bounds(&self) -> Aabb {
        Aabb::new(self.min().into(), self.max().into())
    }
}

/// The triangles that can be hit.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn primitives(triangles: &PreparedTriangles) -> Result<Vec<Primitive>> {
    let space = triangles.space();
    let primitive = |t: &PreparedTriangle| Primitive::new(&space.widened(&t.bounds()), t.index);
    let all = triangles.as_slice();
    let mut primitives = zeroed("boxes of triangles", all.len())?;
    let put = |(to, from): (&mut [Primitive], &[PreparedTriangle])| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = primitive(from));
        from.iter().all(PreparedTriangle::has_area)
    };
    let chunks = primitives.par_chunks_mut(PARALLEL).zip(all.par_chunks(PARALLEL));
    if !chunks.map(put).reduce(|| true, |a, b| a && b) {
        primitives.retain(|primitive| all[primitive.index() as usize].has_area());
    }
    Ok(primitives)
}

/// A node of the binary tree over two triangles or more. The left child stands behind it, the right one behind the whole
/// left subtree; single triangles have no node.
#[derive(Debug, Clone, Copy, Zeroable)]
#[repr(C)]
pub(super) struct BinaryNode {
    pub(super) bounds: Aabb,
    /// Triangles on the left.
    pub(super) n_left: u32,
    /// How it becomes children of a wide node.
    pub(super) shares: Shares,
}

/// What is known of a subtree when it is built.
#[derive(Clone, Copy)]
pub(super) struct Subtree {
    pub(super) min: Vec3A,
    pub(super) max: Vec3A,
    pub(super) costs: Costs,
}

/// The binary tree.
pub(super) struct BinaryTree {
    /// `[triangles]` in the order of the leaves.
    pub(super) primitives: Vec<Primitive>,
    /// `[triangles - 1]`, the root first.
    pub(super) nodes: Vec<BinaryNode>,
}

/// The tree over at least one triangle of a box whose longest side is `reach`.
pub(super) fn binary_tree(
    mut primitives: Vec<Primitive>,
    reach: f32,
    settings: &BvhSettings,
    cost: &LeafCost,
) -> Result<BinaryTree> {
    let mut nodes = zeroed("nodes of a binary tree", primitives.len() - 1)?;
    let mut spare = zeroed("triangles in the order of a tree", primitives.len())?;
    let builder = Builder { settings, cost, unit: (1.0 / reach).min(f32::MAX) };
    builder.build_shared(&mut primitives, &mut spare, true, &mut nodes, 0);
    Ok(BinaryTree { primitives, nodes })
}

/// What stays the same through a build.
pub(super) struct Builder<'a> {
    pub(super) settings: &'a BvhSettings,
    pub(super) cost: &'a LeafCost,
    /// Lengths are multiplied by this before they are multiplied with each other, so that areas stay in the range of an f32:
    /// boxes are wider than the margin of [`crate::geometry::RaySpace`].
    pub(super) unit: f32,
}

impl Builder<'_> {
    /// Half the surface of a box.
    #[inline(always)]
    pub(super) fn half_area(&self, extent: Vec3A) -> f32 {
        let scaled = extent * self.unit;
        scaled.dot(Vec3A::new(scaled.y, scaled.z, scaled.x))
    }

    pub(super) fn single(&self, primitive: &Primitive) -> Subtree {
        let (min, max) = (primitive.min(), primitive.max());
        Subtree { min, max, costs: Costs::of_triangle(self.cost, self.half_area(max - min)) }
    }

    /// The node over two subtrees.
    #[inline(always)]
    pub(super) fn joined(&self, left: &Subtree, right: &Subtree, n_left: usize, n: usize) -> (Subtree, BinaryNode) {
        let (min, max) = (left.min.min(right.min), left.max.max(right.max));
        let area = self.half_area(max - min);
        let (costs, shares) = self.cost.share((&left.costs, n_left), (&right.costs, n - n_left), area);
        let bounds = Aabb::new(min.into(), max.into());
        (Subtree { min, max, costs }, BinaryNode { bounds, n_left: n_left as u32, shares })
    }

    /// Builds a subtree over many primitives, which stand in `from`; in the end they stand there, or in `to` where not `stays`.
    fn build_shared(
        &self,
        from: &mut [Primitive],
        to: &mut [Primitive],
        stays: bool,
        nodes: &mut [BinaryNode],
        level: u32,
    ) -> Subtree {
        let n = from.len();
        if n <= SHARED.max(self.settings.sweep_below as usize) || level >= MOST_SPLIT_LEVELS {
            if stays {
                return self.build(from, to, nodes, level);
            }
            to.copy_from_slice(from);
            return self.build(to, from, nodes, level);
        }
        let chunk = CHUNK.max(n.div_ceil(MOST_CHUNKS));
        let chunks = || from.par_chunks(chunk);
        let centers = chunks().map(CenterBounds::of).reduce(|| CenterBounds::EMPTY, CenterBounds::union);
        let Some(bins) = centers.bins(n, self.settings) else {
            return self.halves(from, to, stays, nodes, n / 2, level);
        };
        let filled: Vec<Filled> = chunks().map(|chunk| fill(chunk, &bins)).collect();
        let Some(border) = best_split_of(&filled, &bins, self) else {
            let n_left = halve(from);
            return self.halves(from, to, stays, nodes, n_left, level);
        };
        // Each chunk has its own places on the left and on the right.
        let plane = BinPlane { bins, border };
        let lefts: Vec<usize> = filled.iter().map(|filled| filled.n_left(&border)).collect();
        let n_left = lefts.iter().sum();
        let (mut left, mut right) = to.split_at_mut(n_left);
        let mut parts = Vec::with_capacity(lefts.len());
        for (chunk, n_left) in from.chunks(chunk).zip(lefts) {
            let (to_left, left_behind) = left.split_at_mut(n_left);
            let (to_right, right_behind) = right.split_at_mut(chunk.len() - n_left);
            parts.push((chunk, to_left, to_right));
            (left, right) = (left_behind, right_behind);
        }
        parts.into_par_iter().for_each(|(chunk, mut left, mut right)| {
            for primitive in chunk {
                let place = if plane.is_left(primitive) { &mut left } else { &mut right };
                if let Some(to) = place.split_off_first_mut() {
                    *to = *primitive;
                }
            }
        });
        self.halves(to, from, !stays, nodes, n_left, level)
    }

    /// Builds both halves of a node over many primitives.
    fn halves(
        &self,
        from: &mut [Primitive],
        to: &mut [Primitive],
        stays: bool,
        nodes: &mut [BinaryNode],
        n_left: usize,
        level: u32,
    ) -> Subtree {
        let n = from.len();
        let ((left, right), (to_left, to_right)) = (from.split_at_mut(n_left), to.split_at_mut(n_left));
        let (node, left_nodes, right_nodes) = split_nodes(nodes, n_left);
        let (left, right) = rayon::join(
            || self.build_shared(left, to_left, stays, left_nodes, level + 1),
            || self.build_shared(right, to_right, stays, right_nodes, level + 1),
        );
        let (subtree, joined) = self.joined(&left, &right, n_left, n);
        *node = joined;
        subtree
    }

    /// Builds a subtree in place. `spare` is as long as `primitives`.
    fn build(
        &self,
        primitives: &mut [Primitive],
        spare: &mut [Primitive],
        nodes: &mut [BinaryNode],
        level: u32,
    ) -> Subtree {
        let n = primitives.len();
        if n == 1 {
            return self.single(&primitives[0]);
        }
        if n <= (self.settings.sweep_below as usize).max(2) {
            return sweep(self, primitives, nodes, level);
        }
        let n_left = if level < MOST_SPLIT_LEVELS {
            match CenterBounds::of(primitives).bins(n, self.settings) {
                // All in one place: any halves are as good.
                None => n / 2,
                Some(bins) => match best_split(primitives, &bins, self) {
                    Some(border) => partition(primitives, spare, &BinPlane { bins, border }),
                    None => halve(primitives),
                },
            }
        } else {
            halve(primitives)
        };
        let ((left, right), (spare_left, spare_right)) = (primitives.split_at_mut(n_left), spare.split_at_mut(n_left));
        let (node, left_nodes, right_nodes) = split_nodes(nodes, n_left);
        let mut build_left = || self.build(left, spare_left, left_nodes, level + 1);
        let mut build_right = || self.build(right, spare_right, right_nodes, level + 1);
        let (left, right) =
            if n > PARALLEL { rayon::join(build_left, build_right) } else { (build_left(), build_right()) };
        let (subtree, joined) = self.joined(&left, &right, n_left, n);
        *node = joined;
        subtree
    }
}

/// The first node, and those of the subtrees below it, of which the left one has so many triangles.
pub(super) fn split_nodes(
    nodes: &mut [BinaryNode],
    n_left: usize,
) -> (&mut BinaryNode, &mut [BinaryNode], &mut [BinaryNode]) {
    let (node, below) = nodes.split_first_mut().expect("there should be a node for every subtree");
    let (left, right) = below.split_at_mut(n_left - 1);
    (node, left, right)
}

/// Bounds of the centres, which are doubled.
#[derive(Clone, Copy)]
pub(super) struct CenterBounds {
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
}

impl CenterBounds {
    const EMPTY: Self = Self { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY };

    pub(super) fn of(primitives: &[Primitive]) -> Self {
        let grown = |all: Self, p: &Primitive| Self { low: all.low.min(p.center()), high: all.high.max(p.center()) };
        primitives.iter().fold(Self::EMPTY, grown)
    }

    fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }
}

/// Brings the primitives that are on the left to the front; their number. Without a branch that depends on the side.
fn partition(primitives: &mut [Primitive], spare: &mut [Primitive], plane: &BinPlane) -> usize {
    let n = primitives.len();
    let spare = &mut spare[..n];
    let mut n_left = 0;
    for i in 0..n {
        let primitive = primitives[i];
        // Both places are behind what has been read.
        primitives[n_left] = primitive;
        spare[i - n_left] = primitive;
        n_left += usize::from(plane.is_left(&primitive));
    }
    primitives[n_left..].copy_from_slice(&spare[..n - n_left]);
    n_left
}

/// Splits at the median of the axis along which the centres spread most.
fn halve(primitives: &mut [Primitive]) -> usize {
    let centers = CenterBounds::of(primitives);
    let axis = Vec3::from(centers.high - centers.low).max_position();
    let middle = primitives.len() / 2;
    primitives.select_nth_unstable_by(middle, |a, b| a.center()[axis].total_cmp(&b.center()[axis]));
    middle
}

/// Small boxes anywhere in a cube, for tests.
#[cfg(test)]
pub(super) fn boxes(n: usize, seed: u32) -> Vec<Primitive> {
    let mut state = seed;
    let mut random = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let mut vector = || Vec3::new(random(), random(), random());
    (0..n as u32)
        .map(|index| {
            let min = vector();
            Primitive::new(&Aabb::new(min, min + 0.01 + 0.1 * vector()), index)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_stand_in_numbers_that_are_not_subnormal() {
        for index in [0, 1, 12_345_678, (1 << 23) - 1, 1 << 23, (1 << 31) - 1, u32::MAX] {
            let primitive = Primitive::new(&Aabb::new(Vec3::ZERO, Vec3::ONE), index);
            assert_eq!(primitive.index(), index);
            assert!(primitive.low.w.is_normal() && primitive.high.w.is_normal());
        }
    }

    #[test]
    fn partitions_lose_nothing() {
        let settings = BvhSettings::DEFAULT;
        let all = boxes(500, 5);
        for n in [2, 3, 100, 500] {
            let mut primitives = all[..n].to_vec();
            let bins = CenterBounds::of(&primitives).bins(n, &settings).unwrap();
            let cost = LeafCost { most: 8, entry: 1.0, triangle: 0.0 };
            let builder = Builder { settings: &settings, cost: &cost, unit: 1.0 };
            let plane = BinPlane { bins, border: best_split(&primitives, &bins, &builder).unwrap() };
            let n_left = partition(&mut primitives, &mut all.clone(), &plane);
            assert!((0..n).all(|i| plane.is_left(&primitives[i]) == (i < n_left)), "{n}");
            let mut indices: Vec<u32> = primitives.iter().map(Primitive::index).collect();
            indices.sort_unstable();
            assert!(indices.into_iter().eq(0..n as u32), "{n}");
        }
    }
}
