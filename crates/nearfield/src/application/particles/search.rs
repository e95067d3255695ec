//! Who finds the neighbours of particles.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use super::scene::positive;
use crate::structure::RebuildPolicy;
use crate::{Error, Result};

/// By which structure, and how, the neighbours of particles are found in each step. All find the same ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParticleSearch {
    /// Every particle is compared with every other.
    BruteForce,
    /// A uniform grid, built anew in each step.
    UniformGrid {
        /// Edge of a cell in parts of the largest reach, 1/64 to 64. With small cells a ball touches about (2 + 2 / cell)³ of them, and
        /// small balls fewer points beside them.
        cell: f64,
    },
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
        Self::UNIFORM_GRID,
        Self::MultiLevelGrid,
        Self::AabbTree(RebuildPolicy::DEFAULT),
        Self::Verlet { skin: Self::SKIN },
    ];

    /// The usual skin of lists.
    pub const SKIN: f64 = 0.3;

    /// A uniform grid with cells as large as the largest reach.
    pub const UNIFORM_GRID: Self = Self::UniformGrid { cell: 1.0 };

    /// Its name: "uniform-grid", "coherent".
    pub fn name(self) -> &'static str {
        match self {
            Self::BruteForce => "brute-force",
            Self::UniformGrid { .. } => "uniform-grid",
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
            Self::UniformGrid { cell } if !CELLS.contains(&cell) => Err(Error::InvalidSetting {
                setting: "cell of the uniform grid",
                found: format!("{cell} of the largest reach"),
                expected: "1/64 (0.015625) to 64 of it: with smaller cells a ball touches too many, larger ones hold everything",
            }),
            _ => Ok(()),
        }
    }

    /// Edge of the cells of a grid for balls of this radius.
    pub(super) fn cell_size(self, radius: f32) -> f32 {
        match self {
            Self::UniformGrid { cell } => (cell * f64::from(radius)) as f32,
            _ => radius,
        }
    }
}

/// Edges of cells in parts of the largest reach. With the smallest a ball touches 130 × 130 rows of cells; kernels give up beyond 60,000.
const CELLS: RangeInclusive<f64> = 1.0 / 64.0..=64.0;

impl fmt::Display for ParticleSearch {
    /// The name, and behind a colon the cell of a grid or the skin of lists where that is not the usual one.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        match *self {
            Self::UniformGrid { cell: number } | Self::Verlet { skin: number } if !Self::ALL.contains(self) => {
                write!(f, ":{number}")
            }
            _ => Ok(()),
        }
    }
}

impl FromStr for ParticleSearch {
    type Err = Error;

    /// Takes a name, and behind a colon the cell of a uniform grid or the skin of lists: "uniform-grid:0.5", "verlet:0.2".
    fn from_str(text: &str) -> Result<Self> {
        let refused = |expected| Error::InvalidSetting { setting: "search", found: text.to_owned(), expected };
        let (name, number) = text.split_once(':').map_or((text, None), |(name, number)| (name, Some(number)));
        let known = Self::ALL.into_iter().find(|search| search.name() == name);
        let usual = known.ok_or_else(|| {
            refused("brute-force, primary, coherent, uniform-grid, multi-level-grid, aabb-tree or verlet")
        })?;
        let Some(number) = number else { return Ok(usual) };
        let number = || number.parse().map_err(|_| refused("a number behind the colon"));
        let search = match usual {
            Self::UniformGrid { .. } => Self::UniformGrid { cell: number()? },
            Self::Verlet { .. } => Self::Verlet { skin: number()? },
            _ => return Err(refused("a colon and a number only behind uniform-grid and verlet")),
        };
        search.validate()?;
        Ok(search)
    }
}

impl Default for SimulationSettings {
    /// A uniform grid, sums as they come, a new order every 100 steps, no limit of speed.
    fn default() -> Self {
        Self {
            search: ParticleSearch::UNIFORM_GRID,
            deterministic: false,
            reorder_every: 100,
            max_speed: f64::INFINITY,
        }
    }
}

impl SimulationSettings {
    /// # Errors
    /// `InvalidSetting` for the cell, the skin, the policy, or a limit of speed that is not a number above 0.
    pub fn validate(&self) -> Result<()> {
        self.search.validate()?;
        if self.max_speed > 0.0 {
            return Ok(());
        }
        let found = self.max_speed.to_string();
        Err(Error::InvalidSetting { setting: "largest speed", found, expected: "a number above 0, or infinity" })
    }
}
