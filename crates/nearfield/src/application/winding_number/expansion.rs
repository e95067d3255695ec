//! The field of many dipoles far away: a Taylor expansion about a centre, up to the second order. The sum over the node is
//! in `evaluate.wesl`.
//!
//! With d = centre − query, u = d/|d| and the symmetric moments M₀ = ΣA, M₁ = Σ sym(s ⊗ A), M₂ = Σ ½ sym(s ⊗ s ⊗ A) of
//! dipoles A at offsets s from the centre, the field is
//! M₀·u/|d|² + (tr M₁ − 3 M₁(u,u))/|d|³ + (15 M₂(u,u,u) − 9 tr M₂·u)/|d|⁴.

use crate::geometry::Scalar;
use crate::geometry::vector::{Vector, dot, norm};

/// A symmetric matrix: xx, yy, zz, xy, xz, yz.
pub(super) type Symmetric2<T> = [T; 6];
/// A symmetric tensor of the third order: xxx, yyy, zzz, xxy, xxz, xyy, yyz, xzz, yzz, xyz.
pub(super) type Symmetric3<T> = [T; 10];

/// Moments about a centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moments<T> {
    pub(super) first: Vector<T>,
    pub(super) second: Symmetric2<T>,
    pub(super) third: Symmetric3<T>,
}

/// The symmetric part of a ⊗ b.
pub(super) fn symmetric2<T: Scalar>(a: Vector<T>, b: Vector<T>) -> Symmetric2<T> {
    let mixed = |i: usize, j: usize| T::of(0.5) * (a[i] * b[j] + a[j] * b[i]);
    [mixed(0, 0), mixed(1, 1), mixed(2, 2), mixed(0, 1), mixed(0, 2), mixed(1, 2)]
}

/// The symmetric part of Q ⊗ a, for a symmetric Q.
fn symmetric3<T: Scalar>([xx, yy, zz, xy, xz, yz]: Symmetric2<T>, [x, y, z]: Vector<T>) -> Symmetric3<T> {
    let (third, two) = (T::of(1.0 / 3.0), T::of(2.0));
    [
        xx * x,
        yy * y,
        zz * z,
        third * (xx * y + two * xy * x),
        third * (xx * z + two * xz * x),
        third * (yy * x + two * xy * y),
        third * (yy * z + two * yz * y),
        third * (zz * x + two * xz * z),
        third * (zz * y + two * yz * z),
        third * (xy * z + xz * y + yz * x),
    ]
}

fn plus<T: Scalar, const N: usize>(a: [T; N], b: [T; N], factor: T) -> [T; N] {
    std::array::from_fn(|i| a[i] + b[i] * factor)
}

impl<T: Scalar> Moments<T> {
    /// Of nothing.
    pub(super) const ZERO: Self = Self { first: [T::ZERO; 3], second: [T::ZERO; 6], third: [T::ZERO; 10] };

    /// Of a flat element with area vector `moment`, at `offset` from the centre, whose own second moment over its area about
    /// its place is `spread`.
    pub(super) fn of_element(offset: Vector<T>, moment: Vector<T>, spread: Symmetric2<T>) -> Self {
        let square = plus(symmetric2(offset, offset), spread, T::ONE);
        let third = symmetric3(square, moment).map(|x| x * T::of(0.5));
        Self { first: moment, second: symmetric2(offset, moment), third }
    }

    /// The same about a centre from which the old one is at `offset`.
    pub(super) fn moved(&self, offset: Vector<T>) -> Self {
        let square = symmetric3(symmetric2(offset, offset), self.first);
        Self {
            first: self.first,
            second: plus(self.second, symmetric2(offset, self.first), T::ONE),
            third: plus(plus(self.third, symmetric3(self.second, offset), T::ONE), square, T::of(0.5)),
        }
    }

    /// Both, about one centre.
    pub(super) fn added(&self, other: &Self) -> Self {
        Self {
            first: plus(self.first, other.first, T::ONE),
            second: plus(self.second, other.second, T::ONE),
            third: plus(self.third, other.third, T::ONE),
        }
    }

    /// The field where the centre is at `offset` from the query, which must not be 0.
    #[inline(always)]
    pub(super) fn field(&self, offset: Vector<T>) -> T {
        let inverse = T::ONE / norm(offset);
        let u = offset.map(|d| d * inverse);
        let [x, y, z] = u;
        let (three, six) = (T::of(3.0), T::of(6.0));
        let [xx, yy, zz, xy, xz, yz] = self.second;
        let quadratic = xx * x * x + yy * y * y + zz * z * z + T::of(2.0) * (xy * x * y + xz * x * z + yz * y * z);
        let second = (xx + yy + zz) - three * quadratic;
        let [xxx, yyy, zzz, xxy, xxz, xyy, yyz, xzz, yzz, xyz] = self.third;
        let pure = xxx * x * x * x + yyy * y * y * y + zzz * z * z * z;
        let twice = (xxy * y + xxz * z) * x * x + (xyy * x + yyz * z) * y * y + (xzz * x + yzz * y) * z * z;
        let cubic = pure + three * twice + six * xyz * x * y * z;
        let trace = dot([xxx + xyy + xzz, xxy + yyy + yzz, xxz + yyz + zzz], u);
        let third = T::of(15.0) * cubic - T::of(9.0) * trace;
        ((third * inverse + second) * inverse + dot(self.first, u)) * inverse * inverse
    }
}

#[cfg(test)]
mod tests {
    use super::super::solid_angle;
    use super::*;
    use crate::geometry::vector::{add, subtract};

    #[test]
    fn expansions_of_order_two_fall_short_by_the_third_power() {
        let (offset, moment) = ([0.3f64, -0.2, 0.1], [0.5, 0.7, -0.4]);
        let direction = [0.48, 0.6, -0.64];
        let error = |distance: f64| {
            let far = direction.map(|x| x * distance);
            let exact = solid_angle::dipole(add(far, offset), moment);
            let moments = Moments::of_element(offset, moment, [0.0; 6]);
            (moments.field(far) / exact - 1.0).abs()
        };
        assert!(error(10.0) < 1e-3 && error(100.0) < 1e-6);
        let ratio = error(10.0) / error(100.0);
        assert!((500.0..2000.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn moved_moments_are_those_about_the_new_centre() {
        let dipoles = [([0.3f64, -0.2, 0.1], [0.5, 0.7, -0.4]), ([-0.1, 0.25, 0.2], [0.1, -0.3, 0.9])];
        let about = |center: Vector<f64>| {
            dipoles.iter().fold(Moments::ZERO, |sum, (place, moment)| {
                sum.added(&Moments::of_element(subtract(*place, center), *moment, [0.0; 6]))
            })
        };
        let shift = [0.7, -0.1, 0.4];
        let (expected, moved) = (about(shift), about([0.0; 3]).moved([-0.7, 0.1, -0.4]));
        let all = |m: &Moments<f64>| [&m.first[..], &m.second[..], &m.third[..]].concat();
        for (a, b) in all(&expected).iter().zip(all(&moved)) {
            assert!((a - b).abs() < 1e-14, "{a} {b}");
        }
    }
}
