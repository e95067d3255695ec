//! Distance fields against loops over all samples and against true surfaces.

use glam::{DVec3, Vec3};

use super::*;
use crate::application::{Progress, Watch};
use crate::geometry::vector::{Vector, dot, norm, norm2, subtract};
use crate::geometry::{Aabb, RegularGrid, Scalar};
use crate::structure::aabb_tree::any_dimension::dist2;
use crate::{Error, Result};

/// Major and minor radius of the torus.
const TORUS: [f64; 2] = [1.0, 0.4];

/// Numbers of a SplitMix64 sequence, from 0 to below 1.
pub(super) fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Samples of the torus, uniform by area, and their normals.
fn torus<T: Scalar>(n: usize, seed: u64) -> (Vec<Vector<T>>, Vec<Vector<T>>) {
    let mut unit = random(seed);
    let (mut points, mut normals) = (Vec::with_capacity(n), Vec::with_capacity(n));
    while points.len() < n {
        let [u, v, keep] = [0; 3].map(|_| unit());
        let [u, v] = [u, v].map(|x| 2.0 * std::f64::consts::PI * x);
        let ring = TORUS[0] + TORUS[1] * libm::cos(v);
        if keep * (TORUS[0] + TORUS[1]) <= ring {
            points.push([ring * libm::cos(u), ring * libm::sin(u), TORUS[1] * libm::sin(v)].map(T::of));
            normals.push([libm::cos(v) * libm::cos(u), libm::cos(v) * libm::sin(u), libm::sin(v)].map(T::of));
        }
    }
    (points, normals)
}

fn torus_distance([x, y, z]: Vector<f64>) -> f64 {
    let ring = (x * x + y * y).sqrt() - TORUS[0];
    (ring * ring + z * z).sqrt() - TORUS[1]
}

fn torus_grid(resolution: u32, band: f64) -> RegularGrid {
    let reach = (TORUS[0] + TORUS[1]) as f32;
    let corner = Vec3::new(reach, reach, TORUS[1] as f32);
    grid_around(DVec3::ZERO, &Aabb::new(-corner, corner), resolution, band).unwrap()
}

/// How far from 0 the true distance is where the field changes its sign along the edges of the grid, in widths: root of the
/// mean square, and the largest.
fn zero_crossings(field: &DistanceField, truth: impl Fn(Vector<f64>) -> f64) -> [f64; 2] {
    let grid = *field.distances.grid();
    let (mut sum, mut largest, mut n) = (0.0, 0.0f64, 0u32);
    for number in 0..grid.n_nodes() {
        let node = grid.node(number).unwrap();
        let here = f64::from(field.distances.value(node));
        for axis in 0..3 {
            let mut beside = node;
            beside[axis] += 1;
            let there = f64::from(field.distances.value(beside));
            if here * there < 0.0 {
                let t = here / (here - there);
                let mut at = grid.position(node).as_dvec3().to_array();
                at[axis] += t * f64::from(grid.spacing());
                let off = truth(at).abs() / f64::from(grid.spacing());
                (sum, largest, n) = (sum + off * off, largest.max(off), n + 1);
            }
        }
    }
    assert!(n > 1000, "{n} crossings");
    [(sum / f64::from(n)).sqrt(), largest]
}

fn field_of<T: Scalar>(n: usize, resolution: u32, settings: &DistanceSettings) -> DistanceField {
    let (points, normals) = torus::<T>(n, 5);
    let samples = OrientedSamples::new(&points, &normals).unwrap();
    samples.distance_field(&torus_grid(resolution, 4.0), settings, &mut Watch::none()).unwrap()
}

/// The paper's formula at a node, over all samples.
fn by_brute_force<T: Scalar>(points: &[Vector<T>], query: &Vector<T>, radius: T) -> Option<u32> {
    let all = points.iter().zip(0..).map(|(p, i)| (dist2(query, p), i));
    let nearest = all.min_by(|a, b| a.0.compare(b.0).then(a.1.cmp(&b.1)))?;
    (nearest.0 <= radius * radius).then_some(nearest.1)
}

