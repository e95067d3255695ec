//! Whether what Accel says of each of its figures held here, computed from the rows: `claims.md`.

use std::fmt::Write as _;

use super::method::Method;
use super::rows::Row;
use super::{Lab, memory, on_gpu, save, stages, variants};
use crate::Result;
use crate::plots::short;

/// What Accel says of a figure, and what the rows say.
struct Claim {
    figure: &'static str,
    original: &'static str,
    /// Whether it held, and the numbers; `None` where rows are missing.
    finding: Option<(bool, String)>,
}

/// Writes `claims.md` from the rows of these devices, this commit and this scale.
///
/// # Errors
/// A file that cannot be read or written.
pub fn write(lab: &Lab) -> Result<()> {
    let (variants, on_gpu) = (lab.own_rows(variants::FILE)?, lab.own_rows(on_gpu::FILE)?);
    let (stages, memory) = (lab.own_rows(stages::FILE)?, lab.own_rows(memory::FILE)?);
    let sizes = memory::sizes(lab);
    let claims = [
        Claim {
            figure: "variants.svg",
            original: "brute force on the CPU pops upwards as neighbours and particles grow, the other three stay much lower",
            finding: slowest_is_cpu_brute_force(&variants),
        },
        Claim {
            figure: "variants-zoom.svg",
            original: "the grid on the CPU and brute force on the GPU grow, the grid on the GPU stays flatter",
            finding: gpu_grid_is_flattest(&variants),
        },
        Claim {
            figure: "variants-zoom.svg",
            original: "the grid on the CPU sometimes outpaces brute force on the GPU",
            finding: cpu_grid_outpaces_gpu_brute_force(&variants),
        },
        Claim {
            figure: "gpu-neighbors.svg",
            original: "on the GPU brute force stays relatively flat while the grid grows, a problem as neighbours approach the whole set",
            finding: brute_force_is_flat(&on_gpu, lab.ten_thousand()),
        },
        Claim {
            figure: "gpu-particles.svg",
            original: "brute force breaks down with many more than 10,000 particles",
            finding: brute_force_breaks_down(&on_gpu),
        },
        Claim {
            figure: "stages.svg",
            original: "brute force on the GPU spends almost all of its time searching",
            finding: brute_force_only_searches(&stages, lab.ten_thousand()),
        },
        Claim {
            figure: "stages.svg",
            original: "the grid on the GPU spends a lot of time not searching, most of it sorting",
            finding: grid_sorts(&stages, lab.ten_thousand()),
        },
        Claim {
            figure: "memory-small.svg",
            original: "at 1,000 particles the grid's memory is significant at low radii, on the order of 5 MB at worst",
            finding: memory_of_few(&memory, sizes.first().copied()),
        },
        Claim {
            figure: "memory-large.svg",
            original: "with many particles the extra memory is insignificant",
            finding: memory_of_many(&memory, sizes.last().copied()),
        },
    ];
    save(&lab.path("claims.md"), &text(lab, &claims))
}

fn text(lab: &Lab, claims: &[Claim]) -> String {
    let mut text = String::from("# Accel's claims about its uniform grid, measured again\n\n");
    for line in lab.caption("") {
        let _ = writeln!(text, "- {}", line.trim_end());
    }
    text.push_str(
        "\nWritten by `nearfield-bench grid` from the CSV files beside it; every answer was checked when it was timed. A curve \
         that ends early goes no further because its next point was foretold to take too long, or its list does not fit a \
         binding of the device.\n",
    );
    if lab.gpu.as_ref().is_some_and(|gpu| !gpu.is_hardware_gpu()) {
        text.push_str(
            "The GPU of these rows is a software renderer on the cores of the CPU: they test the experiments and the counts, not \
             what is said of GPUs.\n",
        );
    }
    for claim in claims {
        let (verdict, numbers) = match &claim.finding {
            Some((true, numbers)) => ("Held", numbers.as_str()),
            Some((false, numbers)) => ("Did not hold", numbers.as_str()),
            None => ("Not measured", "rows are missing"),
        };
        let Claim { figure, original, .. } = claim;
        let _ =
            write!(text, "\n## {figure}\n\n![{figure}]({figure})\n\nAccel: {original}. **{verdict}**: {numbers}.\n");
    }
    text
}

/// Largest number of particles that both curves have, with both times.
fn last_common(a: &[(f64, f64)], b: &[(f64, f64)]) -> Option<(f64, f64, f64)> {
    let both = a.iter().filter_map(|p| b.iter().find(|q| q.0 == p.0).map(|q| (p.0, p.1, q.1)));
    both.max_by(|p, q| p.0.total_cmp(&q.0))
}

