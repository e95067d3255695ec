//! Distance fields of meshes: against a loop over all triangles, against true surfaces, and the signs of closed and of
//! broken meshes.

use nearfield::application::{DistanceSettings, MeshDistance, SignRule, Watch, grid_around};
use nearfield::geometry::RegularGrid;
use nearfield::geometry::generate::{MeshKind, mesh};
use nearfield::query::ClosestPointSearch;
use nearfield::{BruteForceMesh, DVec3, Error, TriMesh, Vec3};

use crate::support::Random;

fn grid(mesh: &TriMesh, resolution: u32) -> RegularGrid {
    grid_around(mesh.origin, &mesh.bounds(), resolution, 4.0).unwrap()
}

#[test]
fn nodes_have_the_closest_triangle_of_a_loop_over_all() {
    for (kind, n, band) in
        [(MeshKind::Torus, 1500, 3.0), (MeshKind::Icosphere, 320, f64::INFINITY), (MeshKind::Soup, 200, 4.0)]
    {
        let mesh = mesh(kind, n, 2);
        let (distance, loops) = (MeshDistance::new(&mesh).unwrap(), BruteForceMesh::build(&mesh).unwrap());
        let (grid, settings) = (grid(&mesh, 41), DistanceSettings::default().band(band));
        let field = distance.distance_field(&grid, &settings, &mut Watch::none()).unwrap();
        let mut random = Random(5);
        for _ in 0..3000 {
            let number = random.below(grid.n_nodes() as u32) as usize;
            let node = grid.node(number).unwrap();
            let place = DVec3::from_array([0, 1, 2].map(|axis| grid.coordinate(axis, node[axis])));
            let value = field.distances.values()[number];
            match loops.closest_point(place, settings.radius(&grid)) {
                Some(closest) => {
                    assert_eq!(field.nearest[number], closest.triangle, "{kind:?} {node:?}");
                    assert_eq!(value.abs(), closest.dist2.sqrt() as f32);
                }
                None => assert!(value.is_nan(), "{kind:?} {node:?}"),
            }
        }
    }
}

#[test]
fn both_signs_are_right_everywhere_around_a_closed_mesh() {
    let cube = mesh(MeshKind::Cube, 12, 0);
    let distance = MeshDistance::new(&cube).unwrap();
    assert!(distance.closure().is_closed());
    assert_eq!(distance.usual_sign(), SignRule::Pseudonormal);
    let (low, high) = (cube.bounds().min.as_dvec3(), cube.bounds().max.as_dvec3());
    // The distance from a box, in closed form.
    let truth = |p: DVec3| {
        let beyond = (low - p).max(p - high);
        beyond.max(DVec3::ZERO).length() + beyond.max_element().min(0.0)
    };
    for sign in [SignRule::Pseudonormal, SignRule::WindingNumber] {
        let settings = DistanceSettings::default().band(f64::INFINITY).sign(sign);
        let field = distance.distance_field(&grid(&cube, 34), &settings, &mut Watch::none()).unwrap();
        let grid = field.distances.grid();
        let width = f64::from(grid.spacing());
        for number in 0..grid.n_nodes() {
            let node = grid.node(number).unwrap();
            let place = DVec3::from_array([0, 1, 2].map(|axis| grid.coordinate(axis, node[axis])));
            let (value, truth) = (f64::from(field.distances.values()[number]), truth(place));
            // A node on the surface has either sign.
            assert!(
                (value - truth).abs() < 1e-6 * width.max(1.0) || truth.abs() < 1e-6,
                "{sign}: {value}, {truth} at {place}"
            );
        }
    }
}

#[test]
fn corners_that_are_stored_three_times_are_one() {
    let cube = mesh(MeshKind::Cube, 12, 0);
    let vertices: Vec<Vec3> = cube.triangles.iter().flatten().map(|&i| cube.vertices[i as usize]).collect();
    let triangles = (0..cube.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let soup = TriMesh { origin: cube.origin, ..TriMesh::new(vertices, triangles).unwrap() };
    let distance = MeshDistance::new(&soup).unwrap();
    assert!(distance.closure().is_closed(), "{:?}", distance.closure());
    let beyond = cube.bounds().max.as_dvec3() + DVec3::new(0.1, 0.2, 0.3);
    let (value, _) = distance.signed_distance(beyond, 9.0).unwrap();
    assert!((value - DVec3::new(0.1, 0.2, 0.3).length()).abs() < 1e-6);
}

#[test]
fn broken_meshes_are_told_and_signed_by_winding_number() {
    let mut open = mesh(MeshKind::Icosphere, 1280, 0);
    open.triangles.truncate(open.triangles.len() - 1);
    let distance = MeshDistance::new(&open).unwrap();
    assert_eq!((distance.closure().border_edges, distance.closure().is_closed()), (3, false));
    assert_eq!(distance.usual_sign(), SignRule::WindingNumber);
    let center = open.bounds().center();
    let settings = DistanceSettings::default().band(f64::INFINITY);
    let field = distance.distance_field(&grid(&open, 21), &settings, &mut Watch::none()).unwrap();
    assert!(field.distances.sample(center) < 0.0);
    let mut turned = mesh(MeshKind::Icosphere, 80, 0);
    turned.triangles[0].swap(0, 1);
    assert_eq!(MeshDistance::new(&turned).unwrap().closure().turned_edges, 3);
    let mut twice = mesh(MeshKind::Icosphere, 80, 0);
    twice.triangles.push(twice.triangles[0]);
    assert_eq!(MeshDistance::new(&twice).unwrap().closure().crowded_edges, 3);
}

#[test]
fn what_a_mesh_has_not_is_refused() {
    let cube = mesh(MeshKind::Cube, 12, 0);
    let distance = MeshDistance::new(&cube).unwrap();
    let of =
        |settings: DistanceSettings, grid: &RegularGrid| distance.distance_field(grid, &settings, &mut Watch::none());
    let settings = DistanceSettings::default();
    let error = of(settings.sign(SignRule::Normal), &grid(&cube, 21)).unwrap_err().to_string();
    assert!(error.contains("pseudonormal or winding-number"), "{error}");
    let away = RegularGrid::new(DVec3::ZERO, Vec3::splat(500.0), 0.1, [9; 3]).unwrap();
    let error = of(settings, &away).unwrap_err().to_string();
    assert!(error.contains("none of 12 triangles"), "{error}");
    assert!(matches!(of(settings.max_bytes(7), &away), Err(Error::OutOfMemory { .. })));
    assert!(matches!(MeshDistance::new(&TriMesh::default()), Err(Error::NoTriangles { .. })));
}
