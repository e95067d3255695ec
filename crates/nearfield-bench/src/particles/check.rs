//! Whether searches simulate the same: bit by bit in deterministic mode, and in what is measured of all particles after a timed run.

use nearfield::application::Watch;
use nearfield::application::particles::{Measures, ParticleScene, ParticleSearch, Particles};
use nearfield::gpu::AdapterKind;

use super::timing::Timed;
use super::ways::Way;
use crate::Result;
use crate::paper::lab::Lab;

/// Steps in deterministic mode: on a GPU in hardware, and elsewhere.
const STEPS: [u32; 2] = [20, 4];
/// Up to so many particles the others are compared with brute force, beyond with the uniform grid.
const MOST_BY_BRUTE_FORCE: usize = 20_000;
/// By how much the centre of all particles may differ after runs in which sums were taken in another order, in parts of the domain.
const CENTER: f64 = 0.005;
/// By which factor kinetic energies may differ then.
const ENERGY: f64 = 2.0;
/// By how much mean neighbours may differ then, in parts.
const NEIGHBORS: f64 = 0.05;

/// Where particles are after some deterministic steps on one device.
pub struct Reference {
    search: ParticleSearch,
    steps: u32,
    particles: Particles,
}

impl Reference {
    /// By brute force, or by the uniform grid where there are many particles.
    ///
    /// # Errors
    /// As the simulations.
    pub fn of(lab: &Lab, scene: &ParticleScene, on_gpu: bool) -> Result<Self> {
        let few = scene.particles.len() <= MOST_BY_BRUTE_FORCE;
        let search = if few { ParticleSearch::BruteForce } else { ParticleSearch::UNIFORM_GRID };
        let in_hardware = on_gpu && lab.gpu().is_some_and(|gpu| gpu.kind() != AdapterKind::Software);
        let steps = STEPS[usize::from(!in_hardware)];
        let particles = after(lab, scene, Way { search, on_gpu }, steps)?;
        Ok(Self { search, steps, particles })
    }

    /// Checks that another search leads to the same, to the bit; says what was compared.
    ///
    /// # Errors
    /// The first particle that differs; as the simulations.
    pub fn check(&self, lab: &Lab, scene: &ParticleScene, way: Way) -> Result<String> {
        same(&after(lab, scene, way, self.steps)?, &self.particles)
            .map_err(|error| format!("{error} by {} after {} steps", self.search, self.steps))?;
        Ok(format!("{} deterministic steps to the bit as by {}", self.steps, self.search))
    }
}

fn after(lab: &Lab, scene: &ParticleScene, way: Way, steps: u32) -> Result<Particles> {
    let mut simulation = way.open(lab, scene, true)?;
    simulation.advance(steps, &mut Watch::none())?;
    Ok(simulation.particles()?)
}

/// Checks that particles are the same to the bit.
///
/// # Errors
/// The first that differs.
pub fn same(found: &Particles, expected: &Particles) -> Result<()> {
    if found.len() != expected.len() {
        return Err(format!("wrong answer: {} particles, expected {}", found.len(), expected.len()).into());
    }
    let differs = |&i: &usize| {
        found.positions[i] != expected.positions[i]
            || found.velocities[i] != expected.velocities[i]
            || found.classes[i] != expected.classes[i]
    };
    match (0..found.len()).find(differs) {
        None => Ok(()),
        Some(i) => Err(format!(
            "wrong answer: particle {i} at {} with velocity {}, expected {} and {}",
            found.positions[i], found.velocities[i], expected.positions[i], expected.velocities[i]
        )
        .into()),
    }
}

/// Checks that everything is a number and inside.
///
/// # Errors
/// What is not.
pub fn sane(measures: &Measures) -> Result<()> {
    let Measures { kinetic_energy, potential_energy, momentum, outside, .. } = measures;
    if !(kinetic_energy.is_finite() && potential_energy.is_finite() && momentum.is_finite()) {
        return Err(format!("wrong answer: energies {kinetic_energy}, {potential_energy}, momentum {momentum}").into());
    }
    if *outside > 0 {
        return Err(format!("wrong answer: {outside} particles are outside the domain").into());
    }
    Ok(())
}

/// Checks that two runs of as many steps of one scene come to about the same, as sums in another order let them; runs of another
/// number of steps are not compared.
///
/// # Errors
/// What differs by more.
pub fn close(scene: &ParticleScene, found: &Timed, expected: &Timed) -> Result<()> {
    if found.steps != expected.steps {
        return Ok(());
    }
    let (a, b) = (&found.end, &expected.end);
    let size = scene.domain[1] - scene.domain[0];
    let moved = (a.mean_position - b.mean_position).abs();
    if moved.cmpgt(CENTER * size).any() {
        return Err(format!("wrong answer: the centre is {}, expected {}", a.mean_position, b.mean_position).into());
    }
    let (energy, other) = (a.kinetic_energy, b.kinetic_energy);
    if energy > ENERGY * other || other > ENERGY * energy {
        return Err(format!("wrong answer: kinetic energy {energy:.4e}, expected {other:.4e}").into());
    }
    let (neighbors, others) = (found.mean_neighbors, expected.mean_neighbors);
    if (neighbors - others).abs() > NEIGHBORS * others.max(0.1) {
        return Err(format!("wrong answer: {neighbors:.3} neighbours on average, expected {others:.3}").into());
    }
    Ok(())
}
