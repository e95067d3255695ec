//! The leaves near a box, kept for many queries in it: each takes those that its own ball meets, without a walk of its own.

use std::ops::Range;

use glam::Vec3;

use super::AabbTree;
use super::region::dist2_below;
use super::shape::TreeShape;
use crate::geometry::Aabb;

/// Leaves from which on queries do not share them: looking through all boxes would take as long as a walk.
const MOST_LEAVES: usize = 256;

/// Leaves with their boxes, axis by axis.
#[derive(Debug, Default)]
pub(crate) struct NearLeaves {
    nodes: Vec<usize>,
    places: Vec<Range<usize>>,
    low: [Vec<f32>; 3],
    high: [Vec<f32>; 3],
    below: Vec<f32>,
}

impl NearLeaves {
    fn clear(&mut self) {
        self.nodes.clear();
        self.places.clear();
        self.low.iter_mut().chain(&mut self.high).for_each(Vec::clear);
    }
}

impl AabbTree {
    /// Finds all leaves that can hold a point within `radius` of the box. False, with some of them only, where there are too
    /// many to share.
    pub(crate) fn leaves_near(&self, around: &Aabb, radius: f32, leaves: &mut NearLeaves) -> bool {
        leaves.clear();
        let region = self.region_near(around, radius);
        let mut next = (!self.boxes.is_empty()).then_some(0);
        while let Some(node) = next {
            let aabb = &self.boxes[node];
            if region.meets(aabb) {
                if !self.shape.is_leaf(node) {
                    next = Some(2 * node + 1);
                    continue;
                }
                if leaves.nodes.len() == MOST_LEAVES {
                    return false;
                }
                leaves.nodes.push(node);
                leaves.places.push(self.shape.points(node));
                for axis in 0..3 {
                    leaves.low[axis].push(aabb.min[axis]);
                    leaves.high[axis].push(aabb.max[axis]);
                }
            }
            next = TreeShape::rope(node);
        }
        true
    }

    /// Makes `spans` those of the leaves that can hold a point within the squared distance `reach2` of the query.
    pub(crate) fn spans_within(
        &self,
        query: Vec3,
        reach2: f32,
        leaves: &mut NearLeaves,
        spans: &mut Vec<Range<usize>>,
    ) {
        let NearLeaves { nodes, places, low, high, below } = leaves;
        if self.settings.period.is_periodic() {
            let bound = |&node: &usize| dist2_below(query, &self.boxes[node], self.settings.period, self.extent);
            below.clear();
            below.extend(nodes.iter().map(bound));
        } else {
            // As `dist2_below` and `norm2`, axis by axis, so that the compiler takes several leaves at once.
            let larger = |a: f32, b: f32| if a > b { a } else { b };
            let n = nodes.len();
            let ([lx, ly, lz], [hx, hy, hz]) = (low.each_ref().map(|v| &v[..n]), high.each_ref().map(|v| &v[..n]));
            let outside = |low: f32, high: f32, at: f32| larger(larger(low - at, at - high), 0.0);
            below.resize(n, 0.0);
            for (i, below) in below.iter_mut().enumerate() {
                let x = outside(lx[i], hx[i], query.x);
                let y = outside(ly[i], hy[i], query.y);
                let z = outside(lz[i], hz[i], query.z);
                *below = x * x + y * y + z * z;
            }
        }
        // Without a branch that could be foreseen wrongly: every leaf is written, and stays if it is met.
        spans.resize(nodes.len(), 0..0);
        let mut met = 0;
        for (places, &below) in places.iter().zip(below.iter()) {
            spans[met] = places.clone();
            met += usize::from(below <= reach2);
        }
        spans.truncate(met);
    }
}
