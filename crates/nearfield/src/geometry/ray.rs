//! Rays.

use glam::Vec3;

/// A half line, or a part of one: the points `origin + t · direction` with `t_min ≤ t ≤ t_max`.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Ray {
    /// Start of the ray.
    pub origin: Vec3,
    /// Smallest t.
    pub t_min: f32,
    /// Direction, any length but zero; t counts in its lengths.
    pub direction: Vec3,
    /// Largest t.
    pub t_max: f32,
}

impl Ray {
    /// The half line from `origin`, with t from 0 to infinity.
    pub const fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, t_min: 0.0, direction, t_max: f32::INFINITY }
    }

    /// The point at `t`.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + t * self.direction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_counts_in_direction_lengths() {
        let ray = Ray::new(Vec3::ONE, Vec3::new(0.0, 0.0, 2.0));
        assert_eq!(ray.at(1.5), Vec3::new(1.0, 1.0, 4.0));
    }
}
