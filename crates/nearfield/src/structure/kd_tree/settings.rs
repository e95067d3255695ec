//! What a caller can choose about a kd-tree.

use crate::{Error, Result};

/// The deepest tree: the walk with a stack keeps a place for each level.
pub(super) const DEEPEST: u32 = 64;
/// Most bins along an axis.
pub(super) const MOST_BINS: u32 = 256;
/// Bytes a triangle that the default bound of memory allows; the same again once for small meshes.
const BYTES_PER_TRIANGLE: u64 = 2048;
/// Bytes of the tree that no bound passes: more would need numbers of nodes or references beyond 32 bits.
const MOST_BYTES: u64 = 1 << 34;

/// Where nodes are cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum KdBuild {
    /// In the middle of the longest side, until no more than `leaf_limit` triangles are left. Source: Accel.
    SpatialMedian,
    /// Where the surface area heuristic expects the least work, of `bins` planes an axis, and of all planes that matter
    /// in nodes with few triangles. Triangles are clipped to their nodes. Source: Wald2006 for the cost and the clipping.
    BinnedSah,
    /// Where the surface area heuristic expects the least work, of all planes that matter. Triangles are clipped to
    /// their nodes ("perfect splits"). A few cuts in a row may cost more than none, in the hope of a good one below.
    /// Source: Wald2006.
    ExactSah,
}

/// How the tree is walked along a ray on the CPU. Both ways visit the same leaves and give the same answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum KdTraversal {
    /// From the root, with a stack of the subtrees that come later.
    Stack,
    /// From leaf to leaf along ropes, without a stack: what the GPU does, on the same arrays. Source: Popov2007.
    #[default]
    Ropes,
}

impl KdTraversal {
    /// Its name: "stack" or "ropes".
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stack => "stack",
            Self::Ropes => "ropes",
        }
    }
}

/// Settings of a kd-tree, fixed when it is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KdTreeSettings {
    /// Where nodes are cut.
    pub build: KdBuild,
    /// Nodes of no more triangles are never cut.
    pub leaf_limit: u32,
    /// Cost of passing an inner node, in the unit of `test_cost`; not used by [`KdBuild::SpatialMedian`].
    pub traversal_cost: f32,
    /// Cost of testing a triangle; not used by [`KdBuild::SpatialMedian`].
    pub test_cost: f32,
    /// The share by which a cut that leaves one side empty counts as cheaper, 0 up to 1 (exclusive); not used by
    /// [`KdBuild::SpatialMedian`].
    pub empty_bonus: f32,
    /// Planes an axis plus one that [`KdBuild::BinnedSah`] compares, 2 to 256.
    pub bins: u32,
    /// Depth limit, 0 to 64: nodes there are leaves with any number of triangles.
    pub max_depth: u32,
    /// Most bytes of the tree, the prepared triangles not counted; `None` for 2 KiB a triangle and 2 KiB. Nodes whose
    /// share of it is used up become leaves. Never more than 16 GiB, whatever is asked.
    pub max_bytes: Option<u64>,
}

impl Default for KdTreeSettings {
    /// [`KdTreeSettings::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl KdTreeSettings {
    /// The binned surface area heuristic with 32 bins, costs 15 : 20 and an empty bonus of 0.2 (those of Wald2006), leaves
    /// of up to 2 triangles without question, depth 48.
    pub const DEFAULT: Self = Self {
        build: KdBuild::BinnedSah,
        leaf_limit: 2,
        traversal_cost: 15.0,
        test_cost: 20.0,
        empty_bonus: 0.2,
        bins: 32,
        max_depth: 48,
        max_bytes: None,
    };

    /// Accel's tree: the middle of the longest side until `leaf_limit` triangles are left (20, 200 and 2000 there).
    pub const fn spatial_median(leaf_limit: u32) -> Self {
        Self { build: KdBuild::SpatialMedian, leaf_limit, ..Self::DEFAULT }
    }

    /// The tree that is built soonest among those that are cut by cost: 16 bins and larger leaves.
    pub const fn fast_build() -> Self {
        Self { leaf_limit: 8, bins: 16, ..Self::DEFAULT }
    }

    /// The tree that is walked soonest: every plane is compared.
    pub const fn best_query() -> Self {
        Self { build: KdBuild::ExactSah, ..Self::DEFAULT }
    }

    /// Sets where nodes are cut.
    pub const fn build(mut self, build: KdBuild) -> Self {
        self.build = build;
        self
    }

    /// Sets how many triangles a node may have without being cut.
    pub const fn leaf_limit(mut self, triangles: u32) -> Self {
        self.leaf_limit = triangles;
        self
    }

    /// Sets the costs of passing an inner node and of testing a triangle.
    pub const fn costs(mut self, traversal: f32, test: f32) -> Self {
        self.traversal_cost = traversal;
        self.test_cost = test;
        self
    }

    /// Sets the bonus of cuts with an empty side.
    pub const fn empty_bonus(mut self, share: f32) -> Self {
        self.empty_bonus = share;
        self
    }

    /// Sets the number of bins.
    pub const fn bins(mut self, bins: u32) -> Self {
        self.bins = bins;
        self
    }

    /// Sets the depth limit.
    pub const fn max_depth(mut self, depth: u32) -> Self {
        self.max_depth = depth;
        self
    }

    /// Sets the bound of memory.
    pub const fn max_bytes(mut self, bytes: u64) -> Self {
        self.max_bytes = Some(bytes);
        self
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub(super) fn validate(&self) -> Result<()> {
        let refuse = |setting, found: String, expected| Err(Error::InvalidSetting { setting, found, expected });
        let is_cost = |cost: f32| cost.is_finite() && cost > 0.0;
        if !is_cost(self.traversal_cost) {
            return refuse("traversal_cost", self.traversal_cost.to_string(), "a finite number above 0");
        }
        if !is_cost(self.test_cost) {
            return refuse("test_cost", self.test_cost.to_string(), "a finite number above 0");
        }
        if !(0.0..1.0).contains(&self.empty_bonus) {
            return refuse("empty_bonus", self.empty_bonus.to_string(), "0 up to 1, 1 excluded");
        }
        if !(2..=MOST_BINS).contains(&self.bins) {
            return refuse("bins", self.bins.to_string(), "2 to 256");
        }
        if self.max_depth > DEEPEST {
            return refuse("max_depth", self.max_depth.to_string(), "0 to 64");
        }
        Ok(())
    }

    /// Bytes that the tree of so many triangles may take.
    pub(super) fn byte_bound(&self, triangles: usize) -> u64 {
        let usual = BYTES_PER_TRIANGLE.saturating_mul(triangles as u64 + 1);
        self.max_bytes.unwrap_or(usual).min(MOST_BYTES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_named() {
        let fault = |settings: KdTreeSettings| settings.validate().unwrap_err().to_string();
        let good = KdTreeSettings::default();
        assert!(good.validate().is_ok());
        assert!(fault(good.costs(0.0, 1.0)).starts_with("traversal_cost = 0"));
        assert!(fault(good.costs(1.0, f32::NAN)).starts_with("test_cost = NaN"));
        assert!(fault(good.empty_bonus(1.0)).starts_with("empty_bonus = 1"));
        assert!(fault(good.bins(1)).starts_with("bins = 1"));
        assert!(fault(good.max_depth(65)).starts_with("max_depth = 65"));
    }
}
