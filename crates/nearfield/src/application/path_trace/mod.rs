//! Pictures by light transport: a path tracer over any ray structure.
//!
//! **Theory.** The light that a pixel gets is an integral over all paths from it to a light (Kajiya1986). Each sample
//! follows one: it scatters as the material says, asks one light at each surface whether it is seen (next-event
//! estimation), and weights what it meets and what it asks for by the power heuristic (Veach1997).
//! From `roulette_depth` on a path that carries little ends by chance, and the others count for it.
//!
//! **Stages.** [`generate`](self) the rays of a tile, cast them as one batch, `shade` the hits (light met, a shadow ray,
//! the next ray), cast the shadow rays as one batch, `accumulate`, until no path is left. The stages are functions of
//! integers and floats, written once per language; a tile is a wavefront on the CPU as on the device.
//!
//! **Cost.** Up to `depth` + 1 rays and `depth` shadow rays a sample; 64 bytes a triangle beside the structure, and
//! some 200 bytes for each path of a tile of 32,768.
//!
//! **Invariants.**
//! 1. The mean of a picture's samples tends to the integral over paths of at most `depth` scatterings: nothing is
//!    clamped. What is not finite is left out and counted ([`Film::dropped`]).
//! 2. A sample is a function of scene, seed, pixel and its number. The same picture comes from any number of threads,
//!    and from all structures that name the same triangles.
//! 3. Rays start off their triangle by a length that follows from the mesh's size and coordinates, never by a fixed one.
//!
//! Triangles are flat, pixels are boxes, and light has three channels.

mod bsdf;
mod camera;
mod cpu;
mod film;
mod generate;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_tables;
mod light;
mod material;
mod sampling;
mod scene;
#[cfg(feature = "io")]
mod scene_file;
mod shade;
mod tables;

pub use camera::{Camera, CameraFrame};
pub use cpu::PathTracer;
pub use film::Film;
pub use generate::{PathParameters, PathState};
#[cfg(feature = "gpu")]
pub use gpu::GpuPathTracer;
#[cfg(feature = "gpu")]
pub use gpu_tables::SceneLayout;
pub use light::{Environment, EnvironmentImage, PointLight};
pub use material::{Material, Surface};
pub use scene::Scene;
#[cfg(feature = "io")]
pub use scene_file::{SceneReader, parse_scene, read_scene};

use crate::{Error, Result};

/// How paths are followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathSettings {
    /// Most scatterings of a path, up to 1000; 0 shows lights alone. What light would reach the camera after more is missing.
    pub depth: u32,
    /// Scatterings after which paths may end by chance; this takes time off and adds noise, but no error.
    pub roulette_depth: u32,
    /// Picks one of the equally likely pictures.
    pub seed: u32,
    /// Whether lights are asked directly. Without it point lights are not seen, and small lights take many samples.
    pub next_event: bool,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self { depth: 10, roulette_depth: 3, seed: 0, next_event: true }
    }
}

/// Most scatterings that can be asked for.
const MOST_DEPTH: u32 = 1000;

impl PathSettings {
    /// Checks the depth.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn check(&self) -> Result<()> {
        if self.depth > MOST_DEPTH {
            let found = self.depth.to_string();
            return Err(Error::InvalidSetting { setting: "depth", found, expected: "a whole number from 0 to 1000" });
        }
        Ok(())
    }
}

/// What passes have done.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PathCounters {
    /// Samples of pixels.
    pub paths: u64,
    /// Rays whose closest hit was asked.
    pub rays: u64,
    /// Rays to lights.
    pub shadow_rays: u64,
    /// Wall clock.
    pub seconds: f64,
}

impl PathCounters {
    fn add(&mut self, other: &Self) {
        self.paths += other.paths;
        self.rays += other.rays;
        self.shadow_rays += other.shadow_rays;
        self.seconds += other.seconds;
    }

    /// Rays of both kinds a second, in millions; zero before any time has passed.
    pub fn mrays_a_second(&self) -> f64 {
        if self.seconds > 0.0 { (self.rays + self.shadow_rays) as f64 * 1e-6 / self.seconds } else { 0.0 }
    }

    /// Samples a second; zero before any time has passed.
    pub fn paths_a_second(&self) -> f64 {
        if self.seconds > 0.0 { self.paths as f64 / self.seconds } else { 0.0 }
    }
}
