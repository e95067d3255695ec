//! What a ball, or the ball swept over a box, is to the boxes of the tree. `region.wesl` is the twin of this file.

use glam::Vec3;

use super::build::BoxN;
use crate::geometry::distance::{LENGTH_SLACK, PERIOD_SLACK, RADIUS_SLACK, WRAP_SLACK, norm2};
use crate::geometry::{Aabb, Period};

/// The box of a node.
pub type NodeBox = BoxN<f32, 3>;

impl NodeBox {
    /// Smallest corner.
    #[inline(always)]
    pub(super) fn low(&self) -> Vec3 {
        Vec3::from_array(self.min)
    }

    /// Largest corner.
    #[inline(always)]
    pub(super) fn high(&self) -> Vec3 {
        Vec3::from_array(self.max)
    }

    /// As a box.
    pub fn to_aabb(&self) -> Aabb {
        Aabb::new(self.low(), self.high())
    }

    /// Middle and half edges; half edges below zero where the box is empty.
    #[inline(always)]
    fn middle(&self) -> (Vec3, Vec3) {
        (0.5 * self.low() + 0.5 * self.high(), 0.5 * self.high() - 0.5 * self.low())
    }
}

/// Where points can lie that are near a box: the box, moved outwards by the radius.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region {
    min: Vec3,
    max: Vec3,
    /// Middle and half edges with the slack of the wrap, for periodic axes.
    center: Vec3,
    half: Vec3,
    period: Period,
}

impl Region {
    /// The region within `radius` of `around`; points lie within `extent` of zero on each axis.
    ///
    /// Rounding keeps the order of numbers: a point that the distance formula finds is never outside. Periodic axes get the
    /// slack of the formula's wrap, and that of middle and half edges.
    #[inline]
    pub(super) fn near(around: &Aabb, radius: f32, period: Period, extent: Vec3) -> Self {
        let reach = Vec3::splat(radius * RADIUS_SLACK + LENGTH_SLACK);
        let (min, max) = (around.min - reach, around.max + reach);
        let mut region = Self { min, max, center: Vec3::ZERO, half: Vec3::ZERO, period };
        if period.is_periodic() {
            let slack = wrap_slack(around.min.abs().max(around.max.abs()), period, extent);
            region.center = 0.5 * around.min + 0.5 * around.max;
            region.half = 0.5 * around.max - 0.5 * around.min + reach + slack;
        }
        region
    }

    /// Whether the box has a point of the region.
    #[inline(always)]
    pub(super) fn meets(&self, node: &NodeBox) -> bool {
        if !self.period.is_periodic() {
            return node.low().cmple(self.max).all() && node.high().cmpge(self.min).all();
        }
        let (middle, half) = node.middle();
        self.period.nearest_image(self.center - middle).abs().cmple(self.half + half).all()
    }

    /// Whether all of the box lies in the region.
    #[inline(always)]
    pub(super) fn contains(&self, node: &NodeBox) -> bool {
        if !self.period.is_periodic() {
            return node.low().cmpge(self.min).all() && node.high().cmple(self.max).all();
        }
        let (middle, half) = node.middle();
        (self.period.nearest_image(self.center - middle).abs() + half).cmple(self.half).all()
    }
}

/// What the wrap to the nearest image may be off by on each periodic axis, for places within `reach` of zero.
#[inline(always)]
fn wrap_slack(reach: Vec3, period: Period, extent: Vec3) -> Vec3 {
    period.lengths() * PERIOD_SLACK + (reach + extent) * (2.0 * WRAP_SLACK)
}

/// A squared distance that no point of the box falls below, in the distance formula's own rounding.
#[inline(always)]
pub(super) fn dist2_below(query: Vec3, node: &NodeBox, period: Period, extent: Vec3) -> f32 {
    if !period.is_periodic() {
        return norm2((node.low() - query).max(query - node.high()).max(Vec3::ZERO));
    }
    let (middle, half) = node.middle();
    let away = period.nearest_image(query - middle).abs() - half - wrap_slack(query.abs(), period, extent);
    norm2(away.max(Vec3::ZERO))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(min: [f32; 3], max: [f32; 3]) -> NodeBox {
        NodeBox { min, max }
    }

    #[test]
    fn a_box_at_exactly_the_radius_is_met() {
        let around = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let region = Region::near(&around, 0.5, Period::NONE, Vec3::ONE);
        assert!(region.meets(&node([1.5, 0.0, 0.0], [2.0, 1.0, 1.0])));
        assert!(!region.meets(&node([1.51, 0.0, 0.0], [2.0, 1.0, 1.0])));
        assert!(!region.meets(&NodeBox::EMPTY));
        assert!(region.contains(&node([-0.5; 3], [1.5; 3])) && !region.contains(&node([-0.6; 3], [1.5; 3])));
    }

    #[test]
    fn a_period_meets_boxes_at_the_other_end() {
        let period = Period::new(Vec3::new(10.0, 0.0, 0.0)).unwrap();
        let around = Aabb::new(Vec3::new(0.25, 0.0, 0.0), Vec3::new(0.5, 1.0, 1.0));
        let region = Region::near(&around, 0.5, period, Vec3::splat(10.0));
        let other_end = node([9.8, 0.0, 0.0], [9.9, 1.0, 1.0]);
        assert!(region.meets(&other_end) && !region.meets(&node([9.0, 0.0, 0.0], [9.7, 1.0, 1.0])));
        assert!(!region.meets(&NodeBox::EMPTY));
        let below = dist2_below(Vec3::new(0.25, 0.5, 0.5), &other_end, period, Vec3::splat(10.0));
        assert!(below <= 0.35 * 0.35 && below > 0.34 * 0.34, "{below}");
    }
}
