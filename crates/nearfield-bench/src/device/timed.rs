//! One thing timed on a GPU, with its answer checked: what the tables of devices and of targets are made of.
//!
//! Peaks of memory are taken before answers are read back, which would add to them.

use std::time::Instant;

use nearfield::gpu::{Buffer, Gpu};
use nearfield::parallel::reduce::{GpuBounds, GpuReduce};
use nearfield::query::{Clock, Stage};
use nearfield::structure::DevicePoint;
use nearfield::{
    FixedRadius, GpuNearestNeighbors, GpuNeighborRows, GpuNeighbors, GpuUniformGrid, GridSettings, NeighborSearch,
    Neighbors, SearchOnDevice, Vec3,
};

use crate::check::{Expected, check_nearest};
use crate::measure::{Effort, Measured, repeat};
use crate::{Error, Result};

/// Times of something whose answer is right.
#[derive(Debug, Clone)]
pub(crate) struct Timed {
    pub(crate) measured: Measured,
    /// Variant of the search that ran; empty where nothing was searched.
    pub(crate) search: &'static str,
    /// Largest number of bytes held on the device meanwhile.
    pub(crate) peak_bytes: u64,
    /// Bytes of the answer on the device.
    pub(crate) answer_bytes: u64,
}

/// The times, or why the device cannot do it.
pub(crate) type Attempt = std::result::Result<Timed, String>;

/// Points as the kernels take them: xyz, and the index as bits.
pub(crate) fn device_points(points: &[Vec3]) -> Vec<DevicePoint> {
    points.iter().enumerate().map(|(i, p)| [p.x, p.y, p.z, f32::from_bits(i as u32)]).collect()
}

/// The stage of a time, where the device has one.
pub(crate) fn device_stage(time: &nearfield::gpu::StageTime) -> Option<Stage> {
    Some(Stage { name: time.name, milliseconds: time.milliseconds?, clock: Clock::Device })
}

/// Repeats what makes an answer on the device, with the peak of the memory meanwhile.
pub(crate) fn peaked<T>(
    gpu: &Gpu,
    effort: Effort,
    make: impl FnMut() -> Result<(T, Vec<Stage>)>,
) -> Result<(T, Measured, u64)> {
    gpu.take_memory_peak();
    let (answer, measured) = repeat(effort, make)?;
    Ok((answer, measured, gpu.take_memory_peak()))
}

