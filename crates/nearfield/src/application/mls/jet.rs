//! Jets (Cazals2005): a height of degree 2 over the plane of the neighbours, all counting alike, as CGAL's
//! `jet_smooth_point_set` fits it. The kernels are those of point-set surfaces with a constant weight.
//!
//! The result is the place of the height over the query. The frame's origin is the query, and not its foot on the plane: with a constant
//! weight both give the same height. Differs from CGAL: the normal equations are solved by Cholesky's factorisation and not by
//! singular values, in coordinates divided by the radius.

use super::Weight;
use super::cloud::{Cloud, Fitted, Query};
use super::height::{self, Frame};
use super::pss::Plane;
use crate::geometry::Scalar;

/// Degree of the height.
pub(super) const DEGREE: usize = 2;

/// Fits the jet of the neighbours of where the query is.
pub(super) fn fit<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, least: u32) -> Fitted<T> {
    let plane = match Plane::of(cloud, query, Weight::Constant, least) {
        Ok(plane) => plane,
        Err((flags, count)) => return Fitted::none(flags, count),
    };
    let frame = Frame { center: query.at, normal: plane.normal };
    match height::fit(cloud, query, frame, (DEGREE, Weight::Constant, least)) {
        Ok((position, normal, _)) => Fitted::at(query, &plane.spread, position, normal),
        Err((flags, count)) => Fitted::none(flags, count),
    }
}
