//! The cube that a curve fills, and the cells of points in it. `domain.wesl` is the twin of this file.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;

use super::{Curve, MAX_LEVEL};
use crate::geometry::{Aabb, validate};
use crate::parallel::reduce;
use crate::{Error, Result};

/// Smallest edge of a domain: one over it, times the number of cells, is a normal f32. Points closer together than
/// this all lie in one cell.
const SMALLEST_EDGE: f32 = 1.0 / (1u128 << 80) as f32;
/// Largest edge: twice the largest coordinate.
const LARGEST_EDGE: f32 = 2.1e18;

/// A cube cut into 2²¹ cells along each axis. Its smallest corner is that of the points, so one octant more or less
/// does not depend on where the points lie.
///
/// A point's cell is ⌊(p − origin) · scale⌋ by axis, in f32: monotone along each axis, and the same on every device,
/// because a subtraction and a multiplication cannot be fused. The far faces belong to the last cells.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Domain {
    origin: [f32; 3],
    edge: f32,
    /// Cells at [`MAX_LEVEL`] a unit of length.
    scale: f32,
    padding: [u32; 3],
}

impl Domain {
    /// The cube with this smallest corner and edge length.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge` for the corner; `InvalidSetting` for an edge that is not between 2⁻⁸⁰ and 2.1e18.
    pub fn new(origin: Vec3, edge: f32) -> Result<Self> {
        validate::coordinates("corners of the domain", &[origin])?;
        if !(SMALLEST_EDGE..=LARGEST_EDGE).contains(&edge) {
            return Err(Error::InvalidSetting {
                setting: "edge of the domain",
                found: format!("{edge:e}"),
                expected: "a length between 2^-80 (8.3e-25) and 2.1e18",
            });
        }
        Ok(Self::with(origin, edge))
    }

    /// The smallest cube at the smallest corner of `bounds` that holds them; a cube of edge 1 at 0 for empty bounds, and
    /// a tiny one where all points are equal.
    pub fn of_bounds(bounds: &Aabb) -> Self {
        if bounds.is_empty() {
            return Self::with(Vec3::ZERO, 1.0);
        }
        Self::with(bounds.min, bounds.extent().max_element().clamp(SMALLEST_EDGE, LARGEST_EDGE))
    }

    /// The domain of these points: the given one, which must hold them, or the smallest around them.
    ///
    /// # Errors
    /// `TooMany`, `NonFinite`, `CoordinateTooLarge`; `OutsideDomain` for points outside the given one.
    pub fn of_points(points: &[Vec3], given: Option<Self>) -> Result<Self> {
        validate::points(points)?;
        let Some(domain) = given else { return Ok(Self::of_bounds(&reduce::bounds(points))) };
        domain.check_contains("points", points)?;
        Ok(domain)
    }

    fn with(origin: Vec3, edge: f32) -> Self {
        Self { origin: origin.to_array(), edge, scale: (1u32 << MAX_LEVEL) as f32 / edge, padding: [0; 3] }
    }

    /// Smallest corner.
    pub fn origin(&self) -> Vec3 {
        Vec3::from_array(self.origin)
    }

    /// Edge length.
    pub fn edge(&self) -> f32 {
        self.edge
    }

    /// Cells at [`MAX_LEVEL`] a unit of length.
    pub(crate) fn scale(&self) -> f32 {
        self.scale
    }

    /// Whether the point lies in the closed cube.
    #[inline(always)]
    pub fn contains(&self, point: Vec3) -> bool {
        let offset = point - self.origin();
        offset.cmpge(Vec3::ZERO).all() && offset.cmple(Vec3::splat(self.edge)).all()
    }

    /// Checks that all points lie in the closed cube. `what` names them in the error.
    ///
    /// # Errors
    /// `OutsideDomain` with their number and the first index.
    pub fn check_contains(&self, what: &'static str, points: &[Vec3]) -> Result<()> {
        let Some(first) = points.par_iter().with_min_len(1 << 14).position_first(|&p| !self.contains(p)) else {
            return Ok(());
        };
        let count = points[first..].par_iter().filter(|&&p| !self.contains(p)).count() as u64;
        Err(Error::OutsideDomain { what, count, first: first as u64 })
    }

