//! Closed meshes and places inside them: where a ray cannot get out without a hit.

use std::collections::HashMap;

use libtest_mimic::Trial;
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{DVec3, TriMesh, Vec3};
use rayon::prelude::*;

use crate::support::{Random, trial};

/// How far around a place all must be inside, in longest sides of the mesh: 2⁻¹² is far beyond the margin of rays.
const CLEARANCE: f32 = 1.0 / 4096.0;

/// Whether every edge is passed as often in one direction as in the other, corners compared by their coordinates.
pub(crate) fn is_closed(mesh: &TriMesh) -> bool {
    let mut balance: HashMap<[[u32; 3]; 2], i64> = HashMap::new();
    let bits = |v: u32| mesh.vertices[v as usize].to_array().map(|c| (c + 0.0).to_bits());
    for triangle in &mesh.triangles {
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (bits(triangle[from]), bits(triangle[to]));
            let step = if from < to { 1 } else { -1 };
            if from != to {
                *balance.entry([from.min(to), from.max(to)]).or_default() += step;
            }
        }
    }
    balance.values().all(|&sum| sum == 0)
}

/// How often the mesh winds around a place: a whole number for a closed one. Source: the solid angle of a triangle by
/// van Oosterom and Strackee.
fn winding(mesh: &TriMesh, place: Vec3) -> f64 {
    let place = place.as_dvec3();
    let angle = |i: usize| {
        let t = mesh.triangle(i);
        let [a, b, c] = [t.a, t.b, t.c].map(|v| v.as_dvec3() - place);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let above = DVec3::dot(a, b.cross(c));
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        2.0 * above.atan2(below)
    };
    (0..mesh.triangles.len()).into_par_iter().map(angle).sum::<f64>() / (4.0 * std::f64::consts::PI)
}

/// Up to `n` places inside a closed mesh, with nothing of its surface near them along the axes.
pub(crate) fn places_inside(mesh: &TriMesh, n: usize, seed: u64) -> Vec<Vec3> {
    let bounds = mesh.bounds();
    let extent = bounds.extent();
    let clearance = CLEARANCE * extent.max_element();
    let mut random = Random(seed);
    let mut unit = || random.unit();
    let candidates: Vec<Vec3> = (0..40 * n).map(|_| bounds.min + extent * Vec3::new(unit(), unit(), unit())).collect();
    let is_inside = |place: &Vec3| {
        let around = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        around.iter().all(|&step| winding(mesh, *place + clearance * step).abs() > 0.5)
    };
    candidates.into_iter().filter(is_inside).take(n).collect()
}

fn closed_meshes_are_told_from_open_ones() {
    for kind in [MeshKind::Icosphere, MeshKind::Torus, MeshKind::Cube] {
        let mut mesh = mesh(kind, 300, 1);
        assert!(is_closed(&mesh), "{kind}");
        mesh.triangles[7].swap(0, 1);
        assert!(!is_closed(&mesh), "{kind} with a triangle turned");
        mesh.triangles.remove(7);
        assert!(!is_closed(&mesh), "{kind} with a hole");
    }
}

fn places_inside_a_torus_are_in_its_tube() {
    let torus = mesh(MeshKind::Torus, 4000, 1);
    let [outer, height] = [torus.bounds().max.x, torus.bounds().max.z];
    let places = places_inside(&torus, 50, 5);
    assert_eq!(places.len(), 50);
    for place in places {
        let from_tube = (place.truncate().length() - (outer - height)).hypot(place.z);
        assert!(from_tube < height, "{place}");
    }
    assert!(winding(&torus, Vec3::ZERO).abs() < 1e-9);
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("closed_meshes_are_told_from_open_ones", closed_meshes_are_told_from_open_ones),
        trial("places_inside_a_torus_are_in_its_tube", places_inside_a_torus_are_in_its_tube),
    ]
}
