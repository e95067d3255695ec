//! Samples of surfaces as scanners give them: spread evenly over a mesh, with noise.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::random::SplitMix64;
use crate::geometry::{PointCloud, TriMesh};

/// Stream that noise is drawn from, beside that of the points of the same seed.
const NOISE: u64 = 0x6e6f_6973_6521_7631;

/// Moves every point by isotropic Gaussian noise of the standard deviation `sigma` along each axis.
///
/// The noise of a point depends on the seed and its index alone.
pub fn add_noise(points: &mut [Vec3], sigma: f64, seed: u64) {
    points.par_iter_mut().enumerate().with_min_len(4096).for_each(|(i, point)| {
        let mut random = SplitMix64::stream(seed ^ NOISE, i as u64);
        let ((x, y), z) = (random.normal_pair(), random.normal());
        *point = (point.as_dvec3() + sigma * DVec3::new(x, y, z)).as_vec3();
    });
}

/// `n` points uniform by area on the triangles of a mesh, with the normals of the triangles they lie on; none without area.
pub fn surface_samples(mesh: &TriMesh, n: usize, seed: u64) -> PointCloud {
    let corners = |t: &[u32; 3]| t.map(|v| mesh.vertices[v as usize].as_dvec3());
    let mut sums = Vec::with_capacity(mesh.triangles.len());
    let mut total = 0.0;
    for triangle in &mesh.triangles {
        let [a, b, c] = corners(triangle);
        total += 0.5 * (b - a).cross(c - a).length();
        sums.push(total);
    }
    if !(total > 0.0 && total.is_finite()) {
        return PointCloud { origin: mesh.origin, ..PointCloud::default() };
    }
    let sample = |i: usize| {
        let mut random = SplitMix64::stream(seed, i as u64);
        let share = random.unit() * total;
        let [a, b, c] = corners(&mesh.triangles[sums.partition_point(|&sum| sum <= share).min(sums.len() - 1)]);
        // Both halves of the parallelogram fold onto the triangle.
        let (mut u, mut v) = (random.unit(), random.unit());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        let normal = (b - a).cross(c - a).normalize_or_zero();
        ((a + u * (b - a) + v * (c - a)).as_vec3(), normal.as_vec3())
    };
    let (points, normals) = (0..n).into_par_iter().with_min_len(4096).map(sample).unzip();
    PointCloud { origin: mesh.origin, points, normals: Some(normals), ..PointCloud::default() }
}
