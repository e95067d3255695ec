//! What a caller can choose about a hierarchy.

use crate::{Error, Result};

/// Most bins of a split.
pub(super) const MOST_BINS: usize = 64;
/// Triangles of a block: the most that a leaf holds.
pub(super) const BLOCK: usize = 8;

/// Settings of a hierarchy, fixed when it is built. They change how long it takes to build and to search, never an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BvhSettings {
    /// Places along each axis at which a node may be split, 2 to 64.
    pub bins: u32,
    /// Nodes of at most this many triangles are split between any two of them, whatever the bins.
    pub sweep_below: u32,
    /// Most triangles of a leaf on the CPU, 1 to 8. On the GPU, where they are tested one by one, it is at most 3.
    pub leaf_triangles: u32,
    /// Time to test the triangles of a leaf on the CPU, in units of the time to test the boxes of a node; finite, above 0.
    pub leaf_cost: f32,
}

impl Default for BvhSettings {
    /// [`BvhSettings::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl BvhSettings {
    /// 32 bins, sweeps up to 16 triangles, leaves of up to 8 that cost as much as a node.
    pub const DEFAULT: Self = Self { bins: 32, sweep_below: 16, leaf_triangles: BLOCK as u32, leaf_cost: 1.0 };

    /// 8 bins and short sweeps: for meshes that change before many rays are cast.
    pub const fn fast_build() -> Self {
        Self { bins: 8, sweep_below: 4, ..Self::DEFAULT }
    }

    /// 64 bins, and sweeps from 4096 triangles down: for meshes that stay.
    pub const fn best_query() -> Self {
        Self { bins: 64, sweep_below: 4096, ..Self::DEFAULT }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub(super) fn validate(&self) -> Result<()> {
        let error = |setting, found: String, expected| Err(Error::InvalidSetting { setting, found, expected });
        if !(2..=MOST_BINS as u32).contains(&self.bins) {
            return error("bins", self.bins.to_string(), "2 to 64");
        }
        if !(1..=BLOCK as u32).contains(&self.leaf_triangles) {
            return error("leaf_triangles", self.leaf_triangles.to_string(), "1 to 8");
        }
        if !(self.leaf_cost.is_finite() && self.leaf_cost > 0.0) {
            return error("leaf_cost", self.leaf_cost.to_string(), "a finite number above 0");
        }
        Ok(())
    }
}
