//! Figures 12 and 13: share of active lanes of both searches, and of the coherent search by phase. The paper calls it warp execution
//! efficiency and takes it from a profiler; here kernels count the rounds of every lane.

use nearfield::query::SearchCounters;
use nearfield::{AabbTree, AabbTreeSettings, FixedRadius, GpuAabbTree, Vec3};

use super::lab::{Lab, spots};
use super::original;
use super::plotting;
use super::rows::{Row, Sheet};
use crate::Result;
use crate::check::Expected;
use crate::plots::{Axes, Frame, Panel};

/// Invocations of the balanced first search: the paper's 32 blocks of 256 threads.
pub const BALANCED: u32 = 32 * 256;
const METHODS: [&str; 3] = ["primary", "primary, balanced", "coherent"];

/// A tree on the device that is measured.
pub enum Counted {
    /// On the GPU.
    OnGpu(Box<GpuAabbTree>),
    /// On the CPU, which knows what 32 lanes in step would do.
    OnCpu(Box<AabbTree>),
}

impl Counted {
    /// A tree of median splits.
    ///
    /// # Errors
    /// As the build of a tree.
    pub fn new(lab: &Lab, points: &[Vec3]) -> Result<Self> {
        let settings = AabbTreeSettings::default();
        Ok(match lab.gpu() {
            Some(gpu) => Self::OnGpu(Box::new(GpuAabbTree::build(gpu, points, &settings)?)),
            None => Self::OnCpu(Box::new(AabbTree::build(points, &settings)?)),
        })
    }

    /// Counters of the coherent search.
    ///
    /// # Errors
    /// What the device returns.
    pub fn coherent(&self, question: &FixedRadius<'_>) -> Result<SearchCounters> {
        Ok(match self {
            Self::OnGpu(tree) => tree.coherent_counters(question)?,
            Self::OnCpu(tree) => tree.coherent_counters(question)?,
        })
    }

    fn primary(&self, question: &FixedRadius<'_>, invocations: Option<u32>) -> Result<SearchCounters> {
        Ok(match (self, invocations) {
            (Self::OnGpu(tree), _) => tree.primary_counters(question, invocations)?,
            (Self::OnCpu(tree), None) => tree.primary_counters(question)?,
            (Self::OnCpu(_), Some(_)) => {
                let what = "balancing the load of lanes in step on the CPU".to_owned();
                return Err(nearfield::Error::Unsupported { what, advice: "measure it on a GPU" }.into());
            }
        })
    }
}

/// Measures the shares of both figures.
///
/// # Errors
/// What a search returns; counts of neighbours that are wrong; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-12")?;
    let on_gpu = lab.gpu().is_some();
    for r_over_l in [original::R_OVER_L, original::R_OVER_L_OF_49] {
        for spot in spots(lab, &original::POINTS) {
            let radius = spot.length(r_over_l);
            let question = FixedRadius::new(radius);
            let mut made: Option<(Counted, Expected)> = None;
            for method in METHODS {
                let mut row = spot.row(lab.device(on_gpu), "", r_over_l, method);
                (row.quantity, row.unit) = ("active lanes", "%");
                sheet.attempt(row.clone(), || {
                    let (tree, expected) = match &made {
                        Some(made) => made,
                        None => made.insert((Counted::new(lab, &spot.points)?, Expected::of(&spot.points, radius)?)),
                    };
                    let counters = match method {
                        "coherent" => tree.coherent(&question)?,
                        "primary" => tree.primary(&question, None)?,
                        _ => tree.primary(&question, Some(BALANCED))?,
                    };
                    expected.check_total(counters.neighbors)?;
                    row.mean_neighbors = Some(expected.mean());
                    row.runs = 1;
                    Ok(shares(&row, &counters))
                })?;
            }
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

/// The share over all phases, and that of each phase that ran where there are several.
fn shares(row: &Row, counters: &SearchCounters) -> Vec<Row> {
    let note = format!(
        "total of neighbours checked; {} traversals, {} nodes, {} candidates, {} tests",
        counters.traversals, counters.nodes_visited, counters.candidates, counters.tests
    );
    let mut rows = vec![row.clone().value(100.0 * counters.active_share()).note(note)];
    for phase in counters.phases.iter().filter(|_| counters.phases.len() > 1) {
        let quantity = match phase.name {
            "pack" => "active lanes, phase I: packing",
            "traverse" => "active lanes, phase II: traversal",
            "extract" => "active lanes, phase III: extraction",
            other => other,
        };
        let share = row.of(quantity, "%");
        rows.push(match phase.taken {
            0 => share.note("missing: no work, the points themselves are the queries"),
            _ => share.value(100.0 * phase.active_share()).note("total of neighbours checked"),
        });
    }
    rows
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let x = |row: &Row| row.points as f64;
    let searches: Vec<Panel> = [original::R_OVER_L, original::R_OVER_L_OF_49]
        .map(|r_over_l| {
            let own = rows.iter().filter(|row| row.quantity == "active lanes" && row.r_over_l == r_over_l);
            Panel { title: format!("r = {r_over_l} L"), series: plotting::by_method(own, x) }
        })
        .into();
    let frame = |title: &str| Frame {
        title: title.to_owned(),
        caption: lab.caption(),
        x_label: "points".to_owned(),
        y_label: "active lanes, %".to_owned(),
        axes: Axes::Linear,
        legend_right: true,
    };
    plotting::save(lab, "figure-12.svg", &frame("Figure 12: active lanes of both searches"), &searches)?;
    let phases: Vec<Row> = rows
        .iter()
        .filter(|row| row.quantity.contains("phase"))
        .map(|row| Row { method: row.quantity.trim_start_matches("active lanes, ").to_owned(), ..row.clone() })
        .collect();
    let by_phase: Vec<Panel> = [original::R_OVER_L, original::R_OVER_L_OF_49]
        .map(|r_over_l| {
            let own = phases.iter().filter(|row| row.r_over_l == r_over_l);
            Panel { title: format!("coherent search, r = {r_over_l} L"), series: plotting::by_method(own, x) }
        })
        .into();
    plotting::save(lab, "figure-13.svg", &frame("Figure 13: active lanes by phase"), &by_phase)
}
