//! The walk along a ray, front to back with a stack, written once for every form of the inner tests.

use super::MOST_LEVELS;
use super::collapse::WIDTH;
use super::layout::{Block, Child, Node};
use super::settings::BLOCK;
use crate::geometry::PreparedRay;
use crate::structure::{CountRayWork, HitVisitor};

/// Entries that a walk through a tree of so many levels can have waiting: a walk goes down to one child of a node and
/// leaves at most seven behind, and what waits belongs to nodes of one path.
pub(super) const fn stack_size(levels: u32) -> usize {
    (WIDTH - 1) * levels as usize
}

/// Trees of at most this many levels are walked with a small stack.
pub(super) const SHALLOW: u32 = 12;
/// The small stack and the large one.
pub(super) const SMALL_STACK: usize = stack_size(SHALLOW);
pub(super) const LARGE_STACK: usize = stack_size(MOST_LEVELS);

/// What a walk needs of a ray beside [`PreparedRay`].
#[derive(Debug, Clone, Copy)]
pub(super) struct WalkRay<'a> {
    pub(super) ray: &'a PreparedRay,
    /// [`PreparedRay::origin`] and [`PreparedRay::inverse`] by axis.
    pub(super) origin: [f32; 3],
    pub(super) inverse: [f32; 3],
    /// Rows of [`Node::planes`] where the ray enters along x, y, z.
    pub(super) near: [usize; 3],
    /// And those where it leaves.
    pub(super) far: [usize; 3],
    /// The axes that become x, y and z of the sheared frame.
    pub(super) axes: [usize; 3],
}

impl<'a> WalkRay<'a> {
    #[inline(always)]
    pub(super) fn new(ray: &'a PreparedRay) -> Self {
        let near = std::array::from_fn(|axis| if ray.inverse[axis] < 0.0 { axis + 3 } else { axis });
        let far = near.map(|row: usize| if row < 3 { row + 3 } else { row - 3 });
        let axes = [(ray.axis + 1) % 3, (ray.axis + 2) % 3, ray.axis];
        Self { ray, origin: ray.origin.to_array(), inverse: ray.inverse.to_array(), near, far, axes }
    }
}

