//! Weakly compressible smoothed particle hydrodynamics (Becker2007).
//!
//! With x the offset from a neighbour, u the relative velocity, h half the support and V = m / ρ, in each step
//! - dv/dt = g − Σ m ((pᵢ + pⱼ) / (ρᵢ ρⱼ) + Π) ∇W + Σ m ν (1 / ρᵢ + 1 / ρⱼ) W′ / |x| u, where Π = −α h c u·x / ((|x|² + 0.01 h²) ρ̄) for two that come
//!   nearer (Monaghan1992). Laminar viscosity is that of Morris1997 without what keeps its denominator from 0: W′ / |x| is finite;
//! - dρ/dt = ρᵢ Σ Vⱼ u·∇W − 2 δ h c Σ Vⱼ (ρⱼ − ρᵢ − ρᴴ) W′ / |x| (Fourtakas2019). ρᴴ, the difference at rest under gravity, is
//!   ρ₀ g·(xⱼ − xᵢ) / c², to first order in it;
//! - v, then ρ with the new v, then x with the new v: symplectic, a leapfrog whose velocities are half a step behind, by one search.
//!
//! The density is a particle's own: it starts at that at rest, or as the scene says, and is saved with the particle. Walls count by
//! Akinci2012's volumes. They have the pressure of the fluid beside them, more by what lies deeper, never pull, and do not move, so both
//! viscosities brake along them. They should be as thick as the support, or of one layer with supports of up to three spacings.
//!
//! Cost: two sums over the neighbours a step.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;

use super::Fluid;
use super::SmoothingKernel;
use super::scene::{not_negative, positive};
use crate::Result;

pub(super) use cpu::CpuWcsph;
#[cfg(feature = "gpu")]
pub(super) use gpu::GpuWcsph;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::{WcsphFluid, WcsphLimits};

/// Of weakly compressible fluids: p = c² ρ₀ / γ ((ρ / ρ₀)^γ − 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WcsphSettings {
    /// The fluid.
    pub fluid: Fluid,
    /// How neighbours count.
    pub smoothing: SmoothingKernel,
    /// c: some ten times the highest speed that is expected.
    pub sound_speed: f64,
    /// γ.
    pub exponent: f64,
    /// α of the artificial viscosity, 0 for none.
    pub artificial_viscosity: f64,
    /// ν of the laminar viscosity, 0 for none.
    pub viscosity: f64,
    /// δ of the diffusion of density, 0 for none.
    pub density_diffusion: f64,
}

impl WcsphSettings {
    /// Wendland's kernel, γ = 7, α = 0.01, δ = 0.1.
    pub fn new(fluid: Fluid, sound_speed: f64) -> Self {
        Self {
            fluid,
            smoothing: SmoothingKernel::Wendland,
            sound_speed,
            exponent: 7.0,
            artificial_viscosity: 0.01,
            viscosity: 0.0,
            density_diffusion: 0.1,
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.fluid.validate()?;
        self.smoothing.validate_for_gradients()?;
        positive("speed of sound", self.sound_speed)?;
        positive("exponent of the pressure", self.exponent)?;
        not_negative("artificial viscosity", self.artificial_viscosity)?;
        not_negative("viscosity", self.viscosity)?;
        not_negative("diffusion of density", self.density_diffusion)
    }
}
