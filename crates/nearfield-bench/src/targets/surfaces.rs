//! Smoothing, resampling, distance fields and contours of scans.

use nearfield::application::{
    ContourSettings, DistanceMode, DistanceSettings, GpuOrientedSamples, NodeValues, Offset, Watch, contour_on_gpu,
    grid_around,
};
use nearfield::query::Clock;
use nearfield::{Aabb, DVec3, RegularGrid, TreeSearch, WlopSettings, WlopVariant};

use super::bench::Bench;
use super::row::{Figure, Outcome, Value};
use crate::Result;
use crate::applications::field::{Samples, Timed};
use crate::applications::figure_14::NOISE;
use crate::applications::figure_17::{checked_topology, left_on_device};
use crate::applications::original::{
    BAND, FIGURE_14, FIGURE_15_FILE, FIGURE_15_ITERATIONS, FIGURE_15_SAMPLES, OFFSET, RESOLUTION, SMOOTHING_ITERATIONS,
    TABLE_3,
};
use crate::applications::scans::Scan;
use crate::applications::smoothing::{Fused, Smoothed, Task, check_points, one_iteration};
use crate::applications::table_3::resolution;
use crate::measure::repeat;
use crate::wlop::times::{Cloud, KITTEN};

/// Seconds after which smoothing is not continued.
const SECONDS: f64 = 20.0;

/// Thirty iterations of planes by the fastest way, and of heights of degree 1; points after the first one must be where the CPU brings
/// them.
pub(super) fn smoothing(bench: &mut Bench) -> Result<Outcome> {
    let workshop = bench.workshop()?;
    let model = &FIGURE_14[2];
    let scan = Scan::new(&workshop, model.file, model.points, NOISE)?;
    let radius = scan.radius_for(model.neighbors)?;
    let task = Task { points: &scan.points, radius, iterations: SMOOTHING_ITERATIONS, seconds: SECONDS };
    let (mut figures, mut mean_neighbors) = (Vec::new(), None);
    for (fused, degree, name) in [
        (Fused::FixedGrid(128), 0, "planes, grid of 128³ cells"),
        (Fused::Tree(TreeSearch::Packed), 1, "heights of degree 1, tree refitted"),
    ] {
        let smoothed: Smoothed = fused.run(&workshop.lab, task, degree)?;
        if smoothed.iterations < SMOOTHING_ITERATIONS {
            figures.push(Figure::missing(name, format!("{} iterations in {SECONDS} s", smoothed.iterations)));
            continue;
        }
        if !smoothed.points.iter().all(|point| point.is_finite()) {
            return Err("wrong answer: points that are no place".into());
        }
        check_points(&smoothed.first, &one_iteration(task, degree)?, scan.body.diagonal)?;
        let note = format!(
            "{} points of {}, {:.1} neighbours in the last iteration",
            scan.points.len(),
            scan.body.name,
            smoothed.mean_neighbors
        );
        mean_neighbors = Some(smoothed.mean_neighbors);
        figures.push(once(name, smoothed.total).note(note));
    }
    Ok(Outcome { mean_neighbors, figures })
}

/// A hundred iterations of locally optimal projection, transfers and tree included, by two variants; the first iteration must be the
/// CPU's.
pub(super) fn resampling(bench: &mut Bench) -> Result<Outcome> {
    let (gpu, file) = (bench.gpu.clone(), bench.data.join(FIGURE_15_FILE));
    let has_file = file.is_file() && bench.scaled(KITTEN) == KITTEN;
    let cloud = Cloud::new(has_file.then_some(file.as_path()), bench.scaled(KITTEN))?;
    let (count, iterations) =
        (bench.scaled(FIGURE_15_SAMPLES).min(cloud.points.len() / 2), FIGURE_15_ITERATIONS as u32);
    let mut figures = Vec::new();
    for variant in [WlopVariant::Authors, WlopVariant::Best] {
        let settings = WlopSettings { tolerance: 0.0, ..WlopSettings::new(variant).iterations(iterations) };
        let (radius, run) = cloud.project(Some(&gpu), count, &settings)?;
        let n = run.reports.len() as f64;
        let around = run.reports.iter().map(|report| report.mean_inputs).sum::<f64>() / n;
        let among = run.reports.iter().map(|report| report.mean_samples).sum::<f64>() / n;
        let body = if has_file { FIGURE_15_FILE } else { "a torus" };
        let note = format!(
            "{} points of {body} to {count} samples, radius {radius:.5}: {around:.0} points and {among:.0} samples around a sample",
            cloud.points.len()
        );
        figures.push(once(variant.to_string(), run.milliseconds).note(note));
    }
    Ok(Outcome::without_neighbors(figures))
}

