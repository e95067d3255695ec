//! Numbers for random choices, and the warps that turn them into directions. Twin of `sampling.wesl`.
//!
//! Every number is a function of the seed, the pixel, the sample and what it is for, so that a picture does not depend
//! on the order of the work. The samples of a pixel form, in every pair of dimensions, the first two dimensions of the
//! sequence of Sobol1967 with the scrambling of Owen1995 done by hashes (Burley2020): the first 2^k of them, for any k, lie one in each
//! cell of every grid of 2^k equal cells, and each alone is uniform. Only sums, products, quotients, square roots and
//! integers are used: sine, cosine and arc tangent are polynomials, the same on every device.

use std::f32::consts::PI;

use glam::Vec3;

use crate::geometry::vector;

/// Scrambles 32 bits (Jarzynski2020).
pub(super) fn pcg(value: u32) -> u32 {
    let state = value.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

/// A seed from a seed and a number.
pub(super) fn combined(seed: u32, number: u32) -> u32 {
    pcg(number.wrapping_add(pcg(seed)))
}

/// A permutation of 32 bits in which a bit depends on lower ones only, on bits in reverse order: Owen's scrambling.
fn scrambled_reverse(reversed: u32, seed: u32) -> u32 {
    let mut v = reversed;
    v ^= v.wrapping_mul(0x3d20_adea);
    v = v.wrapping_add(seed);
    v = v.wrapping_mul((seed >> 16) | 1);
    v ^= v.wrapping_mul(0x0552_6c56);
    v ^= v.wrapping_mul(0x53a2_2864);
    v
}

/// The second dimension of the Sobol sequence from the bits of the index in reverse order, which are the first one:
/// Pascal's triangle modulo 2, row by row.
fn second_dimension(reversed: u32) -> u32 {
    let mut v = reversed;
    v ^= v << 16;
    v ^= (v & 0x00ff_00ff) << 8;
    v ^= (v & 0x0f0f_0f0f) << 4;
    v ^= (v & 0x3333_3333) << 2;
    v ^ ((v & 0x5555_5555) << 1)
}

/// A number in [0, 1) from the upper 24 bits.
pub(super) fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / (1u32 << 24) as f32)
}

/// Two numbers of 32 bits: sample `index` of the stratified sequence with this seed.
pub(super) fn pair(seed: u32, index: u32) -> [u32; 2] {
    // The order is shuffled too, by a scrambling of the index: pairs of dimensions are then independent.
    let shuffled = scrambled_reverse(index.reverse_bits(), pcg(seed));
    let first = scrambled_reverse(shuffled.reverse_bits(), combined(seed, 1)).reverse_bits();
    let second = scrambled_reverse(second_dimension(shuffled).reverse_bits(), combined(seed, 2)).reverse_bits();
    [first, second]
}

/// As [`pair`], as two numbers in [0, 1).
pub(super) fn unit_pair(seed: u32, index: u32) -> [f32; 2] {
    pair(seed, index).map(unit)
}

/// Cosine and sine of `turns` full turns, 0 ≤ `turns` ≤ 1, within 2e-7.
pub(super) fn cos_sin(turns: f32) -> [f32; 2] {
    let quarters = 4.0 * turns;
    let nearest = (quarters + 0.5).floor();
    let angle = (quarters - nearest) * (0.5 * PI);
    let square = angle * angle;
    let sine = angle
        * (1.0
            + square * (-1.0 / 6.0 + square * (1.0 / 120.0 + square * (-1.0 / 5040.0 + square * (1.0 / 362_880.0)))));
    let cosine = 1.0 + square * (-0.5 + square * (1.0 / 24.0 + square * (-1.0 / 720.0 + square * (1.0 / 40_320.0))));
    match nearest as u32 & 3 {
        0 => [cosine, sine],
        1 => [-sine, cosine],
        2 => [-cosine, -sine],
        _ => [sine, -cosine],
    }
}

/// The turns, in [0, 1), after which a vector (`x`, `y`) other than zero lies, within 2e-6.
pub(super) fn turns_of(x: f32, y: f32) -> f32 {
    let (across, up) = (x.abs(), y.abs());
    let ratio = across.min(up) / across.max(up).max(f32::MIN_POSITIVE);
    let s = ratio * ratio;
    // Abramowitz and Stegun 4.4.49 in turns.
    let series = 0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1)));
    let mut turns = ratio * series * (0.5 / PI);
    if up > across {
        turns = 0.25 - turns;
    }
    if x < 0.0 {
        turns = 0.5 - turns;
    }
    if y < 0.0 {
        turns = 1.0 - turns;
    }
    if turns < 1.0 { turns } else { 0.0 }
}

/// A direction around +z with density cosine / π.
pub(super) fn cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let radius = u[0].sqrt();
    let [c, s] = cos_sin(u[1]);
    Vec3::new(radius * c, radius * s, (1.0 - u[0]).sqrt())
}

/// Weights of the second and third corner of a triangle, uniform over its area.
pub(super) fn triangle_weights(u: [f32; 2]) -> [f32; 2] {
    let root = u[0].sqrt();
    [root * (1.0 - u[1]), root * u[1]]
}

