//! Winding numbers against closed forms and the sum over all elements.

use super::*;
use crate::application::Watch;
use crate::geometry::vector::{Vector, norm, scale};
use crate::structure::{AabbTreeN, AabbTreeNSettings};
use crate::{Error, Scalar};

/// Points of a sphere by Fibonacci's lattice, which are their own normals.
fn sphere<T: Scalar>(n: usize) -> Vec<Vector<T>> {
    let point = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / n as f64;
        let angle = i as f64 * (5f64.sqrt() - 1.0) * std::f64::consts::PI;
        let ring = (1.0 - z * z).sqrt();
        [T::of(ring * libm::cos(angle)), T::of(ring * libm::sin(angle)), T::of(z)]
    };
    (0..n).map(point).collect()
}

fn queries<T: Scalar>(n: u32) -> Vec<Vector<T>> {
    let at = |i: u32, prime: u32| T::of(f64::from(i * prime % 1009) / 1009.0 * 3.0 - 1.5);
    (0..n).map(|i| [at(i, 127), at(i, 311), at(i, 733)]).collect()
}

fn spheres_are_inside_and_outside<T: Scalar>(most: f64) {
    let points = sphere::<T>(20_000);
    let areas = vec![T::of(4.0 * std::f64::consts::PI / 20_000.0); points.len()];
    let winding = WindingNumber::of_points(&points, &points, &areas).unwrap();
    assert_eq!(winding.len(), 20_000);
    for query in queries::<T>(500) {
        let distance = norm(query).to_f64() - 1.0;
        let number = winding.at(query).to_f64();
        let off = (number - winding.at_by_brute_force(query).to_f64()).abs();
        assert!(off < if distance.abs() > 0.05 { most } else { 5.0 * most }, "{query:?}: {off}");
        if distance.abs() > 0.05 {
            let expected = if distance < 0.0 { 1.0 } else { 0.0 };
            assert!((number - expected).abs() < 1e-2, "{number} at {distance} of the sphere");
        }
    }
}

#[test]
fn a_sphere_of_samples_is_that_of_the_sum_in_f64() {
    spheres_are_inside_and_outside::<f64>(1e-2);
}

#[test]
fn a_sphere_of_samples_is_that_of_the_sum_in_f32() {
    spheres_are_inside_and_outside::<f32>(1e-2);
}

/// A grid of triangles over a cube, outwards; without its lid where it is open.
fn cube(steps: u32, open: bool) -> (Vec<Vector<f64>>, Vec<[u32; 3]>) {
    let (mut vertices, mut triangles) = (vec![], vec![]);
    for side in 0..if open { 5 } else { 6u32 } {
        let (axis, top) = (side as usize / 2, side % 2 == 1);
        let first = vertices.len() as u32;
        for j in 0..=steps {
            for i in 0..=steps {
                let mut vertex = [0.0; 3];
                vertex[axis] = f64::from(u8::from(top));
                vertex[(axis + 1) % 3] = f64::from(i) / f64::from(steps);
                vertex[(axis + 2) % 3] = f64::from(j) / f64::from(steps);
                vertices.push(vertex);
            }
        }
        for (i, j) in (0..steps).flat_map(|j| (0..steps).map(move |i| (i, j))) {
            let a = first + j * (steps + 1) + i;
            let quad = [a, a + 1, a + steps + 2, a + steps + 1];
            let turned = if top { quad } else { [quad[0], quad[3], quad[2], quad[1]] };
            triangles.push([turned[0], turned[1], turned[2]]);
            triangles.push([turned[0], turned[2], turned[3]]);
        }
    }
    (vertices, triangles)
}

#[test]
fn closed_meshes_have_whole_numbers_also_near_faces_and_corners() {
    let (vertices, triangles) = cube(12, false);
    let winding = WindingNumber::of_triangles(&vertices, &triangles).unwrap();
    for query in queries::<f64>(800) {
        let expected = if query.iter().all(|x| (0.0..1.0).contains(x)) { 1.0 } else { 0.0 };
        assert!((winding.at_by_brute_force(query) - expected).abs() < 1e-12, "{query:?}");
        assert!((winding.at(query) - expected).abs() < 1e-2, "{query:?}: {}", winding.at(query));
    }
    for gap in [1e-3, 1e-6, 1e-9] {
        assert!(winding.is_inside([gap, gap, gap]) && !winding.is_inside([-gap, 0.5, 0.5]));
    }
}

#[test]
fn an_open_mesh_fades_at_its_hole() {
    let (vertices, triangles) = cube(12, true);
    let winding = WindingNumber::of_triangles(&vertices, &triangles).unwrap();
    // The solid angle of the missing lid, seen from the middle, is a sixth of all.
    assert!((winding.at([0.5, 0.5, 0.5]) - 5.0 / 6.0).abs() < 1e-2);
    assert!((winding.at([0.5, 0.5, 1.0]) - 0.5).abs() < 1e-2);
}

