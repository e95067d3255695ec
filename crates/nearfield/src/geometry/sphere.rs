//! Balls.

use glam::Vec3;

/// A closed ball.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct Sphere {
    /// Center.
    pub center: Vec3,
    /// Radius, not negative.
    pub radius: f32,
}

impl Sphere {
    /// The ball around `center`.
    pub const fn new(center: Vec3, radius: f32) -> Self {
        Self { center, radius }
    }

    /// Whether `point` is inside or on the surface: d² ≤ r².
    pub fn contains(&self, point: Vec3) -> bool {
        super::distance::dist2(self.center, point) <= self.radius * self.radius
    }

    /// The smallest box that holds the ball.
    pub fn bounds(&self) -> super::Aabb {
        super::Aabb::new(self.center - self.radius, self.center + self.radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surface_is_inside() {
        let ball = Sphere::new(Vec3::ONE, 0.5);
        assert!(ball.contains(Vec3::new(1.5, 1.0, 1.0)));
        assert!(!ball.contains(Vec3::new(1.5f32.next_up(), 1.0, 1.0)));
        assert_eq!(ball.bounds().extent(), Vec3::ONE);
    }
}
