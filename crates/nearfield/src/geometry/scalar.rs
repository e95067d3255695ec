//! The numbers that points are made of where both precisions are offered.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use bytemuck::Pod;

/// A coordinate: `f32` or `f64`. Functions beyond arithmetic and roots are those of the crate `libm`: the same bits on every
/// machine.
pub trait Scalar:
    Pod
    + PartialOrd
    + Send
    + Sync
    + Debug
    + Default
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// Bounds of the empty box.
    const LARGEST: Self;
    /// Bounds of the empty box.
    const SMALLEST: Self;
    /// Its absolute value may be at most this: squares of differences are finite.
    const MAX_COORDINATE: Self;
    /// The smallest positive number with all its digits.
    const SMALLEST_NORMAL: Self;
    /// The distance from 1 to the next larger number.
    const EPSILON: Self;
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// A number as this type.
    fn of(value: f64) -> Self;
    /// As the widest type.
    fn to_f64(self) -> f64;
    /// Order of all numbers.
    fn compare(self, other: Self) -> std::cmp::Ordering;
    /// Distance from 0.
    fn abs(self) -> Self;
    /// The square root; NaN of a negative number.
    fn sqrt(self) -> Self;
    /// e to this power.
    fn exp(self) -> Self;
    /// The angle of the point (`x`, self), from −π to π.
    fn atan2(self, x: Self) -> Self;
    /// Neither NaN nor infinite.
    fn is_finite(self) -> bool;

    /// The smaller one.
    #[inline(always)]
    fn smaller(self, other: Self) -> Self {
        if other < self { other } else { self }
    }

    /// The larger one.
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        if other > self { other } else { self }
    }
}

macro_rules! scalar {
    ($t:ident, $largest:expr, $exp:path, $atan2:path) => {
        impl Scalar for $t {
            const LARGEST: Self = $t::MAX;
            const SMALLEST: Self = $t::MIN;
            const MAX_COORDINATE: Self = $largest;
            const SMALLEST_NORMAL: Self = $t::MIN_POSITIVE;
            const EPSILON: Self = $t::EPSILON;
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $t
            }

            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }

            #[inline(always)]
            fn compare(self, other: Self) -> std::cmp::Ordering {
                self.total_cmp(&other)
            }

            #[inline(always)]
            fn abs(self) -> Self {
                $t::abs(self)
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                $t::sqrt(self)
            }

            #[inline(always)]
            fn exp(self) -> Self {
                $exp(self)
            }

            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                $atan2(self, x)
            }

            #[inline(always)]
            fn is_finite(self) -> bool {
                $t::is_finite(self)
            }
        }
    };
}

scalar!(f32, 1e18, libm::expf, libm::atan2f);
scalar!(f64, 1e150, libm::exp, libm::atan2);
