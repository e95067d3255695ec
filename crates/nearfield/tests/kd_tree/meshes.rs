//! Meshes that kd-trees get wrong, and rays that aim at their weak places.

use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::{KdTree, Ray, TriMesh, Vec3};

use crate::support::Random;

/// A place in the cube from −1 to 1.
pub(crate) fn in_cube(random: &mut Random) -> Vec3 {
    2.0 * Vec3::new(random.unit(), random.unit(), random.unit()) - 1.0
}

fn of_corners(corners: Vec<Vec3>) -> TriMesh {
    let triangles = (0..corners.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    TriMesh::new(corners, triangles).expect("three corners a triangle")
}

/// Long thin triangles across the whole cube.
fn slivers() -> TriMesh {
    let mut random = Random(3);
    let mut corners = Vec::new();
    for _ in 0..120 {
        let (a, b) = (in_cube(&mut random), in_cube(&mut random));
        corners.extend([a, b, b + 1e-4 * in_cube(&mut random)]);
    }
    of_corners(corners)
}

/// A grid of triangles in the plane z = 0, whose edges lie on planes of spatial medians.
fn coplanar_grid() -> TriMesh {
    let mut corners = Vec::new();
    let at = |i: u32, j: u32| Vec3::new(i as f32 / 8.0 - 1.0, j as f32 / 8.0 - 1.0, 0.0);
    for (i, j) in (0..16).flat_map(|i| (0..16).map(move |j| (i, j))) {
        corners.extend([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
    }
    of_corners(corners)
}

fn nested_shells() -> TriMesh {
    let sphere = mesh(MeshKind::Icosphere, 80, 0);
    let mut corners = Vec::new();
    for shell in 1..=6 {
        let scale = shell as f32 / 6.0;
        corners.extend(sphere.triangles.iter().flatten().map(|&v| scale * sphere.vertices[v as usize]));
    }
    of_corners(corners)
}

/// Triangles that all lie upon each other, twice over, so that no cut parts them.
fn stacked() -> TriMesh {
    let corners = [Vec3::ZERO, Vec3::new(1.0, 0.2, 0.1), Vec3::new(0.3, 1.0, -0.4)];
    of_corners((0..60).flat_map(|_| corners).collect())
}

fn moved(mesh: &TriMesh, scale: f32, shift: f32) -> TriMesh {
    TriMesh { vertices: mesh.vertices.iter().map(|&v| scale * v + shift).collect(), ..mesh.clone() }
}

/// Every mesh with its name.
pub(crate) fn meshes() -> Vec<(&'static str, TriMesh)> {
    let sphere = mesh(MeshKind::Icosphere, 500, 0);
    let line = |k: f32| Vec3::new(k, 2.0 * k, 0.5 * k);
    let some_flat = {
        let mut corners: Vec<Vec3> = (0..30).map(|i| line(i as f32 / 30.0)).collect();
        corners.extend(mesh(MeshKind::Soup, 20, 1).vertices);
        of_corners(corners)
    };
    vec![
        ("icosphere", sphere.clone()),
        ("soup", mesh(MeshKind::Soup, 400, 2)),
        ("slivers", slivers()),
        ("coplanar grid", coplanar_grid()),
        ("nested shells", nested_shells()),
        ("stacked", stacked()),
        ("one triangle", of_corners(vec![Vec3::ZERO, Vec3::X, Vec3::new(0.2, 0.7, 0.1)])),
        ("all degenerate", of_corners((0..30).map(|i| line(i as f32)).collect())),
        ("some degenerate", some_flat),
        ("one point", of_corners(vec![Vec3::ONE; 6])),
        ("tiny", moved(&sphere, 1e-6, 0.0)),
        ("huge", moved(&sphere, 1e6, 0.0)),
        ("far off", moved(&sphere, 1.0, 1e6)),
    ]
}

/// Rays through and around a mesh: from everywhere, along axes, at corners and edges, from surfaces, in the tree's planes.
pub(crate) fn rays(mesh: &TriMesh, tree: &KdTree, n: usize) -> Vec<Ray> {
    let mut random = Random(11);
    let bounds = mesh.bounds();
    let (center, half) = (bounds.center(), (0.5 * bounds.extent()).max(Vec3::splat(1e-30)));
    let reach = half.max_element();
    let axes = [Vec3::X, Vec3::Y, Vec3::Z];
    let inner: Vec<_> = tree.nodes().iter().filter(|node| !node.is_leaf()).collect();
    (0..n)
        .map(|i| {
            let triangle = mesh.triangle(random.below(mesh.triangles.len() as u32) as usize);
            let corners = [triangle.a, triangle.b, triangle.c];
            let place = center + 1.5 * reach * in_cube(&mut random);
            let mut direction = in_cube(&mut random);
            let mut axis = axes[random.below(3) as usize];
            if random.below(2) == 0 {
                axis = -axis;
            }
            let share = random.unit();
            let (corner, next) = (corners[i % 3], corners[(i + 1) % 3]);
            let on_edge = corner + share * (next - corner);
            if direction.length() == 0.0 {
                direction = Vec3::X;
            }
            let mut ray = match i % 10 {
                0 => Ray::new(place, direction),
                1 => Ray::new(corner - 3.0 * reach * axis, axis),
                2 => Ray::new(place, corner - place),
                3 => Ray::new(place, on_edge - place),
                4 => Ray::new(on_edge, direction),
                5 => Ray::new(triangle.centroid(), axis),
                6 => Ray::new(center + 40.0 * reach * direction, -direction),
                7 if !inner.is_empty() => {
                    // In a plane of the tree, along it or not.
                    let node = inner[random.below(inner.len() as u32) as usize];
                    let mut from = place;
                    from[node.axis()] = node.split;
                    if random.below(2) == 0 {
                        direction[node.axis()] = if random.below(2) == 0 { 0.0 } else { -0.0 };
                    }
                    Ray::new(from, direction)
                }
                8 if !tree.leaves().is_empty() => {
                    // Through corners of two leaves.
                    let leaves = tree.leaves();
                    let (a, b) = (
                        leaves[random.below(leaves.len() as u32) as usize],
                        leaves[random.below(leaves.len() as u32) as usize],
                    );
                    Ray::new(a.min, b.max - a.min)
                }
                _ => Ray::new(corner, next - corner),
            };
            if ray.fault().is_some() {
                ray.direction = Vec3::new(0.3, -1.0, 0.2);
            }
            match random.below(8) {
                0 => ray.t_min = -1.0,
                1 => ray.t_max = random.unit(),
                2 => (ray.t_min, ray.t_max) = (-f32::INFINITY, f32::INFINITY),
                _ => {}
            }
            ray
        })
        .collect()
}
