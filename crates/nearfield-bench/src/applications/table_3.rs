//! Table 3: distance fields of two bodies on 257³ nodes within four widths, and of the first within a fifth of its diagonal, by every
//! mode on both devices; the nearest sample of every node by every search; and how near fields come to a torus.

use nearfield::DVec3;
use nearfield::application::{DistanceField, DistanceMode, DistanceSettings, Offset, grid_around};
use nearfield::{Aabb, RegularGrid};

use super::field::{MODES, Samples, Timed};
use super::original::{BAND, BySearch, OFFSET, OFFSET_FIELD, RESOLUTION, TABLE_3};
use super::scans::Scan;
use super::{Workshop, nearest, plotting, searches, torus};
use crate::Result;
use crate::paper::methods::Plug;
use crate::paper::methods::aabb_tree::{COHERENT, ON_CPU, PACKED, PRIMARY};
use crate::paper::methods::kd_tree;
use crate::paper::methods::uniform_grid::FIXED_256;
use crate::paper::rows::{Row, Sheet};

const FIELD: &str = "field";
const FIELD_TOTAL: &str = "field, with build and copies";
const NEAREST: &str = "nearest sample of every node";
const NEAREST_TOTAL: &str = "nearest sample of every node, with build and copies";
/// Fewest cells along a side.
const FEWEST: f64 = 24.0;

/// Nodes along a side for the paper's number: widths stay as many spacings of the samples.
pub fn resolution(paper: usize, points: usize, paper_points: usize) -> u32 {
    let scale = (points as f64 / paper_points as f64).sqrt();
    ((paper as f64 - 1.0) * scale).round().max(FEWEST) as u32 + 1
}

/// Measures both bodies, the wide field and the torus.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be read or written.
pub fn measure(workshop: &Workshop) -> Result<Vec<Row>> {
    let lab = &workshop.lab;
    let mut sheet = Sheet::begin(lab, "table-3")?;
    for (number, original) in TABLE_3.iter().enumerate() {
        let scan = Scan::new(workshop, original.file, original.points, 0.0)?;
        let side = resolution(RESOLUTION, scan.points.len(), original.points);
        let bounds = Aabb::of_points(&scan.points);
        let grid = grid_around(DVec3::ZERO, &bounds, side, BAND)?;
        let setting = format!("{} for {}, {side} nodes, {BAND} widths", scan.body.name, original.name);
        let narrow = Case { workshop, scan: &scan, grid, band: BAND, setting, paper: &original.field };
        narrow.measure(&mut sheet, &searches(lab).collect::<Vec<_>>())?;
        if number == 0 {
            let offset = Offset::Signed(OFFSET * scan.body.diagonal);
            let grid = offset.grid(DVec3::ZERO, &bounds, side)?;
            let band = offset.band(&grid) / f64::from(grid.spacing());
            let setting = format!("{} for {}, {side} nodes, {OFFSET} L and 2 widths", scan.body.name, original.name);
            let wide = Case { workshop, scan: &scan, grid, band, setting, paper: &OFFSET_FIELD };
            // A grid whose cells are far smaller than the radius looks at nearly all of them: the paper's failed.
            let trees = [&COHERENT, &PRIMARY, &PACKED, &ON_CPU, &kd_tree::ON_CPU];
            let trees: Vec<&Plug> = trees.into_iter().filter(|plug| lab.gpu().is_some() || !plug.on_gpu).collect();
            wide.measure(&mut sheet, &trees)?;
        }
    }
    torus::measure(workshop, &mut sheet)?;
    let quantities = [FIELD, FIELD_TOTAL, NEAREST, NEAREST_TOTAL];
    plotting::over_points(lab, "table-3.svg", "Table 3: distance fields", "ms", sheet.rows(), &quantities)?;
    Ok(sheet.into_rows())
}

/// Samples and the grid of their field.
struct Case<'a> {
    workshop: &'a Workshop,
    scan: &'a Scan,
    grid: RegularGrid,
    band: f64,
    setting: String,
    paper: &'a BySearch,
}

impl Case<'_> {
    fn settings(&self, mode: DistanceMode) -> DistanceSettings {
        DistanceSettings::default().mode(mode).band(self.band)
    }

    fn radius(&self) -> f32 {
        self.settings(DistanceMode::Nearest).radius(&self.grid) as f32
    }

    fn measure(&self, sheet: &mut Sheet<'_>, plugs: &[&Plug]) -> Result<()> {
        let lab = &self.workshop.lab;
        // Neighbours, and the nearest samples that other searches must find.
        let mut known: Option<(f64, DistanceField)> = None;
        for mode in MODES {
            for on_gpu in [true, false].into_iter().filter(|on_gpu| !on_gpu || lab.gpu().is_some()) {
                let name = format!("{mode}, {}", if on_gpu { "GPU" } else { "CPU" });
                let row = self.scan.row(lab, on_gpu, &self.setting, self.radius(), &name);
                sheet
                    .attempt(Row { quantity: FIELD, ..row.clone() }, || self.by_mode(mode, on_gpu, &row, &mut known))?;
            }
        }
        let Some((mean_neighbors, field)) = known else { return Ok(()) };
        for plug in plugs {
            let row = self.scan.row(lab, plug.on_gpu, &self.setting, self.radius(), plug.name);
            let row = Row { mean_neighbors: Some(mean_neighbors), runs: 1, ..row };
            sheet.attempt(Row { quantity: NEAREST, ..row.clone() }, || {
                let found = nearest::by_search(lab, plug, &self.scan.points, self.radius(), &field)?;
                let note = "every node checked; nodes from the host and indices to it";
                let row = Row { recall: found.recall, ..row };
                let query = row.of(NEAREST, "ms").value(found.query_ms).note(note);
                let paper = self.paper.milliseconds(plug.name, &FIXED_256);
                let total = row.of(NEAREST_TOTAL, "ms").value(found.total_ms).paper(paper).note(note);
                Ok(vec![query, total])
            })?;
        }
        Ok(())
    }

    fn by_mode(
        &self,
        mode: DistanceMode,
        on_gpu: bool,
        row: &Row,
        known: &mut Option<(f64, DistanceField)>,
    ) -> Result<Vec<Row>> {
        let lab = &self.workshop.lab;
        let samples = Samples { points: &self.scan.points, normals: &self.scan.normals };
        let settings = self.settings(mode);
        let Timed { field, field_ms, device_ms, total_ms, runs } = match lab.gpu().filter(|_| on_gpu) {
            Some(gpu) => samples.field_on_gpu(gpu, &self.grid, &settings, lab.effort())?,
            None => samples.field_on_cpu(&self.grid, &settings)?,
        };
        let note = samples.check(&field, &settings)?;
        let mean_neighbors = match known {
            Some((mean, _)) => *mean,
            None => samples.mean_neighbors(&field, &settings),
        };
        let share = 100.0 * field.n_defined() as f64 / self.grid.n_nodes() as f64;
        let note = format!("{share:.1} % of the nodes have a value; {note}");
        let blank = Row { mean_neighbors: Some(mean_neighbors), runs, ..row.clone() };
        if known.is_none() {
            *known = Some((mean_neighbors, field));
        }
        // The formula of the paper, by its own search in all but name.
        let is_papers = on_gpu && mode == DistanceMode::Nearest;
        let paper = is_papers.then_some(1e3 * self.paper.coherent);
        Ok(vec![
            Row { device_milliseconds: device_ms, ..blank.of(FIELD, "ms").value(field_ms).note(note.clone()) },
            blank.of(FIELD_TOTAL, "ms").value(total_ms).paper(paper).note(note),
        ])
    }
}