#[test]
fn places_and_units_far_away_change_nothing() {
    let points = sphere::<f64>(3000);
    let (shift, factor) = ([3e5, -7e5, 1e5], 1e-4);
    let moved: Vec<Vector<f64>> =
        points.iter().map(|p| std::array::from_fn(|axis| p[axis] * factor + shift[axis])).collect();
    let areas = |factor: f64| vec![factor * factor * 4.0 * std::f64::consts::PI / 3000.0; 3000];
    let here = WindingNumber::of_points(&points, &points, &areas(1.0)).unwrap();
    let there = WindingNumber::of_points(&moved, &points, &areas(factor)).unwrap();
    for query in queries::<f64>(100) {
        let query_there = std::array::from_fn(|axis| query[axis] * factor + shift[axis]);
        assert!((here.at(query) - there.at(query_there)).abs() < 1e-2, "{query:?}");
    }
}

#[test]
fn estimated_areas_sum_to_that_of_the_surface() {
    let points = sphere::<f64>(5000);
    let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
    let areas = disk_areas(&tree);
    let (sum, expected) = (areas.iter().sum::<f64>(), 4.0 * std::f64::consts::PI);
    assert!((sum / expected - 1.0).abs() < 0.12, "{sum}");
    let one = AabbTreeN::build(&[[1.0f32, 2.0, 3.0]], &AabbTreeNSettings::default()).unwrap();
    assert_eq!(disk_areas(&one), [0.0]);
    let none: [Vector<f32>; 0] = [];
    assert!(disk_areas(&AabbTreeN::build(&none, &AabbTreeNSettings::default()).unwrap()).is_empty());
}

#[test]
fn samples_without_direction_or_area_add_nothing() {
    let points = [[0.0f32, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 0.0]];
    let normals = [[0.0f32, 0.0, 5.0], [0.0; 3], [1.0, 0.0, 0.0]];
    let winding = WindingNumber::of_points(&points, &normals, &[0.5, 0.5, 0.0]).unwrap();
    let expected = 0.5 / (4.0 * std::f32::consts::PI);
    assert!((winding.at([0.0; 3]) - expected).abs() < 1e-6);
    assert!(winding.at([0.0, 0.0, 1.0]).is_finite() && winding.at([f32::NAN; 3]).is_nan());
    let nothing = WindingNumber::<f32>::of_points(&[], &[], &[]).unwrap();
    assert_eq!((nothing.at([0.0; 3]), nothing.is_empty()), (0.0, true));
    assert_eq!(WindingNumber::<f64>::of_triangles(&[], &[]).unwrap().at([0.0; 3]), 0.0);
    let same = [[0.5f64; 3]; 30];
    assert!(WindingNumber::of_points(&same, &[[0.0, 0.0, 1.0]; 30], &[1.0; 30]).unwrap().at([0.5; 3]).is_finite());
}

#[test]
fn wrong_input_is_an_error() {
    let points = [[0.0f64; 3]; 2];
    let of = |normals: &[Vector<f64>], areas: &[f64]| WindingNumber::of_points(&points, normals, areas);
    assert!(matches!(of(&points[..1], &[1.0; 2]), Err(Error::LengthMismatch { what: "the normals", .. })));
    assert!(matches!(of(&points, &[1.0; 3]), Err(Error::LengthMismatch { what: "the areas", .. })));
    assert!(matches!(of(&[[0.0; 3], [f64::NAN; 3]], &[1.0; 2]), Err(Error::NonFinite { first: 1, count: 1, .. })));
    assert!(matches!(of(&points, &[1.0, -1.0]), Err(Error::InvalidSetting { .. })));
    assert!(matches!(WindingNumber::of_triangles(&points, &[[0, 1, 2]]), Err(Error::TooMany { found: 2, .. })));
}

#[test]
fn many_places_are_those_one_by_one_and_can_be_interrupted() {
    let points = sphere::<f64>(500);
    let winding = WindingNumber::of_points(&points, &points, &vec![0.025; 500]).unwrap();
    let places: Vec<Vector<f64>> = queries(1009).iter().cycle().take(70_000).map(|q| scale(*q, 0.9)).collect();
    let numbers = winding.at_each(&places, &mut Watch::none()).unwrap();
    assert!(numbers.iter().zip(&places).step_by(777).all(|(&number, &place)| number == winding.at(place)));
    let mut stop = |progress: crate::application::Progress| {
        if progress.done > 0 { std::ops::ControlFlow::Break(()) } else { std::ops::ControlFlow::Continue(()) }
    };
    let ended = winding.at_each(&places, &mut Watch::new(&mut stop));
    assert!(matches!(ended, Err(Error::Interrupted { done: 65_536, total: 70_000, .. })));
}
