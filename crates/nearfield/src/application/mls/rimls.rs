//! Robust implicit moving least squares (Oztireli2009): the planes of the samples, blended by distance and by how well their normals
//! agree with the gradient of the blend. `rimls.wesl` is the twin of this file.
//!
//! f = Σ φ ω n·(x − p) / Σ φ ω, ∇f = (Σ φ ω n + Σ ω ∇φ n·(x − p) − f Σ ω ∇φ) / Σ φ ω, with ω = exp(−|n − ∇f|² / σ²) from the pass
//! before and 1 in the first. Passes end once |Δ∇f|² is below 1e-3, at the latest after the third. The point walks to x − f ∇f.

use super::cloud::{Cloud, Fitted, Query};
use super::spread::Spread;
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};

/// Passes at most.
pub(super) const PASSES: usize = 3;
/// Squared change of the gradient at which passes end.
const STILL: f64 = 1e-3;

/// Sums of a pass.
#[derive(Debug, Clone, Copy, Default)]
struct Blend<T> {
    weight: T,
    value: T,
    normal: Vector<T>,
    slope: Vector<T>,
    slope_value: Vector<T>,
}

impl<T: Scalar> Blend<T> {
    /// f and ∇f; `None` where no sample counts.
    fn solve(&self) -> Option<(T, Vector<T>)> {
        let inverse = T::ONE / self.weight;
        let f = self.value * inverse;
        let sum = vector::add_scaled(vector::add(self.normal, self.slope_value), self.slope, -f);
        let gradient = vector::scale(sum, inverse);
        (self.weight > T::ZERO && f.is_finite() && vector::norm2(gradient).is_finite()).then_some((f, gradient))
    }
}

/// One step of the walk.
pub(super) fn fit<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, normal_width: f64, least: u32) -> Fitted<T> {
    let sharpness = T::of(-1.0 / (normal_width * normal_width));
    let mut spread = Spread::default();
    let mut last: Option<(T, Vector<T>)> = None;
    for pass in 0..PASSES {
        let mut blend = Blend::default();
        cloud.for_each_oriented(query.at, query.radius, |sample, normal| {
            let [value, derivative, _] = cloud.weight.derivatives(sample.y);
            if pass == 0 {
                spread.add(sample, value);
            }
            let likeness = last
                .map_or(T::ONE, |(_, gradient)| (sharpness * vector::norm2(vector::subtract(normal, gradient))).exp());
            let height = -vector::dot(normal, sample.offset);
            let weight = value * likeness;
            let slope = T::of(-2.0) * derivative * likeness / (sample.reach * sample.reach);
            blend.weight += weight;
            blend.value += weight * height;
            blend.normal = vector::add_scaled(blend.normal, normal, weight);
            blend.slope = vector::add_scaled(blend.slope, sample.offset, slope);
            blend.slope_value = vector::add_scaled(blend.slope_value, sample.offset, slope * height);
        });
        if let Some(fault) = spread.fault(least).filter(|_| pass == 0) {
            return Fitted::none(fault, spread.count);
        }
        // A gradient that no normal is like leaves what the pass before found.
        let Some(found) = blend.solve() else { break };
        let change = last.map(|(_, gradient)| vector::norm2(vector::subtract(found.1, gradient)));
        last = Some(found);
        if change.is_some_and(|change| change < T::of(STILL)) {
            break;
        }
    }
    let found = last.and_then(|(f, gradient)| Some((f, gradient, vector::normalized(gradient)?)));
    let Some((f, gradient, normal)) = found else {
        return Fitted::none(PointFlags::DEGENERATE, spread.count);
    };
    let position = vector::add_scaled(query.at, gradient, -f * query.radius);
    Fitted::at(query, &spread, position, normal)
}
