//! What coordinates and radii can be searched in any dimension.

use rayon::prelude::*;

use crate::geometry::Scalar;
use crate::{Error, Result};

/// Points that one thread checks at a time.
const CHECKED_BY_ONE: usize = 1 << 12;

/// Checks that all coordinates are finite and within ±[`Scalar::MAX_COORDINATE`], and that indices are 32 bits wide.
///
/// # Errors
/// `TooMany`, `NonFinite` with their number and the first index; else `CoordinateBeyond` with the first one.
pub(crate) fn coordinates<T: Scalar, const D: usize>(what: &'static str, points: &[[T; D]]) -> Result<()> {
    if points.len() as u64 >= u64::from(u32::MAX) {
        let (found, limit) = (points.len() as u64, u64::from(u32::MAX) - 1);
        return Err(Error::TooMany { what, found, limit, advice: "indices are 32 bits wide; work in parts" });
    }
    let limit = T::MAX_COORDINATE.to_f64();
    let searchable = |point: &[T; D]| point.iter().all(|x| x.to_f64().abs() <= limit);
    if points.par_iter().with_min_len(CHECKED_BY_ONE).all(searchable) {
        return Ok(());
    }
    let is_invalid = |point: &&[T; D]| point.iter().any(|x| !x.to_f64().is_finite());
    if let Some(first) = points.iter().position(|point| is_invalid(&point)) {
        let count = points.iter().filter(is_invalid).count() as u64;
        return Err(Error::NonFinite { what, count, first: first as u64 });
    }
    for (index, point) in points.iter().enumerate() {
        if let Some(axis) = point.iter().position(|x| x.to_f64().abs() > limit) {
            return Err(Error::CoordinateBeyond {
                what,
                index: index as u64,
                axis,
                value: point[axis].to_f64(),
                limit,
            });
        }
    }
    Ok(())
}

/// Checks that a radius is zero, or positive with a square that is a normal number.
///
/// `index` is the query it belongs to, where each query has its own.
///
/// # Errors
/// `InvalidSetting`.
pub(crate) fn radius<T: Scalar>(radius: T, index: Option<usize>) -> Result<()> {
    let square = radius * radius;
    let zero = T::of(0.0);
    let is_usable = radius == zero || (radius > zero && square >= T::SMALLEST_NORMAL && square <= T::LARGEST);
    if is_usable {
        return Ok(());
    }
    let of_query = index.map(|i| format!(" of query {i}")).unwrap_or_default();
    Err(Error::InvalidSetting {
        setting: "radius",
        found: format!("{radius:?}{of_query}"),
        expected: "0, which finds exact duplicates, or a positive number whose square is a normal number of the \
                   coordinates' type",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radii_at_the_edge_of_the_domain() {
        assert!([0.0f32, 1.1e-19, 1.0, 1.8e19].into_iter().all(|r| radius(r, None).is_ok()));
        assert!([0.0f64, 1.5e-154, 1.0, 1.3e154].into_iter().all(|r| radius(r, None).is_ok()));
        assert!([-1.0f32, f32::NAN, f32::INFINITY, 1e-20, 1.9e19].into_iter().all(|r| radius(r, Some(3)).is_err()));
        assert!([-1e-200f64, f64::NAN, f64::INFINITY, 1e-155, 1.4e154].into_iter().all(|r| radius(r, None).is_err()));
    }

    #[test]
    fn invalid_coordinates_are_counted_and_placed() {
        let mut points = vec![[1.0f64; 5]; 10];
        assert!(coordinates("points", &points).is_ok());
        points[7][4] = -2e150;
        let error = coordinates("points", &points).unwrap_err();
        assert!(matches!(error, Error::CoordinateBeyond { index: 7, axis: 4, .. }), "{error}");
        points[3][1] = f64::INFINITY;
        points[9][0] = f64::NAN;
        let error = coordinates("queries", &points).unwrap_err();
        assert!(matches!(error, Error::NonFinite { what: "queries", count: 2, first: 3 }), "{error}");
    }
}
