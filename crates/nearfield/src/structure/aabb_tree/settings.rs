//! What a caller can choose about a tree.

use std::str::FromStr;

use crate::geometry::Period;
use crate::{Error, Result};

/// Settings of a tree, fixed when it is built but for the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AabbTreeSettings {
    /// Most points of a leaf, at least 1.
    pub bucket_size: u32,
    /// How the points are brought into the tree's order.
    pub order: BuildOrder,
    /// How queries are answered; it does not change the tree.
    pub search: TreeSearch,
    /// Period of the space that is searched; it does not change the tree.
    pub period: Period,
}

/// How points are brought into the order of the tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum BuildOrder {
    /// Every node is split at the median of its longest side, as in Xing2017. Tighter boxes; built on the CPU and copied
    /// to a device.
    #[default]
    Median,
    /// Points sorted along the Hilbert curve, cut into the same shape. Built where the points are, much faster.
    Hilbert,
}

/// How fixed-radius questions are answered. The answers are the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum TreeSearch {
    /// One traversal a query, as algorithm 1 of Xing2017, but from the root along the ropes instead of back from a leaf that the
    /// query touches. (`count_primary` and `primary_counters` go the paper's way.)
    Primary,
    /// One traversal a leaf with queries, whose candidates are kept and then tested: algorithm 2 of Xing2017.
    Coherent,
    /// One traversal for queries that stand side by side in the tree's order, candidates tested as they come.
    #[default]
    Packed,
}

impl TreeSearch {
    /// All searches.
    pub const ALL: [Self; 3] = [Self::Primary, Self::Coherent, Self::Packed];

    /// Its name, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Primary => "primary",
            Self::Coherent => "coherent",
            Self::Packed => "packed",
        }
    }
}

impl FromStr for TreeSearch {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|search| search.name() == text).ok_or_else(|| Error::InvalidSetting {
            setting: "search",
            found: text.into(),
            expected: "primary, coherent or packed",
        })
    }
}

impl Default for AabbTreeSettings {
    /// [`AabbTreeSettings::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl AabbTreeSettings {
    /// Leaves of up to 20 points, median splits, packed search, no period.
    pub const DEFAULT: Self =
        Self { bucket_size: 20, order: BuildOrder::Median, search: TreeSearch::Packed, period: Period::NONE };

    /// Sets the most points of a leaf.
    pub fn bucket_size(mut self, points: u32) -> Self {
        self.bucket_size = points;
        self
    }

    /// Sets the order of the points.
    pub fn order(mut self, order: BuildOrder) -> Self {
        self.order = order;
        self
    }

    /// Sets the search.
    pub fn search(mut self, search: TreeSearch) -> Self {
        self.search = search;
        self
    }

    /// Makes the searched space periodic.
    pub fn periodic(mut self, period: Period) -> Self {
        self.period = period;
        self
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// `InvalidSetting` for a bucket size of 0.
    pub(super) fn validate(&self) -> Result<()> {
        if self.bucket_size > 0 {
            return Ok(());
        }
        let (setting, found) = ("bucket_size", self.bucket_size.to_string());
        Err(Error::InvalidSetting { setting, found, expected: "1 point or more" })
    }
}
