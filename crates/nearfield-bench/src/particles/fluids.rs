//! Fluids by every model with a million particles, and the fluid of Accel by its grid and by brute force.

use nearfield::application::particles::{BuiltinOptions, FluidModel, ParticleSearch, builtin_scene};

use super::case::{self, Case, Pace};
use super::check;
use super::original::ACCEL_FRAMES;
use super::timing::{self, Timed};
use super::ways::{Way, devices};
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::rows::{Row, Sheet};

/// Particles of the dam break.
pub const PARTICLES: usize = 1_000_000;
/// Particles of Accel's fluid.
pub const ACCEL_PARTICLES: [usize; 2] = [10_000, 100_000];
const STEPS: u32 = 300;
const SEARCHES: [ParticleSearch; 2] =
    [ParticleSearch::UNIFORM_GRID, ParticleSearch::Verlet { skin: ParticleSearch::SKIN }];
/// A fluid whose mean compression is larger in parts has lost its volume.
const MOST_COMPRESSION: f64 = 0.1;

/// Measures all models, and Accel's fluid.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "fluids")?;
    let accel = case::sizes(lab, &ACCEL_PARTICLES);
    let rows = devices(lab).len() * (FluidModel::ALL.len() * SEARCHES.len() + 2 * accel.len());
    let mut pace = Pace::new(lab, rows);
    for &on_gpu in devices(lab) {
        for model in FluidModel::ALL {
            let case = of_model(lab, "dam-break", model, PARTICLES)?;
            for search in SEARCHES {
                let (way, seconds) = (Way { search, on_gpu }, pace.next_share());
                let row = case.row(lab, on_gpu, way.name());
                sheet.attempt(row.clone(), || Ok(vec![run(lab, &case, way, seconds, row)?.0]))?;
            }
        }
        for &particles in &accel {
            let case = of_model(lab, "accel-fluid", FluidModel::Pbf, particles)?;
            let mut by_brute_force = None;
            for (search, frames) in
                [ParticleSearch::BruteForce, ParticleSearch::UNIFORM_GRID].into_iter().zip(ACCEL_FRAMES)
            {
                let (way, seconds) = (Way { search, on_gpu }, pace.next_share());
                let row = case.row(lab, on_gpu, way.name());
                sheet.attempt(row.clone(), || {
                    let (row, timed) = run(lab, &case, way, seconds, row)?;
                    let mut rows = vec![row.clone().paper(Some(frames))];
                    match by_brute_force {
                        None => by_brute_force = Some(timed.rate()),
                        Some(slow) => {
                            let gain = row.of("gain of the grid", "times").value(timed.rate() / slow);
                            let paper = Some(ACCEL_FRAMES[1] / ACCEL_FRAMES[0]);
                            rows.push(gain.paper(paper).note("its steps a second by those of brute force"));
                        }
                    }
                    Ok(rows)
                })?;
            }
        }
    }
    Ok(sheet.into_rows())
}

/// A built-in scene of a fluid with about so many particles, times the scale.
///
/// # Errors
/// As [`builtin_scene`].
pub(crate) fn of_model(lab: &Lab, name: &str, model: FluidModel, particles: usize) -> Result<Case> {
    let options = BuiltinOptions {
        particles: Some(u32::try_from(lab.points(particles))?),
        model: Some(model),
        ..BuiltinOptions::default()
    };
    let scene = builtin_scene(name, &options)?;
    let setting = format!("{name}, {model}");
    Ok(Case { scene, paper_particles: particles, setting, r_over_l: 0.0, steps: case::steps(lab, STEPS) })
}

/// Times a run; its fluid must stay a fluid.
///
/// # Errors
/// As the simulation; a wrong answer.
pub(crate) fn run(lab: &Lab, case: &Case, way: Way, seconds: f64, row: Row) -> Result<(Row, Timed)> {
    let timed = timing::run(lab, way, &case.scene, case.steps, 0.8 * seconds)?;
    check::sane(&timed.end)?;
    if !(timed.density_error < MOST_COMPRESSION) {
        return Err(format!("wrong answer: the fluid is {} denser than at rest", timed.density_error).into());
    }
    let note = format!(
        "{} of {} steps; {:.1} iterations a step; {:.3} % denser than at rest on average; energy {:.4e} J at the end; {} particles of walls",
        timed.steps,
        case.steps,
        timed.iterations,
        100.0 * timed.density_error,
        timed.end.energy(),
        case.scene.boundary.len()
    );
    let (mean_neighbors, runs) = (Some(timed.mean_neighbors), timed.steps as usize);
    Ok((Row { mean_neighbors, runs, value: Some(timed.rate()), note, ..row }, timed))
}
