//! What one element adds to a winding number. Twins of the functions of the same names in `evaluate.wesl`.

use crate::geometry::Scalar;
use crate::geometry::vector::{Vector, cross, dot, norm, norm2};

/// The part of a dipole: `moment` is normal · area / 4π, `offset` its place minus that of the query. 0 at the dipole itself.
#[inline(always)]
pub(super) fn dipole<T: Scalar>(offset: Vector<T>, moment: Vector<T>) -> T {
    let dist2 = norm2(offset);
    // Negated, so that it also holds for what is not a number.
    if !(dist2 > T::SMALLEST_NORMAL) {
        return T::ZERO;
    }
    let inverse = T::ONE / dist2.sqrt();
    dot(moment, offset) * inverse * inverse * inverse
}

/// The part of a triangle given by its corners minus the query: its solid angle over 4π (VanOosterom1983). 0 in its plane.
#[inline(always)]
pub(super) fn triangle<T: Scalar>([a, b, c]: [Vector<T>; 3]) -> T {
    let volume = dot(a, cross(b, c));
    if volume == T::ZERO {
        return T::ZERO;
    }
    let lengths = [a, b, c].map(norm);
    let [la, lb, lc] = lengths;
    let beside = la * lb * lc + dot(a, b) * lc + dot(a, c) * lb + dot(b, c) * la;
    volume.atan2(beside) * T::of(0.5 / std::f64::consts::PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_of_an_octahedron_is_an_eighth() {
        let octant = [[1.0f64, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!((triangle(octant) - 0.125).abs() < 1e-15);
        let [a, b, c] = octant;
        assert!((triangle([a, c, b]) + 0.125).abs() < 1e-15);
        assert_eq!(triangle([a, b, [0.5, 0.5, 0.0]]), 0.0);
    }

    #[test]
    fn a_small_triangle_far_away_is_a_dipole() {
        let (low, d) = ([3.0f64, -2.0, 5.0], 1e-4);
        let corners = [low, [low[0] + d, low[1], low[2]], [low[0], low[1] + d, low[2]]];
        let center = [low[0] + d / 3.0, low[1] + d / 3.0, low[2]];
        let moment = [0.0, 0.0, 0.5 * d * d / (4.0 * std::f64::consts::PI)];
        let (exact, dipole) = (triangle(corners), dipole(center, moment));
        assert!((exact / dipole - 1.0).abs() < 1e-7, "{exact} {dipole}");
        assert_eq!(super::dipole([0.0f32; 3], [1.0, 0.0, 0.0]), 0.0);
    }
}
