//! A polynomial height over a plane, fitted to weighted samples around a centre: the second step of point-set surfaces and jets.
//! `height.wesl` is the twin of this file.

use super::Weight;
use super::cloud::{Cloud, Query};
use super::spread::Spread;
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::height_field::HeightFit;
use crate::geometry::vector::{self, Vector};

/// Where a height is fitted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<T> {
    /// The centre of the samples and origin of the heights.
    pub(super) center: Vector<T>,
    /// Of length 1: heights are along it.
    pub(super) normal: Vector<T>,
}

/// The place of the surface on the query's normal line, and the normal there; else the reason and the number of samples.
///
/// - `degree`: 1 to 3
#[allow(clippy::type_complexity, reason = "both sides are named above")]
pub(super) fn fit<T: Scalar>(
    cloud: &Cloud<'_, T>,
    query: &Query<T>,
    frame: Frame<T>,
    (degree, weight, least): (usize, Weight, u32),
) -> Result<(Vector<T>, Vector<T>, u32), (PointFlags, u32)> {
    let [u, v] = vector::tangents(frame.normal);
    let (mut height, mut spread) = (HeightFit::new(degree), Spread::default());
    cloud.for_each(frame.center, query.radius, |sample| {
        let (offset, w) = (sample.offset, weight.at(sample.y));
        spread.add(sample, w);
        height.add(vector::dot(offset, u), vector::dot(offset, v), vector::dot(offset, frame.normal), w);
    });
    let count = spread.count;
    if let Some(fault) = spread.fault(least) {
        return Err((fault, count));
    }
    let solved = height.solve().ok_or((PointFlags::DEGENERATE, count))?;
    let origin = vector::scale(vector::subtract(query.origin, frame.center), T::ONE / query.radius);
    let (a, b) = (vector::dot(origin, u), vector::dot(origin, v));
    let [h, h_u, h_v] = value_and_slopes(&solved, a, b);
    let over = vector::add_scaled(vector::add_scaled(vector::scale(u, a), v, b), frame.normal, h);
    let position = vector::add_scaled(frame.center, over, query.radius);
    let normal = vector::add_scaled(vector::add_scaled(frame.normal, u, -h_u), v, -h_v);
    let normal = vector::normalized(normal).ok_or((PointFlags::DEGENERATE, count))?;
    Ok((position, normal, count))
}

/// Σ c m(u, v) up to degree 3 and its derivatives by u and v.
fn value_and_slopes<T: Scalar>(c: &[T], u: T, v: T) -> [T; 3] {
    let (two, three) = (T::of(2.0), T::of(3.0));
    let value = c[0]
        + c[1] * u
        + c[2] * v
        + c[3] * u * u
        + c[4] * u * v
        + c[5] * v * v
        + c[6] * u * u * u
        + c[7] * u * u * v
        + c[8] * u * v * v
        + c[9] * v * v * v;
    let by_u = c[1] + two * c[3] * u + c[4] * v + three * c[6] * u * u + two * c[7] * u * v + c[8] * v * v;
    let by_v = c[2] + c[4] * u + two * c[5] * v + c[7] * u * u + two * c[8] * u * v + three * c[9] * v * v;
    [value, by_u, by_v]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_the_value() {
        let c: Vec<f64> = (0..10u32).map(|i| (f64::from(i) * 1.3).cos()).collect();
        let (u, v, step) = (0.3, -0.2, 1e-6);
        let [_, by_u, by_v] = value_and_slopes(&c, u, v);
        let at = |u, v| value_and_slopes(&c, u, v)[0];
        assert!(((at(u + step, v) - at(u - step, v)) / (2.0 * step) - by_u).abs() < 1e-8);
        assert!(((at(u, v + step) - at(u, v - step)) / (2.0 * step) - by_v).abs() < 1e-8);
        assert_eq!(value_and_slopes(&c, 0.0, 0.0), [c[0], c[1], c[2]]);
    }
}
