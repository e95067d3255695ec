//! Clouds drawn point by point from a distribution, and the degenerate ones.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::random::SplitMix64;

/// Distance between neighbours of the lattice: a power of two.
pub const LATTICE_SPACING: f32 = 1.0 / 16.0;

const SHELL_NOISE: f64 = 0.001;
const PLUMMER_CUTOFF: f64 = 10.0;
pub(super) const TORUS_RADIUS: f64 = 1.0;
pub(super) const TORUS_TUBE: f64 = 0.4;

const BLOB_COUNT: u64 = 100;
const BACKGROUND_SHARE: f64 = 0.1;
/// Stream of the blobs themselves, beyond any point's.
const BLOB_STREAM: u64 = u64::MAX;

/// Evaluates `point` for each of n random streams on all cores; the order is that of the streams.
fn draw(n: usize, seed: u64, point: impl Fn(&mut SplitMix64) -> Vec3 + Sync) -> Vec<Vec3> {
    (0..n).into_par_iter().with_min_len(4096).map(|i| point(&mut SplitMix64::stream(seed, i as u64))).collect()
}

fn unit_cube(random: &mut SplitMix64) -> Vec3 {
    Vec3::new(random.unit_f32(), random.unit_f32(), random.unit_f32())
}

pub(super) fn uniform(n: usize, seed: u64) -> Vec<Vec3> {
    draw(n, seed, unit_cube)
}

pub(super) fn shell(n: usize, seed: u64) -> Vec<Vec3> {
    draw(n, seed, |random| {
        let direction = random.direction();
        (direction * (1.0 + SHELL_NOISE * random.normal())).as_vec3()
    })
}

/// A Gaussian blob of the clustered set.
pub(super) struct Blob {
    center: DVec3,
    pub(super) sigma: f64,
}

/// The blobs of a seed; they do not depend on the number of points.
pub(super) fn blobs(seed: u64) -> Vec<Blob> {
    let mut random = SplitMix64::stream(seed, BLOB_STREAM);
    let mut blob = || Blob {
        center: DVec3::new(random.unit(), random.unit(), random.unit()),
        sigma: libm::exp(std::f64::consts::LN_10 * random.range(-3.2, -1.0)),
    };
    (0..BLOB_COUNT).map(|_| blob()).collect()
}

pub(super) fn clustered(n: usize, seed: u64) -> Vec<Vec3> {
    let blobs = blobs(seed);
    draw(n, seed, |random| {
        if random.unit() < BACKGROUND_SHARE {
            return unit_cube(random);
        }
        let blob = &blobs[random.below(BLOB_COUNT) as usize];
        let ((x, y), z) = (random.normal_pair(), random.normal());
        (blob.center + blob.sigma * DVec3::new(x, y, z)).as_vec3()
    })
}

pub(super) fn plummer(n: usize, seed: u64) -> Vec<Vec3> {
    // The share of mass inside radius s is (s² / (1 + s²))^(3/2); solved for s at a uniform share below the cut-off's.
    let cutoff2 = PLUMMER_CUTOFF * PLUMMER_CUTOFF;
    let inside = cutoff2 / (1.0 + cutoff2);
    let mass = inside * inside.sqrt();
    draw(n, seed, |random| {
        let root = libm::cbrt(mass * random.unit());
        let radius = root / (1.0 - root * root).sqrt();
        (random.direction() * radius).as_vec3()
    })
}

pub(super) fn torus(n: usize, seed: u64) -> Vec<Vec3> {
    draw(n, seed, |random| {
        // Area is proportional to the distance from the axis: angles of the tube are accepted with that weight.
        let (tube_sin, from_axis) = loop {
            let (sin, cos) = libm::sincos(std::f64::consts::TAU * random.unit());
            let from_axis = TORUS_RADIUS + TORUS_TUBE * cos;
            if random.unit() * (TORUS_RADIUS + TORUS_TUBE) < from_axis {
                break (sin, from_axis);
            }
        };
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * random.unit());
        DVec3::new(from_axis * cos, from_axis * sin, TORUS_TUBE * tube_sin).as_vec3()
    })
}

pub(super) fn all_equal(n: usize) -> Vec<Vec3> {
    vec![Vec3::new(0.25, 0.5, 0.75); n]
}

pub(super) fn line(n: usize, seed: u64) -> Vec<Vec3> {
    draw(n, seed, |random| Vec3::new(random.unit_f32(), 0.5, 0.25))
}

pub(super) fn lattice(n: usize) -> Vec<Vec3> {
    let side = (0usize..).find(|&side| side.pow(3) >= n).expect("a side should be found: n is finite");
    let at = |i: usize| i as f32 * LATTICE_SPACING;
    (0..n).map(|i| Vec3::new(at(i % side), at(i / side % side), at(i / (side * side)))).collect()
}
