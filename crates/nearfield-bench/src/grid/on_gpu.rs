//! Brute force and grid on the GPU: over particles around 10,000, and over neighbours at 10,000 particles.

use super::method::Method;
use super::rows::{Row, TOTAL};
use super::{Lab, Spot, ascending, particles, radius_for};
use crate::Result;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};

/// File of the rows.
pub const FILE: &str = "gpu-methods.csv";
/// The two methods.
const METHODS: [Method; 2] = [Method::GpuBruteForce, Method::GpuGrid];
/// Neighbours while the particles vary.
pub(super) const NEIGHBORS: f64 = 50.0;
/// Neighbours while the particles stay; shares of the particles follow.
const VARIED_NEIGHBORS: [f64; 7] = [5.0, 10.0, 25.0, 50.0, 100.0, 250.0, 500.0];
/// Neighbours as shares of the particles: "approaches the size of your data set".
const SHARES: [f64; 4] = [0.1, 0.25, 0.5, 1.0];

/// Measures what is missing; nothing without a GPU.
///
/// # Errors
/// What a build or query returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<()> {
    let mut rows = lab.rows(FILE)?;
    let middle = lab.ten_thousand();
    for n in ascending(vec![middle / 4, middle / 2, middle, 2 * middle, 4 * middle]) {
        let points = particles(n);
        let spot = Spot { points: &points, radius: radius_for(NEIGHBORS, n), wanted: NEIGHBORS };
        if !lab.measure(&mut rows, &spot, &METHODS)? {
            return Ok(());
        }
    }
    let points = particles(middle);
    let shares = SHARES.map(|share| share * middle as f64);
    let few = VARIED_NEIGHBORS.into_iter().filter(|&wanted| wanted < shares[0]);
    for wanted in few.chain(shares) {
        let spot = Spot { points: &points, radius: radius_for(wanted, middle), wanted };
        if !lab.measure(&mut rows, &spot, &METHODS)? {
            return Ok(());
        }
    }
    Ok(())
}

/// Times of a method on the device over measured mean neighbours, at 10,000 particles.
pub(super) fn over_neighbors(rows: &[Row], method: Method, particles: usize) -> Vec<(f64, f64)> {
    curve(rows, method, |row| row.particles == particles, |row| row.mean_neighbors)
}

/// Times of a method on the device over particles.
pub(super) fn over_particles(rows: &[Row], method: Method) -> Vec<(f64, f64)> {
    curve(rows, method, |row| row.wanted_neighbors == NEIGHBORS, |row| row.particles as f64)
}

fn curve(rows: &[Row], method: Method, keep: impl Fn(&Row) -> bool, x: impl Fn(&Row) -> f64) -> Vec<(f64, f64)> {
    let totals = rows.iter().filter(|r| r.method == method.name() && r.stage == TOTAL && keep(r));
    let mut curve: Vec<(f64, f64)> = totals.map(|total| (x(total), on_device(rows, total))).collect();
    curve.sort_by(|a, b| a.0.total_cmp(&b.0));
    curve
}

/// Sum of the stages on the device of the point whose total this is; the total where the device has no clock.
fn on_device(rows: &[Row], total: &Row) -> f64 {
    let same = |r: &&Row| {
        r.clock == "device" && (&r.method, r.particles, r.radius) == (&total.method, total.particles, total.radius)
    };
    let sum: f64 = rows.iter().filter(same).map(|r| r.milliseconds).sum();
    if sum > 0.0 { sum } else { total.milliseconds }
}

/// Draws both dependences.
///
/// # Errors
/// A file that cannot be read or written.
pub fn plot(lab: &Lab) -> Result<()> {
    let rows = lab.own_rows(FILE)?;
    let middle = lab.ten_thousand();
    let series = |method: Method, points| Series {
        name: method.name().to_owned(),
        color: if method == Method::GpuGrid { 3 } else { 2 },
        points,
        look: Look::Line,
    };
    for (file, title, x_label, curves) in [
        (
            "gpu-particles.svg",
            format!("GPU: brute force and grid around {middle} particles, {NEIGHBORS:.0} neighbours"),
            "particles",
            METHODS.map(|m| series(m, over_particles(&rows, m))),
        ),
        (
            "gpu-neighbors.svg",
            format!("GPU: brute force and grid over neighbours, {middle} particles"),
            "measured mean neighbours",
            METHODS.map(|m| series(m, over_neighbors(&rows, m, middle))),
        ),
    ] {
        let frame = Frame {
            title,
            caption: lab.caption("Device timestamps, build and full list included."),
            x_label: x_label.to_owned(),
            y_label: "milliseconds on the device".to_owned(),
            axes: Axes::Logarithmic,
            legend_right: false,
        };
        plots::lines(&lab.path(file), &frame, &[Panel { title: String::new(), series: curves.to_vec() }])?;
    }
    Ok(())
}
