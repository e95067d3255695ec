//! The plane of a query's neighbours, by their covariance about their mean. `plane.wesl` is the twin of this file.

use super::sample::Samples;
use crate::application::PointFlags;
use crate::geometry::symmetric_eigen::Symmetric;
use crate::geometry::vector::{self, Vector};

/// Neighbours with a smaller ratio of their two largest variances lie on a line.
pub(super) const LEAST_WIDTH: f64 = 1e-6;

/// A plane through the mean of neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    /// Of length 1, on either side.
    pub(super) normal: Vector<f64>,
    /// Part of the variance along the normal.
    pub(super) variation: f64,
}

/// The plane in which they spread most.
///
/// # Errors
/// The flag that says why there is none.
pub(super) fn fit_plane(samples: &Samples) -> Result<Plane, PointFlags> {
    if samples.all.len() < 3 {
        return Err(PointFlags::FEW_NEIGHBORS);
    }
    let (mut total, mut sum) = (0.0, [0.0; 3]);
    for sample in &samples.all {
        total += sample.weight;
        sum = vector::add_scaled(sum, sample.offset, sample.weight);
    }
    let mean = vector::scale(sum, 1.0 / total);
    let mut covariance = Symmetric::default();
    for sample in &samples.all {
        covariance.add_outer(vector::subtract(sample.offset, mean), sample.weight);
    }
    plane_of(&covariance).ok_or(PointFlags::DEGENERATE)
}

/// The plane of a covariance; `None` where it has no width.
fn plane_of(covariance: &Symmetric<f64>) -> Option<Plane> {
    let eigen = covariance.eigen();
    let [least, middle, most] = eigen.values.map(|value| value.max(0.0));
    // Also where a value is no number, with weights that are all 0.
    if !(most > 0.0 && middle >= LEAST_WIDTH * most) {
        return None;
    }
    let variation = least / (least + middle + most);
    vector::normalized(eigen.vectors[0]).map(|normal| Plane { normal, variation })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(offsets: &[Vector<f64>]) -> Samples {
        let mut samples = Samples::default();
        samples.begin();
        offsets.iter().for_each(|&offset| samples.add(offset));
        samples.finish(1.0, None);
        samples
    }

    #[test]
    fn points_of_a_plane_give_its_normal() {
        let n = [0.48, 0.6, -0.64];
        let [u, v] = vector::tangents(n);
        let grid = (0..25).map(|i| (f64::from(i % 5) * 0.1, f64::from(i / 5) * 0.2));
        let offsets: Vec<_> = grid.map(|(a, b)| vector::add(vector::scale(u, a), vector::scale(v, b))).collect();
        let plane = fit_plane(&samples(&offsets)).unwrap();
        assert!(vector::dot(plane.normal, n).abs() > 1.0 - 1e-14 && plane.variation < 1e-14, "{plane:?}");
        // All corners of a cube: no direction is special.
        let corners: Vec<_> = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from)).collect();
        assert!((fit_plane(&samples(&corners)).unwrap().variation - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn points_without_a_plane_have_flags() {
        let line: Vec<_> = (0..20).map(|i| vector::scale([0.3, -0.5, 0.7], f64::from(i) * 0.05)).collect();
        for (offsets, flag) in [
            (&line[..0], PointFlags::FEW_NEIGHBORS),
            (&line[..2], PointFlags::FEW_NEIGHBORS),
            (&line[..], PointFlags::DEGENERATE),
            (&[[0.25; 3]; 9][..], PointFlags::DEGENERATE),
        ] {
            assert_eq!(fit_plane(&samples(offsets)), Err(flag));
        }
    }
}