fn slowest_is_cpu_brute_force(rows: &[Row]) -> Option<(bool, String)> {
    let wanted = variants::NEIGHBORS.into_iter().fold(0.0, f64::max);
    let brute_force = variants::curve(rows, Method::CpuBruteForce, wanted);
    let (mut held, mut parts) = (true, Vec::new());
    for method in [Method::CpuGrid, Method::GpuBruteForce, Method::GpuGrid] {
        let curve = variants::curve(rows, method, wanted);
        if let Some((n, slow, fast)) = last_common(&brute_force, &curve) {
            // "Much lower" is taken as half or less.
            held &= fast <= 0.5 * slow;
            let (slow, fast) = (time(slow), time(fast));
            parts.push(format!("{} {fast} where it needs {slow} ({} particles)", method.name(), short(n)));
        }
    }
    (!parts.is_empty()).then(|| (held, format!("with about {wanted:.0} neighbours, {}", parts.join("; "))))
}

/// Growth of each curve from the first to the last place that all of them have, and the two places.
fn growths<const N: usize>(curves: [&[(f64, f64)]; N]) -> Option<([f64; N], f64, f64)> {
    let (first_curve, others) = curves.split_first()?;
    let in_all = |p: &&(f64, f64)| others.iter().all(|c| c.iter().any(|q| q.0 == p.0));
    let places: Vec<f64> = first_curve.iter().filter(in_all).map(|p| p.0).collect();
    let (first, last) = (*places.first()?, *places.last()?);
    let at = |curve: &[(f64, f64)], place: f64| curve.iter().find(|p| p.0 == place).map_or(0.0, |p| p.1);
    (first < last).then(|| (curves.map(|curve| at(curve, last) / at(curve, first)), first, last))
}

/// How many times, in words.
fn times(factor: f64) -> String {
    if factor >= 1000.0 { format!("{factor:.0} times") } else { format!("{} times", short(factor)) }
}

/// A time with its unit.
fn time(milliseconds: f64) -> String {
    if milliseconds >= 1000.0 {
        format!("{} s", short(milliseconds * 1e-3))
    } else {
        format!("{} ms", short(milliseconds))
    }
}

fn gpu_grid_is_flattest(rows: &[Row]) -> Option<(bool, String)> {
    let methods = [Method::CpuGrid, Method::GpuBruteForce, Method::GpuGrid];
    let [cpu_grid, brute_force, gpu_grid] = methods.map(|m| variants::curve(rows, m, 50.0));
    let ([cpu_grid, brute_force, gpu_grid], first, last) = growths([&cpu_grid, &brute_force, &gpu_grid])?;
    Some((
        gpu_grid < cpu_grid && gpu_grid < brute_force,
        format!(
            "from {} to {} particles with about 50 neighbours the grid on the GPU grows {}, on the CPU {}, brute force on the GPU {}",
            short(first),
            short(last),
            times(gpu_grid),
            times(cpu_grid),
            times(brute_force)
        ),
    ))
}

fn cpu_grid_outpaces_gpu_brute_force(rows: &[Row]) -> Option<(bool, String)> {
    let (mut faster, mut points, mut best) = (0, 0, 0.0f64);
    for wanted in variants::NEIGHBORS {
        let grid = variants::curve(rows, Method::CpuGrid, wanted);
        for (n, milliseconds) in variants::curve(rows, Method::GpuBruteForce, wanted) {
            if let Some(own) = grid.iter().find(|p| p.0 == n) {
                points += 1;
                faster += usize::from(own.1 < milliseconds);
                best = best.max(milliseconds / own.1);
            }
        }
    }
    let best = times(best);
    (points > 0).then(|| (faster > 0, format!("in {faster} of {points} cases, at best {best} as fast")))
}

fn brute_force_is_flat(rows: &[Row], particles: usize) -> Option<(bool, String)> {
    let brute_force = on_gpu::over_neighbors(rows, Method::GpuBruteForce, particles);
    let grid = on_gpu::over_neighbors(rows, Method::GpuGrid, particles);
    let ([brute_growth, grid_growth], fewest, most) = growths([&brute_force, &grid])?;
    let (_, brute_last, grid_last) = last_common(&brute_force, &grid)?;
    Some((
        grid_growth > 2.0 * brute_growth,
        format!(
            "from {} to {} mean neighbours of {particles} particles brute force grows {} and the grid {}, to {} and {}",
            short(fewest),
            short(most),
            times(brute_growth),
            times(grid_growth),
            time(brute_last),
            time(grid_last)
        ),
    ))
}

fn brute_force_breaks_down(rows: &[Row]) -> Option<(bool, String)> {
    let brute_force = on_gpu::over_particles(rows, Method::GpuBruteForce);
    let grid = on_gpu::over_particles(rows, Method::GpuGrid);
    let ([brute_growth, grid_growth], fewest, most) = growths([&brute_force, &grid])?;
    let (_, brute_last, grid_last) = last_common(&brute_force, &grid)?;
    Some((
        brute_growth > 2.0 * grid_growth && brute_last > 2.0 * grid_last,
        format!(
            "from {} to {} particles brute force grows {} and the grid {}; at the end brute force takes {} as long",
            short(fewest),
            short(most),
            times(brute_growth),
            times(grid_growth),
            times(brute_last / grid_last)
        ),
    ))
}

