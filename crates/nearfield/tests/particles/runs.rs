//! Some steps of a scene on the CPU and on a device: where its particles are then, and what each step did.

use nearfield::application::Watch;
use nearfield::application::particles::{
    GpuSimulation, ParticleScene, Particles, Simulate, Simulation, SimulationSettings, StepReport,
};
use nearfield::gpu::Gpu;

pub(crate) type Ran = (Particles, Vec<StepReport>);

/// On a device.
pub(crate) fn run(gpu: &Gpu, scene: &ParticleScene, settings: &SimulationSettings, steps: u32) -> Ran {
    ran(GpuSimulation::new(gpu, scene, settings).unwrap(), steps)
}

/// On the CPU.
pub(crate) fn on_cpu(scene: &ParticleScene, settings: &SimulationSettings, steps: u32) -> Ran {
    ran(Simulation::new(scene, settings).unwrap(), steps)
}

fn ran(mut simulation: impl Simulate, steps: u32) -> Ran {
    let reports = simulation.advance(steps, &mut Watch::none()).unwrap();
    (simulation.particles().unwrap(), reports)
}
