//! What a caller can choose about a grid.

use glam::Vec3;

use super::nearest_radius;
use crate::geometry::{Aabb, Period, validate};
use crate::parallel::reduce;
use crate::{Error, Result};

/// Settings of a grid, fixed when it is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridSettings {
    /// Edge length of a cell; a query of that radius touches 3 × 3 rows. 0 lets the build choose by density.
    pub cell_size: f32,
    /// Cells along x are up to this many times shorter than `cell_size`, as far as the table stays small: runs are cut
    /// closer to the ball. 1 to 8.
    pub refine_x: u32,
    /// Where the points lie, if known: saves finding out. Points outside stay exact, only slower to search; in a
    /// periodic domain the points' own bounds are taken instead.
    pub bounds: Option<Aabb>,
    /// Period of the domain.
    pub period: Period,
}

impl GridSettings {
    /// Cells for queries of about this radius.
    pub fn for_radius(radius: f32) -> Self {
        Self { cell_size: radius, refine_x: 4, bounds: None, period: Period::NONE }
    }

    /// Cells chosen by density: about two points each if they were spread evenly.
    pub fn by_density() -> Self {
        Self::for_radius(0.0)
    }

    /// Cells for the `k` nearest of these points: balls as wide as a cell hold a few more than `k`, where points are spread evenly over
    /// space or a surface. For 16 that are some 26.
    ///
    /// It is the median distance within which 32 of the points have so many others, or up to half as much more where the table is dense
    /// then. Distances are measured to all points, without a period, which takes about 0.1 s a million on two cores. Where there are
    /// not so many points it is 0, and the build chooses by density. Any other cells find the same nearest points, slower.
    pub fn for_nearest(points: &[Vec3], k: u32) -> Self {
        let radius = nearest_radius::measured(points, k);
        Self::for_radius(nearest_radius::with_dense_table(radius, &reduce::bounds(points), points.len()))
    }

    /// As [`GridSettings::for_nearest`] for `n_points` points that fill `bounds` evenly, which it gives to the build too.
    pub fn for_nearest_in(bounds: Aabb, n_points: usize, k: u32) -> Self {
        Self::for_radius(nearest_radius::in_bounds(&bounds, n_points, k)).bounds(bounds)
    }

    /// Makes the domain periodic.
    pub fn periodic(mut self, period: Period) -> Self {
        self.period = period;
        self
    }

    /// Gives the bounds of the points.
    pub fn bounds(mut self, bounds: Aabb) -> Self {
        self.bounds = Some(bounds);
        self
    }

    /// The bounds that a grid of these points is laid out in.
    pub(crate) fn bounds_of(&self, points: &[Vec3]) -> Aabb {
        match self.bounds {
            Some(bounds) if !self.period.is_periodic() => bounds,
            _ => reduce::bounds(points),
        }
    }

    /// Checks the settings.
    ///
    /// # Errors
    /// `InvalidSetting` for a cell size that is negative or not finite, or a refinement outside 1 to 8;
    /// `InvalidRadius`, `NonFinite`, `CoordinateTooLarge` for bounds that no coordinate can have.
    pub(crate) fn validate(&self) -> Result<()> {
        if !(self.cell_size >= 0.0 && self.cell_size.is_finite()) {
            return Err(Error::InvalidSetting {
                setting: "cell_size",
                found: format!("{:e}", self.cell_size),
                expected: "a finite length ≥ 0 (0: chosen by density)",
            });
        }
        if !(1..=8).contains(&self.refine_x) {
            return Err(Error::InvalidSetting {
                setting: "refine_x",
                found: self.refine_x.to_string(),
                expected: "1 to 8",
            });
        }
        match self.bounds {
            Some(bounds) => validate::coordinates("corners of the bounds", &[bounds.min, bounds.max]),
            None => Ok(()),
        }
    }
}
