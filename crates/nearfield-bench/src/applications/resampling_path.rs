//! Where the samples of a resampling are in each iteration: what the searches of figure 15 are asked around.
//!
//! The formula is that of weighted locally optimal projection as the paper has it (Huang2009), computed plainly on the CPU and in no
//! time that is measured: x ← Σ p α / v ÷ Σ α / v + μ Σ (x − x′) w′ β ÷ Σ w′ β with θ(r) = exp(−r² / (h / 4)²), α = β = θ(r) / r,
//! v = 1 + Σ θ, w = 1 + Σ θ; in the first iteration α = θ.

use nearfield::{AabbTreeN, AabbTreeNSettings, Vec3};
use rayon::prelude::*;

use crate::Result;

/// How strongly samples push each other away.
const MU: f32 = 0.45;
/// Distances below this part of the radius count as that where they are divided by.
const LEAST: f32 = 1e-3;

fn theta(dist2: f32, radius: f32) -> f32 {
    (-16.0 * dist2 / (radius * radius)).exp()
}

fn tree(points: &[Vec3]) -> Result<AabbTreeN<f32, 3>> {
    let arrays: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
    Ok(AabbTreeN::build(&arrays, &AabbTreeNSettings::default())?)
}

/// 1 + Σ θ over the other points.
fn densities(tree: &AabbTreeN<f32, 3>, points: &[Vec3], radius: f32) -> Vec<f32> {
    let density = |point: &Vec3| {
        let mut sum = 0.0;
        // The point itself gives the 1.
        tree.for_each_within(&point.to_array(), radius, |_, dist2| sum += theta(dist2, radius));
        sum
    };
    points.par_iter().map(density).collect()
}

/// The positions of the samples before each iteration: the first `count` points, as they move.
///
/// # Errors
/// As the trees.
pub fn path(points: &[Vec3], count: usize, radius: f32, iterations: usize) -> Result<Vec<Vec<Vec3>>> {
    let inputs = tree(points)?;
    let v = densities(&inputs, points, radius);
    let mut samples = points[..count.min(points.len())].to_vec();
    let mut all = Vec::with_capacity(iterations);
    for iteration in 0..iterations {
        let own = tree(&samples)?;
        let w = densities(&own, &samples, radius);
        let moved = |(i, &x): (usize, &Vec3)| {
            let (mut drawn, mut draws) = (Vec3::ZERO, 0.0);
            inputs.for_each_within(&x.to_array(), radius, |j, dist2| {
                let r = if iteration == 0 { 1.0 } else { dist2.sqrt().max(LEAST * radius) };
                let alpha = theta(dist2, radius) / (r * v[j as usize]);
                drawn += alpha * (points[j as usize] - x);
                draws += alpha;
            });
            let (mut pushed, mut pushes) = (Vec3::ZERO, 0.0);
            own.for_each_within(&x.to_array(), radius, |j, dist2| {
                if j as usize != i {
                    let beta = w[j as usize] * theta(dist2, radius) / dist2.sqrt().max(LEAST * radius);
                    pushed += beta * (x - samples[j as usize]);
                    pushes += beta;
                }
            });
            let part = |sum: Vec3, weight: f32| if weight > 0.0 { sum / weight } else { Vec3::ZERO };
            x + part(drawn, draws) + MU * part(pushed, pushes)
        };
        let next: Vec<Vec3> = samples.par_iter().enumerate().map(moved).collect();
        all.push(std::mem::replace(&mut samples, next));
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use nearfield::geometry::generate::{CloudKind, cloud};

    use super::*;

    #[test]
    fn samples_spread_and_stay_on_the_surface() {
        let points = cloud(CloudKind::Shell, 4000, 1).points;
        let all = path(&points, 300, 0.6, 25).expect("points");
        assert_eq!((all.len(), all[0].len()), (25, 300));
        assert_eq!(all[0], points[..300]);
        // The mean distance of the nearest grows as samples spread: at random it is half of that of an even pattern.
        let nearest = |samples: &[Vec3]| {
            let one = |i: usize| {
                let others = samples.iter().enumerate().filter(|&(j, _)| j != i);
                others.map(|(_, p)| p.distance(samples[i])).fold(f32::INFINITY, f32::min)
            };
            (0..samples.len()).map(one).sum::<f32>() / samples.len() as f32
        };
        let last = &all[24];
        assert!(nearest(last) > 1.3 * nearest(&all[0]), "{} after {}", nearest(last), nearest(&all[0]));
        assert!(last.iter().all(|p| (p.length() - 1.0).abs() < 0.1), "a shell");
    }
}