fn nodes_are_those_of_brute_force<T: Scalar>(band: f64) {
    let (points, normals) = torus::<T>(2000, 11);
    let samples = OrientedSamples::new(&points, &normals).unwrap();
    let grid = torus_grid(61, 4.0);
    let settings = DistanceSettings::default().mode(DistanceMode::Nearest).band(band);
    let field = samples.distance_field(&grid, &settings, &mut Watch::none()).unwrap();
    let radius = T::of(settings.radius(&grid).min(1e9));
    let mut unit = random(3);
    let mut defined = 0;
    for _ in 0..20_000 {
        let number = (unit() * grid.n_nodes() as f64) as usize;
        let node = grid.node(number).unwrap();
        let query = [0, 1, 2].map(|axis| T::of(grid.coordinate(axis, node[axis])));
        let expected = by_brute_force(&points, &query, radius);
        assert_eq!(field.nearest[number], expected.unwrap_or(DistanceField::NONE), "{node:?}");
        let value = field.distances.values()[number];
        assert_eq!(value.is_nan(), expected.is_none());
        if let Some(index) = expected {
            let (point, normal) = (points[index as usize], normals[index as usize]);
            let offset = subtract(query, point);
            let sign = if dot(offset, normal) >= T::ZERO { 1.0 } else { -1.0 };
            assert_eq!(value, (sign * norm2(offset).sqrt().to_f64()) as f32, "{node:?}");
            defined += 1;
        }
    }
    assert!(defined > 3000);
}

#[test]
fn narrow_bands_are_those_of_brute_force_in_f32() {
    nodes_are_those_of_brute_force::<f32>(4.0);
}

#[test]
fn narrow_bands_are_those_of_brute_force_in_f64() {
    nodes_are_those_of_brute_force::<f64>(2.5);
}

#[test]
fn wide_bands_are_those_of_brute_force() {
    nodes_are_those_of_brute_force::<f32>(f64::INFINITY);
    nodes_are_those_of_brute_force::<f64>(17.0);
}

