//! The rows of a GPU: times are the device's timestamps, but for the row from host memory and back.

use nearfield::gpu::Gpu;
use nearfield::parallel::reduce;
use nearfield::query::{Clock, NeighborSearch};
use nearfield::structure::GridBuilder;
use nearfield::{FixedRadius, GridSettings, SearchOnDevice, Vec3};

use super::table::Row;
use super::timed::{self, Attempt, device_points, peaked};
use crate::Result;
use crate::check::Expected;
use crate::measure::{Effort, Measured};
use crate::sets::Set;

/// Measures the set and hands over each row once its answer is checked.
pub(super) fn measure(
    gpu: &Gpu,
    set: &Set,
    points: &[Vec3],
    radius: f32,
    effort: Effort,
    mut add: impl FnMut(Row),
) -> Result<()> {
    let expected = Expected::of(points, radius)?;
    let (settings, question) = (GridSettings::for_radius(radius), FixedRadius::new(radius));
    let bounds = reduce::bounds(points);
    let input = gpu.upload("points", &device_points(points))?;
    let row = |operation, measured: Option<Measured>, peak_bytes, note: String| Row {
        set: *set,
        radius,
        mean_neighbors: expected.mean(),
        operation,
        structure: "uniform-grid",
        search: "",
        clock: if operation == FROM_HOST { Clock::Host } else { Clock::Device },
        measured,
        structure_bytes: 0,
        peak_bytes,
        note,
    };

    add(row("bounds", Some(timed::bounds(gpu, &input, effort)?), 0, String::new()));

    let mut builder = GridBuilder::new(gpu, points.len(), &bounds, &settings)?;
    let (grid, measured, peak) = peaked(gpu, effort, || {
        let grid = builder.build(&input)?;
        let stages = NeighborSearch::build_stages(&grid);
        Ok((grid, stages))
    })?;
    let structure_bytes = NeighborSearch::memory_bytes(&grid);
    let row = |operation, measured, peak, note| Row { structure_bytes, ..row(operation, measured, peak, note) };
    add(row("build", Some(measured), peak, String::new()));
    let attempted = |operation, attempt: Attempt| match attempt {
        Ok(timed) => {
            Row { search: timed.search, ..row(operation, Some(timed.measured), timed.peak_bytes, String::new()) }
        }
        Err(note) => row(operation, None, 0, note),
    };

    add(attempted("count", Ok(timed::counts(&grid, &question, &expected, effort)?)));
    let listed = timed::list(gpu, &expected, effort, || {
        let list = grid.list_on_device(&question)?;
        let stages = list.report.stages.clone();
        Ok((list, stages))
    })?;
    add(attempted("list", listed));
    let unordered = timed::rows(gpu, &expected, effort, || {
        let rows = grid.list_rows_on_device(&question)?;
        let stages = rows.report.stages.clone();
        Ok((rows, stages))
    })?;
    add(attempted(UNORDERED, unordered));
    drop(grid);

    let listed = timed::list(gpu, &expected, effort, || {
        let grid = builder.build(&input)?;
        let list = grid.list_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&grid), list.report.stages.clone()].concat();
        Ok((list, stages))
    })?;
    add(attempted("build + list", listed));
    drop((builder, input));

    let (list, measured, peak) = timed::from_host(gpu, points, &question, &expected, effort)?;
    let batches = list.report.batches;
    let note = if batches > 1 { format!("in {batches} batches of queries") } else { String::new() };
    let search = list.report.search;
    add(Row { search, ..row(FROM_HOST, Some(measured), peak, note) });
    Ok(())
}

/// The row whose rows stand in completion order.
pub(super) const UNORDERED: &str = "list, rows in completion order";

/// The row timed by the host's clock.
const FROM_HOST: &str = "points in, list out";
