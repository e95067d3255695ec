//! The numbers that trees of any dimension are built of.

use bytemuck::Pod;

/// A coordinate: `f32` or `f64`.
pub trait Scalar: Pod + PartialOrd + Send + Sync + std::fmt::Debug + Default {
    /// Bounds of the empty box.
    const LARGEST: Self;
    /// Bounds of the empty box.
    const SMALLEST: Self;
    /// Its absolute value may be at most this: squares of differences are finite.
    const MAX_COORDINATE: Self;
    /// The smallest positive number with all its digits.
    const SMALLEST_NORMAL: Self;
    /// A number as this type.
    fn of(value: f64) -> Self;
    /// As the widest type.
    fn to_f64(self) -> f64;
    /// a − b.
    fn minus(self, other: Self) -> Self;
    /// a + b.
    fn plus(self, other: Self) -> Self;
    /// a · b.
    fn times(self, other: Self) -> Self;
    /// Order of all numbers.
    fn compare(self, other: Self) -> std::cmp::Ordering;

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
    ($t:ty, $largest:expr) => {
        impl Scalar for $t {
            const LARGEST: Self = <$t>::MAX;
            const SMALLEST: Self = <$t>::MIN;
            const MAX_COORDINATE: Self = $largest;
            const SMALLEST_NORMAL: Self = <$t>::MIN_POSITIVE;

            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $t
            }

            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }

            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self - other
            }

            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self + other
            }

            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self * other
            }

            #[inline(always)]
            fn compare(self, other: Self) -> std::cmp::Ordering {
                self.total_cmp(&other)
            }
        }
    };
}

scalar!(f32, 1e18);
scalar!(f64, 1e150);