#[test]
fn the_boundary_of_the_band_is_inside_and_ties_go_to_the_smallest_index() {
    let points = [[2.0f32, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
    let samples = OrientedSamples::new(&points, &[[1.0f32, 0.0, 0.0]; 3]).unwrap();
    let grid = RegularGrid::new(DVec3::ZERO, Vec3::new(-2.0, 0.0, 0.0), 1.0, [8, 2, 2]).unwrap();
    let settings = DistanceSettings::default().mode(DistanceMode::Nearest).band(2.0);
    let field = samples.distance_field(&grid, &settings, &mut Watch::none()).unwrap();
    let none = DistanceField::NONE;
    assert_eq!(field.nearest[..8], [1, 1, 1, 0, 0, 0, 0, none]);
    assert_eq!(field.distances.values()[..7], [-2.0, -1.0, 0.0, -1.0, 0.0, 1.0, 2.0]);
    assert!(field.distances.value([7, 0, 0]).is_nan());
}

#[test]
fn planes_cross_zero_within_a_four_hundredth_of_a_width() {
    let [rms, largest] = zero_crossings(&field_of::<f32>(100_000, 129, &DistanceSettings::default()), torus_distance);
    println!("plane, 100k samples, 129³: {rms:.5} (at most {largest:.4})");
    assert!(rms <= 0.0025 && largest < 0.03, "{rms} {largest}");
}

#[test]
fn means_cross_zero_near_the_surface_and_the_papers_formula_does_not() {
    let crossing = |mode, smoothing: f64| {
        let settings = DistanceSettings::default().mode(mode).smoothing(smoothing);
        let [rms, largest] = zero_crossings(&field_of::<f64>(25_000, 65, &settings), torus_distance);
        println!("{mode}, σ = {smoothing}, 25k samples, 65³: {rms:.5} (at most {largest:.4})");
        rms
    };
    assert!(crossing(DistanceMode::Plane, 1.0) <= 0.006);
    assert!(crossing(DistanceMode::Imls, 1.0) <= 0.02);
    assert!(crossing(DistanceMode::Apss, 1.0) <= 0.006);
    assert!(crossing(DistanceMode::Nearest, 1.0) > 0.05);
}

#[test]
fn far_values_are_distances_too() {
    let settings = DistanceSettings::default().band(f64::INFINITY);
    for mode in [DistanceMode::Plane, DistanceMode::Imls, DistanceMode::Apss] {
        let field = field_of::<f64>(20_000, 33, &settings.mode(mode));
        let grid = *field.distances.grid();
        let (mut sum, mut wrong) = (0.0, 0);
        for number in 0..grid.n_nodes() {
            let position = grid.position(grid.node(number).unwrap()).as_dvec3().to_array();
            let (truth, value) = (torus_distance(position), f64::from(field.distances.values()[number]));
            sum += (truth - value).powi(2);
            wrong += usize::from(truth * value < 0.0);
        }
        let rms = (sum / grid.n_nodes() as f64).sqrt() / f64::from(grid.spacing());
        println!("{mode} in all of 33³: {rms:.4} widths, {wrong} wrong signs");
        assert!(rms < 0.05 && wrong < 20, "{mode}: {rms} {wrong}");
    }
}

#[test]
fn spheres_fitted_to_noise_are_nearer_than_planes() {
    let (mut points, normals) = torus::<f64>(30_000, 9);
    let mut unit = random(1);
    for point in &mut points {
        // Sums of uniform numbers: noise of half a spacing.
        let noise: Vector<f64> = std::array::from_fn(|_| (0..6).map(|_| unit() - 0.5).sum::<f64>() * 0.016);
        *point = [0, 1, 2].map(|axis| point[axis] + noise[axis]);
    }
    let samples = OrientedSamples::new(&points, &normals).unwrap();
    let crossing = |mode| {
        let settings = DistanceSettings::default().mode(mode).smoothing(2.5);
        let field = samples.distance_field(&torus_grid(65, 4.0), &settings, &mut Watch::none()).unwrap();
        zero_crossings(&field, torus_distance)[0]
    };
    let [plane, imls, apss] = [DistanceMode::Plane, DistanceMode::Imls, DistanceMode::Apss].map(crossing);
    println!("noise: plane {plane:.4}, imls {imls:.4}, apss {apss:.4} widths");
    assert!(apss < 0.5 * plane && imls < 0.7 * plane);
}

#[test]
fn spheres_seen_from_afar_are_the_same_in_f32() {
    // Many samples, so that those around the nearest are near each other and far from the node.
    let settings = DistanceSettings::default().mode(DistanceMode::Apss).band(f64::INFINITY);
    let (fine, wide) = (field_of::<f32>(60_000, 25, &settings), field_of::<f64>(60_000, 25, &settings));
    let width = f64::from(fine.distances.grid().spacing());
    let pairs = fine.distances.values().iter().zip(wide.distances.values()).zip(fine.nearest.iter().zip(&wide.nearest));
    let same: Vec<f64> =
        pairs.filter(|(_, (a, b))| a == b).map(|((&a, &b), _)| (f64::from(a) - f64::from(b)).abs() / width).collect();
    let off = same.iter().filter(|off| **off > 1e-3).count();
    assert!(same.len() > 5_000 && off <= same.len() / 1000, "{off} of {}", same.len());
}

#[test]
fn winding_numbers_give_no_wrong_sign_away_from_the_surface() {
    let settings = DistanceSettings::default().sign(SignRule::WindingNumber);
    let field = field_of::<f32>(25_000, 65, &settings);
    let (grid, mut wrong) = (*field.distances.grid(), 0);
    for number in 0..grid.n_nodes() {
        let value = field.distances.values()[number];
        let truth = torus_distance(grid.position(grid.node(number).unwrap()).as_dvec3().to_array());
        wrong += usize::from(
            !value.is_nan() && truth * f64::from(value) < 0.0 && truth.abs() > 0.1 * f64::from(grid.spacing()),
        );
    }
    assert_eq!(wrong, 0);
}

/// A plate without samples at its sides: beside it, the nearest normal says inside.
#[test]
fn winding_numbers_see_thin_walls_where_normals_do_not() {
    let (mut points, mut normals) = (vec![], vec![]);
    for side in [1.0f64, -1.0] {
        for i in 0..10_000 {
            let at = |i: i32| f64::from(i) / 99.0;
            points.push([at(i % 100), at(i / 100), 0.01 * side]);
            normals.push([0.0, 0.0, side]);
        }
    }
    let samples = OrientedSamples::new(&points, &normals).unwrap();
    let grid = RegularGrid::new(DVec3::ZERO, Vec3::new(0.45, 0.45, -0.1), 0.01, [66, 11, 21]).unwrap();
    let at = |sign, place: Vec3| {
        let settings = DistanceSettings::default().sign(sign).band(8.0);
        samples.distance_field(&grid, &settings, &mut Watch::none()).unwrap().distances.sample(place)
    };
    let [inside, above, beside] = [Vec3::new(0.5, 0.5, 0.0), Vec3::new(0.5, 0.5, 0.04), Vec3::new(1.05, 0.5, 0.0)];
    for sign in [SignRule::Normal, SignRule::WindingNumber] {
        assert!(at(sign, inside) < 0.0 && at(sign, above) > 0.0, "{sign}");
    }
    assert!(at(SignRule::Normal, beside) < 0.0 && at(SignRule::WindingNumber, beside) > 0.0);
}

#[test]
fn a_place_alone_has_the_value_of_the_field() {
    let (points, normals) = torus::<f64>(3000, 5);
    let samples = OrientedSamples::new(&points, &normals).unwrap();
    let (distance, index) = samples.distance(&[1.5, 0.0, 0.0], 1.0, DistanceMode::Plane, 1.0).unwrap();
    assert!((distance - 0.1).abs() < 1e-2);
    assert_eq!(Some(index), by_brute_force(&points, &[1.5, 0.0, 0.0], 1.0));
    assert!(samples.distance(&[9.0, 0.0, 0.0], 1.0, DistanceMode::Plane, 1.0).is_none());
    let area = 4.0 * std::f64::consts::PI.powi(2) * TORUS[0] * TORUS[1];
    let spacing = samples.spacing();
    assert!((spacing / (area / 3000.0).sqrt() - 1.0).abs() < 0.1, "{spacing}");
}

#[test]
fn the_same_bytes_from_any_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| field_of::<f32>(3000, 40, &DistanceSettings::default().mode(DistanceMode::Apss)))
    };
    let (one, three) = (run(1), run(3));
    let bits = |field: &DistanceField| field.distances.values().iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
    assert_eq!((bits(&one), one.nearest), (bits(&three), three.nearest));
}

