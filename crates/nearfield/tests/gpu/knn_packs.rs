//! The nearest points by packs of queries: every size of rows, leaves of every length, ties, more leaves with hits than have
//! numbers, queries that packs leave, and questions that do not suit packs. Expected is what a loop over all points finds.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::{AabbTreeSettings, BuildOrder, GpuAabbTree, Knn, KnnSearch, NearestNeighbors, Vec3};

use crate::support::{Random, gpu_trial};
use crate::{SEED, lattice_points};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("packs_find_the_nearest_for_rows_of_every_size", every_size),
        gpu_trial("packs_find_the_nearest_in_leaves_of_every_length", every_leaf),
        gpu_trial("packs_whose_spans_outnumber_their_numbers_find_the_nearest", many_spans),
        gpu_trial("packs_and_what_they_leave_order_ties_by_index", ties),
        gpu_trial("packs_are_taken_where_they_suit", taken_where_they_suit),
    ]
}

const PACKS: &str = "package::query::knn_packs";

/// Rows of the `k` nearest by the obvious loop, ties by index; differences of `points` are exact.
pub(crate) fn nearest_by_loop(points: &[Vec3], queries: &[Vec3], k: usize, excludes: bool) -> Vec<Vec<u32>> {
    let row = |(i, &query): (usize, &Vec3)| {
        let others = points.iter().enumerate().filter(|&(j, _)| !(excludes && i == j));
        let mut all: Vec<(f32, u32)> = others.map(|(j, &p)| ((query - p).length_squared(), j as u32)).collect();
        all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.into_iter().take(k).map(|(_, j)| j).collect()
    };
    queries.iter().enumerate().map(row).collect()
}

pub(crate) fn assert_rows(name: &str, found: &NearestNeighbors, expected: &[Vec<u32>]) {
    assert_eq!(found.len(), expected.len(), "{name}");
    for (i, expected) in expected.iter().enumerate() {
        assert_eq!(found.row(i), &expected[..], "{name}: row {i}");
    }
}

fn tree(gpu: &Gpu, points: &[Vec3], bucket: u32) -> GpuAabbTree {
    let settings = AabbTreeSettings::DEFAULT.bucket_size(bucket).order(BuildOrder::Hilbert);
    GpuAabbTree::build(gpu, points, &settings).unwrap()
}

/// Whether the device has subgroups that can be packs.
fn has_packs(gpu: &Gpu) -> bool {
    gpu.limits().subgroup.is_some_and(|(smallest, _)| smallest >= 4)
}

fn every_size(gpu: &Gpu) {
    let points = lattice_points(700);
    let tree = tree(gpu, &points, 16);
    for k in [1, 2, 4, 5, 8, 9, 12, 13, 16, 17, 20, 21, 24, 25, 28, 29, 32] {
        let excludes = k % 3 == 0;
        let mut question = Knn::new(k);
        question.exclude_self = excludes;
        let found = tree.knn(&question).unwrap();
        assert_eq!(found.report.kernels[0] == PACKS, has_packs(gpu), "{:?}", found.report);
        assert_rows(&format!("{k} nearest"), &found, &nearest_by_loop(&points, &points, k as usize, excludes));
    }
}

fn every_leaf(gpu: &Gpu) {
    // The last leaf ends with the points, and may have fewer than are tested together.
    for n in [16, 17, 33, 500, 1201] {
        let points = lattice_points(n);
        for bucket in [1, 7, 16, 20, 33, 200] {
            let found = tree(gpu, &points, bucket).knn(&Knn::new(10).exclude_self()).unwrap();
            let expected = nearest_by_loop(&points, &points, 10, true);
            assert_rows(&format!("{n} points in leaves of {bucket}"), &found, &expected);
        }
    }
}

/// Leaves of one point, so that a pack comes upon more of them than there are numbers; and queries all over, of which one pack
/// would keep more.
fn many_spans(gpu: &Gpu) {
    let points = lattice_points(2500);
    let mut random = Random(SEED + 1);
    let queries: Vec<Vec3> = (0..700).map(|_| points[random.below(points.len() as u32) as usize]).collect();
    let tree = tree(gpu, &points, 1);
    for k in [4, 16, 32] {
        let found = tree.knn(&Knn::new(k)).unwrap();
        assert_rows("points", &found, &nearest_by_loop(&points, &points, k as usize, false));
        let found = tree.knn(&Knn::new(k).queries(&queries)).unwrap();
        assert_eq!(found.report.kernels[0] == PACKS, has_packs(gpu), "{:?}", found.report);
        assert_rows("others", &found, &nearest_by_loop(&points, &queries, k as usize, false));
    }
}

fn ties(gpu: &Gpu) {
    let edge = 11;
    let at = |i: usize| Vec3::new((i % edge) as f32, (i / edge % edge) as f32, (i / edge / edge) as f32) * 0.25;
    let mut lattice: Vec<Vec3> = (0..edge * edge * edge).map(at).collect();
    let mut random = Random(SEED + 2);
    for i in (1..lattice.len()).rev() {
        lattice.swap(i, random.below(i as u32 + 1) as usize);
    }
    // More spans than there are numbers, all of them with hits.
    let equal = vec![Vec3::new(0.5, -7.0, 3.25); 2500];
    for (name, points) in [("lattice", lattice), ("equal", equal)] {
        let tree = tree(gpu, &points, 16);
        for k in [3, 8, 16, 27] {
            let found = tree.knn(&Knn::new(k)).unwrap();
            assert_rows(&format!("{k} of {name}"), &found, &nearest_by_loop(&points, &points, k as usize, false));
        }
    }
}

fn taken_where_they_suit(gpu: &Gpu) {
    let points = lattice_points(400);
    let kernels = |n: usize, question: &Knn<'_>| {
        let found = tree(gpu, &points[..n], 16).knn(question).unwrap();
        found.report.kernels.iter().any(|kernel| kernel == PACKS)
    };
    assert_eq!(kernels(400, &Knn::new(32)), has_packs(gpu));
    assert_eq!(kernels(16, &Knn::new(32)), has_packs(gpu), "rows have a place for each point");
    assert!(!kernels(15, &Knn::new(1)), "points for less than one span");
    assert!(!kernels(400, &Knn::new(33)), "rows of more places than words");
    assert_eq!(kernels(400, &Knn::new(8).queries(&points[..100])), has_packs(gpu));
    assert!(!kernels(400, &Knn::new(8).queries(&points[..99])), "sparse queries");
}
