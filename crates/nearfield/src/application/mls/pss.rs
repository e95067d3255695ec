//! Point-set surfaces: a plane at the query, then a polynomial height over it. `plane.wesl`, `plane_search.wesl` and
//! `height.wesl` are the twins of this file.
//!
//! The fast form (Adamson2004) takes the weighted mean a and the smallest eigenvector n of the covariance about a, and projects
//! the origin: x₀ − ⟨n, x₀ − a⟩ n. Iterated with a and n taken where the point then is, the map is idempotent.
//!
//! The full form (Alexa2001, Levin2003) minimises E(n, t) = Σ ⟨n, pᵢ − r − t n⟩² θ(|pᵢ − r − t n|) over the unit vector n and t in
//! ±h/2; the weights are about the foot q = r + t n. It is only about idempotent.
//! Differs: the search starts with the plane of the fast form, which is right also where r is farther from the surface than
//! the samples are wide, and moves n and t together, by the exact gradient and the part of the second derivatives that is
//! positive (Gauss and Newton's): a round is one pass over the neighbours. It ends, as theirs, once both move less than 1e-6 h.

use super::Weight;
use super::cloud::{Cloud, Fitted, Query, turned};
use super::height::{self, Frame};
use super::settings::PlaneSearch;
use super::spread::Spread;
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::symmetric_eigen::Symmetric;
use crate::geometry::vector::{self, Vector};

/// Rounds of the full search at most; three to five are usual.
pub(super) const MOST_ROUNDS: usize = 8;
/// The search has ended once n and t move less, t in radii. For f32 this is some roundings.
const STILL: f64 = 1e-6;
/// The plane may lie so far from the query, in radii.
const FARTHEST: f64 = 0.5;
/// A normal turns by at most the angle of this tangent a round.
const MOST_TURN: f64 = 0.5;

/// The plane of the neighbours: mean, and normal turned to the sides of their normals or of the query's.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane<T> {
    pub(super) spread: Spread<T>,
    pub(super) mean: Vector<T>,
    pub(super) normal: Vector<T>,
}

impl<T: Scalar> Plane<T> {
    /// Of the neighbours of where the query is, relative to it and in radii; else the reason and the number of samples.
    pub(super) fn of(
        cloud: &Cloud<'_, T>,
        query: &Query<T>,
        weight: Weight,
        least: u32,
    ) -> Result<Self, (PointFlags, u32)> {
        let (mut spread, mut guide) = (Spread::default(), [T::ZERO; 3]);
        cloud.for_each(query.at, query.radius, |sample| {
            let w = weight.at(sample.y);
            spread.add(sample, w);
            if let Some(normals) = cloud.normals {
                guide = vector::add_scaled(guide, normals[sample.index], w);
            }
        });
        if let Some(fault) = spread.fault(least) {
            return Err((fault, spread.count));
        }
        let normal = spread.covariance().eigen().vectors[0];
        let guide = if cloud.normals.is_some() { guide } else { query.normal };
        Ok(Self { spread, mean: spread.mean(), normal: turned(normal, guide) })
    }
}