fn refused(result: Result<DistanceField>) -> Error {
    result.expect_err("this should be refused")
}

#[test]
fn what_cannot_be_computed_says_why() {
    let (points, normals) = torus::<f32>(100, 5);
    let samples = OrientedSamples::new(&points, &normals).unwrap();
    let grid = torus_grid(33, 4.0);
    let of = |settings: DistanceSettings| samples.distance_field(&grid, &settings, &mut Watch::none());
    let settings = DistanceSettings::default();
    let error = refused(of(settings.max_bytes(1000)));
    assert!(matches!(error, Error::OutOfMemory { available: 1000, .. }), "{error}");
    for wrong in [settings.band(0.0), settings.band(f64::NAN), settings.smoothing(0.0)] {
        assert!(matches!(refused(of(wrong)), Error::InvalidSetting { .. }));
    }
    assert!(refused(of(settings.sign(SignRule::Pseudonormal))).to_string().contains("normal or winding-number"));
    let away = RegularGrid::new(DVec3::ZERO, Vec3::splat(50.0), 0.1, [9; 3]).unwrap();
    let error = refused(samples.distance_field(&away, &settings, &mut Watch::none())).to_string();
    assert!(error.contains("band = 4 widths of 0.1: none of 100 samples"), "{error}");
    let mut stop = |_: Progress| std::ops::ControlFlow::Break(());
    let ended = samples.distance_field(&grid, &settings, &mut Watch::new(&mut stop));
    assert!(matches!(refused(ended), Error::Interrupted { .. }));
}

#[test]
fn samples_without_normals_say_so() {
    let (points, mut normals) = torus::<f32>(100, 5);
    let of = |normals: &[Vector<f32>]| OrientedSamples::new(&points, normals).unwrap_err();
    assert!(matches!(of(&[]), Error::NoNormals { points: 100, without: 100, first: 0 }));
    assert!(matches!(of(&normals[..9]), Error::LengthMismatch { .. }));
    normals[7] = [0.0; 3];
    normals[9] = [f32::NAN; 3];
    let error = of(&normals);
    assert!(matches!(error, Error::NoNormals { without: 2, first: 7, .. }), "{error}");
    assert!(error.to_string().contains("nearfield normals"));
    let none: [Vector<f32>; 0] = [];
    let nothing = OrientedSamples::new(&none, &none).unwrap();
    assert_eq!(nothing.spacing(), 0.0);
    assert!(nothing.distance_field(&torus_grid(33, 4.0), &DistanceSettings::default(), &mut Watch::none()).is_err());
    let one = OrientedSamples::new(&[[0.0f64; 3]], &[[0.0, 0.0, 2.0]]).unwrap();
    let (distance, _) = one.distance(&[0.0, 0.0, 0.5], 1.0, DistanceMode::Apss, 1.0).unwrap();
    assert!((norm([0.0, 0.0, distance]) - 0.5).abs() < 1e-12);
}
