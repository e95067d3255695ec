//! Steps a second of whole runs, and milliseconds of single steps.

use std::time::Instant;

use nearfield::application::Watch;
use nearfield::application::particles::{Measures, ParticleScene, Particles, Simulate};

use super::ways::Way;
use crate::Result;
use crate::paper::lab::Lab;

/// Most steps that are asked for together; the device is waited for after each such batch, or more often by the simulation itself.
const MOST_TOGETHER: u32 = 512;
/// Seconds that a batch should take.
const BATCH: f64 = 0.25;

/// A timed run.
#[derive(Debug, Clone)]
pub struct Timed {
    /// Steps that were made.
    pub steps: u32,
    /// Seconds they took.
    pub seconds: f64,
    /// Mean number of others that act on a particle, over all steps.
    pub mean_neighbors: f64,
    /// Trees and lists that were built anew.
    pub rebuilds: u32,
    /// Mean iterations of solvers in a step.
    pub iterations: f64,
    /// Mean density error over all steps, in parts.
    pub density_error: f64,
    /// Of all particles at the end.
    pub end: Measures,
    /// They themselves.
    pub particles: Particles,
}

impl Timed {
    /// Steps a second.
    pub fn rate(&self) -> f64 {
        f64::from(self.steps) / self.seconds
    }
}

/// One step.
#[derive(Debug, Clone, Copy)]
pub struct StepTime {
    /// Its number, from 1.
    pub step: u64,
    /// Milliseconds.
    pub milliseconds: f64,
    /// Mean number of others that act on a particle.
    pub mean_neighbors: f64,
    /// Trees and lists that were built anew.
    pub rebuilds: u32,
    /// Milliseconds of a search by itself after it, where one was made.
    pub search: Option<f64>,
}

/// A simulation whose kernels are compiled and whose device is awake, at the start of its scene.
///
/// - `searches`: whether searches by themselves will be timed too
fn warm(lab: &Lab, way: Way, scene: &ParticleScene, searches: bool) -> Result<Box<dyn Simulate>> {
    let mut simulation = way.open(lab, scene, false)?;
    let seconds = if way.on_gpu { lab.effort().warm_up } else { 0.0 };
    let start = Instant::now();
    loop {
        simulation.advance(1, &mut Watch::none())?;
        if searches {
            simulation.time_search()?;
        }
        if start.elapsed().as_secs_f64() >= seconds {
            break;
        }
    }
    simulation.resume(&scene.particles, 0, 0.0)?;
    // What was sent to the device is there.
    drop(simulation.particles()?);
    Ok(simulation)
}

/// Times a run from the start of a scene, its first builds included, up to so many steps and for about so many seconds.
///
/// # Errors
/// As the simulation.
pub fn run(lab: &Lab, way: Way, scene: &ParticleScene, steps: u32, seconds: f64) -> Result<Timed> {
    let mut simulation = warm(lab, way, scene, false)?;
    let (mut done, mut together, mut rebuilds) = (0, 1, 0);
    let (mut neighbors, mut iterations, mut density_error) = (0.0, 0.0, 0.0);
    let begin = Instant::now();
    while done < steps {
        let batch = together.min(steps - done);
        let start = Instant::now();
        for report in simulation.advance(batch, &mut Watch::none())? {
            neighbors += report.mean_neighbors;
            iterations += f64::from(report.iterations);
            density_error += report.density_error[0];
            rebuilds += report.rebuilds;
        }
        done += batch;
        if begin.elapsed().as_secs_f64() > seconds {
            break;
        }
        let took = start.elapsed().as_secs_f64() / f64::from(batch);
        together = ((BATCH / took.max(1e-9)) as u32).clamp(1, MOST_TOGETHER);
    }
    let took = begin.elapsed().as_secs_f64();
    let mean = |sum: f64| sum / f64::from(done.max(1));
    let particles = simulation.particles()?;
    Ok(Timed {
        steps: done,
        seconds: took,
        mean_neighbors: mean(neighbors),
        rebuilds,
        iterations: mean(iterations),
        density_error: mean(density_error),
        end: Measures::of(scene, &particles),
        particles,
    })
}

/// Steps whose stages are timed.
const TIMED_STEPS: usize = 41;

/// Microseconds of each stage of a step by the device's clock, medians over some steps from the scene on; none where the device has no clock,
/// or on the host.
///
/// # Errors
/// As the simulation.
pub fn stages(lab: &Lab, way: Way, scene: &ParticleScene) -> Result<Vec<(&'static str, f64)>> {
    let Some(mut simulation) = way.open_on_gpu(lab, scene)? else { return Ok(Vec::new()) };
    simulation.advance(2, &mut Watch::none())?;
    let mut times: Vec<(&'static str, Vec<f64>)> = Vec::new();
    for _ in 0..TIMED_STEPS {
        let mut step: Vec<(&'static str, f64)> = Vec::new();
        for stage in simulation.advance_timed()?.1 {
            match step.iter_mut().find(|(name, _)| *name == stage.name) {
                Some((_, sum)) => *sum += stage.milliseconds * 1e3,
                None => step.push((stage.name, stage.milliseconds * 1e3)),
            }
        }
        for (name, sum) in step {
            match times.iter_mut().find(|(known, _)| *known == name) {
                Some((_, sums)) => sums.push(sum),
                None => times.push((name, vec![sum])),
            }
        }
    }
    let median = |(name, mut sums): (&'static str, Vec<f64>)| {
        sums.sort_by(f64::total_cmp);
        (name, sums[sums.len() / 2])
    };
    Ok(times.into_iter().map(median).collect())
}

/// Times every step of a run by itself, up to so many and for about so many seconds: the device is waited for after each.
///
/// - `search_every`: after so many steps a search by itself is timed too, from the first on, outside the time of steps; 0 for never
///
/// # Errors
/// As the simulation.
pub fn each_step(
    lab: &Lab,
    way: Way,
    scene: &ParticleScene,
    (steps, search_every): (u32, u32),
    seconds: f64,
) -> Result<Vec<StepTime>> {
    let mut simulation = warm(lab, way, scene, search_every > 0)?;
    let mut times = Vec::with_capacity(steps as usize);
    let begin = Instant::now();
    while times.len() < steps as usize && (times.is_empty() || begin.elapsed().as_secs_f64() < seconds) {
        let start = Instant::now();
        let reports = simulation.advance(1, &mut Watch::none())?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let is_sampled = search_every > 0 && (times.len() as u32).is_multiple_of(search_every);
        let search = if is_sampled { Some(1e3 * simulation.time_search()?.seconds) } else { None };
        times.extend(reports.iter().map(|report| StepTime {
            step: report.step,
            milliseconds,
            mean_neighbors: report.mean_neighbors,
            rebuilds: report.rebuilds,
            search,
        }));
    }
    Ok(times)
}