/// The same for what the device may be unable to do. `check` checks the answer and tells the search that ran and the answer's bytes.
fn attempt<T>(
    gpu: &Gpu,
    effort: Effort,
    make: impl FnMut() -> Result<(T, Vec<Stage>)>,
    check: impl FnOnce(&T) -> Result<(&'static str, u64)>,
) -> Result<Attempt> {
    match peaked(gpu, effort, make) {
        Ok((answer, measured, peak_bytes)) => {
            let (search, answer_bytes) = check(&answer)?;
            Ok(Ok(Timed { measured, search, peak_bytes, answer_bytes }))
        }
        Err(error) => Ok(Err(not_possible(error)?)),
    }
}

/// Counts of the neighbours of all points, query alone.
///
/// # Errors
/// As the query; a wrong answer.
pub(crate) fn counts<S: SearchOnDevice>(
    search: &S,
    question: &FixedRadius<'_>,
    expected: &Expected,
    effort: Effort,
) -> Result<Timed> {
    let gpu = search.gpu();
    let ((counts, search), measured, peak_bytes) = peaked(gpu, effort, || {
        let (counts, report) = search.count_on_device(question)?;
        Ok(((counts, report.search), report.stages))
    })?;
    expected.check_counts(&gpu.read(&counts)?)?;
    Ok(Timed { measured, search, peak_bytes, answer_bytes: counts.bytes() })
}

/// A list in query order, as `make` gives it with its stages.
///
/// # Errors
/// What the device can do but fails at; a wrong answer.
pub(crate) fn list(
    gpu: &Gpu,
    expected: &Expected,
    effort: Effort,
    make: impl FnMut() -> Result<(GpuNeighbors, Vec<Stage>)>,
) -> Result<Attempt> {
    attempt(gpu, effort, make, |list| {
        let offsets: Vec<u64> = gpu.read(&list.offsets)?.into_iter().map(u64::from).collect();
        expected.check_list(&offsets, &gpu.read(&list.indices)?)?;
        Ok((list.report.search, list.offsets.bytes() + list.indices.bytes()))
    })
}

/// A list with rows in completion order, as `make` gives it with its stages.
///
/// # Errors
/// As [`list`].
pub(crate) fn rows(
    gpu: &Gpu,
    expected: &Expected,
    effort: Effort,
    make: impl FnMut() -> Result<(GpuNeighborRows, Vec<Stage>)>,
) -> Result<Attempt> {
    attempt(gpu, effort, make, |rows| {
        let lengths = gpu.read(&rows.lengths)?;
        expected.check_counts(&lengths)?;
        expected.check_rows(&gpu.read(&rows.starts)?, &lengths, &gpu.read(&rows.indices)?)?;
        Ok((rows.report.search, rows.starts.bytes() + rows.lengths.bytes() + rows.indices.bytes()))
    })
}

/// The `k` nearest of all points, as `make` gives them with their stages.
///
/// # Errors
/// As [`list`].
pub(crate) fn nearest(
    gpu: &Gpu,
    points: &[Vec3],
    k: u32,
    effort: Effort,
    make: impl FnMut() -> Result<(GpuNearestNeighbors, Vec<Stage>)>,
) -> Result<Attempt> {
    attempt(gpu, effort, make, |found| {
        check_nearest(points, k, &gpu.read(&found.indices)?)?;
        Ok((found.report.search, found.indices.bytes() + found.dist2.bytes()))
    })
}

/// The way from points on the host to the list there by the grid, with the last list and the peak of the memory.
///
/// # Errors
/// Of the build and the list; a wrong answer.
pub(crate) fn from_host(
    gpu: &Gpu,
    points: &[Vec3],
    question: &FixedRadius<'_>,
    expected: &Expected,
    effort: Effort,
) -> Result<(Neighbors, Measured, u64)> {
    let settings = GridSettings::for_radius(question.largest_radius());
    let (list, measured, peak_bytes) = peaked(gpu, effort, || {
        let start = Instant::now();
        let grid = GpuUniformGrid::build(gpu, points, &settings)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let list = grid.list(question)?;
        let mut stages = vec![Stage { name: "upload + build", milliseconds, clock: Clock::Host }];
        stages.extend(list.report.stages.iter().filter(|s| s.name != "total").cloned());
        Ok((list, stages))
    })?;
    expected.check_list(list.offsets(), list.indices())?;
    Ok((list, measured, peak_bytes))
}

/// The bounds of points on the device.
///
/// # Errors
/// As the reduction; a wrong answer.
pub(super) fn bounds(gpu: &Gpu, input: &Buffer<DevicePoint>, effort: Effort) -> Result<Measured> {
    let reduce = GpuReduce::new(gpu)?;
    let result: Buffer<GpuBounds> = gpu.buffer("bounds", 1)?;
    let ((), measured) = repeat(effort, || {
        let mut commands = gpu.commands("bounds");
        commands.stage("bounds");
        reduce.record_bounds(&mut commands, input, input.len(), &result)?;
        Ok(((), commands.run()?.iter().filter_map(device_stage).collect()))
    })?;
    let (found, expected) = (gpu.read(&result)?[0], gpu.read(input)?);
    let lowest = expected.iter().fold([f32::INFINITY; 3], |m, p| [m[0].min(p[0]), m[1].min(p[1]), m[2].min(p[2])]);
    if found.min[..3] != lowest {
        return Err(format!("wrong answer: the bounds begin at {:?}, expected {lowest:?}", &found.min[..3]).into());
    }
    Ok(measured)
}

/// The note for what a device cannot hold or does not do; other errors stay errors.
///
/// # Errors
/// Any error but `OutOfDeviceMemory` and `Unsupported`.
pub(crate) fn not_possible(error: Error) -> Result<String> {
    match error.downcast_ref::<nearfield::Error>() {
        Some(nearfield::Error::OutOfDeviceMemory { needed, available, .. }) => {
            Ok(format!("does not fit: {needed} bytes, {available} possible"))
        }
        Some(unsupported @ nearfield::Error::Unsupported { .. }) => Ok(unsupported.to_string()),
        _ => Err(error),
    }
}
