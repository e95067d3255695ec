//! Rows of start and length in completion order.

use libtest_mimic::Trial;
use nearfield::{FixedRadius, GpuBruteForce, GpuUniformGrid, GridSettings, ListRows, SearchOnDevice, UniformGrid};

use crate::support::{gpu_trial, trial};
use crate::{RADIUS, lattice_points, rows_by_loop};

/// Tests of both sides.
pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("cpu_rows_equal_the_loop", || {
            let points = lattice_points(3000);
            let grid = UniformGrid::build(&points, &GridSettings::for_radius(RADIUS)).expect("builds");
            let rows = grid.list_rows(&FixedRadius::new(RADIUS)).expect("lists");
            let expected = rows_by_loop(&points, &points, RADIUS);
            for (i, expected) in expected.iter().enumerate() {
                let mut row = rows.row(i).to_vec();
                row.sort_unstable();
                assert!(row.into_iter().eq(expected.iter().map(|&(id, _)| id)), "row {i}");
            }
        }),
        gpu_trial("gpu_rows_equal_the_loop_and_fill_every_place_once", |gpu| {
            let points = lattice_points(3000);
            let expected = rows_by_loop(&points, &points, RADIUS);
            // Cells far below the radius make more words than the masks hold; then a second walk fills the row.
            for (cell_size, overflows) in [(RADIUS, false), (RADIUS / 6.0, true)] {
                let grid = GpuUniformGrid::build(gpu, &points, &GridSettings::for_radius(cell_size)).expect("builds");
                let rows = grid.list_rows_on_device(&FixedRadius::new(RADIUS)).expect("lists");
                let kernels = rows.report.kernels.join(" ");
                assert_eq!(kernels.contains("fill_overflowed"), overflows, "{kernels}");
                assert!(kernels.contains("reserve_rows"), "{kernels}");
                let (starts, lengths) =
                    (gpu.read(&rows.starts).expect("reads"), gpu.read(&rows.lengths).expect("reads"));
                let indices = gpu.read(&rows.indices).expect("reads");
                let mut used = vec![false; indices.len()];
                for (i, expected) in expected.iter().enumerate() {
                    let range = starts[i] as usize..(starts[i] + lengths[i]) as usize;
                    assert!(used[range.clone()].iter().all(|&u| !u), "row {i} overlaps another");
                    used[range.clone()].fill(true);
                    let mut row = indices[range].to_vec();
                    row.sort_unstable();
                    assert!(row.into_iter().eq(expected.iter().map(|&(id, _)| id)), "row {i}");
                }
                assert!(used.into_iter().all(|u| u), "places that no row has");
            }
        }),
        gpu_trial("rows_in_completion_order_need_masks", |gpu| {
            let brute = GpuBruteForce::build(gpu, &lattice_points(10)).expect("builds");
            let error = brute.list_rows_on_device(&FixedRadius::new(RADIUS)).expect_err("brute force has no masks");
            assert!(matches!(error, nearfield::Error::Unsupported { .. }), "{error}");
        }),
    ]
}
