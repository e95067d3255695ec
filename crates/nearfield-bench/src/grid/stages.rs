//! Where the time of the GPU goes: the stages of brute force and of the grid, at 10,000 particles and at many.

use super::method::Method;
use super::rows::{Row, TOTAL};
use super::{Lab, Spot, ascending, particles, radius_for};
use crate::Result;
use crate::plots::{self, Axes, Bar, Frame};

/// File of the rows.
pub const FILE: &str = "stages.csv";
/// Neighbours of every case.
const NEIGHBORS: f64 = 50.0;
/// The many particles, at scale 1.
const MANY: usize = 1_000_000;

/// Measures what is missing; nothing without a GPU.
///
/// # Errors
/// What a build or query returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<()> {
    let mut rows = lab.rows(FILE)?;
    for n in ascending(vec![lab.ten_thousand(), lab.scaled(MANY)]) {
        let points = particles(n);
        let spot = Spot { points: &points, radius: radius_for(NEIGHBORS, n), wanted: NEIGHBORS };
        if !lab.measure(&mut rows, &spot, &[Method::GpuBruteForce, Method::GpuGrid])? {
            return Ok(());
        }
    }
    Ok(())
}

/// The stages of a method at a number of particles, in the order in which they ran.
pub(super) fn stages(rows: &[Row], method: Method, particles: usize) -> Vec<(String, f64)> {
    let own = rows.iter().filter(|r| r.method == method.name() && r.particles == particles && r.stage != TOTAL);
    own.map(|r| (r.stage.clone(), r.milliseconds)).collect()
}

/// Draws a bar of shares for each method and number of particles.
///
/// # Errors
/// A file that cannot be read or written.
pub fn plot(lab: &Lab) -> Result<()> {
    let rows = lab.own_rows(FILE)?;
    let mut bars = Vec::new();
    for n in ascending(rows.iter().map(|r| r.particles).collect()) {
        for method in [Method::GpuBruteForce, Method::GpuGrid] {
            let parts = stages(&rows, method, n);
            if !parts.is_empty() {
                bars.push(Bar { label: format!("{}\n{} particles", method.name(), plots::short(n as f64)), parts });
            }
        }
    }
    let frame = Frame {
        title: format!("GPU: where the time goes, {NEIGHBORS:.0} neighbours"),
        caption: lab.caption("Device timestamps; \"other\" is the rest of the wall clock."),
        x_label: String::new(),
        y_label: "share of the wall clock, %".to_owned(),
        axes: Axes::Linear,
        legend_right: true,
    };
    plots::shares(&lab.path("stages.svg"), &frame, &bars)
}
