//! The nearest points from a grid: rows of every size from pairs, what pairs leave, balls that widen, and cells of any size.
//! Expected is what a loop over all points finds.
//!
//! Devices of hardware search so few points one by one: there `conformance` reaches the kernels with its large clouds.

use libtest_mimic::Trial;
use nearfield::geometry::Period;
use nearfield::gpu::{AdapterKind, Gpu};
use nearfield::query::NeighborSearch;
use nearfield::{FixedRadius, GpuUniformGrid, GridSettings, Knn, KnnSearch, Vec3};

use crate::knn_packs::{assert_rows, nearest_by_loop};
use crate::support::{Random, gpu_trial};
use crate::{SEED, lattice_points};

const PAIRS: &str = "package::query::knn_pairs";

/// Enough points for pairs on a software device, and odd.
const N: usize = 2501;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("pairs_find_the_nearest_for_rows_of_every_size", every_size),
        gpu_trial("pairs_and_what_they_leave_order_ties_by_index", ties),
        gpu_trial("balls_widen_to_the_nearest_in_cells_of_any_size", cells_of_any_size),
        gpu_trial("balls_widen_as_far_as_outliers_are", outliers),
        gpu_trial("the_nearest_within_a_radius_and_around_other_places", within_and_around),
        gpu_trial("cells_for_the_nearest_leave_few_queries", few_are_left),
        gpu_trial("nearest_of_cells_stay_on_the_device", on_device),
    ]
}

/// Points whose differences within a quarter have exact squares.
fn scattered(n: usize) -> Vec<Vec3> {
    let mut random = Random(SEED);
    let mut coordinate = || random.below(4096) as f32 / 4096.0;
    (0..n).map(|_| Vec3::new(coordinate(), coordinate(), coordinate())).collect()
}

fn grid(gpu: &Gpu, points: &[Vec3], settings: &GridSettings) -> GpuUniformGrid {
    GpuUniformGrid::build(gpu, points, settings).unwrap()
}

fn is_in_pairs(found: &nearfield::NearestNeighbors) -> bool {
    found.report.kernels.iter().any(|kernel| kernel == PAIRS)
}

/// Whether this device searches [`N`] points in pairs.
fn searches_in_pairs(gpu: &Gpu) -> bool {
    gpu.kind() == AdapterKind::Software
}

fn every_size(gpu: &Gpu) {
    let points = scattered(N);
    for k in [1, 4, 5, 8, 11, 16, 17, 27, 32, 33, 70] {
        let grid = grid(gpu, &points, &GridSettings::for_nearest(&points, k));
        let excludes = k % 3 == 0;
        let mut question = Knn::new(k);
        question.exclude_self = excludes;
        let found = grid.knn(&question).unwrap();
        assert_eq!(is_in_pairs(&found), searches_in_pairs(gpu) && k <= 32, "{k}: {:?}", found.report);
        assert_rows(&format!("{k} nearest"), &found, &nearest_by_loop(&points, &points, k as usize, excludes));
    }
}

fn ties(gpu: &Gpu) {
    // Few distances, which words cannot tell apart; points in one place, more of them than a row has places; a lattice of one plane.
    let lattice = lattice_points(N);
    let crowded: Vec<Vec3> = (0..N).map(|i| lattice[if i % 4 == 0 { i } else { i % 16 }]).collect();
    let plane: Vec<Vec3> = (0..N).map(|i| Vec3::new((i % 51) as f32, (i / 51) as f32, 2.0) / 64.0).collect();
    let same = vec![Vec3::splat(0.5); N];
    for (name, points) in [("lattice", lattice), ("crowded", crowded), ("plane", plane), ("one place", same)] {
        let grid = grid(gpu, &points, &GridSettings::for_nearest(&points, 16));
        for question in [Knn::new(16), Knn::new(7).exclude_self()] {
            let found = grid.knn(&question).unwrap();
            let expected = nearest_by_loop(&points, &points, question.k as usize, question.exclude_self);
            assert_rows(name, &found, &expected);
        }
    }
}

fn cells_of_any_size(gpu: &Gpu) {
    let points = scattered(N);
    let expected = nearest_by_loop(&points, &points, 16, false);
    for size in [0.0, 0.004, 0.03, 0.06, 0.1, 0.2, 3.0] {
        let found = grid(gpu, &points, &GridSettings::for_radius(size)).knn(&Knn::new(16)).unwrap();
        assert_rows(&format!("cells of {size}"), &found, &expected);
    }
}

