//! Figure 9: steps a second over the largest growth of a box, with rebuilding off.
//!
//! The paper moves the points by a simulation of particles; here they move at random and along vortices, up to half a radius a step.

use std::time::Instant;

use nearfield::structure::aabb_tree::NodeBox;
use nearfield::{AabbTree, AabbTreeSettings, FixedRadius, GpuAabbTree, NeighborSearch, SearchOnDevice, TreeSearch};

use super::growth::largest_ratio;
use super::lab::{Lab, Spot};
use super::methods::{Found, Positions};
use super::motion::Motion;
use super::original;
use super::plotting;
use super::rows::{Row, Sheet};
use crate::Result;
use crate::check::Expected;
use crate::plots::{Axes, Frame, Look, Panel, Series};

/// Points at scale 1: those of the paper's simulation.
const POINTS: usize = 250_000;
/// Steps; the paper's boxes had grown 150 times after 400.
const STEPS: usize = 400;
const SPEED: &str = "steps a second";
const GROWTH: &str = "largest growth of a box";
const MOTIONS: [&str; 2] = ["random, r/2 a step", "vortices, r/2 a step"];

/// Searches that are compared.
const SEARCHES: [TreeSearch; 3] = [TreeSearch::Coherent, TreeSearch::Primary, TreeSearch::Packed];

/// A tree that is refitted and never built anew.
enum Tree {
    OnGpu(Box<GpuAabbTree>),
    OnCpu(Box<AabbTree>),
}

impl Tree {
    fn refit(&mut self, at: &Positions) -> Result<()> {
        match self {
            Self::OnGpu(tree) => drop(tree.refit(at.on_device())?),
            Self::OnCpu(tree) => tree.refit(&at.host)?,
        }
        Ok(())
    }

    fn list(&self, radius: f32) -> Result<Found> {
        let question = FixedRadius::new(radius);
        Ok(match self {
            Self::OnGpu(tree) => Found::OnDevice(tree.list_on_device(&question)?),
            Self::OnCpu(tree) => Found::OnHost(tree.list(&question)?),
        })
    }

    fn boxes(&self) -> Result<Vec<NodeBox>> {
        Ok(match self {
            Self::OnGpu(tree) => tree.read()?.boxes().to_vec(),
            Self::OnCpu(tree) => tree.boxes().to_vec(),
        })
    }
}

