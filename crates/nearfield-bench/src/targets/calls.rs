//! Whole calls by the host's clock: small sets, and points from host memory with the list back there.

use nearfield::parallel::reduce;
use nearfield::query::NeighborSearch;
use nearfield::structure::GridBuilder;
use nearfield::{FixedRadius, GpuBruteForce, GpuListPlan, GpuNeighbors, GridSettings, SearchOnDevice};

use super::bench::Bench;
use super::row::{Figure, Outcome};
use crate::Result;
use crate::device::device_points;
use crate::device::timed::{self, Attempt};
use crate::measure::{Effort, repeat};

/// How much longer than the bare copies the call may take.
const OVER_TRANSFERS: f64 = 1.15;
/// Calls of a small set: their times spread more than those of kernels.
const CALLS: usize = 101;

/// One call after the other, each a list that stays on the device: by the grid and by brute force, each rebuilt with buffers from the pool, and by a plan
/// that keeps its memory. The target is for the fastest.
pub(super) fn small(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let (points, gpu) = (bench.set(set)?, bench.gpu.clone());
    let runs = if bench.effort().runs > 2 { CALLS } else { 2 };
    let effort = Effort { runs, ..bench.effort() };
    let (expected, question) = (points.expected()?, FixedRadius::new(points.radius));
    let input = points.upload(&gpu)?;
    let bounds = reduce::bounds(&points.points);
    let mut builder = GridBuilder::new(&gpu, input.len(), &bounds, &GridSettings::for_radius(points.radius))?;
    let by_grid = timed::list(&gpu, expected, effort, || {
        let grid = builder.build(&input)?;
        let list = grid.list_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&grid), list.report.stages.clone()].concat();
        Ok((list, stages))
    })?;
    let mut brute = GpuBruteForce::build_on_device(&gpu, &input)?;
    let by_brute_force = timed::list(&gpu, expected, effort, || {
        brute.replace_points(&input)?;
        let list = brute.list_on_device(&question)?;
        let stages = list.report.stages.clone();
        Ok((list, stages))
    })?;
    let by_host = |way: &str, attempt: &Attempt| match attempt {
        Ok(timed) => {
            let on_device = timed.measured.device.map(|device| format!("{:.4} ms of it on the device", device.median));
            Figure::by_host(format!("{way}, {}", timed.search), &timed.measured).note(on_device.unwrap_or_default())
        }
        Err(note) => Figure::missing(way, note.clone()),
    };
    let mut plan = GpuListPlan::new(&gpu, input.len(), &question)?;
    gpu.write(plan.points(), 0, &device_points(&points.points))?;
    let by_plan = timed::list(&gpu, expected, effort, || {
        let GpuNeighbors { offsets, indices, report, .. } = plan.list_on_device()?;
        let (offsets, indices, report) = (offsets.clone(), indices.clone(), report.clone());
        Ok((GpuNeighbors { offsets, indices, dist2: None, report }, Vec::new()))
    })?;
    let mut figures = vec![
        by_host("grid", &by_grid),
        by_host("brute force", &by_brute_force),
        by_host("plan that keeps its memory", &by_plan),
    ];
    let medians: Vec<f64> = figures.iter().map(|figure| figure.median()).collect();
    let fastest = medians.iter().copied().fold(f64::INFINITY, f64::min);
    for (figure, median) in figures.iter_mut().zip(medians) {
        figure.is_judged = median == fastest;
    }
    Ok(Outcome::of(expected.mean(), figures))
}

/// Points in host memory to the list there, by the grid. Target and floor come from copies of as many bytes without any work between
/// them, in the same run.
pub(super) fn from_host(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.short_effort());
    let (expected, question, n) = (points.expected()?, FixedRadius::new(points.radius), points.points.len());
    let (list, measured, peak) = timed::from_host(&gpu, &points.points, &question, expected, effort)?;
    let entries = list.indices().len();
    drop(list);

    let source = device_points(&points.points);
    let offsets = gpu.upload("offsets", &vec![1u32; n + 1])?;
    let indices = gpu.upload("indices", &vec![2u32; entries])?;
    let ((uploaded, back), transfers) = repeat(effort, || {
        let uploaded = gpu.upload("points", &source)?;
        let back = (gpu.read(&offsets)?, gpu.read(&indices)?);
        Ok(((uploaded, back), Vec::new()))
    })?;
    if gpu.read(&uploaded)? != source || back.0.iter().any(|&v| v != 1) || back.1.iter().any(|&v| v != 2) {
        return Err("wrong answer: copies differ from what was copied".into());
    }
    let bare = transfers.wall.median;
    let bytes = source.len() * size_of::<[f32; 4]>() + 4 * (n + 1 + entries);
    let note = format!(
        "{:.2} times the bare copies of {:.0} MB, {bare:.2} ms (fastest {:.2})",
        measured.wall.median / bare,
        bytes as f64 * 1e-6,
        transfers.wall.fastest
    );
    let figure = Figure::by_host("grid", &measured).note(note);
    let memory = super::row::Memory { points: n, structure: 0, peak, answer: 4 * (n + 1 + entries) as u64 };
    let figure = Figure { target: Some(OVER_TRANSFERS * bare), floor: Some(bare), memory, ..figure };
    Ok(Outcome::of(expected.mean(), vec![figure]))
}
