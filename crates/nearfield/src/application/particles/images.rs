//! Periodic sides of a domain: places are taken back into it, and the way to another particle is that to its nearest image.

use glam::{BVec3, DVec3};

/// Lengths of the periodic sides of a domain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Images {
    low: DVec3,
    /// 0 on sides that are not periodic, as `inverse`.
    lengths: DVec3,
    inverse: DVec3,
    is_periodic: bool,
}

impl Images {
    /// - `periodic`: by axis; such sides are longer than 0
    pub(super) fn new(domain: [DVec3; 2], periodic: [bool; 3]) -> Self {
        let mask = BVec3::from_array(periodic);
        let lengths = DVec3::select(mask, domain[1] - domain[0], DVec3::ZERO);
        let inverse = DVec3::select(mask, lengths.recip(), DVec3::ZERO);
        Self { low: domain[0], lengths, inverse, is_periodic: mask.any() }
    }

    /// Lengths by axis; 0 where not periodic.
    pub(super) fn lengths(&self) -> DVec3 {
        self.lengths
    }

    /// A difference of two places, brought to the nearest image.
    #[inline]
    pub(super) fn nearest(&self, offset: DVec3) -> DVec3 {
        if self.is_periodic { offset - self.lengths * (offset * self.inverse).round() } else { offset }
    }

    /// The image of a place that lies in the domain.
    #[inline]
    pub(super) fn wrap(&self, position: DVec3) -> DVec3 {
        if self.is_periodic {
            position - self.lengths * ((position - self.low) * self.inverse).floor()
        } else {
            position
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_differences_wrap_on_periodic_sides_only() {
        let images = Images::new([DVec3::splat(-1.0), DVec3::ONE], [true, false, true]);
        assert_eq!(images.wrap(DVec3::new(1.25, 1.25, -3.25)), DVec3::new(-0.75, 1.25, 0.75));
        assert_eq!(images.nearest(DVec3::new(1.5, 1.5, -1.75)), DVec3::new(-0.5, 1.5, 0.25));
        let open = Images::new([DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)], [false; 3]);
        assert_eq!(open.wrap(DVec3::splat(7.0)), DVec3::splat(7.0));
        assert_eq!(open.nearest(DVec3::splat(0.75)), DVec3::splat(0.75));
    }
}
