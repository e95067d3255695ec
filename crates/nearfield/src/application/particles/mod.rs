//! Particles that move and act on their neighbours: grains and fluids, on the CPU in double precision and on the GPU without leaving it.
//!
//! A [`ParticleScene`] says what there is and by which laws it moves, [`SimulationSettings`] how that is computed: the neighbours of each step are
//! found by any [`ParticleSearch`], and no list of them is made unless the search is one. [`Simulation`] runs on the CPU, `GpuSimulation`
//! on a device; both are a [`Simulate`].
//!
//! ```
//! use nearfield::application::Watch;
//! use nearfield::application::particles::{Simulate, Simulation, SimulationSettings, builtin_scene};
//!
//! let scene = builtin_scene("dem-box", &Default::default())?;
//! let mut simulation = Simulation::new(&scene, &SimulationSettings::default())?;
//! let reports = simulation.advance(3, &mut Watch::none())?;
//! assert!(reports[2].mean_neighbors > 1.0);
//! assert!(simulation.measure()?.mean_position.y < 0.0);
//! # Ok::<(), nearfield::Error>(())
//! ```
//!
//! Sources: Green2010 (grains), Macklin2013 (position-based fluids), Becker2007 and Bender2017 (smoothed particle hydrodynamics),
//! Akinci2012 (boundaries), Xing2017 §5.2 and §7 (what is measured).

mod checkpoint;
mod cpu;
mod dem;
mod dfsph;
mod fluid;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_list;
#[cfg(feature = "gpu")]
mod gpu_neighborhood;
#[cfg(feature = "gpu")]
mod gpu_state;
mod images;
mod lattice;
mod measures;
mod neighborhood;
mod pbf;
mod reach;
mod scene;
#[cfg(feature = "io")]
mod scene_file;
mod scenes;
mod search;
mod simulate;
mod state;
mod surface;
mod wcsph;

pub use checkpoint::Checkpoint;
pub use cpu::Simulation;
pub use dem::{Collider, DemSettings, PairRule};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use dem::{DemCollide, DemIntegrate};
pub use dfsph::DfsphSettings;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use dfsph::{DfsphFluid, DfsphProgress};
pub use fluid::{Fluid, SmoothingKernel};
#[cfg(feature = "gpu")]
pub use gpu::GpuSimulation;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::{ParticleClock, ParticleInspection, ParticlePart, ParticleRecord};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu_list::ParticleDrift;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu_state::ParticleBlock;
pub use lattice::{fill_ball, fill_box, line_box};
pub use measures::Measures;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use pbf::PbfFluid;
pub use pbf::PbfSettings;
pub use scene::{Dimensions, MOST_CLASSES, ParticleModel, ParticleScene, Particles, TimeStep};
#[cfg(feature = "io")]
pub use scene_file::{parse_particle_scene, read_particle_scene};
pub use scenes::{BuiltinOptions, FluidModel, builtin_names, builtin_scene};
pub use search::{ParticleSearch, SimulationSettings};
pub use simulate::{SearchTime, Simulate, StepReport};
pub use surface::ParticleSurface;
pub use wcsph::WcsphSettings;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use wcsph::{WcsphFluid, WcsphLimits};
