//! Walks over the nodes: by level, in pre-order, in post-order, and over those that a region touches.

use std::ops::Range;

use super::LinearOctree;
use super::layout::{NONE, OctreeNode};
use super::region::CellRegion;
use crate::geometry::Aabb;

impl LinearOctree {
    /// Number of levels: one more than the depth; 0 without points.
    pub fn n_levels(&self) -> usize {
        self.nodes.level_starts.len() - 1
    }

    /// The nodes of a level, along the curve; none below the deepest one.
    pub fn level(&self, level: u32) -> Range<usize> {
        level_of(&self.nodes.level_starts, level)
    }

    /// `[n_nodes]` number of each node in pre-order: parents before children.
    pub fn pre_order_numbers(&self) -> &[u32] {
        &self.nodes.pre_order
    }

    /// `[n_nodes]` number of each node in post-order: children before parents.
    pub fn post_order_numbers(&self) -> &[u32] {
        &self.nodes.post_order
    }

    /// The nodes in pre-order `[n_nodes]`.
    pub fn pre_order(&self) -> Vec<u32> {
        inverse(&self.nodes.pre_order)
    }

    /// The nodes in post-order `[n_nodes]`: what gathers from the leaves up may take them in this order.
    pub fn post_order(&self) -> Vec<u32> {
        inverse(&self.nodes.post_order)
    }

    /// The leaves along the curve.
    pub fn leaves(&self) -> impl Iterator<Item = u32> + '_ {
        let nodes = self.nodes();
        let mut node = if nodes.is_empty() { NONE } else { 0 };
        std::iter::from_fn(move || {
            while !nodes.get(node as usize)?.is_leaf() {
                node = nodes[node as usize].first_child;
            }
            let leaf = node;
            node = nodes[leaf as usize].rope;
            Some(leaf)
        })
    }

    /// Goes through the nodes in pre-order, by the ropes: `step` gets the number of a node and the node.
    #[inline(always)]
    pub(crate) fn walk(&self, step: impl FnMut(u32, &OctreeNode) -> Step) {
        walk_nodes(self.nodes(), 0, NONE, step);
    }

    /// As [`LinearOctree::walk`], only through a node and its descendants.
    #[inline(always)]
    pub(super) fn walk_below(&self, node: u32, step: impl FnMut(u32, &OctreeNode) -> Step) {
        walk_nodes(self.nodes(), node, self.nodes()[node as usize].rope, step);
    }

    /// Appends spans of points that together hold all points in the cells of the region, along the curve: those of the
    /// largest nodes that lie inside, and of the leaves that lie partly inside. Touching spans become one.
    pub(super) fn spans_in(&self, region: &CellRegion, spans: &mut Vec<Range<usize>>) {
        self.walk(|_, node| {
            if !region.overlaps(node) {
                return Step::Over;
            }
            if !node.is_leaf() && !region.contains(node) {
                return Step::Into;
            }
            let points = node.points();
            match spans.last_mut() {
                Some(last) if last.end == points.start => last.end = points.end,
                _ => spans.push(points),
            }
            Step::Over
        });
    }
}

/// How a walk goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// With the children, if there are any.
    Into,
    /// Behind the descendants.
    Over,
    /// Not at all.
    Stop,
}

/// Goes from node `first` on in pre-order, until `end` or behind the last.
#[inline(always)]
pub(super) fn walk_nodes(nodes: &[OctreeNode], first: u32, end: u32, mut step: impl FnMut(u32, &OctreeNode) -> Step) {
    let mut next = first;
    while next != end {
        let Some(node) = nodes.get(next as usize) else { return };
        next = match step(next, node) {
            Step::Into if !node.is_leaf() => node.first_child,
            Step::Into | Step::Over => node.rope,
            Step::Stop => return,
        };
    }
}

/// The cells of a box: all that its points can have, and those whose points are surely inside.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoxCells {
    all: CellRegion,
    inner: CellRegion,
}

/// What a box is to a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Meeting {
    /// No point of the node is inside.
    Apart,
    /// Points of the node may be inside.
    Partly,
    /// All points of the node are inside.
    Inside,
}

impl BoxCells {
    /// Cells grow with coordinates: a cell above that of the lower corner has only coordinates above the corner's.
    pub(super) fn between(low: [u32; 3], high: [u32; 3]) -> Self {
        let all = CellRegion::between(low, high);
        let inner = CellRegion::between(low.map(|cell| cell + 1), high.map(|cell| cell.saturating_sub(1)));
        Self { all, inner }
    }

    #[inline(always)]
    pub(super) fn meet(&self, node: &OctreeNode) -> Meeting {
        match (self.all.overlaps(node), self.inner.contains(node)) {
            (false, _) => Meeting::Apart,
            (true, false) => Meeting::Partly,
            (true, true) => Meeting::Inside,
        }
    }
}

impl LinearOctree {
    /// Hands over spans of points that together hold all points in the closed box, each once and along the curve, and
    /// whether all points of the span are inside.
    pub(crate) fn spans_in_box(&self, aabb: &Aabb, mut visit: impl FnMut(Range<usize>, bool)) {
        let cells = BoxCells::between(self.domain().cell_of(aabb.min), self.domain().cell_of(aabb.max));
        self.walk(|_, node| {
            match cells.meet(node) {
                Meeting::Apart => {}
                Meeting::Inside => visit(node.points(), true),
                Meeting::Partly if node.is_leaf() => visit(node.points(), false),
                Meeting::Partly => return Step::Into,
            }
            Step::Over
        });
    }
}

/// The nodes of a level, from the first node of each.
pub(super) fn level_of(level_starts: &[u32], level: u32) -> Range<usize> {
    let start = |level: usize| level_starts.get(level).or(level_starts.last()).map_or(0, |&start| start as usize);
    start(level as usize)..start((level as usize).saturating_add(1))
}

/// The inverse of a permutation.
fn inverse(numbers: &[u32]) -> Vec<u32> {
    let mut inverse = vec![0; numbers.len()];
    for (i, &number) in numbers.iter().enumerate() {
        inverse[number as usize] = i as u32;
    }
    inverse
}
