//! Figure 19: the time of every step of a run of 250 k grains, of searches by themselves at sampled steps, and when the tree is built anew.

use std::fs::File;

use nearfield::application::particles::ParticleSearch;
use nearfield::structure::RebuildPolicy;

use super::case::{Case, Pace};
use super::figure_18;
use super::original::{FIGURE_19_PARTICLES, FIGURE_19_REBUILDS};
use super::shifted_sort;
use super::timing::{self, StepTime};
use super::ways::{Way, devices, method};
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
/// Colour of the line of shifted sorts, behind those of the searches.
const SORTED_COLOR: usize = 3 * SEARCHES.len();
/// Marks of a line in the plot: each is the median of as many steps.
const MARKS: usize = 200;
/// Steps of a run after which a search by itself is timed.
const SEARCHES_OF_A_RUN: u32 = 100;
/// Share of the budget for shifted sorts.
const SHIFTED_SORT_SHARE: f64 = 0.1;
/// The quantity of a search by itself.
const SEARCH: &str = "a search alone, median";
/// Columns of the file with all steps. A shifted sort has no step of its own, only a search; others have one where it was timed.
const STEP_COLUMNS: [&str; 9] = [
    "device",
    "commit",
    "particles",
    "method",
    "step",
    "milliseconds",
    "search_milliseconds",
    "mean_neighbors",
    "rebuilds",
];

/// Measures all steps of the searches.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-19")?;
    let case = figure_18::of_size(lab, FIGURE_19_PARTICLES)?;
    let mut writer = csv::Writer::from_path(lab.path("figure-19-steps.csv"))?;
    writer.write_record(STEP_COLUMNS)?;
    let sorted = shifted_sorts(lab, &case, &mut sheet, &mut writer)?;
    let mut panels = Vec::new();
    let search_every = (case.steps / SEARCHES_OF_A_RUN).max(1);
    let mut pace = Pace::of_searches(lab, devices(lab).len() * SEARCHES.len());
    for &on_gpu in devices(lab) {
        let mut series = Vec::new();
        for search in SEARCHES {
            let way = Way { search, on_gpu };
            let seconds = pace.next_share();
            let row = case.row(lab, on_gpu, way.name());
            sheet.attempt(row.clone(), || {
                let times = timing::each_step(lab, way, &case.scene, (case.steps, search_every), 0.8 * seconds)?;
                for time in &times {
                    writer.write_record(record(lab, &case, way, time))?;
                }
                writer.flush()?;
                series.extend(lines(way, &times, series.len()));
                Ok(rows(&case, &row, &times))
            })?;
        }
        if on_gpu {
            series.extend(sorted.clone());
        }
        panels.push(Panel { title: if on_gpu { "GPU" } else { "CPU" }.to_owned(), series });
    }
    panels.retain(|panel| !panel.series.is_empty());
    let frame = Frame {
        title: format!("Figure 19: every step of {} grains", case.scene.particles.len()),
        caption: lab.caption(),
        x_label: "step".to_owned(),
        y_label: "ms of a step, or of a search alone; the device waited for".to_owned(),
        axes: Axes::LogarithmicY,
        legend_right: true,
    };
    plotting::save(lab, "figure-19.svg", &frame, &panels)?;
    Ok(sheet.into_rows())
}

/// Rows of shifted sorts at sampled moments, and their line.
fn shifted_sorts(
    lab: &Lab,
    case: &Case,
    sheet: &mut Sheet<'_>,
    writer: &mut csv::Writer<File>,
) -> Result<Option<Series>> {
    let on_gpu = lab.gpu().is_some();
    let name = method(shifted_sort::NAME, on_gpu);
    let row = case.row(lab, on_gpu, name.clone()).of(SEARCH, "ms");
    let mut line = None;
    sheet.attempt(row.clone(), || {
        let sampled = shifted_sort::sample(lab, case, SHIFTED_SORT_SHARE * lab.budget)?;
        for (step, milliseconds) in &sampled.times {
            writer.write_record([
                lab.device(on_gpu),
                COMMIT.to_owned(),
                case.scene.particles.len().to_string(),
                name.clone(),
                step.to_string(),
                String::new(),
                format!("{milliseconds:.6}"),
                format!("{:.4}", sampled.mean_neighbors),
                "0".to_owned(),
            ])?;
        }
        writer.flush()?;
        let points = sampled.times.iter().map(|&(step, milliseconds)| (step as f64, milliseconds)).collect();
        line = Some(Series { name: format!("{name}, search alone"), color: SORTED_COLOR, points, look: Look::Line });
        let note = format!("k {}, the largest count at {} moments of a run", sampled.k, sampled.times.len());
        let (mean_neighbors, recall) = (Some(sampled.mean_neighbors), Some(sampled.recall));
        let row = Row { mean_neighbors, recall, runs: sampled.times.len(), note, ..row.clone() };
        Ok(vec![row.value(sampled.milliseconds())])
    })?;
    Ok(line)
}

fn record(lab: &Lab, case: &Case, way: Way, time: &StepTime) -> [String; STEP_COLUMNS.len()] {
    [
        lab.device(way.on_gpu),
        COMMIT.to_owned(),
        case.scene.particles.len().to_string(),
        way.name(),
        time.step.to_string(),
        format!("{:.6}", time.milliseconds),
        time.search.map_or(String::new(), |milliseconds| format!("{milliseconds:.6}")),
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
    let searches: Vec<f64> = times.iter().filter_map(|time| time.search).collect();
    if !searches.is_empty() {
        let row = Row { runs: searches.len(), ..row.of(SEARCH, "ms") };
        let note = "outside the run's time: the structure fitted, built or checked as in a step, and all neighbours counted by it";
        rows.push(row.value(median(&searches)).note(note));
    }
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

/// The median of every few steps, the searches alone, and the steps with a rebuild one by one.
fn lines(way: Way, times: &[StepTime], color: usize) -> Vec<Series> {
    let middle = |some: &[StepTime]| {
        let milliseconds: Vec<f64> = some.iter().map(|time| time.milliseconds).collect();
        let step = some.iter().map(|time| time.step as f64).sum::<f64>() / some.len() as f64;
        (step, median(&milliseconds))
    };
    let points = times.chunks(times.len().div_ceil(MARKS).max(1)).map(middle).collect();
    let mut series = vec![Series { name: way.name(), color, points, look: Look::Line }];
    let searches: Vec<(f64, f64)> = times.iter().filter_map(|time| Some((time.step as f64, time.search?))).collect();
    if !searches.is_empty() {
        let name = format!("{}, search alone", way.name());
        series.push(Series { name, color: color + 1, points: searches, look: Look::Line });
    }
    let rebuilt: Vec<(f64, f64)> =
        times.iter().filter(|time| time.rebuilds > 0).map(|time| (time.step as f64, time.milliseconds)).collect();
    if !rebuilt.is_empty() {
        let name = format!("{}, with a rebuild", way.name());
        series.push(Series { name, color: color + 2, points: rebuilt, look: Look::Dots });
    }
    series
}
