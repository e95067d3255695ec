//! The figures of sections 5.2 and 7 of Xing2017 on particles: steps a second on a GeForce GTX 660 Ti (3 GB); and what Accel and the
//! field say about others.

use nearfield::application::particles::ParticleSearch;

/// Steps of a simulation of its figures 18 and 19.
pub const STEPS: u32 = 2000;

/// A row of figure 18, in steps a second.
pub struct ByParticles {
    /// Number of particles.
    pub particles: usize,
    /// By its own search.
    pub coherent: f64,
    /// By shifted sorts.
    pub shifted_sort: f64,
    /// By voxels.
    pub voxels: f64,
}

const fn by_particles(particles: usize, coherent: f64, shifted_sort: f64, voxels: f64) -> ByParticles {
    ByParticles { particles, coherent, shifted_sort, voxels }
}

/// Figure 18.
pub const FIGURE_18: [ByParticles; 5] = [
    by_particles(50_000, 60.98, 15.41, 21.75),
    by_particles(100_000, 25.41, 8.421, 10.63),
    by_particles(150_000, 20.91, 4.155, 6.656),
    by_particles(200_000, 16.55, 3.121, 4.762),
    by_particles(250_000, 13.84, 2.473, 3.662),
];

/// Particles of figure 19, and how often its tree was built anew.
pub const FIGURE_19_PARTICLES: usize = 250_000;
/// See [`FIGURE_19_PARTICLES`].
pub const FIGURE_19_REBUILDS: f64 = 33.0;

/// A column of figure 20, in steps a second.
pub struct BySmallestRadius {
    /// The smallest search radius by the diagonal of the domain.
    pub r_over_l: f64,
    /// By its own search.
    pub coherent: f64,
    /// By voxels.
    pub voxels: f64,
}

/// Figure 20.
pub const FIGURE_20: [BySmallestRadius; 3] = [
    BySmallestRadius { r_over_l: 0.0025, coherent: 66.0, voxels: 21.0 },
    BySmallestRadius { r_over_l: 0.005, coherent: 62.0, voxels: 4.0 },
    BySmallestRadius { r_over_l: 0.01, coherent: 62.0, voxels: 0.4 },
];
/// Particles of figure 20.
pub const FIGURE_20_PARTICLES: usize = 30_000;

/// Frames a second of the fluid of Accel by brute force and by its grid; it does not say with how many particles.
pub const ACCEL_FRAMES: [f64; 2] = [30.0, 40.0];

impl ByParticles {
    /// The value of the search in whose place ours stands.
    pub fn of(&self, search: ParticleSearch) -> Option<f64> {
        of(search, self.coherent, self.voxels)
    }
}

impl BySmallestRadius {
    /// The value of the search in whose place ours stands.
    pub fn of(&self, search: ParticleSearch) -> Option<f64> {
        of(search, self.coherent, self.voxels)
    }
}

fn of(search: ParticleSearch, coherent: f64, voxels: f64) -> Option<f64> {
    match search {
        ParticleSearch::Coherent(_) => Some(coherent),
        ParticleSearch::UNIFORM_GRID => Some(voxels),
        _ => None,
    }
}

/// What a reader of the rows must know.
pub const NOTES: [&str; 6] = [
    "Mean neighbours are the others that act on a particle, itself not counted, over all steps that were timed.",
    "The paper does not say where its grains start, how large they are or how many neighbours they have. Ours are the built-in scenes: \
     figures 18 and 19 are half a bed and half a block that falls into it (`paper-fig18`), the sizes of the CUDA sample its lattice \
     (`dem-box`), figure 20 is `paper-fig20`. At a scale below 1 there are fewer particles and fewer steps.",
    "With one class of radii the multi-level grid is the uniform grid.",
    "The paper's searches make lists. Ours make none, but for verlet, and run on the device without the host, but for trees and lists: they \
     ask it in each step whether to build anew.",
    "Shifted sorts are timed on positions of some moments of the run, and the rest of a step, forces from lists, is added as the verlet \
     search takes it in steps in which its list is still good.",
    "In the paper each particle has its own search radius, which is the rule `gather`; its values stand there.",
];
