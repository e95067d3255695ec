//! Table 2: time to follow points that have moved: refit of the tree against builds of every structure.

use super::lab::{Lab, spots};
use super::measured::device_milliseconds;
use super::methods::{self, Plug, Positions, Start, shifted_sort};
use super::motion::Motion;
use super::original::{self, ByPoints, TABLE_2};
use super::plotting;
use super::rows::{Row, Sheet};
use crate::Result;
use crate::check::Expected;
use crate::measure::repeat;
use crate::plots::{Axes, Frame, Panel};

/// Movement between two updates, in diagonals.
const MOVEMENT: f64 = 0.0005;

/// Measures every row of the table with every method.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "table-2")?;
    for spot in spots(lab, &TABLE_2.map(|row| row.points)) {
        let original = TABLE_2.iter().find(|row| row.points == spot.paper_points);
        let radius = spot.length(original::R_OVER_L);
        let mut moved = spot.points.clone();
        Motion::Random(spot.length(MOVEMENT)).apply(&mut moved, 1);
        let mut expected = None;
        // Shifted sorts have no structure to update: all they do is part of a query.
        for plug in methods::possible(lab).filter(|plug| plug.name != shifted_sort::ON_GPU.name) {
            let mut row = spot.row(lab.device(plug.on_gpu), "", original::R_OVER_L, plug.name);
            row.quantity = "update";
            row.paper = original.and_then(|original| paper(original, plug)).map(|seconds| 1e3 * seconds);
            sheet.attempt(row.clone(), || {
                let expected = match &expected {
                    Some(expected) => expected,
                    None => expected.insert(Expected::of(&moved, radius)?),
                };
                let gpu = lab.gpu().filter(|_| plug.on_gpu);
                let both = [spot.points.clone(), moved.clone()].map(|points| Positions::new(gpu, points));
                let [before, after] = both;
                let (before, after) = (before?, after?);
                let mut method = (plug.make)(&Start { gpu, at: &before, radius, mean_neighbors: expected.mean() })?;
                let mut back = true;
                let (rebuilt, measured) = repeat(lab.effort(), || {
                    back = !back;
                    let update = method.update(if back { &before } else { &after })?;
                    Ok((update.rebuilt, update.stages))
                })?;
                method.update(&after)?;
                let judged = method.list(radius)?.check(gpu, expected)?;
                row.mean_neighbors = Some(expected.mean());
                row.device_milliseconds = device_milliseconds(&measured.stages);
                row.recall = judged.recall;
                row.runs = measured.runs;
                let how = if rebuilt { "built anew" } else { "refitted" };
                Ok(vec![row.value(measured.wall.median).note(format!("{how}; {}", judged.note))])
            })?;
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// The paper's time of what the method does.
fn paper(original: &ByPoints, plug: &Plug) -> Option<f64> {
    match plug.name {
        "grid, GPU" => Some(original.voxels),
        "kd-tree, CPU" => Some(original.kd_tree_cpu),
        name if name.starts_with("tree") && plug.on_gpu && !name.contains("always") => Some(original.refit),
        _ => None,
    }
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let panel = |title: &str, time: &dyn Fn(&Row) -> Option<f64>| {
        let timed: Vec<Row> = rows.iter().map(|row| Row { value: time(row), ..row.clone() }).collect();
        let mut series = plotting::by_method(timed.iter(), |row| row.points as f64);
        let here = |row: &ByPoints| rows.iter().find(|r| r.paper_points == row.points).map(|r| r.points as f64);
        let paper = |name: &str, color, seconds: &dyn Fn(&ByPoints) -> Option<f64>| {
            let point = |row: &ByPoints| Some((here(row)?, 1e3 * seconds(row)?));
            plotting::published(name, color, TABLE_2.iter().filter_map(point).collect())
        };
        series.push(paper("paper: refit, GPU", 1, &|row| Some(row.refit)));
        series.push(paper("paper: voxels, GPU", 3, &|row| Some(row.voxels)));
        series.push(paper("paper: kd-tree, CPU", 7, &|row| Some(row.kd_tree_cpu)));
        series.push(paper("paper: kd-tree, GPU", 2, &|row| row.kd_tree_gpu));
        Panel { title: title.to_owned(), series }
    };
    let frame = Frame {
        title: "Table 2: to follow points that have moved".to_owned(),
        caption: lab.caption(),
        x_label: "points".to_owned(),
        y_label: "milliseconds".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    let panels = [
        panel("wall clock, the device having finished", &|row| row.value),
        panel("by the clock of the device", &|row| row.device_milliseconds),
    ];
    let panels: Vec<Panel> = panels.into_iter().filter(|panel| panel.series.len() > 4).collect();
    plotting::save(lab, "table-2.svg", &frame, &panels)
}
