//! Round meshes with shared vertices, and a soup of separate triangles.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use super::clouds::{TORUS_RADIUS, TORUS_TUBE};
use super::random::SplitMix64;
use crate::geometry::TriMesh;

/// The faces of an icosahedron as corners of [`icosahedron`], counter-clockwise seen from outside.
const ICOSAHEDRON_FACES: [[u32; 3]; 20] = [
    [0, 11, 5],
    [0, 5, 1],
    [0, 1, 7],
    [0, 7, 10],
    [0, 10, 11],
    [1, 5, 9],
    [5, 11, 4],
    [11, 10, 2],
    [10, 7, 6],
    [7, 1, 8],
    [3, 9, 4],
    [3, 4, 2],
    [3, 2, 6],
    [3, 6, 8],
    [3, 8, 9],
    [4, 9, 5],
    [2, 4, 11],
    [6, 2, 10],
    [8, 6, 7],
    [9, 8, 1],
];

fn icosahedron() -> [DVec3; 12] {
    let g = 0.5 * (1.0 + 5.0f64.sqrt());
    [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(DVec3::from_array)
}

/// The count k ≥ `least` for which `unit · k²` is nearest to n, or nearly.
pub(super) fn splits(n: usize, unit: f64, least: u32) -> u32 {
    ((n as f64 / unit).sqrt().round() as u32).max(least)
}

pub(super) fn icosphere(n: usize) -> TriMesh {
    let corners = icosahedron();
    let frequency = splits(n, 20.0, 1);
    let mut mesh = TriMesh::default();
    // A vertex is named by its corners and their weights, which the faces that share it agree on.
    let mut named = HashMap::new();
    for face in ICOSAHEDRON_FACES {
        let mut vertex = |i: u32, j: u32| {
            let mut name = [(face[0], frequency - i - j), (face[1], i), (face[2], j)];
            name.iter_mut().filter(|(_, weight)| *weight == 0).for_each(|part| *part = (u32::MAX, 0));
            name.sort_unstable();
            *named.entry(name).or_insert_with(|| {
                let parts = name.iter().filter(|(_, weight)| *weight > 0);
                let sum: DVec3 = parts.map(|&(corner, weight)| corners[corner as usize] * f64::from(weight)).sum();
                mesh.vertices.push((sum / sum.length()).as_vec3());
                mesh.vertices.len() as u32 - 1
            })
        };
        for i in 0..frequency {
            for j in 0..frequency - i {
                mesh.triangles.push([vertex(i, j), vertex(i + 1, j), vertex(i, j + 1)]);
                if i + j + 1 < frequency {
                    mesh.triangles.push([vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
                }
            }
        }
    }
    mesh
}

pub(super) fn torus(n: usize) -> TriMesh {
    // Two and a half times as many steps around the axis as around the tube make the triangles nearly equilateral.
    let tube_steps = splits(n, 5.0, 3);
    let axis_steps = (n as f64 / (2.0 * f64::from(tube_steps))).round().max(8.0) as u32;
    let angle = |i: u32, steps: u32| libm::sincos(std::f64::consts::TAU * f64::from(i) / f64::from(steps));
    let mut mesh = TriMesh::default();
    for i in 0..axis_steps {
        let (axis_sin, axis_cos) = angle(i, axis_steps);
        for j in 0..tube_steps {
            let (tube_sin, tube_cos) = angle(j, tube_steps);
            let from_axis = TORUS_RADIUS + TORUS_TUBE * tube_cos;
            mesh.vertices.push(DVec3::new(from_axis * axis_cos, from_axis * axis_sin, TORUS_TUBE * tube_sin).as_vec3());
            let at = |i: u32, j: u32| (i % axis_steps) * tube_steps + j % tube_steps;
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    mesh
}

pub(super) fn soup(n: usize, seed: u64) -> TriMesh {
    let half_width = 0.5 / libm::cbrt(n.max(1) as f64);
    let mut mesh = TriMesh::default();
    for i in 0..n {
        let mut random = SplitMix64::stream(seed, i as u64);
        let mut in_cube =
            |low: f64, high: f64| DVec3::new(random.range(low, high), random.range(low, high), random.range(low, high));
        let center = in_cube(0.0, 1.0);
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend([(); 3].map(|()| -> Vec3 { (center + in_cube(-half_width, half_width)).as_vec3() }));
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    mesh
}
