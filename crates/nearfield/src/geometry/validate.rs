//! What coordinates and radii can be searched: the domain of every structure and query.

use glam::Vec3;
use rayon::prelude::*;

use crate::{Error, Result};

/// Largest absolute coordinate: its square, and the square of a difference, is a finite f32.
pub const MAX_COORDINATE: f32 = 1e18;

/// Checks that all coordinates are finite and within ±[`MAX_COORDINATE`].
///
/// `what` is "points" or "queries", for the message.
///
/// # Errors
/// `NonFinite` with their number and the first index; else `CoordinateTooLarge` with the first one.
pub fn coordinates(what: &'static str, points: &[Vec3]) -> Result<()> {
    let searchable = |p: &Vec3| p.abs().cmple(Vec3::splat(MAX_COORDINATE)).all();
    if points.par_iter().with_min_len(1 << 14).all(searchable) {
        return Ok(());
    }
    let count = points.par_iter().filter(|p| !p.is_finite()).count() as u64;
    if let Some(first) = points.iter().position(|p| !p.is_finite()) {
        return Err(Error::NonFinite { what, count, first: first as u64 });
    }
    let too_far = |v: &f32| v.abs() > MAX_COORDINATE;
    for (index, point) in points.iter().enumerate() {
        if let Some(axis) = point.to_array().iter().position(too_far) {
            let value = f64::from(point[axis]);
            return Err(Error::CoordinateTooLarge { what, index: index as u64, axis: ['x', 'y', 'z'][axis], value });
        }
    }
    Ok(())
}

/// Checks what every structure asks of its points: searchable coordinates, and 32-bit indices.
///
/// # Errors
/// `TooMany`, else as [`coordinates`].
pub fn points(points: &[Vec3]) -> Result<()> {
    if points.len() as u64 >= u64::from(u32::MAX) {
        return Err(Error::TooMany {
            what: "points",
            found: points.len() as u64,
            limit: u64::from(u32::MAX) - 1,
            advice: "indices are 32 bits wide; split the cloud into tiles",
        });
    }
    coordinates("points", points)
}

/// Checks that a radius is zero, or positive with a square that is a normal f32.
///
/// `index` is the query it belongs to, where each query has its own.
///
/// # Errors
/// `InvalidRadius`.
pub fn radius(radius: f32, index: Option<u64>) -> Result<()> {
    let reason = if radius.is_nan() {
        "is not a number"
    } else if radius < 0.0 {
        "is negative; the smallest radius is 0, which finds exact duplicates"
    } else if radius.is_infinite() {
        "is infinite; use the diagonal of the bounds to reach every point"
    } else if radius > 0.0 && !(radius * radius).is_normal() {
        "has a square that is not a normal f32; use 0 or a radius between 1.1e-19 and 1.8e19, or scale the data"
    } else {
        return Ok(());
    };
    Err(Error::InvalidRadius { radius, index, reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_coordinates_are_counted_and_placed() {
        let mut points = vec![Vec3::ONE; 10];
        assert!(coordinates("points", &points).is_ok());
        points[7].y = -2e18;
        let error = coordinates("points", &points).unwrap_err();
        assert!(matches!(error, Error::CoordinateTooLarge { index: 7, axis: 'y', .. }), "{error}");
        points[3].z = f32::INFINITY;
        points[9].x = f32::NAN;
        let error = coordinates("queries", &points).unwrap_err();
        assert!(matches!(error, Error::NonFinite { what: "queries", count: 2, first: 3 }), "{error}");
    }

    #[test]
    fn radii_at_the_edge_of_the_domain() {
        for good in [0.0, 1.1e-19, 1.0, 1.8e19] {
            assert!(radius(good, None).is_ok(), "{good}");
        }
        for bad in [-1.0, -0.5e-30, f32::NAN, f32::INFINITY, 1e-20, 1e-45, 1.9e19] {
            assert!(radius(bad, Some(4)).is_err(), "{bad}");
        }
    }
}
