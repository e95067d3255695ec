//! Figure 19: the time of every step of a run of 250 k grains, and how often the tree is built anew.

use nearfield::application::particles::ParticleSearch;
use nearfield::structure::RebuildPolicy;

use super::case::{Case, Pace};
use super::figure_18;
use super::original::{FIGURE_19_PARTICLES, FIGURE_19_REBUILDS};
use super::timing::{self, StepTime};
use super::ways::{Way, devices};
use crate::Result;
use crate::measure::median;
use crate::paper::lab::Lab;
use crate::paper::plotting;
use crate::paper::rows::{Row, Sheet};
use crate::plots::{Axes, Frame, Look, Panel, Series};
use crate::provenance::COMMIT;

const SEARCHES: [ParticleSearch; 3] = [
    ParticleSearch::Coherent(RebuildPolicy::DEFAULT),
    ParticleSearch::UNIFORM_GRID,
    ParticleSearch::Verlet { skin: ParticleSearch::SKIN },
];
/// Marks of a line in the plot: each is the median of as many steps.
const MARKS: usize = 200;
/// Columns of the file with all steps.
const STEP_COLUMNS: [&str; 8] =
    ["device", "commit", "particles", "method", "step", "milliseconds", "mean_neighbors", "rebuilds"];

/// Measures all steps of the searches.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-19")?;
    let case = figure_18::of_size(lab, FIGURE_19_PARTICLES)?;
    let mut writer = csv::Writer::from_path(lab.path("figure-19-steps.csv"))?;
    writer.write_record(STEP_COLUMNS)?;
    let mut panels = Vec::new();
    let mut pace = Pace::of_searches(lab, devices(lab).len() * SEARCHES.len());
    for &on_gpu in devices(lab) {
        let mut series = Vec::new();
        for search in SEARCHES {
            let way = Way { search, on_gpu };
            let seconds = pace.next_share();
            let row = case.row(lab, on_gpu, way.name());
            sheet.attempt(row.clone(), || {
                let times = timing::each_step(lab, way, &case.scene, case.steps, 0.8 * seconds)?;
                for time in &times {
                    writer.write_record(record(lab, &case, way, time))?;
                }
                writer.flush()?;
                series.extend(lines(way, &times, series.len()));
                Ok(rows(&case, &row, &times))
            })?;
        }
        panels.push(Panel { title: if on_gpu { "GPU" } else { "CPU" }.to_owned(), series });
    }
    panels.retain(|panel| !panel.series.is_empty());
    let frame = Frame {
        title: format!("Figure 19: every step of {} grains", case.scene.particles.len()),
        caption: lab.caption(),
        x_label: "step".to_owned(),
        y_label: "ms, the device waited for after each step".to_owned(),
        axes: Axes::LogarithmicY,
        legend_right: true,
    };
    plotting::save(lab, "figure-19.svg", &frame, &panels)?;
    Ok(sheet.into_rows())
}

fn record(lab: &Lab, case: &Case, way: Way, time: &StepTime) -> [String; STEP_COLUMNS.len()] {
    [
        lab.device(way.on_gpu),
        COMMIT.to_owned(),
        case.scene.particles.len().to_string(),
        way.name(),
        time.step.to_string(),
        format!("{:.6}", time.milliseconds),
        format!("{:.4}", time.mean_neighbors),
        time.rebuilds.to_string(),
    ]
}

fn rows(case: &Case, row: &Row, times: &[StepTime]) -> Vec<Row> {
    let milliseconds = |rebuilt: bool| -> Vec<f64> {
        times.iter().filter(|time| (time.rebuilds > 0) == rebuilt).map(|time| time.milliseconds).collect()
    };
    let (without, with) = (milliseconds(false), milliseconds(true));
    let rebuilds: u32 = times.iter().map(|time| time.rebuilds).sum();
    let mut all: Vec<f64> = times.iter().map(|time| time.milliseconds).collect();
    all.sort_by(f64::total_cmp);
    let neighbors = times.iter().map(|time| time.mean_neighbors).sum::<f64>() / times.len().max(1) as f64;
    let cut = if times.len() < case.steps as usize {
        format!(" of {}, in the time of a row", case.steps)
    } else {
        String::new()
    };
    let note = format!("{} steps{cut}; the step whole: search, forces, motion, report", times.len());
    let row = Row { mean_neighbors: Some(neighbors), runs: times.len(), note, ..row.clone() };
    let last = all.len().saturating_sub(1);
    let of_all = |part: f64| all.get((part * last as f64).round() as usize).copied().unwrap_or(0.0);
    let mut rows = vec![
        row.of("a step, median", "ms").value(of_all(0.5)),
        row.of("a step, 99 of 100 are faster", "ms").value(of_all(0.99)),
        row.of("a step, mean", "ms").value(all.iter().sum::<f64>() / all.len().max(1) as f64),
    ];
    if !with.is_empty() {
        rows.push(row.of("a step with a rebuild, median", "ms").value(median(&with)));
        rows.push(row.of("a step without a rebuild, median", "ms").value(median(&without)));
    }
    if row.method.starts_with("uniform-grid") {
        return rows;
    }
    // A run that was cut short has fewer rebuilds than a whole one.
    let is_whole = row.method.starts_with("coherent") && times.len() == super::original::STEPS as usize;
    rows.push(row.of("rebuilds", "times").value(rebuilds.into()).paper(is_whole.then_some(FIGURE_19_REBUILDS)));
    rows
}

/// The median of every few steps, and the steps with a rebuild one by one.
fn lines(way: Way, times: &[StepTime], color: usize) -> Vec<Series> {
    let middle = |some: &[StepTime]| {
        let milliseconds: Vec<f64> = some.iter().map(|time| time.milliseconds).collect();
        let step = some.iter().map(|time| time.step as f64).sum::<f64>() / some.len() as f64;
        (step, median(&milliseconds))
    };
    let points = times.chunks(times.len().div_ceil(MARKS).max(1)).map(middle).collect();
    let mut series = vec![Series { name: way.name(), color, points, look: Look::Line }];
    let rebuilt: Vec<(f64, f64)> =
        times.iter().filter(|time| time.rebuilds > 0).map(|time| (time.step as f64, time.milliseconds)).collect();
    if !rebuilt.is_empty() {
        let name = format!("{}, with a rebuild", way.name());
        series.push(Series { name, color: color + 1, points: rebuilt, look: Look::Dots });
    }
    series
}
