//! Figure 15: the searches of 100 iterations of resampling: from the samples to the points, which stay, and among the samples,
//! which move.

use std::time::Instant;

use nearfield::Vec3;

use super::original::{self, BySearch};
use super::resampling_path::path;
use super::scans::Scan;
use super::{Workshop, plotting, searches};
use crate::Result;
use crate::check::Expected;
use crate::paper::lab::Lab;
use crate::paper::methods::uniform_grid::FIXED_128;
use crate::paper::methods::{Judged, Plug, Positions, Start};
use crate::paper::rows::{Row, Sheet};

const TO_POINTS: &str = "from samples to points: lists";
const AMONG: &str = "among samples: update and lists";
const TOTAL: &str = "all searches of 100 iterations, with builds and copies";
/// Noise in spacings.
const NOISE: f64 = 0.5;

/// Measures both searches with every method.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be read or written.
pub fn measure(workshop: &Workshop) -> Result<Vec<Row>> {
    let lab = &workshop.lab;
    let mut sheet = Sheet::begin(lab, "figure-15")?;
    let scan = Scan::new(workshop, original::FIGURE_15_FILE, original::FIGURE_15_POINTS, NOISE)?;
    let share = original::FIGURE_15_SAMPLES as f64 / original::FIGURE_15_POINTS as f64;
    let n_samples = (share * scan.points.len() as f64).round() as usize;
    // Fewer points cannot have as many neighbours each and still be near each other.
    let radius = scan.radius_for(original::FIGURE_15_NEIGHBORS.min(0.1 * scan.points.len() as f64))?;
    let samples = path(&scan.points, n_samples, radius, original::FIGURE_15_ITERATIONS)?;
    let resampling = Resampling { lab, points: &scan.points, samples: &samples, radius };
    let expected = (resampling.expected_to_points(0)?, resampling.expected_among(0)?);
    let setting = format!("{} for Kitten: {n_samples} samples", scan.body.name);
    let seconds = lab.left().max(0.0) / searches(lab).count() as f64;
    for plug in searches(lab) {
        let row = scan.row(lab, plug.on_gpu, &setting, radius, plug.name);
        sheet.attempt(Row { quantity: AMONG, ..row.clone() }, || {
            resampling.rows(plug, &row, (expected.0.mean(), expected.1.mean()), seconds)
        })?;
    }
    let quantities = [TO_POINTS, AMONG];
    plotting::over_points(lab, "figure-15.svg", "Figure 15: searches of resampling", "ms", sheet.rows(), &quantities)?;
    Ok(sheet.into_rows())
}

struct Resampling<'a> {
    lab: &'a Lab,
    points: &'a [Vec3],
    /// Before each iteration.
    samples: &'a [Vec<Vec3>],
    radius: f32,
}

/// Milliseconds and how the last answer was judged.
struct Searched {
    mean: f64,
    total: f64,
    iterations: usize,
    judged: Judged,
    mean_neighbors: f64,
}

