//! Position-based fluids (Macklin2013): particles are moved until nowhere is denser than at rest.
//!
//! In each step: v += g Δt; x* = x + v Δt; one search of neighbours; rounds of { λ of every particle, then its displacement Δx, then it is
//! kept between the walls }; v = (x* − x) / Δt; vorticity confinement; XSPH viscosity. With volumes V, and W and ∇W of the smoothing kernels
//! poly6 and spiky, in two dimensions with the factors of the plane,
//!
//! - Cᵢ = Σ Vⱼ W(xᵢ − xⱼ) − 1, taken as 0 where it is below: particles do not attract each other
//! - λᵢ = −Cᵢ / (Σₖ |∇ₖCᵢ|² + ε)
//! - Δxᵢ = Σ Vⱼ (λᵢ + λⱼ + sᵢⱼ) ∇W(xᵢ − xⱼ), with sᵢⱼ = −(k / S) (W(xᵢ − xⱼ) / W(Δq))⁴
//!
//! Differs from the paper:
//!
//! - All is free of units. S is Σₖ |∇ₖC|² of the lattice at rest, ε a part of it, and k a compression; Macklin2013 gives the last two as
//!   numbers that suit one size of particles.
//! - The volume of a particle is 1 / Σ W over the lattice at rest, so that this lattice has the density at rest exactly, whatever the
//!   support. Masses, as in measures, are those of [`Fluid::mass`], some percent apart.
//! - Boundary particles have their part in the density and in ∇ᵢCᵢ, with the volumes of Akinci2012 times a factor with which the lattice at
//!   rest can stand one spacing away from a flat wall of one layer: without it the fluid is pushed off by a seventh of a spacing at
//!   the start. They have no λ and no s.
//!
//! Particles are neighbours that were within the support in the search, at x* before the first round; those that only come so close in the
//! rounds are met in the next step. No round moves particles far: what is missed lies at the edge of the support, where kernels vanish.
//!
//! Cost: two passes over the neighbours a round, one at the end for densities, one for viscosity and two for vorticity where asked for.

mod cpu;
mod finish;
#[cfg(feature = "gpu")]
mod gpu;
mod rest;

use glam::DVec3;

use super::scene::{not_negative, positive};
use super::{Dimensions, Fluid, ParticleScene};
use crate::{Error, Result};

pub(super) use cpu::CpuPbf;
#[cfg(feature = "gpu")]
pub(super) use gpu::GpuPbf;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::PbfFluid;

/// Part of its diameter by which a particle moves in a stable step.
const STABLE_WAY: f64 = 0.4;

/// Of position-based fluids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PbfSettings {
    /// The fluid. Its support is at most 16 spacings.
    pub fluid: Fluid,
    /// Iterations of the density constraint in a step, at least.
    pub iterations: u32,
    /// Iterations at most, while the mean compression is above `tolerance`; equal to `iterations` for a fixed number.
    pub most_iterations: u32,
    /// Mean compression that ends the iterations, in parts of the rest density.
    pub tolerance: f64,
    /// ε of the constraint, in parts of Σ|∇C|² of the lattice at rest.
    pub relaxation: f64,
    /// k of the artificial pressure that keeps particles apart at surfaces, 0 for none: two particles `tensile_distance` apart push each
    /// other as if one of them were compressed by this part of the rest density. A fluid grows by it where little presses: a column of
    /// twelve layers by 1 % of its height with 0.01, by 5 % with 0.1.
    pub tensile_strength: f64,
    /// |Δq| of the artificial pressure, in parts of the support, below 1.
    pub tensile_distance: f64,
    /// ε of the vorticity confinement, 0 for none: a speed, the acceleration for each unit of vorticity.
    pub vorticity: f64,
    /// c of the XSPH viscosity, 0 for none. Weights are m / ρ of the other, so it keeps momentum only where densities are alike.
    pub xsph: f64,
}

impl PbfSettings {
    /// Three iterations and the viscosity of Macklin2013, an artificial pressure of 1 % of compression, no vorticity confinement.
    pub fn new(fluid: Fluid) -> Self {
        Self {
            fluid,
            iterations: 3,
            most_iterations: 3,
            tolerance: 1e-4,
            relaxation: 1e-3,
            tensile_strength: 0.01,
            tensile_distance: 0.2,
            vorticity: 0.0,
            xsph: 0.01,
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.fluid.validate()?;
        let invalid = |setting, found, expected| Err(Error::InvalidSetting { setting, found, expected });
        if self.iterations == 0 || self.iterations > self.most_iterations {
            let found = format!("{} to {}", self.iterations, self.most_iterations);
            return invalid("iterations", found, "1 or more, the fewest first");
        }
        positive("tolerance of the compression", self.tolerance)?;
        positive("relaxation of the constraint", self.relaxation)?;
        not_negative("strength of the artificial pressure", self.tensile_strength)?;
        positive("distance of the artificial pressure", self.tensile_distance)?;
        if self.tensile_distance >= 1.0 {
            let found = self.tensile_distance.to_string();
            return invalid("distance of the artificial pressure", found, "below 1, in parts of the support");
        }
        not_negative("vorticity confinement", self.vorticity)?;
        not_negative("XSPH viscosity", self.xsph)
    }
}

/// The domain as far as centres of particles go: half a spacing from its faces, along a side narrower than a particle its middle. Scenes in
/// the plane have no walls across it.
fn walls(settings: &PbfSettings, scene: &ParticleScene) -> [DVec3; 2] {
    let [low, high] = scene.domain;
    let (middle, radius) = (0.5 * (low + high), 0.5 * settings.fluid.spacing);
    let walls = [(low + radius).min(middle), (high - radius).max(middle)];
    match scene.dimensions {
        Dimensions::Two => walls.map(|corner| corner.with_z(0.0)),
        Dimensions::Three => walls,
    }
}

/// How far a particle may move in a stable step, and the speed that it gains falling so far from rest, over √2: the way over the sum of both
/// speeds is at most the step in which v t + g t² is the way.
fn stable_way(settings: &PbfSettings, scene: &ParticleScene) -> [f64; 2] {
    let way = STABLE_WAY * settings.fluid.spacing;
    [way, (scene.gravity.length() * way).sqrt()]
}
