//! Who finds the neighbours of particles.

use std::fmt;
use std::str::FromStr;

use super::scene::positive;
use crate::structure::RebuildPolicy;
use crate::{Error, Result};

/// By which structure, and how, the neighbours of particles are found in each step. All find the same ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParticleSearch {
    /// Every particle is compared with every other.
    BruteForce,
    /// A uniform grid, built anew in each step, with cells for the largest radius.
    UniformGrid,
    /// A uniform grid for each class of radii, with cells for that class; a particle asks each with the reach that the two classes have.
    MultiLevelGrid,
    /// A tree of boxes that is fitted to the particles in each step and built anew when the policy says, searched query by query with
    /// balanced load.
    AabbTree(RebuildPolicy),
    /// The same tree, searched as in Xing2017 by its primary search.
    Primary(RebuildPolicy),
    /// The same tree, searched as in Xing2017 by its coherent search.
    Coherent(RebuildPolicy),
    /// A list of all within the reach and a skin, made by a uniform grid and used until some particle has moved by half the skin.
    Verlet {
        /// The skin in parts of the largest reach.
        skin: f64,
    },
}

/// How particles are simulated; the outcome is the same physics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulationSettings {
    /// Who finds neighbours.
    pub search: ParticleSearch,
    /// Make sums that do not depend on the order in which neighbours are found: in the order of indices on the CPU, in fixed point on
    /// the GPU. Then every search gives the same trajectory, bit by bit, on one device.
    pub deterministic: bool,
    /// Put the particles in the order of a space-filling curve every so many steps; 0 never.
    pub reorder_every: u32,
    /// Speed above which a simulation is ended; infinite for no limit.
    pub max_speed: f64,
}

impl ParticleSearch {
    /// All, with usual settings.
    pub const ALL: [Self; 7] = [
        Self::BruteForce,
        Self::Primary(RebuildPolicy::DEFAULT),
        Self::Coherent(RebuildPolicy::DEFAULT),
        Self::UniformGrid,
        Self::MultiLevelGrid,
        Self::AabbTree(RebuildPolicy::DEFAULT),
        Self::Verlet { skin: Self::SKIN },
    ];

    /// The usual skin of lists.
    pub const SKIN: f64 = 0.3;

    /// Its name: "uniform-grid", "coherent".
    pub fn name(self) -> &'static str {
        match self {
            Self::BruteForce => "brute-force",
            Self::UniformGrid => "uniform-grid",
            Self::MultiLevelGrid => "multi-level-grid",
            Self::AabbTree(_) => "aabb-tree",
            Self::Primary(_) => "primary",
            Self::Coherent(_) => "coherent",
            Self::Verlet { .. } => "verlet",
        }
    }

    /// The same search with this policy, where it has one.
    pub fn with_policy(self, policy: RebuildPolicy) -> Self {
        match self {
            Self::AabbTree(_) => Self::AabbTree(policy),
            Self::Primary(_) => Self::Primary(policy),
            Self::Coherent(_) => Self::Coherent(policy),
            other => other,
        }
    }

    fn validate(self) -> Result<()> {
        match self {
            Self::AabbTree(policy) | Self::Primary(policy) | Self::Coherent(policy) => policy.validate(),
            Self::Verlet { skin } => positive("skin of lists", skin),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for ParticleSearch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ParticleSearch {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|search| search.name() == name);
        known.ok_or_else(|| Error::InvalidSetting {
            setting: "search",
            found: name.to_owned(),
            expected: "brute-force, primary, coherent, uniform-grid, multi-level-grid, aabb-tree or verlet",
        })
    }
}

impl Default for SimulationSettings {
    /// A uniform grid, sums as they come, a new order every 100 steps, no limit of speed.
    fn default() -> Self {
        Self { search: ParticleSearch::UniformGrid, deterministic: false, reorder_every: 100, max_speed: f64::INFINITY }
    }
}

impl SimulationSettings {
    /// # Errors
    /// `InvalidSetting` for the skin, the policy, or a limit of speed that is not a number above 0.
    pub fn validate(&self) -> Result<()> {
        self.search.validate()?;
        if self.max_speed > 0.0 {
            return Ok(());
        }
        let found = self.max_speed.to_string();
        Err(Error::InvalidSetting { setting: "largest speed", found, expected: "a number above 0, or infinity" })
    }
}
