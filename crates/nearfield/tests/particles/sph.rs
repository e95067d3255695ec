//! Smoothed fluids against published experiments, exact solutions and what is conserved; and cases with few particles.

mod edges;
mod flows;
pub(crate) mod scenes;

use nearfield::application::Watch;
use nearfield::application::particles::{ParticleScene, Simulate, Simulation, SimulationSettings};

/// Whether cases that take minutes are asked for.
fn is_long() -> bool {
    std::env::var_os("NEARFIELD_LONG").is_some_and(|v| v == "1")
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
