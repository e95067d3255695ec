//! Vectors of three numbers in either precision, for what is computed in `f32` and in `f64` by one source. Points in `f32`
//! alone are [`glam::Vec3`].

use super::Scalar;

/// Three coordinates.
pub type Vector<T> = [T; 3];

/// a + b.
#[inline(always)]
pub fn add<T: Scalar>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a − b.
#[inline(always)]
pub fn subtract<T: Scalar>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// a · s.
#[inline(always)]
pub fn scale<T: Scalar>(a: Vector<T>, s: T) -> Vector<T> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// a + b · s.
#[inline(always)]
pub fn add_scaled<T: Scalar>(a: Vector<T>, b: Vector<T>, s: T) -> Vector<T> {
    add(a, scale(b, s))
}

/// The inner product.
#[inline(always)]
pub fn dot<T: Scalar>(a: Vector<T>, b: Vector<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The vector product.
#[inline(always)]
pub fn cross<T: Scalar>(a: Vector<T>, b: Vector<T>) -> Vector<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Squared length.
#[inline(always)]
pub fn norm2<T: Scalar>(a: Vector<T>) -> T {
    dot(a, a)
}

/// Length.
#[inline(always)]
pub fn norm<T: Scalar>(a: Vector<T>) -> T {
    norm2(a).sqrt()
}

/// The vector at length 1; `None` where its length is 0 or not a number.
#[inline(always)]
pub fn normalized<T: Scalar>(a: Vector<T>) -> Option<Vector<T>> {
    let length = norm(a);
    (length > T::ZERO && length.is_finite()).then(|| scale(a, T::ONE / length))
}

/// Two vectors that complete a vector of length 1 to a right-handed orthonormal frame (Duff2017). `frame.wesl` is the twin.
#[inline(always)]
pub fn tangents<T: Scalar>(n: Vector<T>) -> [Vector<T>; 2] {
    let sign = if n[2] < T::ZERO { -T::ONE } else { T::ONE };
    let a = -T::ONE / (sign + n[2]);
    let b = n[0] * n[1] * a;
    [[T::ONE + sign * n[0] * n[0] * a, sign * b, -sign * n[0]], [b, sign + n[1] * n[1] * a, -n[1]]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vector_and_its_tangents_are_a_right_handed_frame() {
        for n in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, -0.8, 0.0], [0.48, 0.6, -0.64], [-1.0, 0.0, 0.0]] {
            let [u, v]: [Vector<f64>; 2] = tangents(n);
            let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
            assert!(close(norm(u), 1.0) && close(norm(v), 1.0) && close(dot(u, v), 0.0), "{n:?}");
            assert!(norm(subtract(cross(u, v), n)) < 1e-12, "{n:?}: {:?}", cross(u, v));
        }
    }

    #[test]
    fn only_vectors_with_a_direction_are_normalized() {
        assert_eq!(normalized([0.0f32, 3.0, -4.0]), Some([0.0, 0.6, -0.8]));
        assert_eq!(normalized([0.0f32; 3]), None);
        assert_eq!(normalized([f64::NAN, 0.0, 1.0]), None);
    }
}