/// Fits the surface of this degree.
pub(super) fn fit<T: Scalar>(
    cloud: &Cloud<'_, T>,
    query: &Query<T>,
    (degree, search, least): (u8, PlaneSearch, u32),
) -> Fitted<T> {
    // The full form projects where the point is, the fast one where it began.
    let query = match search {
        PlaneSearch::Full => &Query { origin: query.at, ..*query },
        PlaneSearch::Fast => query,
    };
    let plane = match Plane::of(cloud, query, cloud.weight, least) {
        Ok(plane) => plane,
        Err((flags, count)) => return Fitted::none(flags, count),
    };
    let mut flags = PointFlags::default();
    let mut normal = plane.normal;
    let center = match search {
        PlaneSearch::Fast => {
            let origin = vector::scale(vector::subtract(query.origin, query.at), T::ONE / query.radius);
            let height = vector::dot(normal, vector::subtract(origin, plane.mean));
            vector::add_scaled(query.origin, normal, -height * query.radius)
        }
        PlaneSearch::Full => {
            let Some(found) = minimize(cloud, query, &plane) else {
                return Fitted::none(PointFlags::DEGENERATE, plane.spread.count);
            };
            normal = found.normal;
            flags |= found.flags;
            vector::add_scaled(query.at, normal, found.t * query.radius)
        }
    };
    let mut fitted = Fitted { flags, ..Fitted::at(query, &plane.spread, center, normal) };
    if degree > 0 {
        match height::fit(cloud, query, Frame { center, normal }, (degree.into(), cloud.weight, least)) {
            Ok((position, normal, count)) => {
                fitted.place = Some((position, normal));
                fitted.neighbors = count;
            }
            Err((reason, count)) => return Fitted::none(reason, count),
        }
    }
    fitted
}

/// A plane at height t over the query, in radii.
struct Searched<T> {
    normal: Vector<T>,
    t: T,
    flags: PointFlags,
}

/// The plane with the least energy near the one given. `None` where the neighbours leave it open.
fn minimize<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, plane: &Plane<T>) -> Option<Searched<T>> {
    let farthest = T::of(FARTHEST);
    let mut normal = plane.normal;
    let mut t = clamped(vector::dot(normal, plane.mean), farthest);
    let still = T::of(STILL).larger(T::of(8.0) * T::EPSILON);
    for _ in 0..MOST_ROUNDS {
        let [by_t, by_u, by_v] = step(cloud, query, normal, t)?;
        let [u, v] = vector::tangents(normal);
        let moved = clamped(t + by_t, farthest) - t;
        let turn = [clamped(by_u, T::of(MOST_TURN)), clamped(by_v, T::of(MOST_TURN))];
        t += moved;
        normal = vector::normalized(vector::add_scaled(vector::add_scaled(normal, u, turn[0]), v, turn[1]))?;
        if moved.abs() <= still && turn[0].abs() <= still && turn[1].abs() <= still {
            let at_its_end = t.abs() >= farthest;
            let flags = if at_its_end { PointFlags::LIMITED } else { PointFlags::default() };
            return Some(Searched { normal, t, flags });
        }
    }
    Some(Searched { normal, t, flags: PointFlags::NOT_CONVERGED })
}

fn clamped<T: Scalar>(value: T, most: T) -> T {
    value.smaller(most).larger(-most)
}

/// The step of t and of n along its tangents from here.
///
/// With s = ⟨n, d⟩ − t for d = p − r, and θ' the derivative by the squared distance from q in radii: the gradient by t is
/// −2 Σ s (θ + s² θ'), that along a tangent u is 2 Σ ⟨u, d⟩ s (θ − s t θ').
fn step<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, normal: Vector<T>, t: T) -> Option<[T; 3]> {
    let [u, v] = vector::tangents(normal);
    let foot = vector::add_scaled(query.at, normal, t * query.radius);
    let (mut gradient, mut matrix) = ([T::ZERO; 3], Symmetric::default());
    cloud.for_each(foot, query.radius, |sample| {
        let [value, slope, _] = cloud.weight.derivatives(sample.y);
        // θ' by the squared distance in radii of the search.
        let slope = slope / (sample.reach * sample.reach);
        let s = vector::dot(normal, sample.offset);
        let (a, b) = (vector::dot(u, sample.offset), vector::dot(v, sample.offset));
        let turning = s * (value - s * t * slope);
        let pull = [-s * (value + s * s * slope), a * turning, b * turning];
        gradient = vector::add(gradient, pull);
        matrix.add_outer([-T::ONE, a, b], value);
    });
    solved(&matrix, gradient).map(|step| vector::scale(step, -T::ONE))
}

