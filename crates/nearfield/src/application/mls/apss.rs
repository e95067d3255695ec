//! Algebraic point-set surfaces (Guennebaud2007, Guennebaud2008): the sphere whose gradients agree best with the normals of the
//! samples. `apss.wesl` is the twin of this file.
//!
//! With sums over the weights w, P = Σ w p, N = Σ w n, W = Σ w, all relative to the query:
//! u_q = β ½ (Σ w p·n − P·N / W) / (Σ w p·p − P·P / W), u_l = (N − 2 u_q P) / W, u_c = −(u_l·P + u_q Σ w p·p) / W.

use super::cloud::{Cloud, Fitted, Query};
use super::sphere::AlgebraicSphere;
use super::spread::{Sample, Spread};
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};

/// Sums for a sphere.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SphereSums<T> {
    pub(super) spread: Spread<T>,
    /// Σ w n.
    normals: Vector<T>,
    /// Σ w p·n.
    along: T,
}

impl<T: Scalar> SphereSums<T> {
    #[inline(always)]
    pub(super) fn add(&mut self, sample: &Sample<T>, normal: Vector<T>, weight: T) {
        self.spread.add(sample, weight);
        self.normals = vector::add_scaled(self.normals, normal, weight);
        self.along += weight * vector::dot(sample.offset, normal);
    }

    /// The sphere, relative to the query and in radii of its search.
    pub(super) fn sphere(&self, sphericity: T) -> AlgebraicSphere<T> {
        let Spread { weight, first, second, .. } = self.spread;
        let squares = second.0[0] + second.0[3] + second.0[5];
        let inverse = T::ONE / weight;
        let bend = self.along - vector::dot(first, self.normals) * inverse;
        let size = squares - vector::norm2(first) * inverse;
        let quadratic = sphericity * T::of(0.5) * bend / size;
        let linear = vector::scale(vector::add_scaled(self.normals, first, -(quadratic + quadratic)), inverse);
        let constant = -(vector::dot(linear, first) + quadratic * squares) * inverse;
        AlgebraicSphere { constant, linear, quadratic }
    }
}

/// Projects the query's origin onto the sphere fitted around where it is.
pub(super) fn fit<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, sphericity: f64, least: u32) -> Fitted<T> {
    let mut sums = SphereSums::default();
    cloud.for_each_oriented(query.at, query.radius, |sample, normal| {
        sums.add(sample, normal, cloud.weight.at(sample.y));
    });
    if let Some(fault) = sums.spread.fault(least) {
        return Fitted::none(fault, sums.spread.count);
    }
    let sphere = sums.sphere(T::of(sphericity));
    let origin = vector::scale(vector::subtract(query.origin, query.at), T::ONE / query.radius);
    let Some(found) = sphere.project(origin) else {
        return Fitted::none(PointFlags::DEGENERATE, sums.spread.count);
    };
    let position = vector::add_scaled(query.at, found.position, query.radius);
    let curvature = sphere.mean_curvature() / query.radius;
    Fitted { curvature, ..Fitted::at(query, &sums.spread, position, found.normal) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::application::mls::Weight;

    /// Samples of a sphere around a place in units of the radius of the search.
    fn sums(center: [f64; 3], radius: f64) -> SphereSums<f64> {
        let mut sums = SphereSums::default();
        for index in 0..60usize {
            let turn = index as f64 * 2.4;
            let tilt = 0.1 * (1.0 + index as f64).sqrt();
            let n = vector::normalized([tilt * turn.cos(), tilt * turn.sin(), -1.0]).unwrap();
            let offset = vector::add_scaled(center, n, radius);
            let sample = Sample { index, offset, y: 0.3 + 0.01 * index as f64, reach: 1.0 };
            sums.add(&sample, n, Weight::Quartic.at(sample.y));
        }
        sums
    }

    #[test]
    fn samples_of_a_sphere_give_that_sphere() {
        for (center, radius) in [([0.0, 0.0, 1.0], 1.0), ([0.2, -0.1, 0.7], 0.8), ([0.0, 0.0, 40.0], 40.2)] {
            let sphere = sums(center, radius).sphere(1.0);
            assert!((sphere.mean_curvature() * radius - 1.0).abs() < 1e-9, "{sphere:?}");
            let found = sphere.project([0.1, 0.1, 0.3]).unwrap();
            let off = vector::norm(vector::subtract(found.position, center)) - radius;
            assert!(off.abs() < 1e-11 * radius, "{off}");
        }
    }

    #[test]
    fn without_sphericity_it_is_a_plane() {
        let plane = sums([0.0, 0.0, 1.0], 1.0).sphere(0.0);
        assert_eq!((plane.quadratic, plane.mean_curvature()), (0.0, 0.0));
        assert!(plane.linear[2] < -0.5);
    }
}
