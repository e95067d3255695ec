//! Solids by their signed distances, for tests of distance fields and of the surfaces taken from them.

#![allow(dead_code, reason = "no test uses all of it")]

use glam::DMat3;
use nearfield::geometry::RegularGrid;
use nearfield::{DVec3, Vec3};

/// Reproducible numbers.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x2545_f491_4f6c_dd1d)
    }

    /// From 0 to below 1.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A cubic grid of n nodes a side from −half to half.
pub(crate) fn grid_over(half: f32, n: u32) -> RegularGrid {
    RegularGrid::new(DVec3::ZERO, Vec3::splat(-half), 2.0 * half / (n - 1) as f32, [n; 3]).unwrap()
}

/// Around z, radii 1 and 0.4.
pub(crate) fn torus([x, y, z]: [f64; 3]) -> f64 {
    (x.hypot(y) - 1.0).hypot(z) - 0.4
}

/// Two tori of radii 0.6 and 0.25 that overlap, as one body.
pub(crate) fn double_torus([x, y, z]: [f64; 3]) -> f64 {
    let ring = |x: f64| (x.hypot(y) - 0.6).hypot(z) - 0.25;
    ring(x - 0.65).min(ring(x + 0.65))
}

/// A cube in no special position.
pub(crate) struct RotatedCube {
    axes: [DVec3; 3],
    half: f64,
}

impl RotatedCube {
    pub(crate) fn new(half: f64) -> Self {
        let turn = DMat3::from_rotation_z(0.35) * DMat3::from_rotation_x(0.6) * DMat3::from_rotation_y(-0.8);
        Self { axes: [turn.x_axis, turn.y_axis, turn.z_axis], half }
    }

    /// Largest of the distances from the planes of its faces: exact inside and beside faces, less beyond edges.
    pub(crate) fn distance(&self, p: [f64; 3]) -> f64 {
        let p = DVec3::from(p);
        self.axes.iter().map(|axis| axis.dot(p).abs()).fold(0.0, f64::max) - self.half
    }

    pub(crate) fn gradient(&self, p: [f64; 3]) -> [f64; 3] {
        let p = DVec3::from(p);
        let nearest = self.axes.iter().max_by(|a, b| a.dot(p).abs().total_cmp(&b.dot(p).abs())).unwrap();
        (*nearest * nearest.dot(p).signum()).to_array()
    }

    pub(crate) fn corners(&self) -> Vec<DVec3> {
        let sign = |bits: usize, axis: usize| if bits >> axis & 1 == 1 { self.half } else { -self.half };
        (0..8).map(|bits| (0..3).map(|axis| self.axes[axis] * sign(bits, axis)).sum()).collect()
    }

    /// n² points on each face, with their normals.
    pub(crate) fn samples(&self, n: usize) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let (mut points, mut normals) = (vec![], vec![]);
        let place = |i: usize| ((i as f64 + 0.5) / n as f64 * 2.0 - 1.0) * self.half;
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let normal = self.axes[axis] * side;
                for i in 0..n * n {
                    let (u, v) = (self.axes[(axis + 1) % 3], self.axes[(axis + 2) % 3]);
                    points.push((normal * self.half + u * place(i % n) + v * place(i / n)).to_array());
                    normals.push(normal.to_array());
                }
            }
        }
        (points, normals)
    }
}
