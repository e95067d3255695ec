//! What a caller can choose about a dense octree.

use glam::Vec3;

use super::{CellLayout, MOST_LEVELS};
use crate::curve::{Curve, Domain};
use crate::{Error, Result};

/// Settings of a dense octree, fixed when it is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DenseOctreeSettings {
    /// Levels below the root, k: the finest cells are 2^k along each axis. 0 to 8.
    pub levels: u32,
    /// The order of the cells.
    pub curve: Curve,
    /// The cube that the root is; all points must lie in it. `None` takes the bounds of the points.
    pub domain: Option<Domain>,
    /// Most bytes that a build may take, its scratch memory included; checked before any of it is asked for.
    pub max_memory: u64,
}

impl Default for DenseOctreeSettings {
    /// Six levels in Morton order (299,593 cells) over the bounds of the points.
    fn default() -> Self {
        Self::with_levels(6)
    }
}

impl DenseOctreeSettings {
    /// That many levels below the root, in Morton order, over the bounds of the points.
    pub fn with_levels(levels: u32) -> Self {
        Self { levels, curve: Curve::Morton, domain: None, max_memory: u64::MAX }
    }

    /// Orders the cells along this curve.
    pub fn curve(mut self, curve: Curve) -> Self {
        self.curve = curve;
        self
    }

    /// Makes this cube the root.
    pub fn domain(mut self, domain: Domain) -> Self {
        self.domain = Some(domain);
        self
    }

    /// Limits the memory of the build.
    pub fn max_memory(mut self, bytes: u64) -> Self {
        self.max_memory = bytes;
        self
    }

    /// The layout of the cells.
    ///
    /// # Errors
    /// `InvalidSetting` for more than eight levels.
    pub(super) fn layout(&self) -> Result<CellLayout> {
        if self.levels > MOST_LEVELS {
            return Err(Error::InvalidSetting {
                setting: "levels of a dense octree",
                found: self.levels.to_string(),
                expected: "0 to 8",
            });
        }
        Ok(CellLayout::new(self.levels))
    }

    /// Checks the points and finds their domain.
    ///
    /// # Errors
    /// `TooMany`, `NonFinite`, `CoordinateTooLarge`; `OutsideDomain` where a domain is given and does not hold them.
    pub(super) fn domain_of(&self, points: &[Vec3]) -> Result<Domain> {
        Domain::of_points(points, self.domain)
    }

    /// Bytes that a build on the CPU takes at once.
    pub(super) fn bytes_on_cpu(&self, layout: CellLayout, n_points: usize) -> u64 {
        // Ordered points; keys, order, and the three pairs of columns of the sort.
        let points = (16 + 8 + 24) * n_points as u64;
        // States and nulls before; starts.
        points + 5 * layout.cells() as u64 + 4 * layout.finest() as u64
    }

    /// Bytes that a build on the GPU takes at once beside its input, apart from the tables of scan and sort.
    #[cfg(feature = "gpu")]
    pub(super) fn bytes_on_gpu(layout: CellLayout, n_points: usize) -> u64 {
        // Points and their order; keys before and after the sort, and its spare pair.
        let points = (16 + 4 + 8 + 8) * n_points as u64;
        // States, null flags and nulls before; counts and starts.
        points + 12 * layout.cells() as u64 + 8 * layout.finest() as u64
    }
}
