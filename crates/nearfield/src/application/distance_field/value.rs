//! The distance that the samples near a place give it. `evaluate.wesl` is the twin.
//!
//! All is computed from offsets, query minus sample: coordinates far from zero cancel before anything is squared.

use super::DistanceMode;
use super::samples::OrientedSamples;
use crate::geometry::Scalar;
use crate::geometry::algebraic_sphere::SphereSums;
use crate::geometry::vector::{Vector, dot, subtract};

/// Squared distances beyond that of the nearest, in σ², up to which samples count: weights below e^−12 do not.
pub(super) const REACH: f64 = 12.0;
/// No value is nearer to 0 than the distance of the nearest sample less so many spacings.
pub(super) const TRUSTED: f64 = 2.0;

/// The nearest sample of a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near<T> {
    pub(super) offset: Vector<T>,
    pub(super) dist2: T,
    pub(super) normal: Vector<T>,
}

impl<T: Scalar> Near<T> {
    /// The distance from the nearest sample, with the sign of its normal; 0 counts as outside.
    pub(super) fn nearest(&self) -> T {
        let distance = self.dist2.sqrt();
        if dot(self.offset, self.normal) >= T::ZERO { distance } else { -distance }
    }

    /// The distance from the plane of the nearest sample.
    pub(super) fn plane(&self) -> T {
        dot(self.offset, self.normal)
    }

    /// `value`, but no nearer to 0 than the samples allow.
    fn kept_away(&self, value: T, spacing: T) -> T {
        let least = self.dist2.sqrt() - T::of(TRUSTED) * spacing;
        if value.abs() >= least {
            value
        } else if value >= T::ZERO {
            least
        } else {
            -least
        }
    }
}

/// The distance at `query`.
pub(super) fn distance<T: Scalar>(
    samples: &OrientedSamples<T>,
    query: &Vector<T>,
    near: &Near<T>,
    mode: DistanceMode,
    smoothing: T,
) -> T {
    let sigma = smoothing * samples.spacing;
    let value = match mode {
        DistanceMode::Nearest => return near.nearest(),
        DistanceMode::Imls if sigma > T::ZERO => imls(samples, query, near, sigma),
        DistanceMode::Apss if sigma > T::ZERO => apss(samples, query, near, sigma),
        _ => near.plane(),
    };
    near.kept_away(value, samples.spacing)
}

/// Calls `visit(offset, normal, t)` for every sample whose squared distance is that of the nearest and t · σ², t ≤ 12.
fn around<T: Scalar>(
    samples: &OrientedSamples<T>,
    query: &Vector<T>,
    near: &Near<T>,
    sigma: T,
    mut visit: impl FnMut(Vector<T>, Vector<T>, T),
) {
    let (sigma2, points) = (sigma * sigma, samples.tree.ordered_points());
    let reach2 = near.dist2 + T::of(REACH) * sigma2;
    samples.tree.descend(
        0,
        |node| crate::structure::aabb_tree::any_dimension::dist2_to_box(query, node) <= reach2,
        |leaf| {
            points.for_each_dist2(samples.tree.places(leaf), query, |place, dist2| {
                if dist2 <= reach2 {
                    let offset = subtract(*query, points.position(place));
                    let beyond = (dist2 - near.dist2).larger(T::ZERO) / sigma2;
                    visit(offset, samples.normals[points.ids()[place] as usize], beyond);
                }
            });
        },
    );
}

/// The mean of the distances from the planes, weighted by e^−t.
fn imls<T: Scalar>(samples: &OrientedSamples<T>, query: &Vector<T>, near: &Near<T>, sigma: T) -> T {
    let (mut sum, mut weights) = (T::ZERO, T::ZERO);
    around(samples, query, near, sigma, |offset, normal, t| {
        let weight = (-t).exp();
        sum += weight * dot(offset, normal);
        weights += weight;
    });
    // The nearest counts 1, but for what rounding leaves out.
    if weights > T::ZERO { sum / weights } else { near.plane() }
}

/// The distance from the sphere fitted with weights (1 − t/12)⁴.
fn apss<T: Scalar>(samples: &OrientedSamples<T>, query: &Vector<T>, near: &Near<T>, sigma: T) -> T {
    // From the nearest sample: beside a far query they would all be one place.
    let mut sums = SphereSums::default();
    around(samples, query, near, sigma, |offset, normal, t| {
        let inside = (T::ONE - t * T::of(1.0 / REACH)).larger(T::ZERO);
        let square = inside * inside;
        sums.add(subtract(near.offset, offset), normal, square * square);
    });
    let fitted = (sums.weights > T::ZERO).then(|| sums.sphere(T::ONE).distance(near.offset)).flatten();
    fitted.unwrap_or_else(|| near.plane())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::vector::norm2;

    #[test]
    fn the_sign_of_zero_is_outside_and_values_keep_away() {
        let near = |offset: [f64; 3]| Near { offset, dist2: norm2(offset), normal: [0.0, 0.0, 1.0] };
        assert_eq!(near([3.0, 4.0, 0.0]).nearest(), 5.0);
        assert_eq!(near([0.0, 0.0, -2.0]).nearest(), -2.0);
        assert_eq!(near([3.0, 4.0, 0.0]).kept_away(0.0, 1.0), 3.0);
        assert_eq!(near([3.0, 4.0, -0.5]).kept_away(-0.5, 2.0), -near([3.0, 4.0, -0.5]).dist2.sqrt() + 4.0);
        assert_eq!(near([0.0, 0.0, 5.0]).kept_away(5.0, 1.0), 5.0);
    }
}
