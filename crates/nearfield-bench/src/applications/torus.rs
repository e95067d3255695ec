//! How near fields of samples of a torus come to the truth: their values, and where their surface crosses the edges of the grid.

use nearfield::application::{DistanceField, DistanceMode, DistanceSettings, grid_around};
use nearfield::{Aabb, DVec3, RegularGrid, Vec3};

use super::Workshop;
use super::field::{MODES, Samples};
use super::surfaces::{Surface, torus};
use crate::Result;
use crate::paper::rows::{Row, Sheet};

/// Samples, and what a separate script in f64 found for the root mean square of the crossings in widths, by mode.
const SETS: [(usize, [(DistanceMode, f64); 2]); 2] = [
    (700_000, [(DistanceMode::Nearest, 0.0379), (DistanceMode::Plane, 0.0022)]),
    (100_000, [(DistanceMode::Nearest, 0.0974), (DistanceMode::Plane, 0.0024)]),
];
/// Nodes along the longest side.
const RESOLUTION: usize = 129;

/// Errors of a field, in widths.
struct Errors {
    crossings: [f64; 2],
    values: [f64; 2],
    /// Share of the nodes with a value whose sign is wrong.
    wrong_signs: f64,
}

/// Adds the rows of both sets.
///
/// # Errors
/// As the field; a wrong answer; a file that cannot be written.
pub fn measure(workshop: &Workshop, sheet: &mut Sheet<'_>) -> Result<()> {
    let lab = &workshop.lab;
    for (paper_points, published) in SETS {
        let surface = torus(lab.points(paper_points), 0.0);
        let normals: Vec<Vec3> = surface.points.iter().map(|p| normal(&surface, *p)).collect();
        let samples = Samples { points: &surface.points, normals: &normals };
        let resolution = super::table_3::resolution(RESOLUTION, surface.points.len(), paper_points);
        let bounds = Aabb::new(Vec3::new(-1.4, -1.4, -0.4), Vec3::new(1.4, 1.4, 0.4));
        let grid = grid_around(DVec3::ZERO, &bounds, resolution, super::original::BAND)?;
        for mode in MODES {
            let settings = DistanceSettings::default().mode(mode).band(super::original::BAND);
            let setting = format!("torus, {resolution} nodes, {mode}");
            let radius = settings.radius(&grid);
            let row = Row {
                device: lab.device(lab.gpu().is_some()),
                paper_points,
                points: surface.points.len(),
                dimension: 3,
                setting,
                r_over_l: (radius / surface.diagonal * 1e5).round() / 1e5,
                radius,
                mean_neighbors: None,
                method: if lab.gpu().is_some() { "field, GPU" } else { "field, CPU" }.to_owned(),
                quantity: "error",
                unit: "widths",
                value: None,
                device_milliseconds: None,
                paper: None,
                recall: None,
                runs: 0,
                note: String::new(),
            };
            let script = published.iter().find(|(known, _)| *known == mode).map(|(_, value)| value);
            sheet.attempt(row.clone(), || {
                let timed = match lab.gpu() {
                    Some(gpu) => samples.field_on_gpu(gpu, &grid, &settings, lab.effort())?,
                    None => samples.field_on_cpu(&grid, &settings)?,
                };
                samples.check(&timed.field, &settings)?;
                let errors = errors(&surface, &timed.field);
                let note = script.map_or("exact samples".to_owned(), |value| {
                    format!("exact samples; a script in f64 at {paper_points} samples: {value}")
                });
                let blank = Row {
                    mean_neighbors: Some(samples.mean_neighbors(&timed.field, &settings)),
                    runs: timed.runs,
                    ..row
                };
                let of = |quantity, unit, value: f64| blank.of(quantity, unit).value(value).note("exact samples");
                Ok(vec![
                    blank.of("crossings of edges, RMS", "widths").value(errors.crossings[0]).note(note),
                    of("crossings of edges, largest", "widths", errors.crossings[1]),
                    of("values of nodes, RMS", "widths", errors.values[0]),
                    of("values of nodes, largest", "widths", errors.values[1]),
                    of("wrong signs", "% of nodes", 100.0 * errors.wrong_signs),
                ])
            })?;
        }
    }
    Ok(())
}

fn normal(surface: &Surface, p: Vec3) -> Vec3 {
    DVec3::from_array((surface.normal)(p.as_dvec3().to_array())).as_vec3()
}

fn at(grid: &RegularGrid, node: [u32; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| grid.coordinate(axis, node[axis]))
}

fn errors(surface: &Surface, field: &DistanceField) -> Errors {
    let grid = field.distances.grid();
    let width = f64::from(grid.spacing());
    let (mut crossings, mut values, mut wrong) = (Sum::default(), Sum::default(), 0);
    for number in 0..grid.n_nodes() {
        let node = grid.node(number).expect("the number should be below that of nodes");
        let value = f64::from(field.distances.values()[number]);
        if !value.is_finite() {
            continue;
        }
        let here = at(grid, node);
        let truth = (surface.distance)(here);
        values.add((value - truth) / width);
        wrong += usize::from((value < 0.0) != (truth < 0.0));
        for axis in 0..3 {
            let mut next = node;
            next[axis] += 1;
            if !grid.contains(next) {
                continue;
            }
            let other = f64::from(field.distances.value(next));
            if other.is_finite() && (value < 0.0) != (other < 0.0) {
                let mut place = here;
                place[axis] += width * value / (value - other);
                crossings.add((surface.distance)(place) / width);
            }
        }
    }
    let wrong_signs = wrong as f64 / values.n.max(1) as f64;
    Errors { crossings: crossings.told(), values: values.told(), wrong_signs }
}

#[derive(Default)]
struct Sum {
    n: usize,
    squares: f64,
    largest: f64,
}

impl Sum {
    fn add(&mut self, error: f64) {
        self.n += 1;
        self.squares += error * error;
        self.largest = self.largest.max(error.abs());
    }

    /// Root mean square and largest.
    fn told(&self) -> [f64; 2] {
        [(self.squares / self.n.max(1) as f64).sqrt(), self.largest]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn true_values_have_the_error_of_the_straight_line_between_them() {
        let surface = torus(10, 0.0);
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::new(-1.5, -1.5, -0.5), 0.05, [61, 61, 21]).expect("a grid");
        let truth = |number: usize| (surface.distance)(at(&grid, grid.node(number).expect("a node"))) as f32;
        let values: Vec<f32> = (0..grid.n_nodes()).map(truth).collect();
        let field = |values: Vec<f32>| DistanceField {
            nearest: vec![0; values.len()],
            distances: nearfield::DistanceGrid::new(grid, values).expect("values"),
        };
        let found = errors(&surface, &field(values.clone()));
        assert!(found.values[1] < 1e-5 && found.wrong_signs == 0.0 && found.crossings[1] < 0.02);
        // A field that is a tenth of a width too small has its surface that much farther out, and signs to match.
        let shifted = errors(&surface, &field(values.iter().map(|v| v - 0.005).collect()));
        assert!((shifted.crossings[0] - 0.1).abs() < 0.01 && (shifted.values[0] - 0.1).abs() < 1e-4);
        assert!(shifted.wrong_signs > 0.0);
    }
}
