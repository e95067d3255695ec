//! Triangles.

use glam::Vec3;

use super::Aabb;

/// A triangle by its corners, counter-clockwise seen from outside.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct Triangle {
    /// First corner.
    pub a: Vec3,
    /// Second corner.
    pub b: Vec3,
    /// Third corner.
    pub c: Vec3,
}

impl Triangle {
    /// The triangle between three corners.
    #[inline]
    pub const fn new(a: Vec3, b: Vec3, c: Vec3) -> Self {
        Self { a, b, c }
    }

    /// The smallest box that holds the triangle.
    #[inline]
    pub fn bounds(&self) -> Aabb {
        Aabb::new(self.a.min(self.b).min(self.c), self.a.max(self.b).max(self.c))
    }

    /// Mean of the corners.
    pub fn centroid(&self) -> Vec3 {
        (self.a + self.b + self.c) / 3.0
    }

    /// Normal whose length is twice the area; zero for a degenerate triangle.
    pub fn scaled_normal(&self) -> Vec3 {
        (self.b - self.a).cross(self.c - self.a)
    }

    /// Area.
    pub fn area(&self) -> f32 {
        0.5 * self.scaled_normal().length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_and_normal_of_a_right_triangle() {
        let t = Triangle::new(Vec3::ZERO, Vec3::new(3.0, 0.0, 0.0), Vec3::new(0.0, 4.0, 0.0));
        assert_eq!(t.area(), 6.0);
        assert_eq!(t.scaled_normal(), Vec3::new(0.0, 0.0, 12.0));
        assert_eq!(t.bounds().max, Vec3::new(3.0, 4.0, 0.0));
    }
}