/// The two inner tests of a walk, for eight boxes and for eight triangles.
pub(super) trait Lanes {
    /// Where the ray enters each box, and in which it is at a t from `t_min` to `limit`, one bit a box. The arithmetic is
    /// that of [`PreparedRay::slabs`]; which plane comes first is known from the sign of the direction.
    fn entries(node: &Node, ray: &WalkRay<'_>, limit: f32, entries: &mut [f32; WIDTH]) -> u32;

    /// The triangles that the ray does not pass on the outside, one bit each: those for which
    /// [`crate::geometry::PreparedTriangle::hit`] goes beyond its comparison of edge functions. The arithmetic is the same.
    fn candidates(block: &Block, ray: &WalkRay<'_>) -> u32;
}

/// Any processor, and the compiler's own vectors.
pub(super) struct Portable;

impl Lanes for Portable {
    #[inline(always)]
    fn entries(node: &Node, walk: &WalkRay<'_>, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
        let mut enter = [walk.ray.t_min; WIDTH];
        let mut leave = [limit; WIDTH];
        for axis in 0..3 {
            let (near, far) = (&node.planes[walk.near[axis]], &node.planes[walk.far[axis]]);
            let (origin, inverse) = (walk.origin[axis], walk.inverse[axis]);
            for lane in 0..WIDTH {
                let (to_near, to_far) = ((near[lane] - origin) * inverse, (far[lane] - origin) * inverse);
                enter[lane] = if to_near > enter[lane] { to_near } else { enter[lane] };
                leave[lane] = if to_far < leave[lane] { to_far } else { leave[lane] };
            }
        }
        *entries = enter;
        (0..WIDTH).fold(0, |mask, lane| mask | u32::from(enter[lane] <= leave[lane]) << lane)
    }

    #[inline(always)]
    fn candidates(block: &Block, walk: &WalkRay<'_>) -> u32 {
        let [x, y, z] = walk.axes;
        let (origin, shear) = (walk.origin, walk.ray.shear);
        let mut places = [([0.0f32; BLOCK], [0.0f32; BLOCK]); 3];
        for (corner, (xs, ys)) in block.corners.iter().zip(&mut places) {
            for lane in 0..BLOCK {
                let along = corner[z][lane] - origin[z];
                xs[lane] = (corner[x][lane] - origin[x]) - shear.x * along;
                ys[lane] = (corner[y][lane] - origin[y]) - shear.y * along;
            }
        }
        let mut outside = 0;
        for lane in 0..BLOCK {
            let edge = |from: usize, to: usize| {
                (places[from].0[lane] * places[to].1[lane], places[from].1[lane] * places[to].0[lane])
            };
            let (high, low, middle) = (edge(0, 1), edge(1, 2), edge(0, 2));
            let left = (high.0 < high.1) | (low.0 < low.1) | (middle.1 < middle.0);
            let right = (high.0 > high.1) | (low.0 > low.1) | (middle.1 > middle.0);
            outside |= u32::from(left & right) << lane;
        }
        block.lanes & !outside
    }
}

/// A child that waits, and where the ray enters its box.
#[derive(Debug, Clone, Copy)]
struct Entry {
    enter: f32,
    child: Child,
}

/// Walks along the ray through a tree of so many levels that `STACK` is at least their [`stack_size`].
#[inline(always)]
pub(super) fn walk<L: Lanes, const STACK: usize, V: HitVisitor, W: CountRayWork>(
    nodes: &[Node],
    blocks: &[Block],
    ray: &PreparedRay,
    visitor: &mut V,
    work: &mut W,
) {
    let ray = WalkRay::new(ray);
    // What waits: of the children of one node the nearest last.
    let mut stack = [Entry { enter: 0.0, child: Child::NONE }; STACK];
    let mut waiting = 0;
    let mut entries = [0.0; WIDTH];
    let mut child = Child::ROOT;
    loop {
        if child.is_leaf() {
            let block = &blocks[child.index()];
            work.leaf_visits(1);
            work.triangle_tests(block.len() as u32);
            let mut candidates = L::candidates(block, &ray);
            while candidates != 0 {
                let lane = candidates.trailing_zeros() as usize % BLOCK;
                candidates &= candidates - 1;
                if let Some(hit) = block.triangle(lane).hit(ray.ray)
                    && visitor.offer(&hit, f32::INFINITY).is_break()
                {
                    return;
                }
            }
        } else {
            let node = &nodes[child.index()];
            work.node_visits(node.children().count() as u32);
            let mut met = L::entries(node, &ray, visitor.limit(), &mut entries);
            let take = |met: &mut u32| {
                let slot = met.trailing_zeros() as usize % WIDTH;
                *met &= *met - 1;
                Entry { enter: entries[slot], child: node.children[slot] }
            };
            if met != 0 {
                let mut nearest = take(&mut met);
                let first = waiting;
                while met != 0 {
                    let mut farther = take(&mut met);
                    if farther.enter < nearest.enter {
                        std::mem::swap(&mut farther, &mut nearest);
                    }
                    let mut place = waiting;
                    while place > first && stack[place - 1].enter < farther.enter {
                        stack[place] = stack[place - 1];
                        place -= 1;
                    }
                    stack[place] = farther;
                    waiting += 1;
                }
                child = nearest.child;
                continue;
            }
        }
        // What begins beyond the limit, which may have come nearer, is left out.
        child = loop {
            if waiting == 0 {
                return;
            }
            waiting -= 1;
            if stack[waiting].enter <= visitor.limit() {
                break stack[waiting].child;
            }
        };
    }
}