    /// The cell of a point at [`MAX_LEVEL`]; points outside count to the border.
    #[inline(always)]
    pub fn cell_of(&self, point: Vec3) -> [u32; 3] {
        let last = ((1u32 << MAX_LEVEL) - 1) as f32;
        let scaled = (point - self.origin()) * self.scale;
        // The conversion rounds towards zero, which is down here.
        scaled.clamp(Vec3::ZERO, Vec3::splat(last)).to_array().map(|v| v as u32)
    }

    /// The cell at [`MAX_LEVEL`] of a coordinate this far from the origin; outside coordinates count to the border.
    #[inline(always)]
    pub(crate) fn cell_at(&self, offset: f32) -> u32 {
        (offset * self.scale).clamp(0.0, ((1u32 << MAX_LEVEL) - 1) as f32) as u32
    }

    /// The 63-bit key of a point.
    #[inline(always)]
    pub fn key_of(&self, curve: Curve, point: Vec3) -> u64 {
        curve.encode(self.cell_of(point))
    }

    /// A box that holds every point of the domain whose cell at [`MAX_LEVEL`] is between `low` and `high`, both included: the cells'
    /// own box and a little more, for the rounding of cells (2⁻²¹ of the edge).
    pub fn bounds_of(&self, low: [u32; 3], high: [u32; 3]) -> Aabb {
        let size = f64::from(self.edge) / f64::from(1u32 << MAX_LEVEL);
        let corner = |cell: [u32; 3], side: f64, axis: usize| {
            let exact = f64::from(self.origin[axis]) + (f64::from(cell[axis]) + side) * size;
            let slack = size + exact.abs() * f64::from(f32::EPSILON);
            // `side` is 0 at the low end and 1 at the high end.
            (exact + (2.0 * side - 1.0) * slack) as f32
        };
        let min = [0, 1, 2].map(|axis| corner(low, 0.0, axis));
        let max = [0, 1, 2].map(|axis| corner(high, 1.0, axis));
        Aabb::new(Vec3::from_array(min), Vec3::from_array(max))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_far_faces_belong_to_the_last_cells() {
        let domain = Domain::new(Vec3::new(-1.0, 0.0, 3.0), 4.0).unwrap();
        let last = (1 << MAX_LEVEL) - 1;
        assert_eq!(domain.cell_of(Vec3::new(3.0, 4.0, 7.0)), [last; 3]);
        assert_eq!(domain.cell_of(Vec3::new(-1.0, 2.0, 3.0)), [0, 1 << 20, 0]);
        assert!(domain.contains(Vec3::new(3.0, 4.0, 7.0)) && !domain.contains(Vec3::new(3.001, 0.0, 3.0)));
        assert_eq!(domain.cell_of(Vec3::new(-9.0, 9.0, 3.0)), [0, last, 0]);
    }

    #[test]
    fn bounds_without_extent_make_a_tiny_domain() {
        let point = Vec3::new(5.0, -3.0, 1e9);
        let domain = Domain::of_bounds(&Aabb::new(point, point));
        assert_eq!(domain.cell_of(point), [0; 3]);
        assert!(domain.contains(point) && domain.scale.is_normal());
        assert!(Domain::of_bounds(&Aabb::EMPTY).contains(Vec3::ONE));
    }

    #[test]
    fn edges_that_no_cell_can_have_are_refused() {
        for edge in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-30] {
            assert!(Domain::new(Vec3::ZERO, edge).is_err(), "{edge}");
        }
        assert!(Domain::new(Vec3::NAN, 1.0).is_err());
    }

    #[test]
    fn bounds_of_a_cell_hold_its_points() {
        let domain = Domain::new(Vec3::new(1000.1, -7.3, 0.0), 3.3).unwrap();
        for i in 0..10_000u32 {
            let part = |k: u32| (i.wrapping_mul(k) % 10_007) as f32 / 10_007.0 * 3.3;
            let point = domain.origin() + Vec3::new(part(7919), part(104_729), part(1_299_709));
            let cell = domain.cell_of(point);
            assert!(domain.bounds_of(cell, cell).contains(point), "{point}");
        }
    }
}