/// Share of the named stages in all, in percent.
fn share(stages: &[(String, f64)], names: &[&str]) -> Option<f64> {
    let sum: f64 = stages.iter().map(|s| s.1).sum();
    let own: f64 = stages.iter().filter(|s| names.contains(&s.0.as_str())).map(|s| s.1).sum();
    (sum > 0.0).then_some(100.0 * own / sum)
}

/// Stages that test distances or write neighbours; the scan between them is not searching.
const SEARCH: [&str; 3] = ["count", "fill", "fill long rows"];

fn brute_force_only_searches(rows: &[Row], particles: usize) -> Option<(bool, String)> {
    let search = share(&stages::stages(rows, Method::GpuBruteForce, particles), &SEARCH)?;
    // "Almost all" is taken as nine tenths.
    Some((
        search >= 90.0,
        format!("{search:.0} % of the wall clock at {particles} particles is counting and filling rows"),
    ))
}

fn grid_sorts(rows: &[Row], particles: usize) -> Option<(bool, String)> {
    let stages = stages::stages(rows, Method::GpuGrid, particles);
    let (search, sort, other) = (share(&stages, &SEARCH)?, share(&stages, &["sort"])?, share(&stages, &["other"])?);
    let rest = 100.0 - search - other;
    Some((
        // "A lot" is taken as a quarter.
        rest >= 25.0 && sort >= 0.5 * rest,
        format!(
            "at {particles} particles searching takes {search:.0} % of the wall clock, sorting {sort:.0} %, the other stages on the device {:.0} %, and {other:.0} % is none of them (submitting, waiting, taking memory)",
            (rest - sort).max(0.0)
        ),
    ))
}

/// The grid's worst case over radii: radius, extra bytes.
fn worst(rows: &[Row], method: &str, particles: usize) -> Option<(f64, f64)> {
    memory::extra(rows, method, particles).into_iter().max_by(|a, b| a.1.total_cmp(&b.1))
}

fn memory_of_few(rows: &[Row], particles: Option<usize>) -> Option<(bool, String)> {
    let n = particles?;
    let [cpu, gpu, dense] = memory::METHODS.map(|method| worst(rows, method, n));
    let (radius, bytes) = cpu?;
    let percent = |bytes: f64| 100.0 * bytes / (12.0 * n as f64);
    let (dense_radius, dense_bytes) = dense?;
    let on_gpu = gpu.map_or_else(String::new, |(_, bytes)| format!(", on the GPU {}B", short(bytes)));
    Some((
        percent(bytes) >= 50.0 && bytes <= 5.5e6,
        format!(
            "the most is {}B or {:.0} % of the points (radius {}){on_gpu}; rows are hashed where cells are many, while a dense table needs {}B at radius {}",
            short(bytes),
            percent(bytes),
            short(radius),
            short(dense_bytes),
            short(dense_radius)
        ),
    ))
}

fn memory_of_many(rows: &[Row], particles: Option<usize>) -> Option<(bool, String)> {
    let n = particles?;
    let cpu = memory::extra(rows, memory::METHODS[0], n);
    let percent = |bytes: f64| 100.0 * bytes / (12.0 * n as f64);
    let (least, most) = cpu.iter().fold((f64::INFINITY, 0.0f64), |(l, m), p| (l.min(p.1), m.max(p.1)));
    // "Insignificant" is taken as a tenth of the points.
    (!cpu.is_empty()).then(|| {
        (
            percent(most) <= 10.0,
            format!(
                "on the CPU {}B to {}B, {:.0} to {:.0} % of the {} points; 4 bytes a point are the index that gives answers in the caller's numbers",
                short(least),
                short(most),
                percent(least),
                percent(most),
                short(n as f64)
            ),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_over_what_all_curves_have() {
        let (long, short) = ([(1.0, 9.0), (2.0, 2.0), (4.0, 6.0), (8.0, 99.0)], [(2.0, 1.0), (4.0, 10.0)]);
        assert_eq!(growths([&long, &short]), Some(([3.0, 10.0], 2.0, 4.0)));
        assert_eq!(growths([&long, &short[..1]]), None);
        assert_eq!(growths([&long, &[]]), None);
        assert_eq!(last_common(&long, &short), Some((4.0, 6.0, 10.0)));
    }

    #[test]
    fn shares_are_of_all_stages() {
        let stages = [("count".to_owned(), 1.0), ("sort".to_owned(), 2.0), ("fill".to_owned(), 1.0)];
        assert_eq!(share(&stages, &SEARCH), Some(50.0));
        assert_eq!(share(&[], &SEARCH), None);
    }
}
