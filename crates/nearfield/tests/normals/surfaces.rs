//! Random points on surfaces with their outward normals.

use nearfield::application::Normals;
use nearfield::io::read_mesh;
use nearfield::{AabbTreeN, AabbTreeNSettings, Scalar};

use crate::support::{Random, data_file};

pub(crate) const SEED: u64 = 20_261_129;

/// Radii of the torus about z, whose diagonal is √(2 · 2.8² + 0.8²) ≈ 4.04.
pub(crate) const TORUS: [f64; 2] = [1.0, 0.4];

/// Points and the outward normals of the surface there.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surface {
    pub(crate) points: Vec<[f64; 3]>,
    pub(crate) normals: Vec<[f64; 3]>,
}

impl Surface {
    fn push(&mut self, point: [f64; 3], normal: [f64; 3]) {
        self.points.push(point);
        self.normals.push(normal);
    }

    /// With points off the surface by isotropic Gaussian noise; the normals stay.
    pub(crate) fn with_noise(mut self, sigma: f64, random: &mut Random) -> Self {
        for x in self.points.as_flattened_mut() {
            *x += sigma * gaussian(random);
        }
        self
    }

    /// All of both.
    pub(crate) fn and(mut self, other: Self) -> Self {
        self.points.extend(other.points);
        self.normals.extend(other.normals);
        self
    }

    pub(crate) fn moved(mut self, by: [f64; 3]) -> Self {
        self.points.iter_mut().for_each(|p| *p = add(*p, by));
        self
    }

    pub(crate) fn tree<T: Scalar>(&self) -> AabbTreeN<T, 3> {
        tree(&self.points.iter().map(|p| p.map(T::of)).collect::<Vec<_>>())
    }
}

pub(crate) fn tree<T: Scalar>(points: &[[T; 3]]) -> AabbTreeN<T, 3> {
    AabbTreeN::build(points, &AabbTreeNSettings::default()).unwrap()
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(random: &mut Random) -> f64 {
    f64::from(random.word()) / 2f64.powi(32)
}

fn gaussian(random: &mut Random) -> f64 {
    // Box and Muller.
    let (radius, angle) = (1.0 - unit(random), unit(random));
    (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
}

pub(crate) fn sphere(n: usize, random: &mut Random) -> Surface {
    let mut made = Surface::default();
    for _ in 0..n {
        let (z, angle) = (2.0 * unit(random) - 1.0, std::f64::consts::TAU * unit(random));
        let r = (1.0 - z * z).sqrt();
        let p = [r * angle.cos(), r * angle.sin(), z];
        made.push(p, p);
    }
    made
}

pub(crate) fn torus(n: usize, random: &mut Random) -> Surface {
    let (mut made, [large, small]) = (Surface::default(), TORUS);
    while made.points.len() < n {
        let (around, across) = (std::f64::consts::TAU * unit(random), std::f64::consts::TAU * unit(random));
        let distance = large + small * across.cos();
        // By area.
        if unit(random) * (large + small) < distance {
            let [c, s] = [around.cos(), around.sin()];
            let normal = [across.cos() * c, across.cos() * s, across.sin()];
            made.push([distance * c, distance * s, small * across.sin()], normal);
        }
    }
    made
}

/// A rectangle of 2 × 2 in the plane through the origin with this normal of length 1.
pub(crate) fn square(n: usize, normal: [f64; 3], random: &mut Random) -> Surface {
    let [u, v] = nearfield::geometry::vector::tangents(normal);
    let mut made = Surface::default();
    for _ in 0..n {
        let (a, b) = (2.0 * unit(random) - 1.0, 2.0 * unit(random) - 1.0);
        made.push(std::array::from_fn(|i| a * u[i] + b * v[i]), normal);
    }
    made
}

/// Both sides of a closed box, 2 × 2 and thin along z.
pub(crate) fn sheet(n: usize, thickness: f64, random: &mut Random) -> Surface {
    let half = thickness / 2.0;
    let top = square(n / 2, [0.0, 0.0, 1.0], random).moved([0.0, 0.0, half]);
    let mut made = square(n - n / 2, [0.0, 0.0, -1.0], random).moved([0.0, 0.0, -half]).and(top);
    // As dense as on the sides of 4 each: the rim is 8 long.
    let at_rim = (n as f64 * thickness) as usize;
    for i in 0..at_rim {
        let (along, height) = (2.0 * unit(random) - 1.0, thickness * (unit(random) - 0.5));
        let out = if i & 1 == 0 { 1.0 } else { -1.0 };
        match i & 2 {
            0 => made.push([out, along, height], [out, 0.0, 0.0]),
            _ => made.push([along, out, height], [0.0, out, 0.0]),
        }
    }
    made
}

/// Points on the faces of a mesh of the real data, by area, with the normals of the faces, which point outward there.
pub(crate) fn scan(name: &str, n: usize, random: &mut Random) -> Option<Surface> {
    let mesh = read_mesh(&data_file(name)?, None).unwrap();
    let triangles: Vec<_> = (0..mesh.triangles.len()).map(|i| mesh.triangle(i)).collect();
    let mut sums = vec![0.0f64];
    for triangle in &triangles {
        sums.push(sums[sums.len() - 1] + f64::from((triangle.b - triangle.a).cross(triangle.c - triangle.a).length()));
    }
    let mut made = Surface::default();
    for _ in 0..n {
        let area = unit(random) * sums[sums.len() - 1];
        let triangle = triangles[sums.partition_point(|&sum| sum <= area).clamp(1, triangles.len()) - 1];
        let (mut s, mut t) = (unit(random), unit(random));
        if s + t > 1.0 {
            (s, t) = (1.0 - s, 1.0 - t);
        }
        let [a, b, c] = [triangle.a, triangle.b, triangle.c].map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a).normalize_or_zero();
        made.push((a + (b - a) * s + (c - a) * t).to_array(), normal.to_array());
    }
    Some(made)
}

/// Angles in degrees between found and true normals, whatever their side, sorted; panics where there is none.
pub(crate) fn angles<T: Scalar>(found: &Normals<T>, surface: &Surface) -> Vec<f64> {
    assert_eq!(found.len(), surface.points.len());
    let mut angles: Vec<f64> = (found.vectors.iter().zip(&surface.normals))
        .map(|(n, truth)| {
            let n = n.map(T::to_f64);
            assert!((dot(n, n) - 1.0).abs() < 1e-5, "{n:?}");
            // By the chord: the cosine of small angles is 1.
            let side = if dot(n, *truth) < 0.0 { -1.0 } else { 1.0 };
            let chord2: f64 = (0..3).map(|i| (n[i] * side - truth[i]).powi(2)).sum();
            (2.0 * (chord2.sqrt() / 2.0).min(1.0).asin()).to_degrees()
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    angles
}

/// Median and largest.
pub(crate) fn median_and_most(angles: &[f64]) -> [f64; 2] {
    [angles[angles.len() / 2], angles[angles.len() - 1]]
}

/// The part of the normals on the true side.
pub(crate) fn right_side<T: Scalar>(found: &Normals<T>, surface: &Surface) -> f64 {
    let pairs = found.vectors.iter().zip(&surface.normals);
    pairs.filter(|(n, truth)| dot(n.map(T::to_f64), **truth) > 0.0).count() as f64 / found.len() as f64
}
