//! The algebraic sphere of Guennebaud2007: u_c + u_l · x + u_q |x|² = 0, a plane where u_q is 0. `apss.wesl` has the twin.

use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};

/// A sphere or a plane by its equation; its value is positive on the side that the normals point to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AlgebraicSphere<T> {
    pub(super) constant: T,
    pub(super) linear: Vector<T>,
    pub(super) quadratic: T,
}

/// A place on the sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OnSphere<T> {
    pub(super) position: Vector<T>,
    pub(super) normal: Vector<T>,
}

impl<T: Scalar> AlgebraicSphere<T> {
    /// (|u_l|² − 4 u_c u_q): the squared gradient on the sphere, the same everywhere on it.
    fn gradient2(&self) -> T {
        vector::norm2(self.linear) - T::of(4.0) * self.constant * self.quadratic
    }

    /// The place of the sphere nearest to `y`. `None` where the sphere has no points, or `y` is its centre.
    ///
    /// The gradient at y points along the line through the centre. The two places where this line meets the sphere are the
    /// roots of a quadratic in the way along it, and the smaller root in the form below has no difference of large numbers: it
    /// is exact for spheres, for planes, and for all between.
    pub(super) fn project(&self, y: Vector<T>) -> Option<OnSphere<T>> {
        let two = T::of(2.0);
        let gradient = vector::add_scaled(self.linear, y, two * self.quadratic);
        let value = self.constant + vector::dot(self.linear, y) + self.quadratic * vector::norm2(y);
        let (length, on_sphere2) = (vector::norm(gradient), self.gradient2());
        let direction = vector::normalized(gradient)?;
        if !(on_sphere2 > T::ZERO) {
            return None;
        }
        let way = two * value / (length + on_sphere2.sqrt());
        let position = vector::add_scaled(y, direction, -way);
        let normal = vector::normalized(vector::add_scaled(self.linear, position, two * self.quadratic))?;
        Some(OnSphere { position, normal })
    }

    /// 1 / radius, positive where the normals point away from the centre.
    pub(super) fn mean_curvature(&self) -> T {
        let gradient2 = self.gradient2();
        if gradient2 > T::ZERO { T::of(2.0) * self.quadratic / gradient2.sqrt() } else { T::ZERO }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With a centre and a radius, times a factor.
    fn sphere(center: [f64; 3], radius: f64, factor: f64) -> AlgebraicSphere<f64> {
        AlgebraicSphere {
            constant: factor * (vector::norm2(center) - radius * radius),
            linear: vector::scale(center, -2.0 * factor),
            quadratic: factor,
        }
    }

    #[test]
    fn places_on_spheres_are_those_of_centre_and_radius() {
        for (center, radius, factor) in
            [([0.3, -0.2, 0.9], 1.0, 2.0), ([5.0, 1.0, 0.0], 4.5, 0.1), ([0.0, 0.0, -2.0], 1.5, -3.0)]
        {
            let made = sphere(center, radius, factor);
            for y in [[0.0; 3], [0.1, 0.4, -0.2], [-0.7, 0.7, 0.7]] {
                let found = made.project(y).unwrap();
                let away = vector::normalized(vector::subtract(y, center)).unwrap();
                let expected = vector::add_scaled(center, away, radius);
                assert!(vector::norm(vector::subtract(found.position, expected)) < 1e-12, "{found:?}, {expected:?}");
                let normal = vector::scale(away, factor.signum());
                assert!(vector::norm(vector::subtract(found.normal, normal)) < 1e-12, "{found:?}");
                assert!((made.mean_curvature() - factor.signum() / radius).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn flat_spheres_become_planes_without_a_step() {
        let plane = AlgebraicSphere { constant: -0.25, linear: [0.0, 0.0, 2.0], quadratic: 0.0 };
        let expected = plane.project([0.3, 0.1, 0.7]).unwrap();
        assert_eq!((expected.position, expected.normal), ([0.3, 0.1, 0.125], [0.0, 0.0, 1.0]));
        for bend in [1e-6, 1e-9, 1e-12, 1e-15] {
            let found = AlgebraicSphere { quadratic: bend, ..plane }.project([0.3, 0.1, 0.7]).unwrap();
            assert!(vector::norm(vector::subtract(found.position, expected.position)) < 2.0 * bend + 1e-15);
            let rough = AlgebraicSphere { constant: -0.25f32, linear: [0.0, 0.0, 2.0], quadratic: bend as f32 };
            assert!((rough.project([0.3, 0.1, 0.7]).unwrap().position[2] - 0.125).abs() < 2.0 * bend as f32 + 1e-7);
        }
    }

    #[test]
    fn spheres_without_points_and_their_centres_have_no_nearest_place() {
        let none = AlgebraicSphere { constant: 1.0, linear: [0.0f64; 3], quadratic: 1.0 };
        assert_eq!(none.project([0.1, 0.0, 0.0]), None);
        assert_eq!(none.mean_curvature(), 0.0);
        assert_eq!(sphere([0.5, 0.0, 0.0], 1.0, 1.0).project([0.5, 0.0, 0.0]), None);
    }
}
