//! The device's plumbing and what can go wrong on it: choices, buffers, pipelines, full memory, loss, and callers' own
//! devices and kernels.
//!
//! Tests that limit memory or lose the device open one of their own, so that they can run beside each other. Points lie
//! on a lattice of 1/128: every squared distance is exact in f32, so answers equal the loop to the bit.

mod coherent;
mod grid_builds;
mod kept_pipelines;
mod knn_cells;
mod knn_packs;
mod list_plans;
mod loss;
mod memory;
mod on_device_queries;
mod pairs;
mod plumbing;
mod ray_trees;
mod rows;
#[path = "../support/mod.rs"]
mod support;
mod tiny_triangles;
mod transfers;
mod trees;
mod visitors;

use libtest_mimic::{Arguments, Trial};
use nearfield::gpu::{Adapter, Gpu, adapters};
use nearfield::{GpuBruteForce, GpuUniformGrid, GridSettings, NeighborSearch, Neighbors, Vec3};
use support::Random;

const SEED: u64 = 20_261_123;

/// Radius of the questions; its square is exact, and lattice points at exactly this distance exist.
const RADIUS: f32 = 0.125;

/// Points of the unit cube on the lattice; every eighth lies at exactly [`RADIUS`] from the one before it.
fn lattice_points(n: usize) -> Vec<Vec3> {
    let mut random = Random(SEED);
    let mut coordinate = || random.below(112) as f32 / 128.0;
    let mut points: Vec<Vec3> = (0..n).map(|_| Vec3::new(coordinate(), coordinate(), coordinate())).collect();
    for i in (8..n).step_by(8) {
        points[i] = points[i - 1] + Vec3::new(RADIUS, 0.0, 0.0);
    }
    points
}

/// Neighbours by the obvious loop: index and squared distance, rows ascending by index.
fn rows_by_loop(points: &[Vec3], queries: &[Vec3], radius: f32) -> Vec<Vec<(u32, f32)>> {
    let dist2 = |a: Vec3, b: Vec3| (a.x - b.x).powi(2) + (a.y - b.y).powi(2) + (a.z - b.z).powi(2);
    let row = |&query: &Vec3| {
        let all = points.iter().enumerate().map(|(i, &p)| (i as u32, dist2(query, p)));
        all.filter(|&(_, d2)| d2 <= radius * radius).collect()
    };
    queries.iter().map(row).collect()
}

/// The row with the lowest number that differs, each row in any order.
fn wrong_row(found: &Neighbors, expected: &[Vec<(u32, f32)>]) -> Option<usize> {
    if found.len() != expected.len() {
        return Some(found.len().min(expected.len()));
    }
    (0..expected.len()).find(|&i| {
        let mut row = found.row(i).to_vec();
        row.sort_unstable();
        !row.into_iter().eq(expected[i].iter().map(|&(id, _)| id))
    })
}

/// The adapter of the device that the tests run on.
fn adapter_of(gpu: &Gpu) -> Adapter {
    adapters().into_iter().find(|a| a.name == gpu.name()).expect("the adapter of an open device should be listed")
}

/// A context of the test's own on the adapter of `gpu`.
fn own_context(gpu: &Gpu) -> Gpu {
    Gpu::open_adapter(&adapter_of(gpu)).unwrap()
}

/// Both structures over the points.
fn structures(gpu: &Gpu, points: &[Vec3]) -> [Box<dyn NeighborSearch>; 2] {
    [
        Box::new(GpuBruteForce::build(gpu, points).unwrap()),
        Box::new(GpuUniformGrid::build(gpu, points, &GridSettings::for_radius(RADIUS)).unwrap()),
    ]
}

fn planted_differences_are_found() {
    let points = lattice_points(300);
    let rows = rows_by_loop(&points, &points, RADIUS);
    let cpu = nearfield::BruteForce::build(&points).unwrap();
    let list = cpu.list(&nearfield::FixedRadius::new(RADIUS)).unwrap();
    assert_eq!(wrong_row(&list, &rows), None);
    for i in [0, 150, 299] {
        let mut wrong = rows.clone();
        wrong[i][0].0 += 300;
        assert_eq!(wrong_row(&list, &wrong), Some(i));
        let mut short = rows.clone();
        short[i].pop();
        assert_eq!(wrong_row(&list, &short), Some(i));
    }
    assert_eq!(wrong_row(&list, &rows[1..]), Some(299));
    // The closed ball is tested at all.
    assert!(rows.iter().flatten().filter(|&&(_, d2)| d2 == RADIUS * RADIUS).count() >= 2 * 37);
}

fn main() {
    let mut trials: Vec<Trial> = vec![support::trial("planted_differences_are_found", planted_differences_are_found)];
    trials.extend(plumbing::trials());
    trials.extend(memory::trials());
    trials.extend(loss::trials());
    trials.extend(visitors::trials());
    trials.extend(on_device_queries::trials());
    trials.extend(grid_builds::trials());
    trials.extend(pairs::trials());
    trials.extend(rows::trials());
    trials.extend(transfers::trials());
    trials.extend(kept_pipelines::trials());
    trials.extend(list_plans::trials());
    trials.extend(trees::trials());
    trials.extend(knn_packs::trials());
    trials.extend(knn_cells::trials());
    trials.extend(ray_trees::trials());
    trials.extend(tiny_triangles::trials());
    trials.extend(coherent::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
