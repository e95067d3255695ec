//! The algebraic sphere of Guennebaud2007: u_c + u_l · x + u_q |x|² = 0, a plane where u_q is 0, and its fit to points with normals
//! (Guennebaud2008). `algebraic_sphere.wesl` is the twin.
//!
//! With sums over the weights w, P = Σ w p, N = Σ w n, W = Σ w, the sphere whose gradients agree best with the normals has
//! u_q = β ½ (Σ w p·n − P·N / W) / (Σ w p·p − P·P / W), u_l = (N − 2 u_q P) / W, u_c = −(u_l·P + u_q Σ w p·p) / W.

use super::Scalar;
use super::vector::{self, Vector};

/// Sums over weighted points with normals, which determine a sphere.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SphereSums<T> {
    /// Σ w
    pub weights: T,
    /// Σ w p
    pub points: Vector<T>,
    /// Σ w n
    pub normals: Vector<T>,
    /// Σ w p·p
    pub squares: T,
    /// Σ w p·n
    pub products: T,
}

impl<T: Scalar> SphereSums<T> {
    /// Adds a point with its normal.
    #[inline(always)]
    pub fn add(&mut self, point: Vector<T>, normal: Vector<T>, weight: T) {
        self.weights += weight;
        self.points = vector::add_scaled(self.points, point, weight);
        self.normals = vector::add_scaled(self.normals, normal, weight);
        self.squares += weight * vector::norm2(point);
        self.products += weight * vector::dot(point, normal);
    }

    /// The sphere that fits best, its curvature times `sphericity`: 1 is the fit, 0 a plane. Points at one place have no curvature.
    /// The weights must not sum to 0.
    pub fn sphere(&self, sphericity: T) -> AlgebraicSphere<T> {
        let Self { weights, points, normals, squares, products } = *self;
        let inverse = T::ONE / weights;
        let spread = squares - vector::norm2(points) * inverse;
        let bend = products - vector::dot(points, normals) * inverse;
        let is_spread = spread > T::of(16.0) * T::EPSILON * squares;
        let quadratic = if is_spread { sphericity * T::of(0.5) * bend / spread } else { T::ZERO };
        let linear = vector::scale(vector::add_scaled(normals, points, -(quadratic + quadratic)), inverse);
        let constant = -(vector::dot(linear, points) + quadratic * squares) * inverse;
        AlgebraicSphere { constant, linear, quadratic }
    }
}

/// A sphere or a plane by its equation; its value is positive on the side that the normals point to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlgebraicSphere<T> {
    /// u_c
    pub constant: T,
    /// u_l
    pub linear: Vector<T>,
    /// u_q
    pub quadratic: T,
}

/// A place on the sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnSphere<T> {
    /// Where.
    pub position: Vector<T>,
    /// Of length 1, to the side where values are positive.
    pub normal: Vector<T>,
}

impl<T: Scalar> AlgebraicSphere<T> {
    /// (|u_l|² − 4 u_c u_q): the squared gradient on the sphere, the same everywhere on it.
    fn gradient2(&self) -> T {
        vector::norm2(self.linear) - T::of(4.0) * self.constant * self.quadratic
    }

    /// The distance of `y`, positive on the side that the normals point to. `None` where the sphere has no points.
    ///
    /// The gradient at y points along the line through the centre. The two places where this line meets the sphere are the
    /// roots of a quadratic in the way along it, and the smaller root in the form below has no difference of large numbers: it
    /// is exact for spheres, for planes, and for all between.
    pub fn distance(&self, y: Vector<T>) -> Option<T> {
        let two = T::of(2.0);
        let gradient = vector::add_scaled(self.linear, y, two * self.quadratic);
        let value = self.constant + vector::dot(self.linear, y) + self.quadratic * vector::norm2(y);
        let on_sphere2 = self.gradient2();
        let distance = two * value / (vector::norm(gradient) + on_sphere2.sqrt());
        (on_sphere2 > T::ZERO && distance.is_finite()).then_some(distance)
    }

    /// The place of the sphere nearest to `y`. `None` where the sphere has no points, or `y` is its centre.
    pub fn project(&self, y: Vector<T>) -> Option<OnSphere<T>> {
        let two = T::of(2.0);
        let direction = vector::normalized(vector::add_scaled(self.linear, y, two * self.quadratic))?;
        let position = vector::add_scaled(y, direction, -self.distance(y)?);
        let normal = vector::normalized(vector::add_scaled(self.linear, position, two * self.quadratic))?;
        Some(OnSphere { position, normal })
    }

    /// 1 / radius, positive where the normals point away from the centre.
    pub fn mean_curvature(&self) -> T {
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

    /// Sums over places of a sphere, their weights uneven.
    fn sums(center: [f64; 3], radius: f64, outwards: f64) -> SphereSums<f64> {
        let mut sums = SphereSums::default();
        for i in 0..60 {
            let (turn, tilt) = (f64::from(i) * 2.4, 0.1 * (1.0 + f64::from(i)).sqrt());
            let n = vector::normalized([tilt * turn.cos(), tilt * turn.sin(), -1.0]).unwrap();
            sums.add(vector::add_scaled(center, n, radius), vector::scale(n, outwards), 1.0 - 0.01 * f64::from(i));
        }
        sums
    }

    #[test]
    fn points_of_a_sphere_give_that_sphere() {
        for (center, radius) in [([0.0, 0.0, 1.0], 1.0), ([0.2, -0.1, 0.7], 0.8), ([0.0, 0.0, 40.0], 40.2)] {
            for outwards in [1.0, -1.0] {
                let sphere = sums(center, radius, outwards).sphere(1.0);
                assert!((sphere.mean_curvature() * radius - outwards).abs() < 1e-9, "{sphere:?}");
                let y = [0.1, 0.1, 0.3];
                let found = sphere.project(y).unwrap();
                let off = vector::norm(vector::subtract(found.position, center)) - radius;
                assert!(off.abs() < 1e-11 * radius, "{off}");
                let expected = outwards * (vector::norm(vector::subtract(y, center)) - radius);
                assert!((sphere.distance(y).unwrap() - expected).abs() < 1e-9, "{:?} {expected}", sphere.distance(y));
            }
        }
    }

    #[test]
    fn without_sphericity_it_is_a_plane() {
        let plane = sums([0.0, 0.0, 1.0], 1.0, 1.0).sphere(0.0);
        assert_eq!((plane.quadratic, plane.mean_curvature()), (0.0, 0.0));
        assert!(plane.linear[2] < -0.5);
    }

    #[test]
    fn flat_points_give_the_plane_and_a_single_one_too() {
        let mut flat = SphereSums::default();
        for i in 0..9 {
            flat.add([f64::from(i % 3), f64::from(i / 3), -0.75], [0.0, 0.0, 1.0], 1.0);
        }
        assert!((flat.sphere(1.0).distance([0.0; 3]).unwrap() - 0.75).abs() < 1e-12);
        let mut one = SphereSums::default();
        one.add([0.5f32, 0.25, -2.0], [0.0, 0.0, 1.0], 1.0);
        assert_eq!(one.sphere(1.0).distance([0.0; 3]), Some(2.0));
        let mut opposite = one;
        opposite.add([0.5f32, 0.25, -2.0], [0.0, 0.0, -1.0], 1.0);
        assert_eq!(opposite.sphere(1.0).distance([0.0; 3]), None);
    }
}
