//! Figure 10: time of a step, update and query together, over the number of points; random movements of four ranges, three radii,
//! every method.

use super::lab::{Lab, spots};
use super::measured::{References, run_steps};
use super::methods;
use super::motion::Motion;
use super::original;
use super::plotting;
use super::rows::{Row, Sheet};
use crate::Result;
use crate::plots::{Axes, Frame, Panel};

/// Ranges of the movement along each axis in diagonals. The paper does not give its own: three small ones and one at which trees are
/// built anew in every step.
const RANGES: [f64; 4] = [0.0005, 0.001, 0.005, 0.05];
/// Radii in diagonals.
const RADII: [f64; 3] = [original::R_OVER_L, original::R_OVER_L_OF_49, 0.005];
const QUANTITY: &str = "update + query";

fn setting(range: f64) -> String {
    format!("movement {range} L")
}

/// Measures every point of the charts.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-10")?;
    let spots = spots(lab, &original::POINTS);
    let n_methods = methods::possible(lab).count();
    let seconds = lab.seconds_a_point(2 * spots.len() * RANGES.len() * RADII.len() * n_methods);
    // The paper's own radius first, with every movement, in case the budget ends early.
    for r_over_l in RADII {
        for spot in &spots {
            let mut references = References::default();
            for range in RANGES {
                for plug in methods::possible(lab) {
                    let mut row = spot.row(lab.device(plug.on_gpu), &setting(range), r_over_l, plug.name);
                    row.quantity = QUANTITY;
                    row.paper = paper(spot.paper_points, r_over_l, plug.name);
                    let motion = Motion::Random(spot.length(range));
                    sheet.attempt(row.clone(), || {
                        let case = (&spot.points[..], spot.length(r_over_l));
                        let steps = run_steps(lab, plug, case, motion, (original::STEPS, seconds), &mut references)?;
                        let note =
                            format!("{}; {} of {} steps rebuilt", steps.judged.note, steps.rebuilds, steps.steps);
                        row.mean_neighbors = Some(steps.mean_neighbors);
                        row.device_milliseconds = steps.device;
                        row.recall = steps.judged.recall;
                        row.runs = steps.steps;
                        Ok(vec![row.value(steps.milliseconds).note(note)])
                    })?;
                }
            }
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// The paper's 1600 queries a millisecond, of the coherent search among a million points.
fn paper(points: usize, r_over_l: f64, method: &str) -> Option<f64> {
    let is_it = points == 1_000_000 && r_over_l >= original::R_OVER_L && method.contains("coherent");
    is_it.then_some(points as f64 / original::QUERIES_A_MILLISECOND)
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    for (number, range) in RANGES.into_iter().enumerate() {
        let panel = |r_over_l: f64| {
            let own: Vec<&Row> =
                rows.iter().filter(|r| r.setting == setting(range) && r.r_over_l == r_over_l).collect();
            let neighbors = own.iter().filter_map(|r| r.mean_neighbors).fold(0.0, f64::max);
            let mut series = plotting::by_method(own.iter().copied(), |row| row.points as f64);
            if r_over_l >= original::R_OVER_L {
                let time = 1e6 / original::QUERIES_A_MILLISECOND;
                let million = rows.iter().find(|r| r.paper_points == 1_000_000).map_or(1e6, |r| r.points as f64);
                series.push(plotting::published("paper: coherent, 1600 queries/ms at 1 M", 0, vec![(million, time)]));
            }
            Panel { title: format!("r = {r_over_l} L, up to {neighbors:.1} neighbours"), series }
        };
        let frame = Frame {
            title: format!("Figure 10: a step of moving points, {}", setting(range)),
            caption: lab.caption(),
            x_label: "points".to_owned(),
            y_label: "ms a step: update and lists".to_owned(),
            axes: Axes::Logarithmic,
            legend_right: false,
        };
        let panels: Vec<Panel> = RADII.map(panel).into_iter().filter(|p| !p.series.is_empty()).collect();
        plotting::save(lab, &format!("figure-10-{}.svg", number + 1), &frame, &panels)?;
    }
    Ok(())
}