impl Resampling<'_> {
    fn expected_to_points(&self, iteration: usize) -> Result<Expected> {
        Expected::around(self.points, &self.samples[iteration], self.radius)
    }

    fn expected_among(&self, iteration: usize) -> Result<Expected> {
        Expected::of(&self.samples[iteration], self.radius)
    }

    fn rows(&self, plug: &Plug, row: &Row, neighbors: (f64, f64), seconds: f64) -> Result<Vec<Row>> {
        let fill = |quantity, searched: &Searched, paper: &BySearch| Row {
            mean_neighbors: Some(searched.mean_neighbors),
            recall: searched.judged.recall,
            runs: searched.iterations,
            ..row
                .of(quantity, "ms")
                .value(searched.mean)
                .paper(paper.milliseconds(plug.name, &FIXED_128))
                .note(searched.judged.note)
        };
        // Where one of the searches cannot be done, the other still can.
        let among = self.among(plug, neighbors.1, 0.5 * seconds)?;
        let mut rows = vec![fill(AMONG, &among, &original::FIGURE_15_AMONG_SAMPLES)];
        let to_points = match self.to_points(plug, neighbors.0, 0.5 * seconds) {
            Ok(searched) => searched,
            Err(error) => {
                let reason = crate::paper::rows::refusal(&error).ok_or(error)?;
                rows.push(row.of(TO_POINTS, "ms").note(format!("missing: {reason}")));
                return Ok(rows);
            }
        };
        rows.push(fill(TO_POINTS, &to_points, &original::FIGURE_15_TO_POINTS));
        let iterations = among.iterations.min(to_points.iterations);
        let whole = Row { mean_neighbors: Some(to_points.mean_neighbors), runs: iterations, ..row.of(TOTAL, "ms") };
        rows.push(if iterations < self.samples.len() {
            whole.note(format!("missing: {iterations} iterations took the share of the budget"))
        } else {
            let note = format!("{:.1} ms of it among samples; the step itself is not in it", among.total);
            whole.value(among.total + to_points.total).note(note)
        });
        Ok(rows)
    }

    fn to_points(&self, plug: &Plug, mean_neighbors: f64, seconds: f64) -> Result<Searched> {
        let gpu = self.lab.gpu().filter(|_| plug.on_gpu);
        let begin = Instant::now();
        let at = Positions::new(gpu, self.points.to_vec())?;
        let mut method = (plug.make)(&Start { gpu, at: &at, radius: self.radius, mean_neighbors })?;
        let built = begin.elapsed().as_secs_f64();
        // Kernels are made in a search that is not timed.
        if let Some(gpu) = gpu {
            drop(method.list_around(&Positions::new(Some(gpu), self.samples[0].clone())?, self.radius)?);
        }
        let (begin, mut searching, mut iterations) = (Instant::now(), 0.0, 0);
        let last = loop {
            let queries = Positions::new(gpu, self.samples[iterations].clone())?;
            let start = Instant::now();
            let lists = method.list_around(&queries, self.radius)?;
            searching += start.elapsed().as_secs_f64();
            iterations += 1;
            if iterations >= self.samples.len() || begin.elapsed().as_secs_f64() > seconds {
                break lists;
            }
        };
        let total = 1e3 * (built + begin.elapsed().as_secs_f64());
        let expected = self.expected_to_points(iterations - 1)?;
        let judged = last.check(gpu, &expected)?;
        let mean = 1e3 * searching / iterations as f64;
        Ok(Searched { mean, total, iterations, judged, mean_neighbors: expected.mean() })
    }

    fn among(&self, plug: &Plug, mean_neighbors: f64, seconds: f64) -> Result<Searched> {
        let gpu = self.lab.gpu().filter(|_| plug.on_gpu);
        let begin = Instant::now();
        let at = Positions::new(gpu, self.samples[0].clone())?;
        let mut method = (plug.make)(&Start { gpu, at: &at, radius: self.radius, mean_neighbors })?;
        let built = begin.elapsed().as_secs_f64();
        if gpu.is_some() {
            drop(method.list(self.radius)?);
        }
        let (begin, mut searching, mut iterations) = (Instant::now(), 0.0, 0);
        let last = loop {
            let at = Positions::new(gpu, self.samples[iterations].clone())?;
            let start = Instant::now();
            method.update(&at)?;
            let lists = method.list(self.radius)?;
            searching += start.elapsed().as_secs_f64();
            iterations += 1;
            if iterations >= self.samples.len() || begin.elapsed().as_secs_f64() > seconds {
                break lists;
            }
        };
        let total = 1e3 * (built + begin.elapsed().as_secs_f64());
        let expected = self.expected_among(iterations - 1)?;
        let judged = last.check(gpu, &expected)?;
        let mean = 1e3 * searching / iterations as f64;
        Ok(Searched { mean, total, iterations, judged, mean_neighbors: expected.mean() })
    }
}
