//! Brute force and grid on CPU and GPU over the number of particles, for several numbers of neighbours: Accel's
//! three-dimensional graph.

use super::method::Method;
use super::rows::{Row, TOTAL};
use super::{Lab, Spot, ascending, particles, radius_for};
use crate::Result;
use crate::plots::{self, Axes, Frame, Look, Panel, Series};

/// File of the rows.
pub const FILE: &str = "variants.csv";
/// Numbers of particles at scale 1.
const PARTICLES: [usize; 10] = [1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000];
/// Neighbours away from the border; the largest is the cap in Accel's example.
pub const NEIGHBORS: [f64; 4] = [10.0, 50.0, 100.0, 250.0];

/// Measures what is missing.
///
/// # Errors
/// What a build or query returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<()> {
    let mut rows = lab.rows(FILE)?;
    for n in ascending(PARTICLES.map(|n| lab.scaled(n)).to_vec()) {
        let points = particles(n);
        for wanted in NEIGHBORS {
            let spot = Spot { points: &points, radius: radius_for(wanted, n), wanted };
            if !lab.measure(&mut rows, &spot, &Method::ALL)? {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Wall-clock totals of a method over particles, for one number of neighbours.
pub(super) fn curve(rows: &[Row], method: Method, wanted: f64) -> Vec<(f64, f64)> {
    let own = rows.iter().filter(|r| r.method == method.name() && r.stage == TOTAL && r.wanted_neighbors == wanted);
    let mut curve: Vec<(f64, f64)> = own.map(|r| (r.particles as f64, r.milliseconds)).collect();
    curve.sort_by(|a, b| a.0.total_cmp(&b.0));
    curve
}

/// Draws all four methods with logarithmic axes, and without brute force on the CPU with linear ones.
///
/// # Errors
/// A file that cannot be read or written.
pub fn plot(lab: &Lab) -> Result<()> {
    let rows = lab.own_rows(FILE)?;
    let zoomed: Vec<Method> = Method::ALL.into_iter().filter(|&m| m != Method::CpuBruteForce).collect();
    for (file, methods, logarithmic, title) in [
        ("variants.svg", &Method::ALL[..], true, "All neighbours of all particles: four variants"),
        (
            "variants-zoom.svg",
            &zoomed[..],
            false,
            "All neighbours of all particles, without brute force on the CPU (linear axes)",
        ),
    ] {
        let panels = NEIGHBORS.map(|wanted| panel(&rows, methods, wanted, logarithmic));
        let frame = Frame {
            title: title.to_owned(),
            caption: lab.caption("Wall clock, build and full list included; points and list stay on the device."),
            x_label: "particles".to_owned(),
            y_label: "milliseconds".to_owned(),
            axes: if logarithmic { Axes::Logarithmic } else { Axes::Linear },
            legend_right: !logarithmic,
        };
        plots::lines(&lab.path(file), &frame, &panels)?;
    }
    Ok(())
}

fn panel(rows: &[Row], methods: &[Method], wanted: f64, logarithmic: bool) -> Panel {
    let series = |&method: &Method| {
        let color = Method::ALL.iter().position(|&m| m == method).unwrap_or_default();
        Series { name: method.name().to_owned(), color, points: curve(rows, method, wanted), look: Look::Line }
    };
    let mut series: Vec<Series> = methods.iter().map(series).filter(|s| !s.points.is_empty()).collect();
    if !logarithmic {
        // Brute force would push the rest to the axis: the panel ends where the grids do, and brute force leaves it.
        let highest = |s: &Series| s.points.iter().map(|p| p.1).fold(0.0, f64::max);
        let grids = series.iter().filter(|s| s.name.ends_with("grid")).map(highest).fold(0.0, f64::max);
        for brute_force in series.iter_mut().filter(|s| !s.name.ends_with("grid")) {
            brute_force.points.retain(|p| p.1 <= 2.0 * grids);
        }
    }
    let means = rows.iter().filter(|r| r.wanted_neighbors == wanted).map(|r| r.mean_neighbors);
    let (low, high) = means.fold((f64::INFINITY, 0.0f64), |(low, high), mean| (low.min(mean), high.max(mean)));
    let measured = if low <= high { format!(" (measured {low:.0} to {high:.0})") } else { String::new() };
    Panel { title: format!("{wanted:.0} neighbours{measured}"), series }
}
