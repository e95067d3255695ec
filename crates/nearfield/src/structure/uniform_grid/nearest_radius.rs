//! How wide cells are for a search of the nearest points: balls of that radius hold a few more than are asked for.

use std::collections::BinaryHeap;

use glam::Vec3;
use rayon::prelude::*;

use super::{GridLayout, GridSettings};
use crate::geometry::Aabb;

/// Points around which it is measured: their median is some 4 % of the number of points in a ball off.
const SAMPLE: usize = 32;
/// Points that one thread looks at together.
const CHUNK: usize = 1 << 14;

/// Other points that a ball should hold: where they are spread evenly, of a hundred balls one has fewer than `k` (Poisson, 2.2
/// standard deviations), and few have many more, which would be tested for nothing.
fn points_in_ball(k: u32) -> f64 {
    let k = f64::from(k) + 1.0;
    k + 2.2 * k.sqrt()
}

/// The median, over a sample of the points, of the distance within which so many others lie; 0 where there are not so many.
pub(super) fn measured(points: &[Vec3], k: u32) -> f32 {
    let others = points_in_ball(k).round() as usize;
    if points.len() <= others {
        return 0.0;
    }
    let sample: Vec<Vec3> = points.iter().copied().step_by(points.len().div_ceil(SAMPLE)).collect();
    // The squared distances of the nearest, the point itself among them: as integers, whose order is the same.
    let none = || sample.iter().map(|_| BinaryHeap::with_capacity(others + 2)).collect::<Vec<_>>();
    let near = points.par_chunks(CHUNK).fold(none, |mut near: Vec<BinaryHeap<u32>>, chunk| {
        for (near, &center) in near.iter_mut().zip(&sample) {
            chunk.iter().for_each(|&point| keep(near, (point - center).length_squared().to_bits(), others + 1));
        }
        near
    });
    let near = near.reduce(none, |mut a, b| {
        for (a, b) in a.iter_mut().zip(b) {
            b.into_iter().for_each(|dist2| keep(a, dist2, others + 1));
        }
        a
    });
    let mut farthest: Vec<u32> = near.iter().filter_map(|near| near.peek().copied()).collect();
    let middle = farthest.len() / 2;
    let (_, &mut median, _) = farthest.select_nth_unstable(middle);
    let radius = f32::from_bits(median).sqrt();
    if radius.is_finite() { radius } else { 0.0 }
}

/// Keeps the smallest `most` values.
#[inline(always)]
fn keep(smallest: &mut BinaryHeap<u32>, value: u32, most: usize) {
    if smallest.len() < most {
        smallest.push(value);
    } else if smallest.peek().is_some_and(|&largest| value < largest) {
        smallest.pop();
        smallest.push(value);
    }
}

/// The radius of a ball with so many points where `n_points` fill these bounds evenly; flat and straight bounds by the axes they have.
/// 0 where they have none.
pub(super) fn in_bounds(bounds: &Aabb, n_points: usize, k: u32) -> f32 {
    let axes = bounds.extent().to_array().into_iter().filter(|&extent| extent > 0.0);
    let dimension = axes.clone().count();
    if n_points == 0 || dimension == 0 || bounds.is_empty() {
        return 0.0;
    }
    // A ball of radius 1 has this length, area or volume.
    let unit = [2.0, std::f64::consts::PI, 4.0 / 3.0 * std::f64::consts::PI][dimension - 1];
    let log_volume: f64 = axes.map(|extent| f64::from(extent).ln()).sum();
    let log_ball = log_volume + (points_in_ball(k) / n_points as f64 / unit).ln();
    let radius = (log_ball / dimension as f64).exp() as f32;
    if radius.is_finite() { radius.max(f32::MIN_POSITIVE) } else { 0.0 }
}

/// How much wider cells may be than balls have to be, step by step: balls then hold up to twice as many points of a surface.
const WIDER: [f32; 5] = [1.0, 1.1, 1.2, 1.35, 1.5];

/// The radius, or a little more where cells would be too many for a dense table and then are not: hashed rows are not searched in pairs.
pub(super) fn with_dense_table(radius: f32, bounds: &Aabb, n_points: usize) -> f32 {
    let is_dense = |radius: &f32| {
        let n_points = u32::try_from(n_points).unwrap_or(u32::MAX);
        GridLayout::new(n_points, bounds, &GridSettings::for_radius(*radius)).hashed == 0
    };
    let wider = WIDER.map(|factor| radius * factor).into_iter().filter(|radius| radius.is_finite());
    wider.filter(|_| radius > 0.0).find(is_dense).unwrap_or(radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generate::{CloudKind, cloud};

    /// Mean number of other points within the radius.
    fn mean(points: &[Vec3], radius: f32) -> f64 {
        let within = |p: &Vec3| points.iter().filter(|q| (*p - **q).length_squared() <= radius * radius).count() - 1;
        let sample: Vec<usize> = points.iter().step_by(7).map(within).collect();
        sample.iter().sum::<usize>() as f64 / sample.len() as f64
    }

    #[test]
    fn balls_hold_a_few_more_than_are_asked_for() {
        for kind in [CloudKind::Uniform, CloudKind::Shell] {
            let points = cloud(kind, 7000, 7).points;
            for k in [1, 16, 32] {
                let (found, wanted) = (mean(&points, measured(&points, k)), points_in_ball(k));
                assert!((0.7 * wanted..1.3 * wanted).contains(&found), "{kind:?}, {k}: {found}, wanted {wanted}");
            }
        }
    }

    #[test]
    fn even_points_are_measured_as_their_bounds_say() {
        let points = cloud(CloudKind::Uniform, 30_000, 7).points;
        let bounds = Aabb::of_points(&points);
        let ratio = measured(&points, 16) / in_bounds(&bounds, points.len(), 16);
        assert!((0.93..1.15).contains(&ratio), "{ratio}");
    }

    #[test]
    fn cells_of_a_surface_are_wide_enough_for_a_dense_table() {
        let bounds = Aabb::new(Vec3::ZERO, Vec3::ONE);
        // A sphere of diameter 1 with so many points has 26 in a ball of this radius.
        let radius = |n: usize| (26.0 / n as f32).sqrt();
        assert_eq!(with_dense_table(radius(500_000), &bounds, 500_000), radius(500_000));
        let wider = with_dense_table(radius(2_000_000), &bounds, 2_000_000) / radius(2_000_000);
        assert!((1.05..1.5).contains(&wider), "{wider}");
        assert_eq!(with_dense_table(1e-5, &bounds, 1000), 1e-5, "no table would be dense");
        assert_eq!(with_dense_table(0.0, &bounds, 1000), 0.0);
    }

    #[test]
    fn points_without_a_scale_have_no_radius() {
        assert_eq!(measured(&[], 16), 0.0);
        assert_eq!(measured(&[Vec3::ONE; 20], 16), 0.0);
        assert_eq!(measured(&[Vec3::ONE; 90], 16), 0.0);
        assert_eq!(in_bounds(&Aabb::of_points(&[Vec3::ONE; 3]), 3, 16), 0.0);
        assert_eq!(in_bounds(&Aabb::of_points(&[]), 0, 16), 0.0);
    }
}