/// Two directions that make a right-handed frame with a unit vector.
pub(super) fn frame(normal: Vec3) -> [Vec3; 2] {
    vector::tangents(normal.to_array()).map(Vec3::from_array)
}

/// The weight of a sample by the power heuristic (Veach1997): `this` is its density, `other` that of the other way.
pub(super) fn power_weight(this: f32, other: f32) -> f32 {
    // By the ratio, so that squares of densities cannot overflow.
    let ratio = other / this;
    1.0 / (1.0 + ratio * ratio)
}

/// The largest component.
pub(super) fn largest(v: Vec3) -> f32 {
    v.x.max(v.y).max(v.z)
}

/// The share of each colour channel in how bright it looks (Rec. 709).
pub(super) fn luminance(color: Vec3) -> f32 {
    0.2126 * color.x + 0.7152 * color.y + 0.0722 * color.z
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The second dimension as Sobol defines it: the sum of the direction numbers of the index's bits.
    fn sobol_by_direction_numbers(index: u32) -> u32 {
        let (mut direction, mut sum) = (1u32 << 31, 0);
        for bit in 0..32 {
            if index >> bit & 1 == 1 {
                sum ^= direction;
            }
            direction ^= direction >> 1;
        }
        sum
    }

    #[test]
    fn the_second_dimension_is_that_of_sobol() {
        for i in 0..10_000 {
            let index = pcg(i);
            assert_eq!(second_dimension(index.reverse_bits()), sobol_by_direction_numbers(index), "{index}");
        }
    }

    #[test]
    fn the_first_samples_of_a_power_of_two_are_stratified_in_every_grid() {
        for seed in [0, 1, 77, u32::MAX] {
            for power in 0..=8 {
                let n = 1u32 << power;
                let points: Vec<[u32; 2]> = (0..n).map(|i| pair(seed, i)).collect();
                for across in 0..=power {
                    let mut taken = vec![false; n as usize];
                    for [x, y] in &points {
                        let column = u64::from(*x) >> (32 - across);
                        let row = u64::from(*y) >> (32 - (power - across));
                        let cell = (row << across | column) as usize;
                        assert!(!std::mem::replace(&mut taken[cell], true), "seed {seed}, 2^{power}, 2^{across}");
                    }
                }
            }
        }
    }

    #[test]
    fn single_samples_are_uniform_and_dimensions_are_not_correlated() {
        // Chi-squared of 64 cells over 2^16 seeds: 63 degrees of freedom, so beyond 120 once in 50,000.
        const SEEDS: u32 = 1 << 16;
        for index in [0, 1, 5, 1023] {
            let mut one_pair = [0u32; 64];
            let mut two_pairs = [0u32; 64];
            for seed in 0..SEEDS {
                let [x, y] = pair(combined(seed, 0), index);
                let [z, _] = pair(combined(seed, 1), index);
                one_pair[(x >> 29 << 3 | y >> 29) as usize] += 1;
                two_pairs[(x >> 29 << 3 | z >> 29) as usize] += 1;
            }
            for counts in [one_pair, two_pairs] {
                let expected = f64::from(SEEDS) / 64.0;
                let chi2: f64 = counts.iter().map(|&c| (f64::from(c) - expected).powi(2) / expected).sum();
                assert!(chi2 < 120.0, "sample {index}: {chi2}");
            }
        }
    }

    #[test]
    fn polynomials_are_the_functions() {
        for i in 0..=100_000 {
            let turns = i as f32 / 100_000.0;
            let [c, s] = cos_sin(turns);
            let (sine, cosine) = (f64::from(turns) * std::f64::consts::TAU).sin_cos();
            assert!((f64::from(c) - cosine).abs() < 2e-7 && (f64::from(s) - sine).abs() < 2e-7, "{turns}");
            let back = turns_of(3.0 * c, 3.0 * s) - turns;
            assert!((back - back.round()).abs() < 3e-6, "{turns}: {back}");
        }
        assert_eq!(turns_of(1.0, -1e-30), 0.0);
    }

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        for i in 0..1000u32 {
            let [u, v] = unit_pair(i, 3);
            let [c, s] = cos_sin(v);
            let z = 2.0 * u - 1.0;
            let normal = Vec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z).normalize();
            let [a, b] = frame(normal);
            assert!((a.cross(b) - normal).length() < 2e-6, "{normal}");
            assert!((a.length() - 1.0).abs() < 1e-6 && (b.length() - 1.0).abs() < 1e-6);
        }
        assert!(frame(Vec3::NEG_Z)[0].is_finite());
    }

    #[test]
    fn cosine_directions_have_the_mean_of_their_density() {
        let n = 1 << 12;
        let sum: Vec3 = (0..n).map(|i| cosine_hemisphere(unit_pair(9, i))).sum();
        let mean = sum / n as f32;
        // E[z] = 2/3; a stratified mean of 4096 is well within 1e-3.
        assert!((mean - Vec3::new(0.0, 0.0, 2.0 / 3.0)).length() < 1e-3, "{mean}");
    }
}
