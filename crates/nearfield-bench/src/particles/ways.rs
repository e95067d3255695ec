//! Who simulates: a search on a device.

use nearfield::application::particles::{
    GpuSimulation, ParticleScene, ParticleSearch, Simulate, Simulation, SimulationSettings,
};
use nearfield::gpu::AdapterKind;

use crate::Result;
use crate::paper::lab::Lab;

/// Most pairs of a step that are tried by brute force: on a GPU in hardware, and elsewhere.
const MOST_PAIRS: [f64; 2] = [1e11, 3e9];

/// The single grid of figure 20 with cells for its smallest radius: its radii are 3 r, 2 r and r, so by each rule the least reach is a third
/// of the largest, and a large ball touches many cells.
pub const AT_R_MIN: ParticleSearch = ParticleSearch::UniformGrid { cell: 1.0 / 3.0 };

/// A search on a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Way {
    /// Who finds neighbours.
    pub search: ParticleSearch,
    /// On the GPU, or on all threads of the host.
    pub on_gpu: bool,
}

impl Way {
    /// "coherent, GPU".
    pub fn name(self) -> String {
        method(search_name(self.search), self.on_gpu)
    }

    /// A simulation from the start of the scene.
    ///
    /// # Errors
    /// As the simulations; `Unsupported` for brute force among so many particles that a step takes seconds.
    pub fn open(self, lab: &Lab, scene: &ParticleScene, deterministic: bool) -> Result<Box<dyn Simulate>> {
        let gpu = lab.gpu().filter(|_| self.on_gpu);
        let in_hardware = gpu.is_some_and(|gpu| gpu.kind() != AdapterKind::Software);
        let pairs = (scene.particles.len() as f64).powi(2);
        if self.search == ParticleSearch::BruteForce && pairs > MOST_PAIRS[usize::from(!in_hardware)] {
            let what = format!("brute force over {pairs:.1e} pairs a step");
            return Err(nearfield::Error::Unsupported { what, advice: "use fewer particles" }.into());
        }
        let settings = self.settings(deterministic);
        Ok(match gpu {
            Some(gpu) => Box::new(GpuSimulation::new(gpu, scene, &settings)?),
            None => Box::new(Simulation::new(scene, &settings)?),
        })
    }

    /// A simulation on the GPU, whose stages can be timed; `None` on the host.
    ///
    /// # Errors
    /// As the simulation.
    pub fn open_on_gpu(self, lab: &Lab, scene: &ParticleScene) -> Result<Option<GpuSimulation>> {
        let gpu = lab.gpu().filter(|_| self.on_gpu);
        Ok(gpu.map(|gpu| GpuSimulation::new(gpu, scene, &self.settings(false))).transpose()?)
    }

    fn settings(self, deterministic: bool) -> SimulationSettings {
        SimulationSettings { search: self.search, deterministic, ..SimulationSettings::default() }
    }
}

/// The name of a search in the tables.
pub fn search_name(search: ParticleSearch) -> &'static str {
    if search == AT_R_MIN { "uniform-grid at r_min" } else { search.name() }
}

/// The name of a method on a device.
pub fn method(name: &str, on_gpu: bool) -> String {
    format!("{name}, {}", if on_gpu { "GPU" } else { "CPU" })
}

/// The devices that are measured: the GPU first, where there is one.
pub fn devices(lab: &Lab) -> &'static [bool] {
    if lab.gpu().is_some() { &[true, false] } else { &[false] }
}

/// All searches, the paper's own first, brute force last.
pub fn searches() -> Vec<ParticleSearch> {
    let named = ["coherent", "primary", "aabb-tree", "uniform-grid", "multi-level-grid", "verlet", "brute-force"];
    named.iter().filter_map(|name| name.parse().ok()).collect()
}
