//! The distance formula in any dimension, written once: d² = ((d₀·d₀ + d₁·d₁) + d₂·d₂) + …, over the axes in order, in the
//! type of the coordinates, never fused. `rows.wesl` is the twin of this file.
//!
//! A point is a neighbour when d² ≤ r·r. A device may fuse a multiplication with an addition: of the D + 2 roundings of a
//! squared distance none is then larger, so it may differ where |d − r| is within (D + 3) / 2 ulp of r.

use crate::geometry::Scalar;
use crate::structure::aabb_tree::BoxN;

/// Part of the radius added before boxes are chosen: more than all roundings of two squared distances in 16 dimensions
/// and `f32`, that of a box and that of a point in it, may differ by (37 · 2⁻²⁴ of the square).
pub const RADIUS_SLACK: f64 = 1.0 + 1.0 / (1 << 18) as f64;

/// The sum with the square of one more difference.
#[inline(always)]
pub(super) fn add_square<T: Scalar>(sum: T, difference: T) -> T {
    sum + difference * difference
}

/// Squared length of a vector given by axis.
#[inline(always)]
fn norm2<T: Scalar, const D: usize>(difference: impl Fn(usize) -> T) -> T {
    (0..D).fold(T::of(0.0), |sum, axis| add_square(sum, difference(axis)))
}

/// Squared distance between two points.
#[inline(always)]
pub fn dist2<T: Scalar, const D: usize>(a: &[T; D], b: &[T; D]) -> T {
    norm2::<T, D>(|axis| a[axis] - b[axis])
}

/// Length of the gap between two intervals; 0 where they overlap.
#[inline(always)]
fn gap<T: Scalar>(a: (T, T), b: (T, T)) -> T {
    (a.0 - b.1).larger(b.0 - a.1).larger(T::ZERO)
}

/// A squared distance that no point of the box falls below: rounding keeps the order of numbers.
#[inline(always)]
pub(crate) fn dist2_to_box<T: Scalar, const D: usize>(query: &[T; D], node: &BoxN<T, D>) -> T {
    norm2::<T, D>(|axis| gap((query[axis], query[axis]), (node.min[axis], node.max[axis])))
}

/// A squared distance that no two points of the boxes fall below.
#[inline(always)]
pub(crate) fn dist2_of_boxes<T: Scalar, const D: usize>(a: &BoxN<T, D>, b: &BoxN<T, D>) -> T {
    norm2::<T, D>(|axis| gap((a.min[axis], a.max[axis]), (b.min[axis], b.max[axis])))
}

/// Whether the box meets the box around all balls with a radius of `reach` and a centre in `around`.
#[inline(always)]
pub(crate) fn is_swept_near<T: Scalar, const D: usize>(around: &BoxN<T, D>, reach: T, node: &BoxN<T, D>) -> bool {
    (0..D).all(|axis| gap((around.min[axis], around.max[axis]), (node.min[axis], node.max[axis])) <= reach)
}

/// How far boxes are looked for: the radius with the slack of its roundings, and a length below which squares may vanish.
#[inline(always)]
pub(crate) fn reach<T: Scalar>(radius: T) -> T {
    radius * T::of(RADIUS_SLACK) + T::ONE / T::MAX_COORDINATE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_summed_over_the_axes_in_order() {
        let (a, b) = ([1.0f32, 3.0, -2.0, 0.1], [0.3f32, -0.7, 5.0, 0.7]);
        let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]];
        assert_eq!(dist2(&a, &b), ((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2]) + d[3] * d[3]);
    }

    #[test]
    fn boxes_are_as_near_as_their_nearest_points() {
        let node = BoxN { min: [0.0f64, 0.0], max: [1.0, 2.0] };
        assert_eq!(dist2_to_box(&[0.5, 1.0], &node), 0.0);
        assert_eq!(dist2_to_box(&[4.0, 6.0], &node), 25.0);
        let other = BoxN { min: [4.0, -6.0], max: [5.0, -4.0] };
        assert_eq!(dist2_of_boxes(&node, &other), 25.0);
        assert!(is_swept_near(&node, 4.0, &other) && !is_swept_near(&node, 3.9, &other));
        assert!(!is_swept_near(&node, 1e100, &BoxN::EMPTY) && dist2_to_box(&[0.0, 0.0], &BoxN::EMPTY) > 1e300);
    }

    #[test]
    fn no_radius_overflows_its_reach() {
        assert!(reach(1.8e19f32) * reach(1.8e19f32) < f32::INFINITY && reach(0.0f32) * reach(0.0f32) > 0.0);
        assert!(reach(1.3e154f64) * reach(1.3e154f64) < f64::INFINITY && reach(0.0f64) * reach(0.0f64) > 0.0);
    }
}
