//! Figure 7: refit of the tree with its nodes level by level against nodes in random order, and the library's own refit.

use nearfield::gpu::{Commands, Gpu, StageTime};
use nearfield::query::{Clock, Stage};
use nearfield::{AabbTree, AabbTreeSettings, FixedRadius, GpuAabbTree, NeighborSearch};

use super::lab::{Lab, Spot, spots};
use super::original::{self, TABLE_2};
use super::plotting;
use super::refit::{LevelRefit, Placing};
use super::rows::{Row, Sheet};
use crate::Result;
use crate::measure::{Measured, repeat};
use crate::plots::{Axes, Frame, Panel};

const BY_LEVEL: &str = "nodes level by level";
const SHUFFLED: &str = "nodes shuffled";
const LIBRARY: &str = "library: several levels a dispatch";

/// Measures every point of the figure; nothing without a GPU.
///
/// # Errors
/// What a device returns; a wrong box; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-7")?;
    for spot in spots(lab, &TABLE_2.map(|row| row.points)) {
        let Some(gpu) = lab.gpu() else {
            let row = spot.row(lab.device(false), "", original::R_OVER_L, "every refit");
            sheet.add(Row { quantity: "refit", ..row }.note("missing: it compares kernels, and there is no GPU"))?;
            break;
        };
        let mut made: Option<(AabbTree, f64)> = None;
        for method in [BY_LEVEL, SHUFFLED, LIBRARY] {
            let mut row = spot.row(lab.device(true), "", original::R_OVER_L, method);
            row.quantity = "refit";
            let paper = TABLE_2.iter().find(|row| row.points == spot.paper_points).map(|row| 1e3 * row.refit);
            row.paper = paper.filter(|_| method == BY_LEVEL);
            sheet.attempt(row.clone(), || {
                let (tree, mean) = match &made {
                    Some(made) => made,
                    None => made.insert(tree_of(&spot)?),
                };
                let measured = refit(lab, gpu, tree, method)?;
                row.mean_neighbors = Some(*mean);
                row.runs = measured.runs;
                row.device_milliseconds = measured.device.map(|timing| timing.median);
                let time = row.device_milliseconds.unwrap_or(measured.wall.median);
                Ok(vec![row.value(time).note("every box checked against the CPU's")])
            })?;
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// The tree, and the neighbours of a point.
fn tree_of(spot: &Spot) -> Result<(AabbTree, f64)> {
    let tree = AabbTree::build(&spot.points, &AabbTreeSettings::default())?;
    let counts = tree.count(&FixedRadius::new(spot.length(original::R_OVER_L)))?.into_vec();
    let total: u64 = counts.iter().map(|&count| u64::from(count)).sum();
    Ok((tree, total as f64 / counts.len().max(1) as f64))
}

fn refit(lab: &Lab, gpu: &Gpu, tree: &AabbTree, method: &str) -> Result<Measured> {
    let time = |record: &dyn Fn(&mut Commands)| {
        let once = || {
            let mut commands = gpu.commands("refit");
            commands.stage("refit");
            record(&mut commands);
            Ok(((), device_stages(&commands.run()?)))
        };
        repeat(lab.effort(), once).map(|((), measured)| measured)
    };
    let (measured, boxes) = match method {
        LIBRARY => {
            let copy = GpuAabbTree::upload(gpu, tree)?;
            let measured = time(&|commands| copy.record_fit(commands))?;
            (measured, copy.read()?.boxes().to_vec())
        }
        _ => {
            let placing = if method == SHUFFLED { Placing::Shuffled } else { Placing::ByLevel };
            let copy = LevelRefit::new(gpu, tree, placing)?;
            let measured = time(&|commands| copy.record(commands))?;
            (measured, copy.boxes()?)
        }
    };
    if let Some(node) = boxes.iter().zip(tree.boxes()).position(|(found, expected)| found != expected) {
        let (found, expected) = (boxes[node], tree.boxes()[node]);
        return Err(format!("wrong answer: node {node} has the box {found:?}, expected {expected:?}").into());
    }
    Ok(measured)
}

fn device_stages(times: &[StageTime]) -> Vec<Stage> {
    let stage = |t: &StageTime| Some(Stage { name: t.name, milliseconds: t.milliseconds?, clock: Clock::Device });
    times.iter().filter_map(stage).collect()
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let x = |row: &Row| row.points as f64;
    let mut series = plotting::by_method(rows.iter(), x);
    series.push(plotting::published_of("paper: level by level (its table 2)", 0, rows.iter(), x));
    let frame = Frame {
        title: "Figure 7: refit of the tree".to_owned(),
        caption: lab.caption(),
        x_label: "points".to_owned(),
        y_label: "milliseconds on the device".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: false,
    };
    let measured = rows.iter().any(|row| row.value.is_some());
    let panels = if measured { vec![Panel { title: String::new(), series }] } else { Vec::new() };
    plotting::save(lab, "figure-7.svg", &frame, &panels)
}
