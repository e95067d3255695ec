//! Boxes around a few corners, in f32 or f64.

use super::scalar::Scalar;

/// Low and high corner of a box; NaN for one that touches nothing.
pub(crate) type Bounds<T> = [[T; 3]; 2];

/// The box of some corners; NaN where one is not finite.
#[inline]
pub(crate) fn bounds_of<T: Scalar, const N: usize>(corners: [[T; 3]; N]) -> Bounds<T> {
    if !corners.iter().flatten().all(|x| x.is_finite()) {
        return [[T::of(f64::NAN); 3]; 2];
    }
    let first = [corners[0]; 2];
    corners[1..].iter().fold(first, |[low, high], p| {
        [[0, 1, 2].map(|axis| low[axis].smaller(p[axis])), [0, 1, 2].map(|axis| high[axis].larger(p[axis]))]
    })
}

/// Whether two boxes share a point; never with NaN.
#[inline]
pub(crate) fn overlap<T: Scalar>(a: &Bounds<T>, b: &Bounds<T>) -> bool {
    (0..3).all(|axis| a[0][axis] <= b[1][axis] && b[0][axis] <= a[1][axis])
}