fn outliers(gpu: &Gpu) {
    // A cluster, a smaller one far away with fewer points than are asked for, and a point at the end of the world.
    let mut points = scattered(N);
    points.iter_mut().take(9).for_each(|p| *p = *p / 64.0 + Vec3::splat(1024.0));
    points[9] = Vec3::new(-1e18, 0.0, 0.0);
    for settings in [GridSettings::for_nearest(&points, 12), GridSettings::for_radius(0.02)] {
        let found = grid(gpu, &points, &settings).knn(&Knn::new(12)).unwrap();
        let expected = nearest_by_loop(&points, &points, 12, false);
        for (i, expected) in expected.iter().enumerate().skip(10) {
            assert_eq!(found.row(i), &expected[..], "row {i}");
        }
        // Distances to what is far away are rounded: the near part of the row is what can be told.
        for (i, expected) in expected.iter().enumerate().take(9) {
            assert_eq!(found.row(i)[..9], expected[..9], "row {i}");
            assert_eq!(found.found(i), 12);
        }
        assert_eq!((found.row(9)[0], found.found(9)), (9, 12));
    }
}

fn within_and_around(gpu: &Gpu) {
    let points = scattered(N);
    let grid = grid(gpu, &points, &GridSettings::for_nearest(&points, 16));
    let radii: Vec<f32> = (0..N).map(|i| [0.0, 0.0625, 0.125, 0.25][i % 4]).collect();
    let places: Vec<Vec3> = scattered(2 * N).split_off(N).into_iter().map(|p| 2.0 * p - 0.5).collect();
    let all = nearest_by_loop(&points, &points, N, false);
    let cut = |rows: &[Vec<u32>], queries: &[Vec3], k: usize, radius: &dyn Fn(usize) -> f32| -> Vec<Vec<u32>> {
        let is_near = |i: usize, &j: &u32| (points[j as usize] - queries[i]).length_squared() <= radius(i).powi(2);
        let row = |(i, row): (usize, &Vec<u32>)| row.iter().copied().filter(|j| is_near(i, j)).take(k).collect();
        rows.iter().enumerate().map(row).collect()
    };
    for radius in [0.0, 0.03125, 0.0625, 0.25, 4.0] {
        let found = grid.knn(&Knn::new(16).within(radius)).unwrap();
        assert_rows(&format!("within {radius}"), &found, &cut(&all, &points, 16, &|_| radius));
    }
    let found = grid.knn(&Knn::new(16).within_each(&radii)).unwrap();
    assert_rows("within each", &found, &cut(&all, &points, 16, &|i| radii[i]));
    // One query without a limit among those that have one.
    let limits: Vec<f32> = (0..N).map(|i| if i == 5 { 1.8e19 } else { radii[i] }).collect();
    let found = grid.knn(&Knn::new(16).within_each(&limits)).unwrap();
    assert_rows("one anywhere", &found, &cut(&all, &points, 16, &|i| limits[i]));
    let around = nearest_by_loop(&points, &places, 20, false);
    assert_rows("other places", &grid.knn(&Knn::new(20).queries(&places)).unwrap(), &around);
    let found = grid.knn(&Knn::new(20).queries(&places).within(0.125)).unwrap();
    assert_rows("other places within", &found, &cut(&around, &places, 20, &|_| 0.125));
    // Periodic axes: a cloud that is shifted by half a period along each is the same.
    let period = Period::new(Vec3::ONE).unwrap();
    let shifted: Vec<Vec3> = points.iter().map(|p| (*p + 0.5).rem_euclid(Vec3::ONE)).collect();
    let rows = [&points, &shifted].map(|points| {
        let settings = GridSettings::for_nearest(points, 16).periodic(period);
        GpuUniformGrid::build(gpu, points, &settings).unwrap().knn(&Knn::new(16)).unwrap()
    });
    assert_eq!(rows[0].indices(), rows[1].indices());
}

fn few_are_left(gpu: &Gpu) {
    let points = scattered(20_000);
    let settings = GridSettings::for_nearest(&points, 16);
    let counts = grid(gpu, &points, &settings).count(&FixedRadius::new(settings.cell_size)).unwrap();
    let few = counts.as_slice().iter().filter(|&&count| count < 16).count();
    let mean = counts.as_slice().iter().map(|&count| f64::from(count)).sum::<f64>() / points.len() as f64;
    // A fifth of so few points are near a face, where a ball has half of its points.
    assert!(few < points.len() / 6 && (20.0..32.0).contains(&mean), "{few} of {} left, {mean} a ball", points.len());
}

fn on_device(gpu: &Gpu) {
    let points = scattered(300);
    let expected = nearest_by_loop(&points, &points, 7, false).concat();
    let grid = grid(gpu, &points, &GridSettings::for_nearest(&points, 7));
    let found = grid.knn_on_device(&Knn::new(7)).unwrap();
    assert_eq!((found.places, found.report.search), (7, "nearest-cells"));
    assert_eq!(gpu.read(&found.indices).unwrap(), expected);
    assert_eq!(grid.knn_on_device(&Knn::new(400).exclude_self()).unwrap().places, 299);
    assert_eq!(grid.knn_on_device(&Knn::new(0)).unwrap().places, 0);
}
