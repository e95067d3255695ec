//! Ways through the tree on the CPU: all that is near a region, and the nearest first.

use std::ops::Range;

use glam::Vec3;

use super::AabbTree;
use super::region::{Region, dist2_below};
use super::shape::TreeShape;
use crate::geometry::Aabb;

impl AabbTree {
    /// The region within `radius` of a box.
    #[inline(always)]
    pub(super) fn region_near(&self, around: &Aabb, radius: f32) -> Region {
        Region::near(around, radius, self.settings.period, self.extent)
    }

    /// Appends spans of points that together hold all points in the region: those of the largest nodes that lie inside, and
    /// of the leaves that lie partly inside. Touching spans become one. Returns the number of nodes looked at.
    pub(super) fn spans_in(&self, region: &Region, spans: &mut Vec<Range<usize>>) -> usize {
        let mut next = (!self.boxes.is_empty()).then_some(0);
        let mut visited = 0;
        while let Some(node) = next {
            visited += 1;
            let aabb = &self.boxes[node];
            if region.meets(aabb) {
                if !self.shape.is_leaf(node) && !region.contains(aabb) {
                    next = Some(2 * node + 1);
                    continue;
                }
                let points = self.shape.points(node);
                match spans.last_mut() {
                    Some(last) if last.end == points.start => last.end = points.end,
                    _ => spans.push(points),
                }
            }
            next = TreeShape::rope(node);
        }
        visited
    }

    /// Goes from a leaf to the root, and at each node above walks the subtree on the other side in depth-first order, as
    /// far as boxes meet the region within `radius` of `around`. Hands the places of each leaf that is met to `take`, its
    /// own first, and returns the number of nodes looked at.
    ///
    /// Source: the back-traversal of algorithms 1 and 2 of Xing2017.
    pub(crate) fn back_traverse(
        &self,
        leaf: usize,
        around: &Aabb,
        radius: f32,
        mut take: impl FnMut(Range<usize>),
    ) -> usize {
        let region = self.region_near(around, radius);
        let (mut visited, mut current, mut subtree) = (0, leaf, leaf);
        loop {
            let behind = TreeShape::rope(subtree);
            let mut next = Some(subtree);
            while let Some(node) = next.filter(|_| next != behind) {
                visited += 1;
                if region.meets(&self.boxes[node]) {
                    if !self.shape.is_leaf(node) {
                        next = Some(2 * node + 1);
                        continue;
                    }
                    take(self.shape.points(node));
                }
                next = TreeShape::rope(node);
            }
            let (Some(sibling), Some(parent)) = (TreeShape::sibling(current), TreeShape::parent(current)) else {
                return visited;
            };
            (current, subtree) = (parent, sibling);
        }
    }

    /// Hands spans of points to `test`, each point at most once and near ones first, until nothing that is left can lie
    /// within the squared distance that `test` returned last, or the one given.
    pub(crate) fn boxes_nearest_first(&self, query: Vec3, reach2: f32, mut test: impl FnMut(Range<usize>) -> f32) {
        /// Nodes that wait: one a level at most, and the one at hand.
        const DEEPEST: usize = 34;
        if self.boxes.is_empty() {
            return;
        }
        let below = |node: usize| dist2_below(query, &self.boxes[node], self.settings.period, self.extent);
        let mut reach2 = reach2;
        let mut waiting = [(0usize, 0f32); DEEPEST];
        waiting[0] = (0, below(0));
        let mut n_waiting = 1;
        while n_waiting > 0 {
            n_waiting -= 1;
            let (mut node, bound) = waiting[n_waiting];
            if bound > reach2 {
                continue;
            }
            let mut dead = false;
            while !self.shape.is_leaf(node) {
                let [left, right] = [2 * node + 1, 2 * node + 2];
                let [to_left, to_right] = [below(left), below(right)];
                let ((near, to_near), far) = if to_right < to_left {
                    ((right, to_right), (left, to_left))
                } else {
                    ((left, to_left), (right, to_right))
                };
                if far.1 <= reach2 {
                    waiting[n_waiting] = far;
                    n_waiting += 1;
                }
                if to_near > reach2 {
                    dead = true;
                    break;
                }
                node = near;
            }
            if !dead {
                reach2 = test(self.shape.points(node)).min(reach2);
            }
        }
    }

    /// The leaf that a search from the top ends in that always takes the child whose box is nearer to the query, the first
    /// of equals: a leaf that contains the query, where one does on that way. `None` without points.
    pub fn nearest_leaf(&self, query: Vec3) -> Option<usize> {
        let below = |node: usize| dist2_below(query, &self.boxes[node], self.settings.period, self.extent);
        let mut node = (!self.boxes.is_empty()).then_some(0)?;
        while !self.shape.is_leaf(node) {
            let [left, right] = [2 * node + 1, 2 * node + 2];
            node = if below(right) < below(left) { right } else { left };
        }
        Some(node)
    }
}
