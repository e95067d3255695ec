//! Grains that push each other: the discrete element method of the CUDA particles sample (Green2010).
//!
//! In each step: v += g Δt, v is damped, x += v Δt, particles that would leave the domain are put back to where they touch the wall and lose
//! a part of their speed across it; then all pairs within reach act on each other with the velocities as they are, and the sums are
//! *added to the velocities as they are*, as impulses a step, not as forces. So stiffness and step belong together: with half the step,
//! halve the stiffness.
//!
//! With x the distance of two centres, n = the unit vector to the other, u its relative velocity and t = u − (u·n) n, one receives
//! −spring (reach − |x|) n + damping u + shear t + attraction x.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use super::scene::{MOST_CLASSES, not_negative, positive};
use crate::{Error, Result};

pub(super) use cpu::CpuDem;
#[cfg(feature = "gpu")]
pub(super) use gpu::GpuDem;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::{DemCollide, DemIntegrate};

/// Of grains. Numbers in parentheses are those of Green2010, which [`DemSettings::green`] gives.
#[derive(Debug, Clone, PartialEq)]
pub struct DemSettings {
    /// `[n_classes]` radius of the particles of each class, at most [`MOST_CLASSES`] of them.
    pub radii: Vec<f64>,
    /// Which pairs act on each other.
    pub pair_rule: PairRule,
    /// Impulse a step for each unit of overlap (0.5).
    pub spring: f64,
    /// Part of the relative velocity that is taken over (0.02).
    pub damping: f64,
    /// Part of the tangential relative velocity that is taken over (0.1).
    pub shear: f64,
    /// Impulse a step for each unit of distance, towards the other (0).
    pub attraction: f64,
    /// What is left of a velocity after a step (1).
    pub global_damping: f64,
    /// Factor of the speed across a wall after it was touched, negative where particles bounce (−0.5).
    pub wall_damping: f64,
    /// A ball that does not move.
    pub collider: Option<Collider>,
}

/// A ball that does not move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collider {
    /// Where it is.
    pub center: DVec3,
    /// Its radius.
    pub radius: f64,
}

/// Within which distance two particles act on each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum PairRule {
    /// Below the sum of the radii: they touch.
    #[default]
    Contact,
    /// Below the larger radius.
    Symmetric,
    /// A particle is acted on by those below its own radius: large ones feel small ones, but not the other way round, so momentum is not
    /// conserved.
    Gather,
}

impl PairRule {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Contact, Self::Symmetric, Self::Gather];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Contact => "contact",
            Self::Symmetric => "symmetric",
            Self::Gather => "gather",
        }
    }

    /// The distance within which the second acts on the first.
    pub fn reach(self, own: f64, other: f64) -> f64 {
        match self {
            Self::Contact => own + other,
            Self::Symmetric => own.max(other),
            Self::Gather => own,
        }
    }
}

impl fmt::Display for PairRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for PairRule {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|rule| rule.name() == name);
        known.ok_or_else(|| Error::InvalidSetting {
            setting: "pair rule",
            found: name.to_owned(),
            expected: "contact, symmetric or gather",
        })
    }
}

impl DemSettings {
    /// The numbers of Green2010 for particles of one radius, without its collider.
    pub fn green(radius: f64) -> Self {
        Self {
            radii: vec![radius],
            pair_rule: PairRule::Contact,
            spring: 0.5,
            damping: 0.02,
            shear: 0.1,
            attraction: 0.0,
            global_damping: 1.0,
            wall_damping: -0.5,
            collider: None,
        }
    }

    /// The largest distance within which two particles act on each other.
    pub fn largest_reach(&self) -> f64 {
        let largest = self.largest_radius();
        self.pair_rule.reach(largest, largest)
    }

    /// The largest radius.
    pub fn largest_radius(&self) -> f64 {
        self.radii.iter().copied().fold(0.0, f64::max)
    }

    pub(super) fn validate(&self) -> Result<()> {
        if self.radii.is_empty() || self.radii.len() > MOST_CLASSES {
            let found = format!("{} classes", self.radii.len());
            return Err(Error::InvalidSetting { setting: "radii of grains", found, expected: "1 to 8 classes" });
        }
        self.radii.iter().try_for_each(|&radius| positive("radius of grains", radius))?;
        not_negative("spring of grains", self.spring)?;
        not_negative("damping of grains", self.damping)?;
        not_negative("shear of grains", self.shear)?;
        not_negative("global damping", self.global_damping)?;
        if let Some(collider) = &self.collider {
            positive("radius of the collider", collider.radius)?;
        }
        let others = [("attraction of grains", self.attraction), ("damping at walls", self.wall_damping)];
        match others.into_iter().find(|(_, value)| !value.is_finite()) {
            Some((setting, value)) => {
                Err(Error::InvalidSetting { setting, found: value.to_string(), expected: "a finite number" })
            }
            None => Ok(()),
        }
    }
}
