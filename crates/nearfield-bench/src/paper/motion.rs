//! How points move: at random as in the paper, or along a flow.

use nearfield::Vec3;
use rayon::prelude::*;

/// A kind of movement; points stay in the cube from -1 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// Each coordinate by up to this much in either direction, evenly; reflected at the faces.
    Random(f32),
    /// Along the vortices of Taylor and Green: cells that turn against each other, with this much a step at most.
    Vortices(f32),
}

impl Motion {
    /// Moves the points; step and index alone decide where to.
    pub fn apply(self, points: &mut [Vec3], step: u64) {
        points.par_iter_mut().enumerate().with_min_len(4096).for_each(|(i, p)| {
            *p = match self {
                Self::Random(range) => {
                    let by = Vec3::new(unit(step, i, 0), unit(step, i, 1), unit(step, i, 2)) * range;
                    reflected(*p + by)
                }
                Self::Vortices(length) => {
                    let q = *p * std::f32::consts::PI;
                    let flow = Vec3::new(q.x.sin() * q.y.cos() * q.z.cos(), -q.x.cos() * q.y.sin() * q.z.cos(), 0.0);
                    reflected(*p + flow * length)
                }
            };
        });
    }
}

/// A number from -1 to 1.
fn unit(step: u64, point: usize, axis: u64) -> f32 {
    let mut bits =
        (step * 3 + axis).wrapping_mul(0xd134_2543_de82_ef95) ^ (point as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    // The finalizer of splitmix64.
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^= bits >> 31;
    (bits >> 40) as f32 / (1 << 23) as f32 - 1.0
}

fn reflected(p: Vec3) -> Vec3 {
    let over = (p.abs() - 1.0).max(Vec3::ZERO);
    (p - 2.0 * over * p.signum()).clamp(Vec3::splat(-1.0), Vec3::splat(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_stay_in_the_cube_and_move_no_farther_than_said() {
        for motion in [Motion::Random(0.3), Motion::Vortices(0.3)] {
            let before: Vec<Vec3> = (0..5000).map(|i| Vec3::new(unit(9, i, 0), unit(9, i, 1), unit(9, i, 2))).collect();
            let mut points = before.clone();
            motion.apply(&mut points, 1);
            assert!(points.iter().all(|p| p.abs().max_element() <= 1.0));
            let farthest = before.iter().zip(&points).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
            assert!(farthest <= 0.3001 && farthest > 0.2, "{motion:?}: {farthest}");
        }
    }

    #[test]
    fn random_movements_are_even_and_differ_by_step() {
        let n = 20_000;
        let mean = |step| (0..n).map(|i| f64::from(unit(step, i, 0))).sum::<f64>() / n as f64;
        let square = (0..n).map(|i| f64::from(unit(1, i, 2)).powi(2)).sum::<f64>() / n as f64;
        // Deviations of the mean and of the mean square of an even distribution are 0.004 and 0.002.
        assert!(mean(1).abs() < 0.02 && mean(2).abs() < 0.02 && (square - 1.0 / 3.0).abs() < 0.01);
        assert_ne!(unit(1, 5, 0), unit(2, 5, 0));
    }
}
