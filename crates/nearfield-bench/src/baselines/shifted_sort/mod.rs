//! Approximate nearest neighbours from sorts along shifted Morton curves. Source: Li2012.
//!
//! Points that are close in space are mostly close on a Morton curve, but for those on two sides of a face of a large
//! octant. So the curve is shifted: shift j of s moves all points by j/s of the edge of their cube, along all axes, inside a
//! cube of twice the edge. For each shift points are sorted by key, and each query looks at the `window` points before it
//! and after it. What it meets is merged by distance, each point once.
//!
//! With s = 5 in space (the dimension and one, rounded up to an odd number) about 98 % of the nearest are found; four
//! equal shifts leave the order of the finer cells as it is and find half of them.
//!
//! Other queries than the points are looked up by binary search among the sorted keys, where Li2012 sort them together
//! with the points. Their rows are the same up to the order of points in one cell.
//!
//! Cost: a sort of n keys and 2 · `window` distances a query for each shift; 36 bytes a point and 8 a place of a row.
//!
//! Invariants of an answer: rows are in query order, nearest first, ties by lower index; each point comes once; a point is
//! in a row if it is among the `k` nearest of those met. [`mod@reference`] is the same definition, written plainly.

mod gpu;
pub mod reference;

pub use gpu::{Asks, GpuShiftedSort, ShiftedRows};
pub use reference::Asking;

use nearfield::{Aabb, Domain, Error, Result, Vec3};

use super::check_k;

/// What to look at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShiftedSortSettings {
    /// Places of a row, 1 to 128.
    pub k: usize,
    /// Shifted curves, 1 to 64.
    pub shifts: usize,
    /// Points looked at before a query, and after, on each curve: 1 to 128. Li2012: k.
    pub window: usize,
}

impl ShiftedSortSettings {
    /// Five shifts, k points before and after.
    pub fn new(k: usize) -> Self {
        Self { k, shifts: 5, window: k }
    }

    /// With another number of shifts.
    pub fn shifts(mut self, shifts: usize) -> Self {
        self.shifts = shifts;
        self
    }

    /// With another number of points looked at before and after.
    pub fn window(mut self, window: usize) -> Self {
        self.window = window;
        self
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn validate(&self) -> Result<()> {
        check_k(self.k)?;
        let settings = [("shifts", self.shifts, 1..=64, "1 to 64"), ("window", self.window, 1..=128, "1 to 128")];
        for (setting, found, possible, expected) in settings {
            if !possible.contains(&found) {
                return Err(Error::InvalidSetting { setting, found: found.to_string(), expected });
            }
        }
        Ok(())
    }

    /// The cube of each shift: twice as large as that around `bounds`, which is moved inside it. Moving the corner of
    /// the cube down by as much is the same as moving the points up.
    ///
    /// # Errors
    /// `InvalidSetting`, `CoordinateTooLarge` for bounds of more than 1e18.
    pub fn domains(&self, bounds: &Aabb) -> Result<Vec<Domain>> {
        let cube = Domain::of_bounds(bounds);
        let edge = cube.edge();
        let corner = |j: usize| cube.origin() - Vec3::splat(edge * (j as f32 / self.shifts as f32));
        (0..self.shifts).map(|j| Domain::new(corner(j), 2.0 * edge)).collect()
    }
}
