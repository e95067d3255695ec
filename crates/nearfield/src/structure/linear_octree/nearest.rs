//! The way from a query to its nearest points: first the smallest node around it that has enough of them, then what is
//! beside that node, beside its parent, and so on, as long as it can be nearer. `nearest.wesl` is the twin of the bound.

use std::ops::Range;

use glam::Vec3;

use super::LinearOctree;
use super::layout::OctreeNode;
use super::region::OctreeLayout;
use super::walk::Step;
use crate::curve::MAX_LEVEL;
use crate::geometry::distance::norm2;

/// Part of the lengths on an axis by which a node is taken to be larger than its cells.
///
/// With edge e, scale s = 2²¹/e and a query at offset a from the origin: a point p of the node has
/// low ≤ fl(fl(p − origin) · s), two roundings of 2⁻²⁴, and at its high end one more, that of s. The ends of the node
/// are off by the division for the length of a cell (2.5 ulp on a device), one product and one sum, a and the difference
/// by one rounding each: together less than 2⁻²⁰ (e + |a|). With a period L the wraps of formula and bound add six
/// roundings of at most e + |a| + L. This is twice as much.
const NODE_SLACK: f32 = 1.0 / (1 << 19) as f32;

/// A query as the bounds of nodes see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Probe {
    /// Offset from the domain's origin.
    offset: Vec3,
    slack: Vec3,
    /// Length of a cell.
    cell: f32,
}

impl OctreeLayout {
    pub(super) fn probe(&self, query: Vec3) -> Probe {
        let offset = query - self.domain.origin();
        let lengths = offset.abs() + self.domain.edge() + Vec3::from_array(self.period);
        let slack = lengths * NODE_SLACK;
        Probe { offset, slack, cell: 1.0 / self.domain.scale() }
    }

    /// A squared distance that no point of the node falls below, in the distance formula's own rounding: each axis is
    /// bounded from below, and differences, squares and sums of f32 are monotone.
    #[inline(always)]
    pub(super) fn dist2_below(&self, probe: &Probe, node: &OctreeNode) -> f32 {
        let size = (1u32 << (MAX_LEVEL - node.level)) as f32 * probe.cell;
        let low = Vec3::from_array(node.low.map(|cell| cell as f32)) * probe.cell - probe.offset;
        let mut outside = low.max(-(low + size));
        if self.period != [0.0; 3] {
            outside = self.nearest_image_of(low, size, outside);
        }
        norm2((outside - probe.slack).max(Vec3::ZERO))
    }

    /// The distance to the interval from `low` on, or to its nearest image where the axis has a period.
    fn nearest_image_of(&self, low: Vec3, size: f32, outside: Vec3) -> Vec3 {
        let period = Vec3::from_array(self.period);
        // The image that starts behind the query, and the one before it; where that one reaches the query, the distance is
        // below zero.
        let ahead = low - period * (low * Vec3::from_array(self.inverse_period)).floor();
        let wrapped = ahead.min(period - (ahead + size));
        Vec3::select(period.cmpgt(Vec3::ZERO), wrapped, outside)
    }
}

impl LinearOctree {
    /// Hands spans of points to `test`, each point at most once and near ones first, until nothing that is left can lie
    /// within the squared distance that `test` returned last. The first span has at least `wanted` points, if there are
    /// so many and they are not spread over more than a cell about as wide as `radius`, beyond which nothing is wanted.
    pub(crate) fn octants_nearest_first(
        &self,
        query: Vec3,
        wanted: usize,
        radius: f32,
        mut test: impl FnMut(Range<usize>) -> f32,
    ) {
        let Some(mut inner) = self.smallest_around(query, wanted, radius) else { return };
        let nodes = self.nodes();
        let probe = self.layout.probe(query);
        let mut reach2 = test(nodes[inner].points());
        while let Some(parent) = nodes.get(nodes[inner].parent as usize) {
            for sibling in parent.children().filter(|&sibling| sibling != inner) {
                self.walk_below(sibling as u32, |_, node| {
                    if self.layout.dist2_below(&probe, node) > reach2 {
                        return Step::Over;
                    }
                    if node.is_leaf() {
                        reach2 = test(node.points());
                    }
                    Step::Into
                });
            }
            inner = nodes[inner].parent as usize;
        }
    }

    /// The smallest node around the query's cell that has `wanted` points or is at least as wide as `radius`; the root
    /// where none is. `None` without points. Queries outside the domain count to its border.
    ///
    /// One product and a comparison decide on the width, so that devices start at the same node.
    pub(super) fn smallest_around(&self, query: Vec3, wanted: usize, radius: f32) -> Option<usize> {
        let radius_in_cells = radius * self.domain().scale();
        let nodes = self.nodes();
        let key = self.domain().key_of(self.curve(), query);
        let mut node = nodes.first().map(|_| 0)?;
        for level in 0..MAX_LEVEL {
            let index = (key >> (3 * (MAX_LEVEL - 1 - level)) & 7) as u32;
            match nodes[node].child(index) {
                Some(child)
                    if nodes[child as usize].n_points() as usize >= wanted
                        || radius_in_cells <= (1u32 << (MAX_LEVEL - 1 - level)) as f32 =>
                {
                    node = child as usize;
                }
                _ => break,
            }
        }
        Some(node)
    }
}
