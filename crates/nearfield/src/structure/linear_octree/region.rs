//! The cells that can hold a neighbour: what a ball or box is to an octree. `region.wesl` is the twin of this file.
//!
//! Points are brought to cells by a function that is monotone along each axis, so the cells of two bounds enclose the
//! cells of all coordinates between them, exactly: no tolerance is needed beyond that of the distance formula.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::OctreeNode;
use crate::curve::{Domain, MAX_LEVEL};
use crate::geometry::Aabb;
use crate::geometry::Period;
use crate::geometry::distance::{LENGTH_SLACK, PERIOD_SLACK, RADIUS_SLACK, WRAP_SLACK};

const LAST_CELL: u32 = (1 << MAX_LEVEL) - 1;

/// What the kernels know of a tree, in the bytes of their uniform.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct OctreeLayout {
    /// The cube that is cut.
    pub domain: Domain,
    /// Length of the period by axis; 0 where not periodic.
    pub period: [f32; 3],
    /// Number of points.
    pub n_points: u32,
    /// One over the period; 0 where not periodic.
    pub inverse_period: [f32; 3],
    /// Number of nodes.
    pub n_nodes: u32,
    /// Largest distance of a point from the domain's origin by axis.
    pub extent: [f32; 3],
    /// Unused.
    pub padding: u32,
}

/// One or two intervals of cells an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CellRegion {
    pub(super) low: [u32; 3],
    pub(super) high: [u32; 3],
    /// The second intervals, where a period folds the region; elsewhere empty: from the largest number to zero.
    pub(super) second_low: [u32; 3],
    pub(super) second_high: [u32; 3],
}

impl OctreeLayout {
    pub(super) fn new(domain: Domain, period: Period, bounds: &Aabb, [n_points, n_nodes]: [usize; 2]) -> Self {
        let extent = if bounds.is_empty() { Vec3::ZERO } else { bounds.max - domain.origin() };
        Self {
            domain,
            period: period.lengths().to_array(),
            n_points: n_points as u32,
            inverse_period: period.inverse().to_array(),
            n_nodes: n_nodes as u32,
            extent: extent.to_array(),
            padding: 0,
        }
    }

    /// The cells that can hold a point within `radius` of the box `around`.
    #[inline]
    pub(super) fn region_near(&self, around: &Aabb, radius: f32) -> CellRegion {
        let mut region = CellRegion::between([0; 3], [0; 3]);
        let origin = self.domain.origin();
        for axis in 0..3 {
            let (low, high) = (around.min[axis], around.max[axis]);
            let mut reach = radius * RADIUS_SLACK + LENGTH_SLACK;
            let period = self.period[axis];
            if period == 0.0 {
                region.low[axis] = self.domain.cell_at((low - reach) - origin[axis]);
                region.high[axis] = self.domain.cell_at((high + reach) - origin[axis]);
                continue;
            }
            let (low, high) = (low - origin[axis], high - origin[axis]);
            let extent = self.extent[axis];
            reach += period * PERIOD_SLACK + (low.abs().max(high.abs()) + extent) * WRAP_SLACK;
            let whole = !((high - low) + 2.0 * reach < period && extent <= period);
            if whole {
                (region.low[axis], region.high[axis]) = (0, LAST_CELL);
                continue;
            }
            let turns = period * (low * self.inverse_period[axis]).floor();
            let (first, last) = ((low - turns) - reach, (high - turns) + reach);
            region.low[axis] = self.domain.cell_at(first);
            region.high[axis] = self.domain.cell_at(last);
            // The points lie within one period: at most one more image of the interval meets them.
            let shift = if last >= period { -period } else { period };
            if last >= period || first + period <= extent {
                region.second_low[axis] = self.domain.cell_at(first + shift);
                region.second_high[axis] = self.domain.cell_at(last + shift);
            }
        }
        region
    }
}

impl CellRegion {
    /// The region of the cells between two, both included.
    pub(super) fn between(low: [u32; 3], high: [u32; 3]) -> Self {
        Self { low, high, second_low: [u32::MAX; 3], second_high: [0; 3] }
    }

    /// Whether a node has a cell of the region.
    #[inline(always)]
    pub(super) fn overlaps(&self, node: &OctreeNode) -> bool {
        let (low, high) = (node.low, node.high());
        (0..3).all(|axis| {
            (low[axis] <= self.high[axis] && high[axis] >= self.low[axis])
                || (low[axis] <= self.second_high[axis] && high[axis] >= self.second_low[axis])
        })
    }

    /// Whether all cells of a node are in the region.
    #[inline(always)]
    pub(super) fn contains(&self, node: &OctreeNode) -> bool {
        let (low, high) = (node.low, node.high());
        (0..3).all(|axis| {
            (low[axis] >= self.low[axis] && high[axis] <= self.high[axis])
                || (low[axis] >= self.second_low[axis] && high[axis] <= self.second_high[axis])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::Octant;

    /// The root, and the first and last octant of level 3.
    fn nodes() -> [OctreeNode; 3] {
        let node = |octant: Octant| OctreeNode {
            low: octant.cell_range(Default::default())[0],
            level: octant.level(),
            octant,
            ..bytemuck::Zeroable::zeroed()
        };
        [Octant::ROOT, Octant::of_key(0, 3), Octant::of_key((1 << 63) - 1, 3)].map(node)
    }

    #[test]
    fn a_region_without_a_period_has_one_interval_an_axis() {
        let eighth = 1 << (MAX_LEVEL - 3);
        let region = CellRegion::between([3 * eighth; 3], [5 * eighth; 3]);
        assert_eq!(nodes().map(|node| region.overlaps(&node)), [true, false, false]);
        assert_eq!(nodes().map(|node| region.contains(&node)), [false; 3]);
        let corner = CellRegion::between([0; 3], [eighth - 1; 3]);
        assert_eq!(nodes().map(|node| corner.overlaps(&node)), [true, true, false]);
        assert_eq!(nodes().map(|node| corner.contains(&node)), [false, true, false]);
    }

    #[test]
    fn a_ball_at_the_border_of_a_period_meets_both_ends() {
        let bounds = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let layout =
            |lengths| OctreeLayout::new(Domain::of_bounds(&bounds), Period::new(lengths).unwrap(), &bounds, [8, 8]);
        let near = |layout: &OctreeLayout, at: Vec3| layout.region_near(&Aabb::new(at, at), 0.05);
        let meets = |region: CellRegion| nodes().map(|node| region.overlaps(&node));
        let corner = Vec3::splat(0.99);
        assert_eq!(meets(near(&layout(Vec3::ZERO), corner)), [true, false, true]);
        assert_eq!(meets(near(&layout(Vec3::ONE), corner)), [true, true, true]);
        assert_eq!(meets(near(&layout(Vec3::ONE), corner + 7.0)), [true, true, true], "images of the centre count");
        assert_eq!(meets(near(&layout(Vec3::ONE), Vec3::splat(0.5))), [true, false, false]);
        // Points that lie over more than a period, and a ball larger than one, meet everything.
        assert_eq!(meets(near(&layout(Vec3::splat(0.5)), Vec3::splat(0.3))), [true, true, true]);
        assert_eq!(meets(near(&layout(Vec3::splat(0.08)), Vec3::splat(0.3))), [true, true, true]);
    }
}
