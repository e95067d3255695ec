//! What the paper says beside its figures: queries a millisecond, build and transfer by the time of a query, the share of merged
//! traversals, and what balancing the load gains.

use std::time::Instant;

use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::Gpu;
use nearfield::query::Counts;
use nearfield::{AabbTree, AabbTreeSettings, FixedRadius, GpuAabbTree, Vec3};

use super::figure_12::{BALANCED, Counted};
use super::lab::{Lab, Spot, spots};
use super::measured::{References, device_milliseconds, run_steps};
use super::methods::{self, Plug};
use super::motion::Motion;
use super::original;
use super::rows::{Row, Sheet};
use crate::Result;
use crate::check::Expected;
use crate::measure::repeat;
use crate::sets::SEED;

/// Movement of the points between two queries, in diagonals.
const MOVEMENT: f64 = 0.001;
/// Steps that a speed is the mean of.
const STEPS: usize = 10;

/// Measures each claim.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "claims")?;
    let spots = spots(lab, &[100_000, 500_000, 1_000_000]);
    let seconds = lab.seconds_a_point(4 * spots.len() * methods::possible(lab).count());
    for spot in &spots {
        for (own, setting) in [(true, "queries: the points"), (false, "queries: as many others")] {
            let mut row = spot.row(lab.device(lab.gpu().is_some()), setting, original::R_OVER_L, "coherent");
            (row.quantity, row.unit) = ("merged traversals", "%");
            sheet.attempt(row.clone(), || merged(lab, spot, row, own))?;
        }
        let mut row = spot.row(lab.device(lab.gpu().is_some()), "", original::R_OVER_L, "primary, balanced");
        (row.quantity, row.unit) = ("gain of balancing the load", "%");
        sheet.attempt(row.clone(), || match lab.gpu() {
            Some(gpu) => balancing(lab, gpu, spot, row),
            None => {
                let what = "balancing the load of lanes in step on the CPU".to_owned();
                Err(nearfield::Error::Unsupported { what, advice: "measure it on a GPU" }.into())
            }
        })?;
        for r_over_l in [original::R_OVER_L, original::R_OVER_L_OF_49] {
            let mut references = References::default();
            for plug in methods::possible(lab) {
                let mut row = spot.row(lab.device(plug.on_gpu), "", r_over_l, plug.name);
                (row.quantity, row.unit) = ("queries a millisecond, with the update", "queries/ms");
                sheet.attempt(row.clone(), || speed(lab, spot, plug, row, seconds, &mut references))?;
            }
        }
    }
    Ok(sheet.into_rows())
}

/// Queries a millisecond, and for trees the ratio of a build with its transfer to a query.
fn speed(
    lab: &Lab,
    spot: &Spot,
    plug: &Plug,
    mut row: Row,
    seconds: f64,
    references: &mut References,
) -> Result<Vec<Row>> {
    let (motion, radius) = (Motion::Random(spot.length(MOVEMENT)), spot.length(row.r_over_l));
    let steps = run_steps(lab, plug, (&spot.points, radius), motion, (STEPS, seconds), references)?;
    row.mean_neighbors = Some(steps.mean_neighbors);
    row.recall = steps.judged.recall;
    row.runs = steps.steps;
    row.note = steps.judged.note.to_owned();
    let is_coherent = plug.name.contains("coherent");
    let paper = (is_coherent && spot.paper_points == 1_000_000).then_some(original::QUERIES_A_MILLISECOND);
    let mut rows = vec![row.clone().value(spot.points.len() as f64 / steps.milliseconds).paper(paper)];
    let is_tree = plug.on_gpu && plug.name.starts_with("tree");
    if let (true, Some(gpu)) = (is_tree, lab.gpu()) {
        let start = Instant::now();
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        let tree = one.install(|| AabbTree::build(&spot.points, &AabbTreeSettings::default()))?;
        let copy = GpuAabbTree::upload(gpu, &tree)?;
        gpu.read_range(copy.nodes(), 0..1)?;
        let build = start.elapsed().as_secs_f64() * 1e3;
        let query = steps.milliseconds - steps.update;
        let note = format!(
            "build on one core and transfer {build:.2} ms by query {query:.2} ms; paper {:?}",
            original::BUILD_BY_QUERY
        );
        let ratio = row.of("build and transfer by query", "times").value(build / query).note(note);
        rows.push(
            ratio.paper(is_coherent.then_some(0.5 * (original::BUILD_BY_QUERY[0] + original::BUILD_BY_QUERY[1]))),
        );
    }
    Ok(rows)
}

