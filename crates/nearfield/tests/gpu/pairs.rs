//! Searches of a grid's own points two at a time: the same answers as the loop, in the cases that the kernels treat apart.
//!
//! Devices of hardware search so few points one by one: there `conformance` reaches the kernels with its large clouds.

use libtest_mimic::Trial;
use nearfield::geometry::Period;
use nearfield::gpu::{AdapterKind, Gpu};
use nearfield::{FixedRadius, GpuUniformGrid, GridSettings, NeighborSearch, SearchOnDevice, Vec3};

use crate::support::gpu_trial;
use crate::{RADIUS, lattice_points, rows_by_loop};

const KERNEL: &str = "package::structure::uniform_grid::find_pairs";

/// A case's number of points: enough for pairs on a software device, and odd.
const N: usize = 2501;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("pairs_find_what_the_loop_finds", pairs_find_what_the_loop_finds),
        gpu_trial("rows_of_pairs_with_too_many_words_are_whole", rows_of_pairs_with_too_many_words_are_whole),
        gpu_trial("what_pairs_do_not_serve_is_searched_one_by_one", what_pairs_do_not_serve_is_searched_one_by_one),
    ]
}

/// Whether this device searches [`N`] points in pairs.
fn searches_in_pairs(gpu: &Gpu) -> bool {
    gpu.kind() == AdapterKind::Software
}

/// Counts, list and rows in completion order equal the loop; gives the kernels of the three, one after the other.
fn check(case: &str, gpu: &Gpu, points: &[Vec3], settings: &GridSettings, question: &FixedRadius<'_>) -> String {
    let radius = question.largest_radius();
    let mut expected: Vec<Vec<u32>> = Vec::new();
    for (i, row) in rows_by_loop(points, points, radius).into_iter().enumerate() {
        let ids = row.into_iter().map(|(id, _)| id);
        expected.push(ids.filter(|&id| !question.exclude_self || id != i as u32).collect());
    }
    let grid = GpuUniformGrid::build(gpu, points, settings).unwrap();
    let (counts, counted) = grid.count_on_device(question).unwrap();
    assert!(gpu.read(&counts).unwrap().into_iter().eq(expected.iter().map(|row| row.len() as u32)), "{case}: counts");

    let list = grid.list_on_device(question).unwrap();
    let (offsets, indices) = (gpu.read(&list.offsets).unwrap(), gpu.read(&list.indices).unwrap());
    let rows = grid.list_rows_on_device(question).unwrap();
    let (starts, lengths) = (gpu.read(&rows.starts).unwrap(), gpu.read(&rows.lengths).unwrap());
    let entries = gpu.read(&rows.indices).unwrap();
    assert_eq!((indices.len(), entries.len()), (offsets[points.len()] as usize, indices.len()), "{case}");
    let sorted = |row: &[u32]| {
        let mut row = row.to_vec();
        row.sort_unstable();
        row
    };
    for (i, expected) in expected.iter().enumerate() {
        assert_eq!(&sorted(&indices[offsets[i] as usize..offsets[i + 1] as usize]), expected, "{case}: row {i}");
        let range = starts[i] as usize..(starts[i] + lengths[i]) as usize;
        assert_eq!(&sorted(&entries[range]), expected, "{case}: row {i} in completion order");
    }
    let host = grid.count(question).unwrap();
    assert!(host.as_slice().iter().eq(&lengths), "{case}: counts on the host");
    [counted.kernels, list.report.kernels, rows.report.kernels, host.report.kernels].concat().join(" ")
}

fn pairs_find_what_the_loop_finds(gpu: &Gpu) {
    let points = lattice_points(N);
    let flat: Vec<Vec3> = points.iter().map(|p| Vec3::new(p.x, p.y, 0.5)).collect();
    let all = FixedRadius::new(RADIUS);
    let cells = GridSettings::for_radius(RADIUS);
    let unrefined = GridSettings { refine_x: 1, ..cells };
    let inside = nearfield::geometry::Aabb::new(Vec3::splat(0.375), Vec3::splat(0.5));
    for (case, points, settings, question) in [
        ("a cube", &points, cells, all),
        ("a cube, an even number", &points[1..].to_vec(), cells, all),
        ("without the point itself", &points, cells, all.exclude_self()),
        ("large cells", &points, GridSettings::for_radius(0.5), all),
        ("cells as long as wide", &points, unrefined, all),
        ("points outside the bounds", &points, cells.bounds(inside), all),
        ("one layer of cells", &flat, cells, all.exclude_self()),
    ] {
        let kernels = check(case, gpu, points, &settings, &question);
        let used = kernels.matches(KERNEL).count();
        assert_eq!(used > 0, searches_in_pairs(gpu), "{case}: {kernels}");
        assert!(used == 0 || used >= 4, "{case}: {kernels}");
    }
}

fn rows_of_pairs_with_too_many_words_are_whole(gpu: &Gpu) {
    // Rows of some 200, of which a workgroup's memory holds no five, and some of which have more words than are kept.
    let narrow: Vec<Vec3> = lattice_points(N).iter().map(|p| Vec3::new(0.25, p.y, 0.5)).collect();
    let cells = GridSettings::for_radius(0.03125);
    for question in [FixedRadius::new(0.03125), FixedRadius::new(0.03125).exclude_self()] {
        let kernels = check("long rows", gpu, &narrow, &cells, &question);
        assert_eq!(kernels.matches("for long rows").count(), 2 * usize::from(searches_in_pairs(gpu)), "{kernels}");
    }
}

fn what_pairs_do_not_serve_is_searched_one_by_one(gpu: &Gpu) {
    let points = lattice_points(N);
    let all = FixedRadius::new(RADIUS);
    let kernels = check("thin cells", gpu, &points, &GridSettings::for_radius(RADIUS / 2.0), &all);
    assert!(!kernels.contains(KERNEL), "{kernels}");
    let kernels = check("few points", gpu, &points[..2000], &GridSettings::for_radius(RADIUS), &all);
    assert!(!kernels.contains(KERNEL), "{kernels}");

    let cells = GridSettings::for_radius(RADIUS);
    let grid = GpuUniformGrid::build(gpu, &points, &cells).unwrap();
    let radii: Vec<f32> = (0..points.len()).map(|i| (i % 17) as f32 / 128.0).collect();
    let period = Period::new(Vec3::splat(2.0)).unwrap();
    let periodic = GpuUniformGrid::build(gpu, &points, &cells.periodic(period)).unwrap();
    for (case, grid, question) in [
        ("other queries", &grid, all.queries(&points)),
        ("radii of their own", &grid, FixedRadius::each(&radii)),
        ("a period", &periodic, all),
    ] {
        let (counts, report) = grid.count_on_device(&question).unwrap();
        let right = |(i, count): (usize, u32)| {
            let radius = if case == "radii of their own" { radii[i] } else { RADIUS };
            rows_by_loop(&points, &[points[i]], radius)[0].len() == count as usize
        };
        assert!(gpu.read(&counts).unwrap().into_iter().enumerate().step_by(7).all(right), "{case}");
        assert!(!report.kernels.contains(&KERNEL.to_owned()), "{case}: {:?}", report.kernels);
    }
}
