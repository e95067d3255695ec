//! Smoothed fluids against published experiments, exact solutions and what is conserved; and cases with few particles.

mod columns;
mod edges;
mod flows;
mod scenes;

pub(crate) use columns::column;

use libtest_mimic::Trial;
use nearfield::application::Watch;
use nearfield::application::particles::{ParticleScene, Simulate, Simulation, SimulationSettings};

/// The trials of smoothed fluids.
pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = edges::trials();
    trials.extend(flows::trials());
    trials.extend(columns::trials());
    trials
}

/// A simulation with usual settings.
fn simulation(scene: &ParticleScene) -> Simulation {
    Simulation::new(scene, &SimulationSettings::default()).expect("a scene that can be simulated")
}

/// Makes steps until this time has passed; returns how many.
fn advance_to(simulation: &mut Simulation, time: f64) -> u64 {
    let before = simulation.step();
    while simulation.time() < time {
        simulation.advance(1, &mut Watch::none()).expect("a step");
    }
    simulation.step() - before
}
