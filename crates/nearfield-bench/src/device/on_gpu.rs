//! The rows of a GPU: times are the device's timestamps, but for the row from host memory and back.

use std::time::Instant;

use nearfield::gpu::{Buffer, Gpu};
use nearfield::parallel::reduce::{self, GpuBounds, GpuReduce};
use nearfield::query::{Clock, NeighborSearch, Stage};
use nearfield::structure::{DevicePoint, GridBuilder};
use nearfield::{FixedRadius, GpuNeighbors, GpuUniformGrid, GridSettings, SearchOnDevice, Vec3};

use super::table::Row;
use crate::check::Expected;
use crate::measure::{Effort, Measured, repeat};
use crate::sets::Set;
use crate::{Error, Result};

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
    // Peaks are taken before answers are read back, which would add to them.
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

    add(row("bounds", Some(time_bounds(gpu, &input, effort)?), 0, String::new()));

    let mut builder = GridBuilder::new(gpu, points.len(), &bounds, &settings)?;
    gpu.take_memory_peak();
    let (grid, measured) = repeat(effort, || {
        let grid = builder.build(&input)?;
        let stages = build_stages(&grid);
        Ok((grid, stages))
    })?;
    let structure_bytes = NeighborSearch::memory_bytes(&grid);
    let row = |operation, measured, peak, note| Row { structure_bytes, ..row(operation, measured, peak, note) };
    add(row("build", Some(measured), gpu.take_memory_peak(), String::new()));

    let ((counts, search), measured) = repeat(effort, || {
        let (counts, report) = grid.count_on_device(&question)?;
        Ok(((counts, report.search), report.stages))
    })?;
    let peak = gpu.take_memory_peak();
    expected.check_counts(&gpu.read(&counts)?)?;
    drop(counts);
    add(Row { search, ..row("count", Some(measured), peak, String::new()) });
    gpu.take_memory_peak();

    let listed = repeat(effort, || {
        let list = grid.list_on_device(&question)?;
        let stages = list.report.stages.clone();
        Ok((list, stages))
    });
    let peak = gpu.take_memory_peak();
    add(match checked(gpu, &expected, listed)? {
        Ok((measured, search)) => Row { search, ..row("list", Some(measured), peak, String::new()) },
        Err(note) => row("list", None, 0, note),
    });

    gpu.take_memory_peak();
    let unordered = repeat(effort, || {
        let rows = grid.list_rows_on_device(&question)?;
        let stages = rows.report.stages.clone();
        Ok((rows, stages))
    });
    let peak = gpu.take_memory_peak();
    add(match unordered {
        Ok((rows, measured)) => {
            expected.check_counts(&gpu.read(&rows.lengths)?)?;
            expected.check_rows(&gpu.read(&rows.starts)?, &gpu.read(&rows.lengths)?, &gpu.read(&rows.indices)?)?;
            Row { search: rows.report.search, ..row(UNORDERED, Some(measured), peak, String::new()) }
        }
        Err(error) => row(UNORDERED, None, 0, too_large(error)?),
    });
    drop(grid);
    gpu.take_memory_peak();

    let listed = repeat(effort, || {
        let grid = builder.build(&input)?;
        let list = grid.list_on_device(&question)?;
        let stages = [build_stages(&grid), list.report.stages.clone()].concat();
        Ok((list, stages))
    });
    let peak = gpu.take_memory_peak();
    add(match checked(gpu, &expected, listed)? {
        Ok((measured, search)) => Row { search, ..row("build + list", Some(measured), peak, String::new()) },
        Err(note) => row("build + list", None, 0, note),
    });
    drop((builder, input));

    gpu.take_memory_peak();
    let (list, measured) = repeat(effort, || {
        let start = Instant::now();
        let grid = GpuUniformGrid::build(gpu, points, &settings)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let list = grid.list(&question)?;
        let mut stages = vec![Stage { name: "upload + build", milliseconds, clock: Clock::Host }];
        stages.extend(list.report.stages.iter().filter(|s| s.name != "total").cloned());
        Ok((list, stages))
    })?;
    let peak = gpu.take_memory_peak();
    expected.check_list(list.offsets(), list.indices())?;
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

/// Points as the kernels take them: xyz, and the index as bits.
pub(crate) fn device_points(points: &[Vec3]) -> Vec<DevicePoint> {
    points.iter().enumerate().map(|(i, p)| [p.x, p.y, p.z, f32::from_bits(i as u32)]).collect()
}

/// The stages of a build on the device.
fn build_stages(grid: &GpuUniformGrid) -> Vec<Stage> {
    NeighborSearch::build_stages(grid)
}

fn time_bounds(gpu: &Gpu, input: &Buffer<DevicePoint>, effort: Effort) -> Result<Measured> {
    let reduce = GpuReduce::new(gpu)?;
    let result: Buffer<GpuBounds> = gpu.buffer("bounds", 1)?;
    let ((), measured) = repeat(effort, || {
        let mut commands = gpu.commands("bounds");
        commands.stage("bounds");
        reduce.record_bounds(&mut commands, input, input.len(), &result)?;
        let times = commands.run()?;
        let stage = |t: &nearfield::gpu::StageTime| {
            Some(Stage { name: t.name, milliseconds: t.milliseconds?, clock: Clock::Device })
        };
        Ok(((), times.iter().filter_map(stage).collect()))
    })?;
    let (found, expected) = (gpu.read(&result)?[0], gpu.read(input)?);
    let lowest = expected.iter().fold([f32::INFINITY; 3], |m, p| [m[0].min(p[0]), m[1].min(p[1]), m[2].min(p[2])]);
    if found.min[..3] != lowest {
        return Err(format!("wrong answer: the bounds begin at {:?}, expected {lowest:?}", &found.min[..3]).into());
    }
    Ok(measured)
}

/// The times and the search of a list whose answer is right, or why the device cannot hold it.
pub(super) fn checked(
    gpu: &Gpu,
    expected: &Expected,
    listed: Result<(GpuNeighbors, Measured)>,
) -> Result<std::result::Result<(Measured, &'static str), String>> {
    match listed {
        Ok((list, measured)) => {
            let offsets: Vec<u64> = gpu.read(&list.offsets)?.into_iter().map(u64::from).collect();
            expected.check_list(&offsets, &gpu.read(&list.indices)?)?;
            Ok(Ok((measured, list.report.search)))
        }
        Err(error) => Ok(Err(too_large(error)?)),
    }
}

/// The note for a list that does not fit one binding; other errors stay errors.
pub(super) fn too_large(error: Error) -> Result<String> {
    match error.downcast_ref::<nearfield::Error>() {
        Some(nearfield::Error::OutOfDeviceMemory { needed, available, .. }) => {
            Ok(format!("does not fit: {needed} bytes, {available} possible"))
        }
        _ => Err(error),
    }
}
