//! Figure 14: 30 iterations of smoothing of three scans by point-set surfaces, by every search, with lists and without, and how near
//! the points come to the mesh they were taken from.

use nearfield::Vec3;
use nearfield::application::MeshDistance;
use rayon::prelude::*;

use super::original::{FIGURE_14, SMOOTHING_ITERATIONS, Smoothed as Original};
use super::scans::Scan;
use super::smoothing::{Fused, Smoothed, Task, check_points, one_iteration, with_lists};
use super::{Workshop, picture, plotting, searches};
use crate::Result;
use crate::check::Expected;
use crate::paper::methods::uniform_grid::FIXED_256;
use crate::paper::rows::{Row, Sheet};

const SEARCH: &str = "a search: update and lists";
const TOTAL: &str = "30 iterations in all";
const OFF: &str = "distance from the mesh, RMS";
const BIAS: &str = "distance from the mesh, mean";
/// Noise in spacings.
pub(crate) const NOISE: f64 = 0.5;
/// Points whose distance from the mesh is taken.
const MEASURED: usize = 20_000;
/// Degrees of the height without lists, beside the 0 that lists have.
const DEGREES: [u8; 2] = [1, 2];

/// Measures every model by every method.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be read or written.
pub fn measure(workshop: &Workshop) -> Result<Vec<Row>> {
    let lab = &workshop.lab;
    let mut sheet = Sheet::begin(lab, "figure-14")?;
    for (number, original) in FIGURE_14.iter().enumerate() {
        let scan = Scan::new(workshop, original.file, original.points, NOISE)?;
        let picture = lab.path(&format!("figure-14-{}.png", number + 1));
        Model { workshop, original, scan: &scan, radius: scan.radius_for(original.neighbors)? }
            .measure(&mut sheet, &picture)?;
    }
    let title = "Figure 14: smoothing by point-set surfaces";
    plotting::over_points(lab, "figure-14.svg", title, "ms", sheet.rows(), &[SEARCH, TOTAL])?;
    Ok(sheet.into_rows())
}

/// What the points are compared with.
#[derive(Default)]
struct Reference {
    /// After one iteration.
    first: Vec<Vec3>,
    /// In the end, by the first search that came there.
    last: Option<Vec<Vec3>>,
}

struct Model<'a> {
    workshop: &'a Workshop,
    original: &'a Original,
    scan: &'a Scan,
    radius: f32,
}

