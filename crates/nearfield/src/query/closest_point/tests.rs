//! Closest points of the hierarchy against those of the loop over all triangles.

use glam::{DVec3, Vec3};

use super::*;
use crate::geometry::TriMesh;
use crate::geometry::generate::{MeshKind, mesh};
use crate::{BruteForceMesh, BvhSettings, TriangleBvh};

fn places(n: u32, around: DVec3, reach: f64) -> impl Iterator<Item = DVec3> {
    (0..n).map(move |i| {
        let at = |prime: u32| f64::from(i * prime % 1009) / 1009.0 * 2.0 - 1.0;
        around + reach * DVec3::new(at(127), at(311), at(733))
    })
}

#[test]
fn closest_points_are_those_of_brute_force() {
    for (kind, n) in [(MeshKind::Torus, 2000), (MeshKind::Soup, 1500), (MeshKind::Cube, 12), (MeshKind::Icosphere, 320)]
    {
        let mesh = mesh(kind, n, 3);
        let (bvh, loops) =
            (TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap(), BruteForceMesh::build(&mesh).unwrap());
        let bounds = mesh.bounds();
        let reach = f64::from(bounds.diagonal());
        for (place, radius) in
            places(400, bounds.center().as_dvec3(), reach).zip([f64::INFINITY, 0.1 * reach, 0.5 * reach].iter().cycle())
        {
            assert_eq!(bvh.closest_point(place, *radius), loops.closest_point(place, *radius), "{kind:?} at {place}");
        }
    }
}

#[test]
fn distances_from_a_far_mesh_keep_their_digits() {
    let corner = Vec3::new(1e6, -2e6, 5e5);
    let vertices = vec![corner, corner + Vec3::X, corner + Vec3::Y];
    let mesh = TriMesh::new(vertices, vec![[0, 1, 2]]).unwrap();
    let bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
    let place = corner.as_dvec3() + DVec3::new(0.25, 0.25, 1e-4);
    let found = bvh.closest_point(place, 1.0).unwrap();
    assert!((found.dist2.sqrt() - 1e-4).abs() < 1e-9, "{}", found.dist2.sqrt());
}

#[test]
fn the_radius_is_inside_and_equal_distances_go_to_the_lowest_triangle() {
    let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::X, Vec3::Y, Vec3::ZERO, Vec3::ONE];
    // One without an area, and one twice.
    let mesh = TriMesh::new(vertices, vec![[0, 0, 1], [0, 1, 2], [5, 3, 4]]).unwrap();
    let bvh = TriangleBvh::build(&mesh, &BvhSettings::default()).unwrap();
    let found = bvh.closest_point(DVec3::new(0.25, 0.25, 2.0), 2.0).unwrap();
    assert_eq!((found.triangle, found.dist2, found.point), (1, 4.0, DVec3::new(0.25, 0.25, 0.0)));
    for (place, radius) in [(DVec3::Z * 2.0, 1.999), (DVec3::NAN, 1.0), (DVec3::Z, f64::NAN), (DVec3::Z, -1.0)] {
        assert_eq!(bvh.closest_point(place, radius), None);
    }
}
