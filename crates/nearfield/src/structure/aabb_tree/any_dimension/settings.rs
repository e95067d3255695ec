//! What a caller can choose about a tree in any dimension.

use crate::structure::aabb_tree::TreeSearch;
use crate::{Error, Result};

/// Settings of a tree in any dimension; its points are ordered by median splits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AabbTreeNSettings {
    /// Most points of a leaf, at least 1.
    pub bucket_size: u32,
    /// How fixed-radius questions are answered; it does not change the tree.
    pub search: TreeSearch,
}

impl Default for AabbTreeNSettings {
    /// Leaves of up to 20 points, packed search.
    fn default() -> Self {
        Self { bucket_size: 20, search: TreeSearch::Packed }
    }
}

impl AabbTreeNSettings {
    /// Sets the most points of a leaf.
    pub fn bucket_size(mut self, points: u32) -> Self {
        self.bucket_size = points;
        self
    }

    /// Sets the search.
    pub fn search(mut self, search: TreeSearch) -> Self {
        self.search = search;
        self
    }

    pub(super) fn validate(&self) -> Result<()> {
        if self.bucket_size > 0 {
            return Ok(());
        }
        Err(Error::InvalidSetting { setting: "bucket_size", found: "0".into(), expected: "1 point or more" })
    }
}
