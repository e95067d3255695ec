//! Noisy samples of surfaces whose distance is known, and plain normals of them.

#![allow(dead_code, reason = "no test uses all of it")]

use nearfield::geometry::generate::{CloudKind, MeshKind, add_noise, cloud, mesh, surface_samples};
use nearfield::geometry::symmetric_eigen::Symmetric;
use nearfield::geometry::vector;
use nearfield::{AabbTreeN, AabbTreeNSettings};

const SEED: u64 = 20_261_129;

/// A surface by its signed distance and its outward normal.
pub(crate) struct Surface {
    /// Noisy points, in f64.
    pub(crate) points: Vec<[f64; 3]>,
    /// Diagonal of the exact surface's box.
    pub(crate) diagonal: f64,
    pub(crate) distance: fn([f64; 3]) -> f64,
    pub(crate) normal: fn([f64; 3]) -> [f64; 3],
}

fn noisy(mut points: Vec<nearfield::Vec3>, sigma: f64) -> Vec<[f64; 3]> {
    if sigma > 0.0 {
        add_noise(&mut points, sigma, SEED);
    }
    points.iter().map(|p| p.as_dvec3().to_array()).collect()
}

/// The torus with radii 1 and 0.4; `noise` as a part of the diagonal.
pub(crate) fn torus(n: usize, noise: f64) -> Surface {
    let diagonal = (2.0 * 2.8f64.powi(2) + 0.8f64.powi(2)).sqrt();
    Surface {
        points: noisy(cloud(CloudKind::Torus, n, SEED).points, noise * diagonal),
        diagonal,
        distance: |[x, y, z]| ((x * x + y * y).sqrt() - 1.0).hypot(z) - 0.4,
        normal: |[x, y, z]| {
            let axis = (x * x + y * y).sqrt();
            vector::normalized([x - x / axis, y - y / axis, z]).unwrap_or([0.0; 3])
        },
    }
}

/// The unit sphere.
pub(crate) fn sphere(n: usize, noise: f64) -> Surface {
    let diagonal = 12f64.sqrt();
    let on_sphere =
        cloud(CloudKind::Shell, n, SEED).points.iter().map(|p| p.as_dvec3().normalize().as_vec3()).collect();
    Surface {
        points: noisy(on_sphere, noise * diagonal),
        diagonal,
        distance: |p| vector::norm(p) - 1.0,
        normal: |p| vector::normalized(p).unwrap_or([0.0; 3]),
    }
}

/// The cube of side 2 about the origin.
pub(crate) fn cube(n: usize, noise: f64) -> Surface {
    let unit = surface_samples(&mesh(MeshKind::Cube, 12, 1), n, SEED).points;
    let points = unit.iter().map(|&p| 2.0 * p - nearfield::Vec3::ONE).collect();
    let diagonal = 12f64.sqrt();
    Surface {
        points: noisy(points, noise * diagonal),
        diagonal,
        distance: |p| {
            let over = p.map(|x: f64| x.abs() - 1.0);
            let outside = vector::norm(over.map(|x| x.max(0.0)));
            outside + over[0].max(over[1]).max(over[2]).min(0.0)
        },
        normal: |p: [f64; 3]| {
            let axis = (0..3).max_by(|&a, &b| p[a].abs().total_cmp(&p[b].abs())).unwrap();
            std::array::from_fn(|i| if i == axis { p[axis].signum() } else { 0.0 })
        },
    }
}

impl Surface {
    /// Root mean square and mean of the distances of some points, as parts of the diagonal.
    pub(crate) fn error(&self, points: &[[f64; 3]]) -> (f64, f64) {
        let (mut squares, mut sum) = (0.0, 0.0);
        for &point in points {
            let distance = (self.distance)(point);
            squares += distance * distance;
            sum += distance;
        }
        let n = points.len() as f64;
        ((squares / n).sqrt() / self.diagonal, sum / n / self.diagonal)
    }

    /// Normals of the planes of the points within a radius, pointing out.
    pub(crate) fn plane_normals(&self, radius: f64) -> Vec<[f64; 3]> {
        use rayon::prelude::*;
        let tree = AabbTreeN::build(&self.points, &AabbTreeNSettings::default()).unwrap();
        let normal = |point: &[f64; 3]| {
            let (mut n, mut first, mut second) = (0.0, [0.0; 3], Symmetric::default());
            tree.for_each_within(point, radius, |index, _| {
                let offset = vector::subtract(self.points[index as usize], *point);
                n += 1.0;
                first = vector::add(first, offset);
                second.add_outer(offset, 1.0);
            });
            second.add_outer(first, -1.0 / n);
            let found = second.eigen().vectors[0];
            if vector::dot(found, (self.normal)(*point)) < 0.0 { vector::scale(found, -1.0) } else { found }
        };
        self.points.par_iter().map(normal).collect()
    }
}
