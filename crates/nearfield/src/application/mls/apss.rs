//! Algebraic point-set surfaces (Guennebaud2007, Guennebaud2008): the sphere whose gradients agree best with the normals of the
//! samples, around the query and in radii of its search. `apss.wesl` is the twin of this file.

use super::cloud::{Cloud, Fitted, Query};
use super::spread::Spread;
use crate::application::PointFlags;
use crate::geometry::algebraic_sphere::SphereSums;
use crate::geometry::{Scalar, vector};

/// Projects the query's origin onto the sphere fitted around where it is.
pub(super) fn fit<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, sphericity: f64, least: u32) -> Fitted<T> {
    let (mut spread, mut sums) = (Spread::default(), SphereSums::default());
    cloud.for_each_oriented(query.at, query.radius, |sample, normal| {
        let weight = cloud.weight.at(sample.y);
        spread.add(sample, weight);
        sums.add(sample.offset, normal, weight);
    });
    if let Some(fault) = spread.fault(least) {
        return Fitted::none(fault, spread.count);
    }
    let sphere = sums.sphere(T::of(sphericity));
    let origin = vector::scale(vector::subtract(query.origin, query.at), T::ONE / query.radius);
    let Some(found) = sphere.project(origin) else {
        return Fitted::none(PointFlags::DEGENERATE, spread.count);
    };
    let position = vector::add_scaled(query.at, found.position, query.radius);
    let curvature = sphere.mean_curvature() / query.radius;
    Fitted { curvature, ..Fitted::at(query, &spread, position, found.normal) }
}
