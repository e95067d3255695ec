//! Axis-aligned bounding boxes.

use bytemuck::Zeroable;
use glam::Vec3;

/// A closed axis-aligned box. Empty when any `min` is greater than its `max`.
#[derive(Debug, Clone, Copy, PartialEq, Zeroable)]
#[repr(C)]
pub struct Aabb {
    /// Smallest corner.
    pub min: Vec3,
    /// Largest corner.
    pub max: Vec3,
}

impl Aabb {
    /// The empty box: the identity of [`Aabb::union`].
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The box between two corners.
    #[inline]
    pub const fn new(min: Vec3, max: Vec3) -> Self {
        Self { min, max }
    }

    /// The smallest box that holds all points; [`Aabb::EMPTY`] for none.
    pub fn of_points(points: &[Vec3]) -> Self {
        points.iter().fold(Self::EMPTY, |aabb, &p| aabb.grown_to(p))
    }

    /// The smallest box that holds `self` and `point`.
    #[inline]
    pub fn grown_to(self, point: Vec3) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// The smallest box that holds both.
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The box moved outwards by `distance` on every side.
    pub fn swept(self, distance: f32) -> Self {
        Self { min: self.min - distance, max: self.max + distance }
    }

    /// Whether no point is inside.
    pub fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    /// Edge lengths; zero where empty.
    #[inline]
    pub fn extent(&self) -> Vec3 {
        (self.max - self.min).max(Vec3::ZERO)
    }

    /// Midpoint of the box.
    #[inline]
    pub fn center(&self) -> Vec3 {
        0.5 * self.min + 0.5 * self.max
    }

    /// Length of the diagonal; zero where empty.
    pub fn diagonal(&self) -> f32 {
        self.extent().length()
    }

    /// Whether `point` is inside or on the border.
    pub fn contains(&self, point: Vec3) -> bool {
        point.cmpge(self.min).all() && point.cmple(self.max).all()
    }

    /// Whether the boxes share a point.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Squared distance from `point` to the nearest point of the box; zero inside.
    pub fn dist2_to(&self, point: Vec3) -> f32 {
        let outside = (self.min - point).max(point - self.max).max(Vec3::ZERO);
        super::distance::norm2(outside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_is_the_identity_of_union() {
        let unit = Aabb::new(Vec3::ZERO, Vec3::ONE);
        assert_eq!(Aabb::EMPTY.union(unit), unit);
        assert!(Aabb::EMPTY.is_empty() && !unit.is_empty());
        assert_eq!(Aabb::EMPTY.extent(), Vec3::ZERO);
    }

    #[test]
    fn distance_is_zero_inside_and_exact_outside() {
        let unit = Aabb::new(Vec3::ZERO, Vec3::ONE);
        assert_eq!(unit.dist2_to(Vec3::splat(0.25)), 0.0);
        assert_eq!(unit.dist2_to(Vec3::new(4.0, 5.0, 0.5)), 25.0);
    }

    #[test]
    fn borders_belong_to_the_box() {
        let unit = Aabb::new(Vec3::ZERO, Vec3::ONE);
        assert!(unit.contains(Vec3::ONE));
        assert!(unit.overlaps(&Aabb::new(Vec3::ONE, Vec3::splat(2.0))));
    }
}
