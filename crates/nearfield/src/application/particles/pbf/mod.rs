//! Position-based fluids (Macklin2013).

use super::Fluid;
use super::scene::{not_negative, positive};
use crate::{Error, Result};

/// Of position-based fluids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PbfSettings {
    /// The fluid.
    pub fluid: Fluid,
    /// Iterations of the density constraint in a step, at least.
    pub iterations: u32,
    /// Iterations at most, while the mean compression is above `tolerance`; equal to `iterations` for a fixed number.
    pub most_iterations: u32,
    /// Mean compression that ends the iterations, in parts of the rest density.
    pub tolerance: f64,
    /// ε of the constraint, in parts of Σ|∇C|² of the lattice at rest.
    pub relaxation: f64,
    /// k of the artificial pressure that keeps particles apart at surfaces, 0 for none.
    pub tensile_strength: f64,
    /// |Δq| of the artificial pressure, in parts of the support.
    pub tensile_distance: f64,
    /// ε of the vorticity confinement, 0 for none.
    pub vorticity: f64,
    /// c of the XSPH viscosity, 0 for none.
    pub xsph: f64,
}

impl PbfSettings {
    /// As Macklin2013, without vorticity confinement.
    pub fn new(fluid: Fluid) -> Self {
        Self {
            fluid,
            iterations: 3,
            most_iterations: 3,
            tolerance: 1e-4,
            relaxation: 1e-3,
            tensile_strength: 0.1,
            tensile_distance: 0.2,
            vorticity: 0.0,
            xsph: 0.01,
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        self.fluid.validate()?;
        if self.iterations == 0 || self.iterations > self.most_iterations {
            let found = format!("{} to {}", self.iterations, self.most_iterations);
            return Err(Error::InvalidSetting {
                setting: "iterations",
                found,
                expected: "1 or more, the fewest first",
            });
        }
        positive("tolerance of the compression", self.tolerance)?;
        positive("relaxation of the constraint", self.relaxation)?;
        not_negative("strength of the artificial pressure", self.tensile_strength)?;
        positive("distance of the artificial pressure", self.tensile_distance)?;
        not_negative("vorticity confinement", self.vorticity)?;
        not_negative("XSPH viscosity", self.xsph)
    }
}
