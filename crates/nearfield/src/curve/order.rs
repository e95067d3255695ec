//! Points in the order of a curve.

use glam::Vec3;
use rayon::prelude::*;

use super::{Curve, Domain, MAX_LEVEL, hilbert, morton};
use crate::Result;
use crate::geometry::validate;
use crate::parallel::{radix_sort, reduce};

/// Jumps that one task adds up: the same parts on any number of threads, so the same sum.
const JUMPS: usize = 1 << 16;

/// The points along a curve through the smallest domain that holds them: at each place the index of the point there
/// `[n]`. Points of one cell stand by index.
///
/// # Errors
/// `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more).
pub fn order(points: &[Vec3], curve: Curve) -> Result<Vec<u32>> {
    validate::points(points)?;
    order_in(points, curve, &Domain::of_bounds(&reduce::bounds(points)))
}

/// As [`order`], by the cells of a domain; points outside count to its border.
///
/// # Errors
/// As [`order`].
pub fn order_in(points: &[Vec3], curve: Curve, domain: &Domain) -> Result<Vec<u32>> {
    by_key(points, |point| domain.key_of(curve, point))
}

/// As [`order_in`], along the curve in two dimensions through `axes` (0 for x, 1 for y, 2 for z): for points in a plane, of
/// which the curve in three dimensions would meet only a slice.
///
/// # Errors
/// As [`order`].
///
/// # Panics
/// If an axis is not below 3.
pub fn order_in_plane(points: &[Vec3], curve: Curve, domain: &Domain, axes: [usize; 2]) -> Result<Vec<u32>> {
    let encode = match curve {
        Curve::Morton => morton::encode_2d_u64,
        Curve::Hilbert => hilbert::encode_2d_u64,
    };
    by_key(points, |point| {
        let cell = domain.cell_of(point);
        // Level 0 of the domain is level 0 of the key, which has 31.
        encode(axes.map(|axis| cell[axis] << (31 - MAX_LEVEL)))
    })
}

fn by_key(points: &[Vec3], key: impl Fn(Vec3) -> u64 + Sync) -> Result<Vec<u32>> {
    validate::points(points)?;
    let mut keys: Vec<u64> = points.par_iter().with_min_len(1 << 12).map(|&point| key(point)).collect();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    radix_sort::sort_pairs(&mut keys, &mut order, 0..63)?;
    Ok(order)
}

/// Mean distance from each point to the next; 0 for fewer than two points.
pub fn mean_jump(points: &[Vec3]) -> f64 {
    if points.len() < 2 {
        return 0.0;
    }
    let jump = |pair: &[Vec3]| pair[0].as_dvec3().distance(pair[1].as_dvec3());
    let part = |start: usize| {
        let end = points.len().min(start + JUMPS + 1);
        points[start..end].windows(2).map(jump).sum::<f64>()
    };
    let starts: Vec<usize> = (0..points.len()).step_by(JUMPS).collect();
    let sums: Vec<f64> = starts.into_par_iter().map(part).collect();
    sums.iter().sum::<f64>() / (points.len() - 1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    #[test]
    fn the_ten_points_of_a_z_stand_in_its_order() {
        // In quarters of the square: the key of (x, y) has x's bit first.
        let expected = [[0, 0], [0, 1], [1, 0], [1, 1], [0, 2], [1, 3], [2, 0], [3, 1], [2, 3], [3, 3]];
        let points: Vec<Vec3> = expected.iter().rev().map(|&[x, y]| Vec3::new(x as f32, y as f32, 0.0)).collect();
        assert_eq!(order(&points, Curve::Morton).unwrap(), [9, 8, 7, 6, 5, 4, 3, 2, 1, 0]);
    }

    #[test]
    fn in_a_plane_the_hilbert_curve_goes_from_neighbor_to_neighbor() {
        for [x, y] in [[0, 1], [2, 0], [1, 2]] {
            let at = |i: usize, j: usize| {
                let mut point = Vec3::splat(-3.0);
                (point[x], point[y]) = (i as f32, j as f32);
                point
            };
            let points: Vec<Vec3> = (0..256).map(|i| at(i * 7 % 16, i / 16)).collect();
            let domain = Domain::new(at(0, 0), 16.0).unwrap();
            let order = order_in_plane(&points, Curve::Hilbert, &domain, [x, y]).unwrap();
            let sorted: Vec<Vec3> = order.iter().map(|&i| points[i as usize]).collect();
            assert_eq!(mean_jump(&sorted), 1.0, "axes {x} and {y}");
            // A slice of the z-curve is the z-curve of the plane, where the axes keep their order.
            let order = order_in_plane(&points, Curve::Morton, &domain, [x.min(y), x.max(y)]).unwrap();
            assert_eq!(order, order_in(&points, Curve::Morton, &domain).unwrap(), "axes {x} and {y}");
        }
    }

    #[test]
    fn points_of_one_cell_stand_by_index() {
        let points = [Vec3::ONE, Vec3::ZERO, Vec3::ONE, Vec3::ZERO, Vec3::splat(1e-9)];
        for curve in Curve::ALL {
            let order = order(&points, curve).unwrap();
            let at = |i: u32| order.iter().position(|&j| j == i).unwrap();
            assert!(at(1) < at(3) && at(3) < at(4) && at(0) < at(2), "{curve}: {order:?}");
        }
        assert!(order(&[], Curve::Hilbert).unwrap().is_empty());
        assert!(matches!(order(&[Vec3::NAN], Curve::Morton), Err(Error::NonFinite { .. })));
    }

    #[test]
    fn keys_ascend_along_the_order_and_jumps_get_short() {
        let word = |i: u32, k: u32| (i.wrapping_mul(k).wrapping_add(k) >> 8) as f32 / (1 << 24) as f32;
        let points: Vec<Vec3> = (0..200_000u32)
            .map(|i| Vec3::new(word(i, 2_654_435_761), word(i, 2_246_822_519), word(i, 3_266_489_917)))
            .collect();
        let domain = Domain::of_bounds(&reduce::bounds(&points));
        for curve in Curve::ALL {
            let order = order(&points, curve).unwrap();
            let sorted: Vec<Vec3> = order.iter().map(|&i| points[i as usize]).collect();
            let place = |i: &u32| (domain.key_of(curve, points[*i as usize]), *i);
            assert!(order.is_sorted_by_key(place), "{curve}");
            assert!(mean_jump(&sorted) < 0.1 * mean_jump(&points), "{curve}");
        }
    }

    #[test]
    fn the_mean_jump_is_the_length_of_the_path_by_its_steps() {
        assert_eq!(mean_jump(&[]), 0.0);
        assert_eq!(mean_jump(&[Vec3::ONE]), 0.0);
        assert_eq!(mean_jump(&[Vec3::ZERO, 3.0 * Vec3::X, 3.0 * Vec3::X + 4.0 * Vec3::Y]), 3.5);
        let steps: Vec<Vec3> = (0..200_001).map(|i| Vec3::new((i % 2) as f32, 0.0, 0.0)).collect();
        assert_eq!(mean_jump(&steps), 1.0);
    }
}
