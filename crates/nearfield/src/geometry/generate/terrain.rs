//! An airborne scan of fractal hills.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::random::{SplitMix64, mix};
use crate::geometry::PointCloud;

/// Where the scan lies: a corner in UTM metres, and a height, so that coordinates need more bits than an f32 has.
const ORIGIN: DVec3 = DVec3::new(637_000.0, 5_403_000.0, 400.0);
/// Width in metres of the square that holds one point.
const SPACING: f64 = 0.5;
const NOISE: f64 = 0.02;

/// Longest wavelength in metres and the amplitude that goes with it.
pub(super) const WAVELENGTH: f64 = 256.0;
pub(super) const AMPLITUDE: f64 = 40.0;
/// Octaves halve the wavelength; 2^-0.8 an octave is the roughness of natural hills (Hurst exponent 0.8).
pub(super) const GAIN: f64 = 0.574_349_177_498_517_5;
pub(super) const OCTAVES: u32 = 9;

pub(super) fn scan(n: usize, seed: u64) -> PointCloud {
    let columns = (0usize..).find(|&c| c.pow(2) >= n).expect("a width should be found: n is finite");
    let point = |i: usize| {
        let (row, step) = (i / columns, i % columns);
        // The scanner sweeps to and fro.
        let column = if row.is_multiple_of(2) { step } else { columns - 1 - step };
        let mut random = SplitMix64::stream(seed, i as u64);
        let x = (column as f64 + random.unit()) * SPACING;
        let y = (row as f64 + random.unit()) * SPACING;
        let z = height(x, y, seed) + NOISE * random.normal();
        DVec3::new(x, y, z).as_vec3()
    };
    let points: Vec<Vec3> = (0..n).into_par_iter().with_min_len(1024).map(point).collect();
    PointCloud { origin: ORIGIN, ..PointCloud::new(points) }
}

/// Height in metres above the origin: a sum of value noises.
pub(super) fn height(x: f64, y: f64, seed: u64) -> f64 {
    let (mut total, mut amplitude, mut frequency) = (0.0, AMPLITUDE, 1.0 / WAVELENGTH);
    for octave in 0..OCTAVES {
        let key = mix(seed ^ (u64::from(octave) << 56));
        total += amplitude * value_noise(x * frequency, y * frequency, key);
        amplitude *= GAIN;
        frequency *= 2.0;
    }
    total
}

/// Noise in [-1, 1): random values on the integer lattice, blended by 6t⁵ - 15t⁴ + 10t³ (Perlin2002).
fn value_noise(x: f64, y: f64, key: u64) -> f64 {
    let (column, row) = (x.floor(), y.floor());
    let value = |dx: f64, dy: f64| {
        let cell = ((column + dx) as i64 as u64) ^ ((row + dy) as i64 as u64).rotate_left(32);
        (mix(mix(cell) ^ key) >> 11) as f64 * (2.0 / (1u64 << 53) as f64) - 1.0
    };
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (u, v) = (fade(x - column), fade(y - row));
    let blend = |a: f64, b: f64, t: f64| a + t * (b - a);
    blend(blend(value(0.0, 0.0), value(1.0, 0.0), u), blend(value(0.0, 1.0), value(1.0, 1.0), u), v)
}
