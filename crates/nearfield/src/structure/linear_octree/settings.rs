//! What a caller can choose about an octree.

use glam::Vec3;

use crate::curve::{Curve, Domain, MAX_LEVEL};
use crate::geometry::Period;
use crate::{Error, Result};

/// Settings of an octree, fixed when it is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OctreeSettings {
    /// Most points of a leaf above the depth limit; 0 cuts every occupied octant down to `max_level`.
    pub leaf_capacity: u32,
    /// Depth limit, 0 to 21: leaves there hold any number of points.
    pub max_level: u32,
    /// The order of points and octants.
    pub curve: Curve,
    /// The cube that is cut; `None` for the smallest one around the points. Points outside are an error.
    pub domain: Option<Domain>,
    /// Period of the space that is searched; it does not change the tree.
    pub period: Period,
}

impl Default for OctreeSettings {
    /// [`OctreeSettings::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl OctreeSettings {
    /// Leaves of up to 32 points, no depth limit but that of the keys, Morton order, the domain of the points.
    pub const DEFAULT: Self =
        Self { leaf_capacity: 32, max_level: MAX_LEVEL, curve: Curve::Morton, domain: None, period: Period::NONE };

    /// Every occupied octant down to `level` becomes a node: the leaves are the occupied cells of that level.
    pub fn uniform(level: u32) -> Self {
        Self { leaf_capacity: 0, max_level: level, ..Self::default() }
    }

    /// Sets the leaf capacity.
    pub fn leaf_capacity(mut self, points: u32) -> Self {
        self.leaf_capacity = points;
        self
    }

    /// Sets the depth limit.
    pub fn max_level(mut self, level: u32) -> Self {
        self.max_level = level;
        self
    }

    /// Sets the curve.
    pub fn curve(mut self, curve: Curve) -> Self {
        self.curve = curve;
        self
    }

    /// Sets the domain.
    pub fn domain(mut self, domain: Domain) -> Self {
        self.domain = Some(domain);
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
    /// `InvalidSetting` for a depth limit above 21.
    pub(super) fn validate(&self) -> Result<()> {
        if self.max_level <= MAX_LEVEL {
            return Ok(());
        }
        let (setting, found) = ("max_level", self.max_level.to_string());
        Err(Error::InvalidSetting { setting, found, expected: "0 to 21" })
    }

    /// Checks the points and gives the domain they are cut in.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany`; `OutsideDomain` for points outside a given domain.
    pub(super) fn domain_of(&self, points: &[Vec3]) -> Result<Domain> {
        Domain::of_points(points, self.domain)
    }

    /// Levels that points are sorted by at first: the keys then have 30 bits, which is enough for most clouds.
    pub(super) fn few_levels(&self) -> u32 {
        self.max_level.min(NARROW_LEVELS)
    }
}

/// Levels of a 32-bit key.
pub(super) const NARROW_LEVELS: u32 = 10;