/// Share of the traversals that packing saves.
fn merged(lab: &Lab, spot: &Spot, mut row: Row, own: bool) -> Result<Vec<Row>> {
    let radius = spot.length(row.r_over_l);
    let tree = Counted::new(lab, &spot.points)?;
    let n = spot.points.len();
    let counters = if own {
        let counters = tree.coherent(&FixedRadius::new(radius))?;
        Expected::of(&spot.points, radius)?.check_total(counters.neighbors)?;
        row.note = "total of neighbours checked".to_owned();
        counters
    } else {
        let others: Vec<Vec3> = cloud(CloudKind::Uniform, n, SEED + 1).points.iter().map(|p| *p * 2.0 - 1.0).collect();
        let counters = tree.coherent(&FixedRadius::new(radius).queries(&others))?;
        let grid = nearfield::UniformGrid::build(&spot.points, &nearfield::GridSettings::for_radius(radius))?;
        let counts = nearfield::NeighborSearch::count(&grid, &FixedRadius::new(radius).queries(&others))?;
        let total: u64 = counts.as_slice().iter().map(|&count| u64::from(count)).sum();
        // Pairs at the radius may count or not: at most a few in a million.
        if counters.neighbors.abs_diff(total) > 2 + total / 100_000 {
            return Err(format!("wrong answer: {} neighbours in all, the grid has {total}", counters.neighbors).into());
        }
        row.note = "total of neighbours checked against the grid".to_owned();
        counters
    };
    row.mean_neighbors = Some(counters.neighbors as f64 / n as f64);
    row.runs = 1;
    row.note += &format!("; {} traversals for {n} queries", counters.traversals);
    Ok(vec![row.value(100.0 * counters.merged_share()).paper(Some(original::MERGED_TRAVERSALS))])
}

/// By how many percent the first search does more queries in the same time when its load is balanced.
fn balancing(lab: &Lab, gpu: &Gpu, spot: &Spot, mut row: Row) -> Result<Vec<Row>> {
    let (radius, settings) = (spot.length(row.r_over_l), AabbTreeSettings::default());
    let tree = GpuAabbTree::build(gpu, &spot.points, &settings)?;
    let (question, expected) = (FixedRadius::new(radius), Expected::of(&spot.points, radius)?);
    let time = |invocations| -> Result<(f64, usize)> {
        let (counts, measured): (Counts, _) = repeat(lab.effort(), || {
            let counts = tree.count_primary(&question, invocations)?;
            let stages = counts.report.stages.clone();
            Ok((counts, stages))
        })?;
        expected.check_counts(counts.as_slice())?;
        Ok((device_milliseconds(&measured.stages).unwrap_or(measured.wall.median), measured.runs))
    };
    let ((one_each, runs), (balanced, _)) = (time(None)?, time(Some(BALANCED))?);
    row.mean_neighbors = Some(expected.mean());
    row.runs = runs;
    let note = format!(
        "counting: one query an invocation {one_each:.3} ms, {BALANCED} invocations {balanced:.3} ms; every count checked"
    );
    Ok(vec![row.value(100.0 * (one_each / balanced - 1.0)).paper(Some(original::LOAD_BALANCING)).note(note)])
}
