//! What the paper says beside its figures: build and transfer by the time of a query, and queries a millisecond.

use std::time::Instant;

use nearfield::{AabbTree, AabbTreeSettings, GpuAabbTree};

use super::lab::{Lab, Spot, spots};
use super::measured::{References, run_steps};
use super::methods::{self, Plug};
use super::motion::Motion;
use super::original;
use super::rows::{Row, Sheet};
use crate::Result;

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
    if let (true, Some(gpu)) = (plug.on_gpu && plug.name.contains("tree") && !plug.name.contains("kd"), lab.gpu()) {
        let start = Instant::now();
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        let tree = one.install(|| AabbTree::build(&spot.points, &AabbTreeSettings::default()))?;
        let copy = GpuAabbTree::upload(gpu, &tree)?;
        gpu.read_range(copy.nodes(), 0..1)?;
        let build = start.elapsed().as_secs_f64() * 1e3;
        let query = steps.milliseconds - steps.update;
        let note = format!("build on one core and transfer {build:.2} ms by query {query:.2} ms; paper {:?}", original::BUILD_BY_QUERY);
        let ratio = row.of("build and transfer by query", "times").value(build / query).note(note);
        rows.push(ratio.paper(is_coherent.then_some(0.5 * (original::BUILD_BY_QUERY[0] + original::BUILD_BY_QUERY[1]))));
    }
    Ok(rows)
}
