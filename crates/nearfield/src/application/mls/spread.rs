//! Where the weighted samples around a query lie: their number, mean and covariance, and whether they can carry a surface.
//! `spread.wesl` is the twin of this file.
//!
//! All lengths are relative to the query and in radii of its search: sums of squares then keep their digits wherever the points
//! lie and however long their unit is.

use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::symmetric_eigen::Symmetric;
use crate::geometry::vector::{self, Vector};

/// Samples are on a line where the middle eigenvalue of their covariance is below this part of the largest.
const LINE: f64 = 1e-6;

/// A sample as a query sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample<T> {
    /// Its index in the cloud.
    pub(super) index: usize,
    /// Sample minus query.
    pub(super) offset: Vector<T>,
    /// Squared distance as a part of the squared radius of the support, 0 to 1.
    pub(super) y: T,
    /// Radius of the support that it is in.
    pub(super) reach: T,
}

/// Sums over the samples of a query.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Spread<T> {
    /// Samples, those at the edge of the support whose weight is 0 among them.
    pub(super) count: u32,
    /// Σ w.
    pub(super) weight: T,
    /// Σ w p.
    pub(super) first: Vector<T>,
    /// Σ w p pᵀ.
    pub(super) second: Symmetric<T>,
    /// Σ w h.
    reach: T,
}

impl<T: Scalar> Spread<T> {
    #[inline(always)]
    pub(super) fn add(&mut self, sample: &Sample<T>, weight: T) {
        self.count += 1;
        self.weight += weight;
        self.first = vector::add_scaled(self.first, sample.offset, weight);
        self.second.add_outer(sample.offset, weight);
        self.reach += weight * sample.reach;
    }

    /// The mean of the samples.
    pub(super) fn mean(&self) -> Vector<T> {
        vector::scale(self.first, T::ONE / self.weight)
    }

    /// The mean radius of the supports.
    pub(super) fn mean_reach(&self) -> T {
        self.reach / self.weight
    }

    /// The covariance about the mean.
    pub(super) fn covariance(&self) -> Symmetric<T> {
        let mut about = Symmetric(self.second.0.map(|sum| sum / self.weight));
        about.add_outer(self.mean(), -T::ONE);
        about
    }

    /// Why there can be no surface: too few samples, or all on a line or at one place.
    pub(super) fn fault(&self, least: u32) -> Option<PointFlags> {
        if self.count < least {
            return Some(PointFlags::FEW_NEIGHBORS);
        }
        (!(self.weight > T::ZERO) || is_line(&self.covariance())).then_some(PointFlags::DEGENERATE)
    }
}

/// Whether the ellipsoid of a covariance has no more than one axis, by the sums of its eigenvalues and of their products:
/// λ₁λ₂ + λ₂λ₃ + λ₃λ₁ against (λ₁ + λ₂ + λ₃)², which for a flat one is λ_mid : λ_max.
pub(super) fn is_line<T: Scalar>(covariance: &Symmetric<T>) -> bool {
    let [xx, xy, xz, yy, yz, zz] = covariance.0;
    let sum = xx + yy + zz;
    let products = (xx * yy - xy * xy) + (yy * zz - yz * yz) + (zz * xx - xz * xz);
    !(products >= T::of(LINE) * sum * sum && sum > T::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread(points: &[[f64; 3]]) -> Spread<f64> {
        let mut spread = Spread::default();
        for (index, &offset) in points.iter().enumerate() {
            spread.add(&Sample { index, offset, y: 0.5, reach: 0.5 }, 0.25);
        }
        spread
    }

    #[test]
    fn sums_give_mean_and_covariance() {
        let spread = spread(&[[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.5], [2.0, -1.0, -0.5]]);
        assert_eq!((spread.count, spread.mean(), spread.mean_reach()), (4, [2.0, 0.0, 0.0], 0.5));
        assert_eq!(spread.covariance().0, [0.5, 0.0, 0.0, 0.5, 0.25, 0.125]);
        assert_eq!(spread.fault(4), None);
        assert_eq!(spread.fault(5), Some(PointFlags::FEW_NEIGHBORS));
    }

    #[test]
    fn lines_and_single_places_carry_no_surface() {
        let along = |thin: f64| -> Vec<[f64; 3]> {
            (0..20u8).map(|i| [f64::from(i), f64::from(i) * 2.0, thin * f64::from(i % 2)]).collect()
        };
        assert_eq!(spread(&along(0.0)).fault(3), Some(PointFlags::DEGENERATE));
        // A ratio of variances of 0.25 · thin² / 166, on both sides of a millionth.
        assert_eq!(spread(&along(0.02)).fault(3), Some(PointFlags::DEGENERATE));
        assert_eq!(spread(&along(0.04)).fault(3), None);
        assert_eq!(spread(&[[0.5; 3]; 9]).fault(3), Some(PointFlags::DEGENERATE));
        assert_eq!(spread(&[]).fault(0), Some(PointFlags::DEGENERATE));
    }
}
