//! What the grid adds to the memory of the points, by radius, for 1,000 particles and for many.
//!
//! Beside our grids on the CPU and on the GPU stands the dense table that Accel describes: cells as large as the radius
//! over the unit cube, 4 bytes a cell and 4 bytes a sorted index, by arithmetic.

use super::rows::{Row, Rows, TOTAL};
use super::{Lab, ascending, particles};
use crate::Result;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};
use crate::provenance::COMMIT;
use nearfield::structure::UniformGrid;
use nearfield::{GpuUniformGrid, GridSettings, NeighborSearch, Vec3};

/// File of the rows.
pub const FILE: &str = "memory.csv";
/// Radii in edges of the cube that the particles fill.
pub const RADII: [f32; 9] = [0.5, 0.25, 0.125, 0.0625, 0.04, 0.025, 0.0125, 0.01, 0.008];
/// Accel's small number of particles, the same at every scale.
pub(super) const FEW: usize = 1_000;
/// The large number at scale 1.
const MANY: usize = 1_000_000;

/// A layout whose bytes are compared.
pub(super) const METHODS: [&str; 3] = ["cpu grid", "gpu grid", "dense table (computed)"];

/// The numbers of particles at a scale.
pub(super) fn sizes(lab: &Lab) -> Vec<usize> {
    ascending(vec![FEW, lab.scaled(MANY).max(2 * FEW)])
}

/// Builds what is missing and notes its bytes.
///
/// # Errors
/// What a build returns; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<()> {
    let mut rows = lab.rows(FILE)?;
    for n in sizes(lab) {
        let points = particles(n);
        for radius in RADII {
            for method in METHODS {
                if lab.is_over() {
                    return Ok(());
                }
                measure_point(lab, &mut rows, &points, radius, method)?;
            }
        }
    }
    Ok(())
}

fn measure_point(lab: &Lab, rows: &mut Rows, points: &[Vec3], radius: f32, method: &str) -> Result<()> {
    let device = match (method, &lab.gpu) {
        ("gpu grid", None) => return Ok(()),
        ("gpu grid", Some(gpu)) => gpu.name.clone(),
        _ => lab.cpu.name.clone(),
    };
    let mut row = Row {
        device,
        commit: COMMIT.to_owned(),
        scale: lab.scale,
        particles: points.len(),
        wanted_neighbors: 0.0,
        radius,
        mean_neighbors: inner_neighbors(points.len(), radius),
        method: method.to_owned(),
        stage: TOTAL.to_owned(),
        clock: "host".to_owned(),
        milliseconds: 0.0,
        runs: 1,
        points_bytes: 12 * points.len() as u64,
        structure_bytes: 0,
    };
    let point = super::rows::Point {
        device: &row.device,
        commit: COMMIT,
        scale: lab.scale,
        particles: row.particles,
        radius,
        method,
    };
    if rows.has(&point) {
        return Ok(());
    }
    let (start, settings) = (std::time::Instant::now(), GridSettings::for_radius(radius));
    row.structure_bytes = match (method, lab.gpu()) {
        ("cpu grid", _) => UniformGrid::build(points, &settings)?.memory_bytes(),
        ("gpu grid", Some(gpu)) => NeighborSearch::memory_bytes(&GpuUniformGrid::build(gpu, points, &settings)?),
        _ => row.points_bytes + dense_table_bytes(points.len(), radius),
    };
    row.milliseconds = start.elapsed().as_secs_f64() * 1e3;
    rows.append(vec![row])
}

/// Bytes of a dense table over the unit cube and of the sorted indices.
pub fn dense_table_bytes(n: usize, radius: f32) -> u64 {
    // In f32, so that the radius 0.04 has 25 cells to the edge and not a 26th for its rounding.
    let cells = (1.0 / radius).ceil() as u64;
    4 * cells * cells * cells + 4 * n as u64
}

/// Particles in a ball of that radius away from the border, at most all.
fn inner_neighbors(n: usize, radius: f32) -> f64 {
    let volume = 4.0 / 3.0 * std::f64::consts::PI * f64::from(radius).powi(3);
    (n as f64 * volume).min(n as f64)
}

/// Bytes beyond the points' own over radius, ascending.
pub(super) fn extra(rows: &[Row], method: &str, particles: usize) -> Vec<(f64, f64)> {
    let own = rows.iter().filter(|r| r.method == method && r.particles == particles);
    let mut curve: Vec<(f64, f64)> =
        own.map(|r| (f64::from(r.radius), r.structure_bytes.saturating_sub(r.points_bytes) as f64)).collect();
    curve.sort_by(|a, b| a.0.total_cmp(&b.0));
    curve
}

/// Draws extra bytes, and extra bytes as a share of the points, for both numbers of particles.
///
/// # Errors
/// A file that cannot be read or written.
pub fn plot(lab: &Lab) -> Result<()> {
    let rows = lab.own_rows(FILE)?;
    for (file, n, size) in
        sizes(lab).iter().zip(["small", "large"]).map(|(&n, size)| (format!("memory-{size}.svg"), n, size))
    {
        let curves = |scale: f64| {
            let series = |(number, method): (usize, &&str)| Series {
                name: (*method).to_owned(),
                color: [1, 3, 7][number],
                points: extra(&rows, method, n).iter().map(|&(r, bytes)| (r, bytes * scale)).collect(),
                look: Look::Line,
            };
            METHODS.iter().enumerate().map(series).filter(|s| !s.points.is_empty()).collect::<Vec<_>>()
        };
        let frame = Frame {
            title: format!("Memory the grid adds to {} particles ({size} set)", plots::short(n as f64)),
            caption: lab.caption("Bytes beyond 12 a particle; the particles fill a cube of edge 1."),
            x_label: "radius, edges of the cube".to_owned(),
            y_label: "extra memory".to_owned(),
            axes: Axes::Logarithmic,
            legend_right: true,
        };
        let panels = [
            Panel { title: "extra megabytes".to_owned(), series: curves(1e-6) },
            Panel { title: "extra, % of the points".to_owned(), series: curves(100.0 / (12.0 * n as f64)) },
        ];
        plots::lines(&lab.path(&file), &frame, &panels)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dense_table_of_unit_cells_holds_one_entry() {
        assert_eq!(dense_table_bytes(10, 1.0), 4 + 40);
        assert_eq!(dense_table_bytes(0, 0.04), 4 * 25 * 25 * 25);
    }
}
