//! Surfaces whose distance is known, and noisy samples of them: the sets of the quality figures.

use nearfield::application::{Length, NormalSettings, Watch, estimate_normals_at};
use nearfield::geometry::generate::{CloudKind, MeshKind, add_noise, cloud, mesh, surface_samples};
use nearfield::geometry::vector;
use nearfield::{AabbTreeN, AabbTreeNSettings, Vec3};

use crate::Result;
use crate::sets::SEED;

/// A surface by its signed distance and its outward normal.
pub struct Surface {
    /// Its name.
    pub name: &'static str,
    /// Noisy samples.
    pub points: Vec<Vec3>,
    /// Diagonal of the box of the exact surface.
    pub diagonal: f64,
    /// Signed distance.
    pub distance: fn([f64; 3]) -> f64,
    /// Outward normal at the nearest place.
    pub normal: fn([f64; 3]) -> [f64; 3],
}

fn noisy(mut points: Vec<Vec3>, sigma: f64) -> Vec<Vec3> {
    if sigma > 0.0 {
        add_noise(&mut points, sigma, SEED);
    }
    points
}

/// The torus with radii 1 and 0.4; `noise` as a part of the diagonal.
pub fn torus(n: usize, noise: f64) -> Surface {
    let diagonal = (2.0 * 2.8f64.powi(2) + 0.8f64.powi(2)).sqrt();
    Surface {
        name: "torus",
        points: noisy(cloud(CloudKind::Torus, n, SEED).points, noise * diagonal),
        diagonal,
        distance: |[x, y, z]| (x.hypot(y) - 1.0).hypot(z) - 0.4,
        normal: |[x, y, z]| {
            let axis = x.hypot(y);
            vector::normalized([x - x / axis, y - y / axis, z]).unwrap_or([0.0; 3])
        },
    }
}

/// The unit sphere.
pub fn sphere(n: usize, noise: f64) -> Surface {
    let diagonal = 12f64.sqrt();
    let shell = cloud(CloudKind::Shell, n, SEED).points;
    let on_sphere = shell.iter().map(|p| p.as_dvec3().normalize().as_vec3());
    Surface {
        name: "sphere",
        points: noisy(on_sphere.collect(), noise * diagonal),
        diagonal,
        distance: |p| vector::norm(p) - 1.0,
        normal: |p| vector::normalized(p).unwrap_or([0.0; 3]),
    }
}

/// The cube of side 2 about the origin.
pub fn cube(n: usize, noise: f64) -> Surface {
    let unit = surface_samples(&mesh(MeshKind::Cube, 12, 1), n, SEED).points;
    let diagonal = 12f64.sqrt();
    Surface {
        name: "cube",
        points: noisy(unit.iter().map(|&p| 2.0 * p - Vec3::ONE).collect(), noise * diagonal),
        diagonal,
        distance: |p| {
            let over = p.map(|x: f64| x.abs() - 1.0);
            let outside = vector::norm(over.map(|x| x.max(0.0)));
            outside + over[0].max(over[1]).max(over[2]).min(0.0)
        },
        normal: |p: [f64; 3]| {
            let axis = if p[0].abs() >= p[1].abs().max(p[2].abs()) {
                0
            } else if p[1].abs() >= p[2].abs() {
                1
            } else {
                2
            };
            std::array::from_fn(|i| if i == axis { p[axis].signum() } else { 0.0 })
        },
    }
}

impl Surface {
    /// The samples as arrays.
    pub fn arrays(&self) -> Vec<[f32; 3]> {
        self.points.iter().map(Vec3::to_array).collect()
    }

    /// Root mean square and mean of the distances of some points, as parts of the diagonal.
    pub fn error<'a>(&self, points: impl ExactSizeIterator<Item = &'a [f32; 3]>) -> (f64, f64) {
        let n = points.len().max(1) as f64;
        let (mut squares, mut sum) = (0.0, 0.0);
        for point in points {
            let distance = (self.distance)(point.map(f64::from));
            squares += distance * distance;
            sum += distance;
        }
        ((squares / n).sqrt() / self.diagonal, sum / n / self.diagonal)
    }

    /// Normals of the planes of the samples within a radius, pointing out.
    ///
    /// # Errors
    /// As [`estimate_normals_at`].
    pub fn plane_normals(&self, radius: f64) -> Result<Vec<[f32; 3]>> {
        let points = self.arrays();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default())?;
        let settings = NormalSettings::default().within(Length::Absolute(radius));
        let mut normals = estimate_normals_at(&tree, &points, &settings, &mut Watch::none())?;
        for (i, point) in points.iter().enumerate() {
            let outward = (self.normal)(point.map(f64::from));
            if vector::dot(normals.vectors[i].map(f64::from), outward) < 0.0 {
                normals.flip(i);
            }
        }
        Ok(normals.vectors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_samples_lie_on_their_surface_and_noise_is_seen() {
        for make in [torus, sphere, cube] {
            let exact = make(500, 0.0);
            let (rms, _) = exact.error(exact.arrays().iter());
            assert!(rms < 1e-6, "{}: {rms}", exact.name);
            let rough = make(5000, 0.005);
            let (rms, _) = rough.error(rough.arrays().iter());
            assert!((0.0046..0.0053).contains(&rms), "{}: {rms}", rough.name);
            let normals = rough.plane_normals(0.3).expect("normals");
            let outward = rough
                .points
                .iter()
                .zip(&normals)
                .filter(|(p, n)| vector::dot(n.map(f64::from), (rough.normal)(p.as_dvec3().to_array())) > 0.7);
            assert!(outward.count() > 4000, "{}", rough.name);
        }
    }
}
