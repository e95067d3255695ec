//! What all fluids of particles have in common: smoothing kernels, masses, and how walls of particles count.

mod boundary;
mod density_error;
mod smoothing;
mod weights;

pub(super) use boundary::masses;
#[cfg(feature = "gpu")]
pub(super) use boundary::{boundary_alone, boundary_masses};
pub(super) use density_error::density_error;
pub use smoothing::SmoothingKernel;
pub(super) use weights::{Lattice, Weights};

use super::Dimensions;
use super::scene::positive;
use crate::{Error, Result};

/// Largest support in spacings; neighbours are some four times its cube.
const MOST_SPACINGS: f64 = 16.0;

/// A fluid as a set of particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fluid {
    /// Distance of neighbouring particles at rest; also the diameter of one.
    pub spacing: f64,
    /// Distance beyond which particles do not act on each other: the support of the smoothing kernel, not its smoothing length.
    pub support: f64,
    /// Density at rest.
    pub rest_density: f64,
}

impl Fluid {
    /// Water of density 1000 whose particles reach two spacings far.
    pub fn water(spacing: f64) -> Self {
        Self { spacing, support: 2.0 * spacing, rest_density: 1000.0 }
    }

    /// Mass of a particle: that of the fluid in a cell of the spacing's width.
    pub fn mass(&self, dimensions: Dimensions) -> f64 {
        self.rest_density * self.spacing.powi(dimensions.number() as i32)
    }

    /// # Errors
    /// `InvalidSetting` for numbers that are not positive, a support below the spacing (particles would not meet) or above 16 spacings.
    pub fn validate(&self) -> Result<()> {
        positive("spacing of the fluid", self.spacing)?;
        positive("support of the fluid", self.support)?;
        positive("rest density of the fluid", self.rest_density)?;
        if self.support > self.spacing && self.support <= MOST_SPACINGS * self.spacing {
            return Ok(());
        }
        let found = format!("{} with spacing {}", self.support, self.spacing);
        let expected = "more than the spacing, and at most 16 spacings";
        Err(Error::InvalidSetting { setting: "support of the fluid", found, expected })
    }
}
