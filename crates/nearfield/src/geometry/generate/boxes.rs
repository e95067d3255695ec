//! Meshes of flat quadrilaterals: the cube and the Cornell box.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use super::meshes::splits;
use crate::geometry::TriMesh;

pub(super) fn cube(n: usize) -> TriMesh {
    let k = splits(n, 12.0, 1);
    let mut mesh = TriMesh::default();
    let mut named = HashMap::new();
    for axis in 0..3 {
        for side in [0, k] {
            let mut vertex = |i: u32, j: u32| {
                let mut cell = [0; 3];
                cell[axis] = side;
                // Turning the two other axes keeps the face counter-clockwise seen from outside.
                let (u, v) = if side == k { (i, j) } else { (j, i) };
                cell[(axis + 1) % 3] = u;
                cell[(axis + 2) % 3] = v;
                *named.entry(cell).or_insert_with(|| {
                    mesh.vertices.push(Vec3::from_array(cell.map(|c| (f64::from(c) / f64::from(k)) as f32)));
                    mesh.vertices.len() as u32 - 1
                })
            };
            for i in 0..k {
                for j in 0..k {
                    let (a, b, c, d) = (vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
                    mesh.triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }
    mesh
}

const WHITE: [u8; 4] = [193, 189, 180, 255];
const RED: [u8; 4] = [161, 13, 15, 255];
const GREEN: [u8; 4] = [31, 115, 37, 255];
const LAMP: [u8; 4] = [255, 255, 255, 255];

type Corners = [[f64; 3]; 4];

/// The measured Cornell box (Goral1984), as Cornell University publishes its corners: counter-clockwise
/// seen from inside the room and from outside the blocks. The lamp hangs 0.3 mm below the ceiling instead of in its hole.
#[rustfmt::skip]
const CORNELL: [([u8; 4], Corners); 16] = [
    // Floor, lamp, ceiling, back, right, left.
    (WHITE, [[552.8, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 559.2], [549.6, 0.0, 559.2]]),
    (LAMP, [[343.0, 548.5, 227.0], [343.0, 548.5, 332.0], [213.0, 548.5, 332.0], [213.0, 548.5, 227.0]]),
    (WHITE, [[556.0, 548.8, 0.0], [556.0, 548.8, 559.2], [0.0, 548.8, 559.2], [0.0, 548.8, 0.0]]),
    (WHITE, [[549.6, 0.0, 559.2], [0.0, 0.0, 559.2], [0.0, 548.8, 559.2], [556.0, 548.8, 559.2]]),
    (GREEN, [[0.0, 0.0, 559.2], [0.0, 0.0, 0.0], [0.0, 548.8, 0.0], [0.0, 548.8, 559.2]]),
    (RED, [[552.8, 0.0, 0.0], [549.6, 0.0, 559.2], [556.0, 548.8, 559.2], [556.0, 548.8, 0.0]]),
    // The short block: top, then its sides.
    (WHITE, [[130.0, 165.0, 65.0], [82.0, 165.0, 225.0], [240.0, 165.0, 272.0], [290.0, 165.0, 114.0]]),
    (WHITE, [[290.0, 0.0, 114.0], [290.0, 165.0, 114.0], [240.0, 165.0, 272.0], [240.0, 0.0, 272.0]]),
    (WHITE, [[130.0, 0.0, 65.0], [130.0, 165.0, 65.0], [290.0, 165.0, 114.0], [290.0, 0.0, 114.0]]),
    (WHITE, [[82.0, 0.0, 225.0], [82.0, 165.0, 225.0], [130.0, 165.0, 65.0], [130.0, 0.0, 65.0]]),
    (WHITE, [[240.0, 0.0, 272.0], [240.0, 165.0, 272.0], [82.0, 165.0, 225.0], [82.0, 0.0, 225.0]]),
    // The tall block.
    (WHITE, [[423.0, 330.0, 247.0], [265.0, 330.0, 296.0], [314.0, 330.0, 456.0], [472.0, 330.0, 406.0]]),
    (WHITE, [[423.0, 0.0, 247.0], [423.0, 330.0, 247.0], [472.0, 330.0, 406.0], [472.0, 0.0, 406.0]]),
    (WHITE, [[472.0, 0.0, 406.0], [472.0, 330.0, 406.0], [314.0, 330.0, 456.0], [314.0, 0.0, 456.0]]),
    (WHITE, [[314.0, 0.0, 456.0], [314.0, 330.0, 456.0], [265.0, 330.0, 296.0], [265.0, 0.0, 296.0]]),
    (WHITE, [[265.0, 0.0, 296.0], [265.0, 330.0, 296.0], [423.0, 330.0, 247.0], [423.0, 0.0, 247.0]]),
];

pub(super) fn cornell(n: usize) -> TriMesh {
    let k = splits(n, 2.0 * CORNELL.len() as f64, 1);
    let mut mesh = TriMesh::default();
    let mut colors = vec![];
    for (color, corners) in CORNELL {
        let [a, b, c, d] = corners.map(DVec3::from_array);
        let first = mesh.vertices.len() as u32;
        for i in 0..=k {
            for j in 0..=k {
                let (u, v) = (f64::from(i) / f64::from(k), f64::from(j) / f64::from(k));
                let point = (a * (1.0 - u) + b * u) * (1.0 - v) + (d * (1.0 - u) + c * u) * v;
                mesh.vertices.push(point.as_vec3());
                colors.push(color);
            }
        }
        let at = |i: u32, j: u32| first + i * (k + 1) + j;
        for i in 0..k {
            for j in 0..k {
                mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    mesh.colors = Some(colors);
    mesh
}
