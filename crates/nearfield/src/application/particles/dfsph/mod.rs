//! Divergence-free smoothed particle hydrodynamics (Bender2017).
//!
//! In each step, all with the neighbours at its start: velocities are freed of divergence that compresses, gravity and viscosities act,
//! velocities are corrected until the density at the end of the step is nowhere above that at rest, and particles move. Both solvers
//! iterate κᵢ / ρᵢ = ω (what is too much) / (Δt² (|Σ V ∇W|² + Σ |V ∇W|²)), v −= Δt Σ V (κᵢ / ρᵢ + κⱼ / ρⱼ) ∇W, with volumes in place of masses.
//!
//! The solver for densities starts from the pressures p = Σ κ of the last step, which a particle keeps. So it may find them too high: an
//! iteration changes p by what is too much or too little, but never below 0, and pushes by the change. With every change goes a part of the
//! one before (Polyak1964). In a column of a hundred layers of eight particles at rest (in the plane, a support of two spacings, XSPH of 0.05,
//! steps by speed, 200 of them after half a second) a step takes 18 iterations; from no pressure it takes 69, and without momentum too a
//! hundred are not enough. Pressures of neighbours differ by much; their mean is some tenth above the weight they carry.
//!
//! Differs: ω is not 1 but what keeps the iteration stable on a lattice with this support (0.7 in the plane with two spacings, less with
//! more neighbours); of the last pressures nine tenths are begun with, where the fluid is not thin, and p Δt² / ρ of a quarter of a support squared
//! at most; the volume of a particle is the one with which a lattice has the density at rest, and walls count by Akinci2012's
//! volumes times a factor (Band2018) with which a lattice beside a wall has it too.
//!
//! Steps by speed are also shorter than what √(p / ρ) takes for a spacing, with the pressure at the foot of the fluid as it stands at the start.
//! Between longer ones pressed particles leave each other by more than the next pressures can take back: the column above holds up to 0.7
//! of it, and springs apart from 0.8 of it on, whatever the solver. Fixed steps are taken as they are.
//!
//! Supports of two spacings are enough for free surfaces and splashes; where the fluid is sheared evenly, three and more keep its volume
//! better: the drop of the tests is 18 % too wide with two, and within 1 % with 3.4.
//!
//! Cost: two sums over the neighbours an iteration. When not to use: pressure crosses a few layers an iteration, so deep water that is hit needs
//! many of them.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;

use super::scene::{not_negative, positive};
use super::{Dimensions, Fluid, ParticleScene, SmoothingKernel};
use crate::{Error, Result};

pub(super) use cpu::CpuDfsph;
#[cfg(feature = "gpu")]
pub(super) use gpu::GpuDfsph;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::{DfsphFluid, DfsphProgress};

/// Of incompressible fluids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DfsphSettings {
    /// The fluid.
    pub fluid: Fluid,
    /// How neighbours count.
    pub smoothing: SmoothingKernel,
    /// Mean compression that ends the iterations of a step, in parts of the rest density.
    pub density_tolerance: f64,
    /// Mean rate of compression over a step that ends the iterations for a field without divergence, in parts of the rest density.
    pub divergence_tolerance: f64,
    /// Most iterations of each solver.
    pub most_iterations: u32,
    /// ν of the laminar viscosity, 0 for none.
    pub viscosity: f64,
    /// c of the XSPH viscosity, 0 for none.
    pub xsph: f64,
}

impl DfsphSettings {
    /// A mean compression of 0.01 %, a mean divergence of 0.1 %, at most 100 iterations.
    pub fn new(fluid: Fluid) -> Self {
        Self {
            fluid,
            smoothing: SmoothingKernel::CubicSpline,
            density_tolerance: 1e-4,
            divergence_tolerance: 1e-3,
            most_iterations: 100,
            viscosity: 0.0,
            xsph: 0.0,
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.fluid.validate()?;
        self.smoothing.validate_for_gradients()?;
        positive("tolerance of the density", self.density_tolerance)?;
        positive("tolerance of the divergence", self.divergence_tolerance)?;
        not_negative("viscosity", self.viscosity)?;
        not_negative("XSPH viscosity", self.xsph)?;
        if self.most_iterations > 0 {
            return Ok(());
        }
        Err(Error::InvalidSetting { setting: "most iterations", found: "0".to_owned(), expected: "1 or more" })
    }
}

/// Neighbours below which a particle lies at a surface, where divergence is not corrected.
fn fewest_neighbors(dimensions: Dimensions) -> u32 {
    if dimensions == Dimensions::Two { 6 } else { 20 }
}

/// The longest stable step of fluid that stands as high as the particles of the scene: that in which √(g × height) leads one spacing.
fn longest_step(fluid: &Fluid, scene: &ParticleScene) -> f64 {
    let falls = scene.particles.positions.iter().map(|position| position.dot(scene.gravity));
    let (least, most) = falls.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), fall| (a.min(fall), b.max(fall)));
    fluid.spacing / (most - least).max(0.0).sqrt()
}
