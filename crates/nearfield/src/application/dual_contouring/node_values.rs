//! The values that a surface is taken from: those of a grid, seen from the level of the surface.

use crate::geometry::{DistanceGrid, RegularGrid, Scalar};
use crate::{Error, Result};

/// Values at the nodes of a grid and what counts as the surface among them.
#[derive(Debug, Clone, Copy)]
pub struct NodeValues<'a, T> {
    grid: RegularGrid,
    values: &'a [T],
    level: T,
    two_sided: bool,
}

impl<'a, T: Scalar> NodeValues<'a, T> {
    /// The surface where values are 0: inside they are negative. Values that are not finite are undefined.
    ///
    /// - `values`: `[nz][ny][nx]` as in [`DistanceGrid`]
    ///
    /// # Errors
    /// `LengthMismatch` unless there is one value a node.
    pub fn new(grid: &RegularGrid, values: &'a [T]) -> Result<Self> {
        let (found, expected) = (values.len() as u64, grid.n_nodes() as u64);
        if found != expected {
            return Err(Error::LengthMismatch { what: "the values of a grid", found, expected });
        }
        Ok(Self { grid: *grid, values, level: T::ZERO, two_sided: false })
    }

    /// The surface where values are `level`: of distances, the offset surface.
    pub fn at_level(self, level: T) -> Self {
        Self { level, two_sided: false, ..self }
    }

    /// The surface where the size of values is `level`: on both sides of a surface that may be open.
    pub fn two_sided(self, level: T) -> Self {
        Self { level, two_sided: true, ..self }
    }

    /// The nodes.
    pub fn grid(&self) -> &RegularGrid {
        &self.grid
    }

    /// Number of nodes along each axis.
    pub(super) fn nodes(&self) -> [u32; 3] {
        self.grid.nodes()
    }

    /// Level of the surface, and whether sizes are meant.
    #[cfg(feature = "gpu")]
    pub(super) fn level(&self) -> (T, bool) {
        (self.level, self.two_sided)
    }

    /// The values as given.
    pub(super) fn raw(&self) -> &'a [T] {
        self.values
    }

    /// The value of a node less the level: negative inside. NaN where undefined and outside the grid.
    #[inline]
    pub fn value(&self, node: [u32; 3]) -> T {
        let [nx, ny, nz] = self.nodes();
        if node[0] >= nx || node[1] >= ny || node[2] >= nz {
            return T::of(f64::NAN);
        }
        let number = (node[2] as usize * ny as usize + node[1] as usize) * nx as usize + node[0] as usize;
        self.seen(self.values[number])
    }

    /// A value as seen from the level.
    #[inline]
    pub(super) fn seen(&self, value: T) -> T {
        let size = if self.two_sided { value.abs() } else { value };
        let seen = size - self.level;
        match seen.is_finite() {
            // Devices may take smaller ones for 0.
            true if seen.abs() < T::SMALLEST_NORMAL => T::ZERO,
            true => seen,
            false => T::of(f64::NAN),
        }
    }
}

impl<'a> From<&'a DistanceGrid> for NodeValues<'a, f32> {
    fn from(field: &'a DistanceGrid) -> Self {
        Self { grid: *field.grid(), values: field.values(), level: 0.0, two_sided: false }
    }
}
