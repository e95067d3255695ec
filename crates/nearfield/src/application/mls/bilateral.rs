//! The bilateral step of edge-aware resampling (Huang2013, §4) as CGAL's `bilateral_smooth_point_set` takes it. `bilateral.wesl` is the
//! twin of this file.
//!
//! With the weights w = exp(−4 d² / R²) exp(−(1 − n·nᵢ)² / (1 − cos σ)²), the point moves along the mean normal Σ w nᵢ by
//! −Σ w nᵢ·(x − pᵢ) / Σ w, and that normal becomes its own. R is the radius; of the k nearest, 0.95 times the largest distance of
//! a k-th. A point without a normal first takes the mean of those around it.

use super::cloud::{Cloud, Fitted, Query};
use super::spread::Spread;
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector;

/// Share of the largest distance of a k-th neighbour that the weight falls over.
pub(super) const FALLOFF: f64 = 0.95;

/// (1 − cos σ)², and at least 1e-16.
pub(super) fn bandwidth(sharpness_degrees: f64) -> f64 {
    (1.0 - libm::cos(sharpness_degrees.to_radians())).max(1e-8).powi(2)
}

/// One step.
pub(super) fn fit<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, sharpness_degrees: f64, least: u32) -> Fitted<T> {
    let by_normal = T::of(-1.0 / bandwidth(sharpness_degrees));
    let ratio = query.radius / query.falloff;
    let by_distance = T::of(-4.0) * ratio * ratio;
    let has_normal = vector::norm2(query.normal) > T::ZERO;
    let (mut spread, mut normals, mut heights) = (Spread::default(), [T::ZERO; 3], T::ZERO);
    cloud.for_each_oriented(query.at, query.radius, |sample, normal| {
        let apart = if has_normal { T::ONE - vector::dot(query.normal, normal) } else { T::ZERO };
        let dist2 = vector::norm2(sample.offset);
        let weight = (by_distance * dist2 + by_normal * apart * apart).exp();
        spread.add(sample, weight);
        normals = vector::add_scaled(normals, normal, weight);
        heights -= weight * vector::dot(normal, sample.offset);
    });
    if let Some(fault) = spread.fault(least) {
        return Fitted::none(fault, spread.count);
    }
    let Some(normal) = vector::normalized(normals) else {
        return Fitted::none(PointFlags::DEGENERATE, spread.count);
    };
    let position = vector::add_scaled(query.at, normal, -heights / spread.weight * query.radius);
    Fitted::at(query, &spread, position, normal)
}
