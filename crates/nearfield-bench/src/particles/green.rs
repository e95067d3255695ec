//! The grains of Green2010 at the sizes of the CUDA sample: steps a second, and what of the memory's bandwidth that is.

use nearfield::application::particles::{ParticleModel, ParticleScene, ParticleSearch};

use super::case::{self, Case, Pace, Shared};
use super::ways::Way;
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::rows::{Row, Sheet};

/// Sizes on the GPU.
pub const SIZES_ON_GPU: [usize; 3] = [65_536, 250_000, 1_000_000];
/// Sizes on the CPU.
pub const SIZES_ON_CPU: [usize; 2] = [16_384, 100_000];
const NAMES: [&str; 4] = ["uniform-grid", "verlet", "coherent", "aabb-tree"];
const STEPS: u32 = 2000;

/// Measures all sizes.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "green")?;
    let searches: Vec<ParticleSearch> = NAMES.iter().filter_map(|name| name.parse().ok()).collect();
    let on_gpu = if lab.gpu().is_some() { case::sizes(lab, &SIZES_ON_GPU) } else { Vec::new() };
    let on_cpu = case::sizes(lab, &SIZES_ON_CPU);
    let all: Vec<(bool, usize)> = on_gpu.iter().map(|&n| (true, n)).chain(on_cpu.iter().map(|&n| (false, n))).collect();
    let mut pace = Pace::new(lab, all.len() * searches.len());
    for (on_gpu, size) in all {
        let case = of_size(lab, size)?;
        let mut shared = Shared::default();
        for &search in &searches {
            let (way, seconds) = (Way { search, on_gpu }, pace.next_share());
            sheet.attempt(case.row(lab, on_gpu, way.name()), || {
                let (row, timed) = case.time(lab, way, seconds, &mut shared)?;
                let mut rows = vec![row.clone()];
                if search == ParticleSearch::UNIFORM_GRID {
                    rows.extend(case.stages(lab, way, &row, &timed)?);
                }
                if search == ParticleSearch::UNIFORM_GRID && on_gpu {
                    let bytes = bytes_a_step(&case.scene);
                    let note =
                        "what a step has to move at least once: positions, velocities, the sort of the grid, reports";
                    rows.push(row.of("memory traffic of a step, at least", "MB").value(bytes * 1e-6).note(note));
                    let note = "that traffic by the time of a step; neighbours come from caches and are not counted";
                    rows.push(row.of("bandwidth of that", "GB/s").value(bytes * timed.rate() * 1e-9).note(note));
                }
                Ok(rows)
            })?;
        }
    }
    Ok(sheet.into_rows())
}

/// The sample's lattice of about so many grains, times the scale.
///
/// # Errors
/// As the built-in scene.
pub(crate) fn of_size(lab: &Lab, size: usize) -> Result<Case> {
    Ok(Case {
        scene: case::scene("dem-box", lab.points(size))?,
        paper_particles: size,
        setting: String::new(),
        r_over_l: 0.0,
        steps: case::steps(lab, STEPS),
    })
}

/// Bytes that a step with a uniform grid has to read and write at least.
///
/// A particle is a position and a velocity of 16 bytes each. Motion reads and writes both; the table entry of each is made from its
/// position (16 + 8); every pass of the sort reads and writes a key and a value of 4 bytes; the gather reads a place and a position and
/// writes one; the search reads position and velocity, and writes a velocity and a count; the report reads position, velocity and count.
pub fn bytes_a_step(scene: &ParticleScene) -> f64 {
    let ParticleModel::Dem(dem) = &scene.model else { return 0.0 };
    let n = scene.particles.len() as f64;
    let cells = (scene.domain[1] - scene.domain[0]) / dem.largest_reach();
    // No more entries than 8 a particle, and digits of 8 bits.
    let entries = cells.element_product().min(8.0 * n).max(2.0);
    let passes = (entries.log2() / 8.0).ceil();
    let (motion, entry, gather, search, report) = (64.0, 24.0, 36.0, 52.0, 36.0);
    n * (motion + entry + 16.0 * passes + gather + search + report)
}