/// Measures both motions with each search.
///
/// # Errors
/// What a tree returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-9")?;
    let spot = Spot::new(lab, POINTS);
    let step = spot.length(0.5 * original::R_OVER_L);
    for (motion, name) in [Motion::Random(step), Motion::Vortices(step)].into_iter().zip(MOTIONS) {
        for search in SEARCHES {
            let on_gpu = lab.gpu().is_some();
            let method = format!("tree {}, never rebuilt, {}", search.name(), if on_gpu { "GPU" } else { "CPU" });
            let row = spot.row(lab.device(on_gpu), name, original::R_OVER_L, &method);
            let seconds = lab.seconds_a_point(MOTIONS.len() * SEARCHES.len());
            sheet
                .attempt(Row { quantity: SPEED, ..row.clone() }, || run(lab, &spot, (motion, search), &row, seconds))?;
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// Two rows for each step that is noted: growth and speed.
fn run(lab: &Lab, spot: &Spot, (motion, search): (Motion, TreeSearch), row: &Row, seconds: f64) -> Result<Vec<Row>> {
    let (gpu, radius) = (lab.gpu(), spot.length(original::R_OVER_L));
    let settings = AabbTreeSettings::default().search(search);
    let mut tree = match gpu {
        Some(gpu) => Tree::OnGpu(Box::new(GpuAabbTree::build(gpu, &spot.points, &settings)?)),
        None => Tree::OnCpu(Box::new(AabbTree::build(&spot.points, &settings)?)),
    };
    let at_build = tree.boxes()?;
    let mut at = Positions::new(gpu, spot.points.clone())?;
    drop(tree.list(radius)?);
    let (mut rows, begin, mut since_last) = (Vec::new(), Instant::now(), Vec::new());
    for step in 1..=STEPS {
        let mut moved = std::mem::take(&mut at.host);
        motion.apply(&mut moved, step as u64);
        at = Positions::new(gpu, moved)?;
        let start = Instant::now();
        tree.refit(&at)?;
        let found = tree.list(radius)?;
        since_last.push(start.elapsed().as_secs_f64());
        let is_last = step == STEPS || begin.elapsed().as_secs_f64() > seconds;
        if is_noted(step) || is_last {
            let expected = Expected::of(&at.host, radius)?;
            let judged = found.check(gpu, &expected)?;
            let growth = largest_ratio(&tree.boxes()?, &at_build, radius);
            let fps = since_last.len() as f64 / since_last.iter().sum::<f64>();
            let mut noted = row.clone();
            noted.mean_neighbors = Some(expected.mean());
            noted.runs = since_last.len();
            noted.setting = format!("{}, {step} steps after the build", row.setting);
            noted.note = judged.note.to_owned();
            rows.push(noted.of(GROWTH, "times").value(growth));
            rows.push(noted.of(SPEED, "steps/s").value(fps));
            since_last.clear();
        }
        if is_last {
            if step < STEPS {
                let cut = format!("missing: steps {} to {STEPS}, for the budget", step + 1);
                rows.push(Row { mean_neighbors: None, ..row.of(SPEED, "steps/s") }.note(cut));
            }
            break;
        }
    }
    Ok(rows)
}

/// Steps after which growth and speed are noted: 1, 2, 4, 7, 10, 20, 40, 70, 100 …
fn is_noted(step: usize) -> bool {
    let power = 10usize.pow(step.ilog10());
    step.is_multiple_of(power) && [1, 2, 4, 7].contains(&(step / power))
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let panel = |motion: &str| {
        // The rows of a noted step stand in pairs: growth, then speed.
        let mut series: Vec<Series> = Vec::new();
        let pairs = rows
            .windows(2)
            .filter(|w| w[0].quantity == GROWTH && w[1].quantity == SPEED && w[0].setting.starts_with(motion));
        for pair in pairs {
            let (Some(growth), Some(speed)) = (pair[0].value, pair[1].value) else { continue };
            let point = (growth, speed);
            match series.iter_mut().find(|line| line.name == pair[1].method) {
                Some(line) => line.points.push(point),
                None => {
                    let color = [0, 9, 1][series.len().min(2)];
                    series.push(Series { name: pair[1].method.clone(), color, points: vec![point], look: Look::Line });
                }
            }
        }
        let speeds = || series.iter().flat_map(|line| &line.points).map(|point| point.1);
        let (low, high) = (speeds().fold(f64::INFINITY, f64::min), speeds().fold(0.0, f64::max));
        if high > 0.0 {
            let limit = vec![(original::MU, low), (original::MU, high)];
            series.push(plotting::published("paper: rebuilt above this growth", 7, limit));
        }
        Panel { title: motion.to_owned(), series }
    };
    let points = rows.first().map_or(0, |row| row.points);
    let frame = Frame {
        title: format!("Figure 9: {points} points, the tree never built anew"),
        caption: lab.caption(),
        x_label: "largest volume of a box by that at the build".to_owned(),
        y_label: "steps a second: refit and lists".to_owned(),
        axes: Axes::Logarithmic,
        legend_right: true,
    };
    plotting::save(lab, "figure-9.svg", &frame, &MOTIONS.map(panel))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noted_steps_thin_out() {
        let noted: Vec<usize> = (1..=STEPS).filter(|&step| is_noted(step)).collect();
        assert_eq!(noted, [1, 2, 4, 7, 10, 20, 40, 70, 100, 200, 400]);
    }
}