/// The grid of the field within four widths.
fn narrow_grid(scan: &Scan) -> Result<RegularGrid> {
    let side = resolution(RESOLUTION, scan.points.len(), TABLE_3[0].points);
    Ok(grid_around(DVec3::ZERO, &Aabb::of_points(&scan.points), side, BAND)?)
}

/// A field of 257³ nodes within four widths, from samples in host memory to values there; the part on the device beside it.
pub(super) fn field(bench: &mut Bench) -> Result<Outcome> {
    let scan = bench.scan()?;
    let grid = narrow_grid(&scan)?;
    whole_field(bench, &scan, &grid, &DistanceSettings::default().band(BAND))
}

/// The field within a fifth of the diagonal, from which surfaces at that distance are contoured.
pub(super) fn offset_field(bench: &mut Bench) -> Result<Outcome> {
    let scan = bench.scan()?;
    let side = resolution(RESOLUTION, scan.points.len(), TABLE_3[0].points);
    let offset = Offset::Signed(OFFSET * scan.body.diagonal);
    let grid = offset.grid(DVec3::ZERO, &Aabb::of_points(&scan.points), side)?;
    let band = offset.band(&grid) / f64::from(grid.spacing());
    whole_field(bench, &scan, &grid, &DistanceSettings::default().band(band))
}

fn whole_field(bench: &mut Bench, scan: &Scan, grid: &RegularGrid, settings: &DistanceSettings) -> Result<Outcome> {
    let (gpu, effort) = (bench.gpu.clone(), bench.short_effort());
    let samples = Samples { points: &scan.points, normals: &scan.normals };
    let Timed { field, field_ms, device_ms, total_ms, runs } = samples.field_on_gpu(&gpu, grid, settings, effort)?;
    let checked = samples.check(&field, settings)?;
    let mean = samples.mean_neighbors(&field, settings);
    let mode: DistanceMode = settings.mode;
    let note = format!(
        "{} samples of {}, {} nodes a side, mode {mode}, {:.1} % of the nodes have a value; {checked}",
        scan.points.len(),
        scan.body.name,
        grid.nodes()[0],
        100.0 * field.n_defined() as f64 / grid.n_nodes() as f64
    );
    let whole = Value { runs, ..once("", total_ms).value.ok_or("a value was given")? };
    let on_device = Value {
        median: device_ms.unwrap_or(field_ms),
        fastest: device_ms.unwrap_or(field_ms),
        clock: Some(if device_ms.is_some() { Clock::Device } else { Clock::Host }),
        runs,
    };
    Ok(Outcome::of(
        mean,
        vec![
            Figure::value("with tree and copies", whole).note(note),
            Figure::value("the field alone", on_device).beside(),
        ],
    ))
}

/// The surface of the narrow field: triangles left on the device, and a mesh without intersections on the host.
pub(super) fn contour(bench: &mut Bench) -> Result<Outcome> {
    let (scan, gpu, effort) = (bench.scan()?, bench.gpu.clone(), bench.short_effort());
    let grid = narrow_grid(&scan)?;
    let settings = DistanceSettings::default().band(BAND);
    let field = GpuOrientedSamples::build(&gpu, &scan.points, &scan.normals)?.distance_field(&grid, &settings)?;
    let (triangles, measured) = left_on_device(&gpu, &field, &grid, 0.0, effort)?;
    let there = Figure::by_host("values and triangles on the device", &measured);
    let there = there.note(format!("{triangles} triangles, before flipped ones are looked for"));
    let distances = field.read_distances()?;
    let values = NodeValues::from(&distances);
    let (surface, measured) = repeat(effort, || {
        Ok((contour_on_gpu(&gpu, &values, &ContourSettings::default(), &mut Watch::none())?, Vec::new()))
    })?;
    let topology = checked_topology(&surface.mesh())?;
    let back = Figure::by_host("values and mesh on the host, untangled", &measured).note(format!(
        "{} triangles, manifold and oriented, Euler number {}, {} intersections left",
        topology.triangles,
        topology.euler_number(),
        surface.report().intersections
    ));
    Ok(Outcome::without_neighbors(vec![there, back]))
}

/// Milliseconds of one run by the host's clock.
fn once(way: impl Into<String>, milliseconds: f64) -> Figure {
    Figure::value(way, Value { median: milliseconds, fastest: milliseconds, clock: Some(Clock::Host), runs: 1 })
}