impl Model<'_> {
    fn measure(&self, sheet: &mut Sheet<'_>, picture: &std::path::Path) -> Result<()> {
        let lab = &self.workshop.lab;
        let attempts = searches(lab).count() + Fused::ALL.len() * (1 + DEGREES.len());
        let task = Task {
            points: &self.scan.points,
            radius: self.radius,
            iterations: SMOOTHING_ITERATIONS,
            seconds: lab.seconds_a_point(FIGURE_14.len() * attempts),
        };
        let distance = MeshDistance::new(&self.scan.body.mesh)?;
        let expected = Expected::of(task.points, self.radius)?;
        let before = self.off(&distance, task.points);
        let blank = Row { mean_neighbors: Some(expected.mean()), runs: 1, ..self.row(false, "the scan") };
        for row in self.quality(&blank, before, "before any smoothing") {
            sheet.add(row)?;
        }
        // Exact searches must bring the points to the same places, by the degree of the height.
        let mut references: [Reference; 1 + DEGREES.len()] = Default::default();
        if lab.gpu().is_some() && !lab.is_over() {
            for (degree, reference) in references.iter_mut().enumerate() {
                reference.first = one_iteration(task, degree as u8)?;
            }
        }
        for plug in searches(lab) {
            let row = self.row(plug.on_gpu, plug.name);
            sheet.attempt(Row { quantity: SEARCH, ..row.clone() }, || {
                let smoothed = with_lists(lab, plug, task, expected.mean())?;
                let is_exact = smoothed.judged.as_ref().is_none_or(|judged| judged.recall.is_none());
                let note = smoothed.judged.as_ref().map_or("", |judged| judged.note);
                let compared = self.compare(&smoothed, is_exact.then_some(&mut references[0]))?;
                let search = self.original.search.milliseconds(plug.name, &FIXED_256);
                let total = self.original.total.milliseconds(plug.name, &FIXED_256);
                let note = format!("degree 0; {note}{compared}");
                Ok(self.rows(&row, &smoothed, &distance, &note, (search, total)))
            })?;
        }
        let fused = Fused::ALL.into_iter().filter(|fused| lab.gpu().is_some() || !fused.is_on_gpu());
        let mut shown: Option<Smoothed> = None;
        for fused in fused {
            let row = self.row(fused.is_on_gpu(), &fused.name());
            sheet.attempt(Row { quantity: TOTAL, ..row.clone() }, || {
                let smoothed = fused.run(lab, task, 0)?;
                let compared = self.compare(&smoothed, Some(&mut references[0]))?;
                let note = format!("degree 0, no lists{compared}");
                Ok(self.rows(&row, &smoothed, &distance, &note, (None, None)))
            })?;
            for degree in DEGREES.into_iter().filter(|_| fused.fits_heights()) {
                let row = self.row(fused.is_on_gpu(), &format!("{}, degree {degree}", fused.name()));
                sheet.attempt(Row { quantity: TOTAL, ..row.clone() }, || {
                    let smoothed = fused.run(lab, task, degree)?;
                    let compared = self.compare(&smoothed, Some(&mut references[usize::from(degree)]))?;
                    let note = format!("degree {degree}, no lists{compared}");
                    let rows = self.rows(&row, &smoothed, &distance, &note, (None, None));
                    shown = Some(smoothed);
                    Ok(rows)
                })?;
            }
        }
        match shown {
            Some(after) => picture::before_and_after(picture, task.points, &after.points),
            None => Ok(()),
        }
    }

    fn row(&self, on_gpu: bool, method: &str) -> Row {
        let setting = format!("{} for {}", self.scan.body.name, self.original.name);
        self.scan.row(&self.workshop.lab, on_gpu, &setting, self.radius, method)
    }

    /// Checks the points after one iteration against those of the CPU, and those of whole runs against the first whole run.
    fn compare(&self, smoothed: &Smoothed, reference: Option<&mut Reference>) -> Result<&'static str> {
        if !smoothed.points.iter().all(|p| p.is_finite()) {
            return Err("wrong answer: points that are no place".into());
        }
        let Some(reference) = reference else { return Ok("; points not compared") };
        let has_first = !smoothed.first.is_empty();
        if has_first {
            check_points(&smoothed.first, &reference.first, self.scan.body.diagonal)?;
        }
        if smoothed.iterations < SMOOTHING_ITERATIONS {
            return Ok(if has_first {
                "; points of one iteration compared with the CPU"
            } else {
                "; points not compared"
            });
        }
        match &reference.last {
            Some(points) => {
                check_points(&smoothed.points, points, self.scan.body.diagonal)?;
                Ok("; points where other searches have brought them")
            }
            None => {
                reference.last = Some(smoothed.points.clone());
                Ok("; other searches are compared with its points")
            }
        }
    }

    fn rows(
        &self,
        row: &Row,
        smoothed: &Smoothed,
        distance: &MeshDistance,
        note: &str,
        (search, total): (Option<f64>, Option<f64>),
    ) -> Vec<Row> {
        let blank = Row {
            mean_neighbors: Some(smoothed.mean_neighbors),
            recall: smoothed.judged.as_ref().and_then(|judged| judged.recall),
            runs: smoothed.iterations,
            ..row.clone()
        };
        let mut rows = Vec::new();
        if let Some(milliseconds) = smoothed.search {
            rows.push(blank.of(SEARCH, "ms").value(milliseconds).paper(search).note(note));
        }
        let whole = blank.of(TOTAL, "ms").paper(total);
        if smoothed.iterations < SMOOTHING_ITERATIONS {
            let made = smoothed.iterations;
            rows.push(
                whole
                    .note(format!("missing: {made} iterations took {:.0} ms, the share of the budget", smoothed.total)),
            );
            return rows;
        }
        rows.push(whole.value(smoothed.total).note(note));
        rows.extend(self.quality(&blank, self.off(distance, &smoothed.points), note));
        rows
    }

    fn quality(&self, blank: &Row, (rms, mean): (f64, f64), note: &str) -> [Row; 2] {
        [blank.of(OFF, "% of L").value(rms).note(note), blank.of(BIAS, "% of L").value(mean).note(note)]
    }

    /// Root mean square and mean of the signed distances of some points from the mesh, in percent of the diagonal.
    fn off(&self, mesh: &MeshDistance, points: &[Vec3]) -> (f64, f64) {
        let step = points.len().div_ceil(MEASURED).max(1);
        let distance = |p: &Vec3| mesh.signed_distance(p.as_dvec3(), f64::INFINITY).map_or(f64::NAN, |found| found.0);
        let distances: Vec<f64> = points.par_iter().step_by(step).map(distance).collect();
        let n = distances.len().max(1) as f64;
        let percent = 100.0 / self.scan.body.diagonal;
        let squares: f64 = distances.iter().map(|d| d * d).sum();
        ((squares / n).sqrt() * percent, distances.iter().sum::<f64>() / n * percent)
    }
}
