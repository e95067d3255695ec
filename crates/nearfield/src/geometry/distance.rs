//! The distance formula, written once: d² = (dx·dx + dy·dy) + dz·dz in f32, never fused.
//!
//! A point is a neighbour when d² ≤ r·r. `distance.wesl` is the twin of this file; a GPU compiler may fuse a
//! multiplication with an addition there, so the two may differ where |d − r| is within 4 ulp of r.

use glam::Vec3;

/// Part of the radius added before cells are chosen. A point with d² ≤ r² in f32 lies within r·(1 + 2⁻²²) on each
/// axis, whatever the compiler fuses.
pub const RADIUS_SLACK: f32 = 1.0 + 1.0 / (1 << 20) as f32;
/// Length added before cells are chosen: differences below it have a square that a device may flush to zero.
pub const LENGTH_SLACK: f32 = 2e-19;
/// Part of the period added on a periodic axis, for the rounding of the wrap.
pub const PERIOD_SLACK: f32 = 1.0 / (1 << 20) as f32;
/// Part of the distances of query and points from the origin added on a periodic axis: differences of points many
/// periods apart are rounded before they are wrapped (six roundings of 2⁻²⁴ at most).
pub const WRAP_SLACK: f32 = 1.0 / (1 << 21) as f32;

/// Squared length of `v`.
#[inline(always)]
pub fn norm2(v: Vec3) -> f32 {
    v.x * v.x + v.y * v.y + v.z * v.z
}

/// Squared distance between two points.
#[inline(always)]
pub fn dist2(a: Vec3, b: Vec3) -> f32 {
    norm2(a - b)
}

/// Lengths of a periodic domain. An axis with length 0 is not periodic.
///
/// The distance between two points is the distance to the nearest image; a point is met at most once, whatever the radius.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Period {
    lengths: Vec3,
    inverse: Vec3,
}

impl Period {
    /// No periodic axis.
    pub const NONE: Self = Self { lengths: Vec3::ZERO, inverse: Vec3::ZERO };

    /// Periodic lengths per axis, 0 for an axis without period.
    ///
    /// # Errors
    /// `InvalidSetting` if a length is negative, not finite, or so small or large that its inverse is not a normal number.
    pub fn new(lengths: Vec3) -> crate::Result<Self> {
        for length in lengths.to_array() {
            if length != 0.0 && !(1e-18..=1e18).contains(&length) {
                return Err(crate::Error::InvalidSetting {
                    setting: "period",
                    found: format!("{length:e}"),
                    expected: "0 (not periodic) or a length between 1e-18 and 1e18 on each axis",
                });
            }
        }
        let inverse = Vec3::from_array(lengths.to_array().map(|l| if l > 0.0 { 1.0 / l } else { 0.0 }));
        Ok(Self { lengths, inverse })
    }

    /// Length per axis; 0 where not periodic.
    pub fn lengths(&self) -> Vec3 {
        self.lengths
    }

    /// One over the length; 0 where not periodic.
    pub fn inverse(&self) -> Vec3 {
        self.inverse
    }

    /// Whether any axis is periodic.
    pub fn is_periodic(&self) -> bool {
        self.lengths != Vec3::ZERO
    }

    /// The difference `v` brought to the nearest image.
    #[inline(always)]
    pub fn nearest_image(&self, v: Vec3) -> Vec3 {
        let turns = (v * self.inverse).to_array().map(f32::round_ties_even);
        v - self.lengths * Vec3::from_array(turns)
    }

    /// Squared distance to the nearest image.
    #[inline(always)]
    pub fn dist2(&self, a: Vec3, b: Vec3) -> f32 {
        norm2(self.nearest_image(a - b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boundary_on_representable_numbers_is_inside() {
        let r = 0.5f32;
        assert!(dist2(Vec3::new(0.25, 0.0, 0.0), Vec3::new(0.75, 0.0, 0.0)) <= r * r);
        assert!(dist2(Vec3::new(0.25, 0.0, 0.0), Vec3::new(0.75f32.next_up(), 0.0, 0.0)) > r * r);
    }

    #[test]
    fn nearest_image_crosses_the_border() {
        let period = Period::new(Vec3::new(1.0, 0.0, 0.0)).unwrap();
        assert_eq!(period.dist2(Vec3::new(0.0625, 0.0, 0.0), Vec3::new(0.9375, 0.0, 0.0)), 0.125 * 0.125);
        assert_eq!(period.dist2(Vec3::new(0.0, 0.25, 0.0), Vec3::new(0.0, 4.25, 0.0)), 16.0);
    }

    #[test]
    fn bad_periods_are_refused() {
        for length in [-1.0, f32::NAN, f32::INFINITY, 1e-30] {
            assert!(Period::new(Vec3::new(0.0, length, 0.0)).is_err());
        }
    }
}