/// x of A x = b for a positive definite A.
fn solved<T: Scalar>(a: &Symmetric<T>, b: Vector<T>) -> Option<Vector<T>> {
    let [xx, xy, xz, yy, yz, zz] = a.0;
    let cofactors = [yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy];
    let determinant = xx * cofactors[0] + xy * cofactors[1] + xz * cofactors[2];
    // Relative to the matrix's own diagonal, which is that of a determinant without correlations.
    if !(determinant > T::of(64.0) * T::EPSILON * xx * yy * zz) {
        return None;
    }
    let inverse =
        Symmetric([cofactors[0], cofactors[1], cofactors[2], xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]);
    Some(vector::scale(inverse.times(b), T::ONE / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::{AabbTreeN, AabbTreeNSettings};

    /// A bumpy patch of 900 samples in [−1, 1]².
    fn patch() -> Vec<[f64; 3]> {
        let at = |i: u32| {
            let (x, y) = (f64::from(i % 30) / 14.5 - 1.0, f64::from(i / 30) / 14.5 - 1.0);
            [x, y, 0.2 * x * x - 0.1 * x * y + 0.03 * (9.0 * x).sin() + 0.05 * y]
        };
        (0..900).map(at).collect()
    }

    /// E(n, t) by its definition.
    fn energy(points: &[[f64; 3]], r: [f64; 3], h: f64, n: [f64; 3], t: f64) -> f64 {
        let q = vector::add_scaled(r, n, t);
        let term = |p: &[f64; 3]| {
            let d = vector::subtract(*p, q);
            let y = vector::norm2(d) / (h * h);
            if y <= 1.0 { vector::dot(n, d).powi(2) * Weight::Quartic.at(y) } else { 0.0 }
        };
        points.iter().map(term).sum()
    }

    #[test]
    fn systems_are_solved() {
        let a = Symmetric([4.0, 1.0, -0.5, 3.0, 0.25, 2.0]);
        let x = solved(&a, a.times([1.0, -2.0, 3.0])).unwrap();
        assert!(vector::norm(vector::subtract(x, [1.0, -2.0, 3.0])) < 1e-14);
        assert_eq!(solved(&Symmetric([1.0, 1.0, 0.0, 1.0, 0.0, 1.0]), [1.0; 3]), None);
    }

    #[test]
    fn the_full_search_ends_in_a_minimum() {
        let points = patch();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
        let cloud = Cloud { tree: &tree, positions: &points, normals: None, own_radii: None, weight: Weight::Quartic };
        for at in [[0.1, 0.2, 0.0], [-0.4, 0.3, 0.1], [0.0, 0.0, 0.15]] {
            let query = Query { origin: at, at, normal: [0.0; 3], radius: 0.5, falloff: 0.5 };
            let plane = Plane::of(&cloud, &query, Weight::Quartic, 3).unwrap();
            let found = minimize(&cloud, &query, &plane).unwrap();
            assert!(found.flags.is_empty());
            let (n, t) = (found.normal, found.t * 0.5);
            let least = energy(&points, at, 0.5, n, t);
            let [u, v] = vector::tangents(n);
            // No neighbouring plane has less: the samples move across the edge of the support where its weight is 0.
            for step in [1e-3, -1e-3] {
                assert!(energy(&points, at, 0.5, n, t + step) > least);
                for tangent in [u, v] {
                    let turned = vector::normalized(vector::add_scaled(n, tangent, step)).unwrap();
                    assert!(energy(&points, at, 0.5, turned, t) > least);
                }
            }
            // And the slope is 0, also by differences: to 1e-5 of what turning the plane by a radian changes.
            let slope = (energy(&points, at, 0.5, n, t + 1e-5) - energy(&points, at, 0.5, n, t - 1e-5)) / 2e-5;
            assert!(slope.abs() < 1e-4 * least.max(1e-3), "{slope} at an energy of {least}");
        }
    }
}
