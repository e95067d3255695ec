//! The place of a vertex: the point whose squared distances from the tangent planes of its crossings are least (Ju2002).
//! `qef.wesl` is the twin of this file.
//!
//! Planes that are nearly alike leave directions open. Along eigenvectors of AᵀA with small eigenvalues the point stays at
//! the mean of the crossings (the truncated pseudo-inverse about the mass point).

use crate::geometry::Scalar;
use crate::geometry::symmetric_eigen::Symmetric;
use crate::geometry::vector::{self, Vector};

/// Where crossings put a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed<T> {
    /// Mean of the crossings.
    pub(super) mass: Vector<T>,
    /// The minimum.
    pub(super) place: Vector<T>,
}

/// The minimum of Σ (n · (x − p))² over positions p and normals n of length 1.
///
/// - `threshold`: eigenvalues at or below this part of the largest count as 0
pub(super) fn place<T: Scalar>(crossings: &[(Vector<T>, Vector<T>)], threshold: T) -> Placed<T> {
    let weight = T::ONE / T::of(crossings.len() as f64);
    let sum = crossings.iter().fold([T::ZERO; 3], |sum, (p, _)| vector::add(sum, *p));
    let mass = vector::scale(sum, weight);
    let (mut matrix, mut right) = (Symmetric::<T>::default(), [T::ZERO; 3]);
    for &(p, n) in crossings {
        matrix.add_outer(n, T::ONE);
        right = vector::add_scaled(right, n, vector::dot(n, vector::subtract(p, mass)));
    }
    let eigen = matrix.eigen();
    let least = eigen.values[2] * threshold;
    let mut place = mass;
    for (value, vector) in eigen.values.into_iter().zip(eigen.vectors) {
        if value > least && value > T::ZERO {
            place = vector::add_scaled(place, vector, vector::dot(vector, right) / value);
        }
    }
    let is_place = place.iter().all(|x| x.is_finite());
    Placed { mass, place: if is_place { place } else { mass } }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_planes_meet_in_the_corner() {
        fn check<T: Scalar>(tolerance: f64) {
            let corner = [0.25, -0.5, 0.75];
            let normals = [[0.48, 0.6, -0.64], [0.8, 0.0, 0.6], [0.36, -0.8, -0.48]];
            let planes: Vec<_> = normals
                .iter()
                .map(|n: &[f64; 3]| {
                    let [u, v] = vector::tangents(*n);
                    let p = vector::add_scaled(vector::add_scaled(corner, u, 0.3), v, -0.2);
                    (p.map(T::of), n.map(T::of))
                })
                .collect();
            let placed = place(&planes, T::of(1e-3));
            let off = corner.iter().zip(&placed.place).map(|(corner, found)| (found.to_f64() - corner).abs());
            assert!(off.fold(0.0, f64::max) < tolerance, "{placed:?}");
        }
        check::<f64>(1e-14);
        check::<f32>(1e-6);
    }

    #[test]
    fn open_directions_stay_at_the_mean() {
        let up = [0.0, 0.0, 1.0];
        let plane = [([0.0, 0.0, 0.5], up), ([1.0, 0.0, 0.5], up), ([1.0, 1.0, 0.5], up), ([0.0, 1.0, 0.5], up)];
        assert_eq!(place(&plane, 0.1).place, [0.5, 0.5, 0.5]);
        // A crease along x: the place is on it, in the middle.
        let across = [0.0, 1.0, 0.0];
        let crease =
            [([0.0, 0.25, 0.5], up), ([1.0, 0.25, 0.5], up), ([0.0, 0.75, 0.0], across), ([1.0, 0.75, 0.0], across)];
        let placed = place(&crease, 0.1).place;
        assert!(vector::norm(vector::subtract(placed, [0.5, 0.75, 0.5])) < 1e-14, "{placed:?}");
    }

    #[test]
    fn small_eigenvalues_are_dropped_by_the_threshold() {
        // Two planes a degree apart meet far away; with noisy normals that is no feature.
        let (sin, cos) = (1f64.to_radians().sin(), 1f64.to_radians().cos());
        let planes = [([0.0, 0.0, 0.0], [-sin, 0.0, cos]), ([1.0, 0.0, 0.1], [sin, 0.0, cos])];
        let (noisy, exact) = (place(&planes, 0.1).place, place(&planes, 1e-6).place);
        assert!((noisy[0] - 0.5).abs() < 0.01 && (exact[0] - 0.5).abs() > 2.0, "{noisy:?} {exact:?}");
        assert_eq!(place(&[([0.5, 0.5, 0.5], [0.0; 3])], 0.1).place, [0.5; 3]);
    }
}
