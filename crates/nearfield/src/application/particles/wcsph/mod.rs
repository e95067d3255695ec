//! Weakly compressible smoothed particle hydrodynamics (Becker2007).

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
