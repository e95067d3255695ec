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
    /// e to this power is still a number with all its digits.
    const LOWEST_POWER: Self;
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
    /// e to each of these powers, which are to be 0 or below and are taken to be no lower than [`Self::LOWEST_POWER`]: within two
    /// roundings, and the same bits on every machine. Several at once are some times faster than one by one.
    fn exp_each(powers: &mut [Self]);
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
    ($t:ident, $largest:expr, $lowest:expr, $exp:path, $exp_one:path, $atan2:path) => {
        impl Scalar for $t {
            const LARGEST: Self = $t::MAX;
            const SMALLEST: Self = $t::MIN;
            const MAX_COORDINATE: Self = $largest;
            const SMALLEST_NORMAL: Self = $t::MIN_POSITIVE;
            const EPSILON: Self = $t::EPSILON;
            const LOWEST_POWER: Self = $lowest;
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
            fn exp_each(powers: &mut [Self]) {
                // Straight code, which compilers do for some numbers at once.
                powers.iter_mut().for_each(|x| *x = $exp_one(if *x < $lowest { $lowest } else { *x }));
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

scalar!(f32, 1e18, -87.0, libm::expf, exp_f32, libm::atan2f);
scalar!(f64, 1e150, -708.0, libm::exp, exp_f64, libm::atan2);

// e^x = 2^k · e^r with the whole number k nearest to x / ln 2, and e^r by its power series for |r| ≤ ln 2 / 2. A number of 1.5 times
// the highest place of the digits, added to k, puts k into the lowest bits, from where it is added to the exponent.

#[inline(always)]
fn exp_f32(x: f32) -> f32 {
    const WHOLE: f32 = 12_582_912.0;
    // ln 2 in two parts, the first of so few digits that k times it is exact.
    const HIGH: f32 = 0.693_359_4;
    const LOW: f32 = -2.121_944_4e-4;
    let shifted = x * std::f32::consts::LOG2_E + WHOLE;
    let k = shifted - WHOLE;
    let r = (x - k * HIGH) - k * LOW;
    let mut sum = 1.0 / 5040.0;
    for divisor in [720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0] {
        sum = sum * r + 1.0 / divisor;
    }
    f32::from_bits(sum.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[inline(always)]
fn exp_f64(x: f64) -> f64 {
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    const HIGH: f64 = 0.693_147_180_369_123_8;
    const LOW: f64 = 1.908_214_929_270_587_7e-10;
    const DIVISORS: [f64; 13] =
        [479_001_600.0, 39_916_800.0, 3_628_800.0, 362_880.0, 40_320.0, 5040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0];
    let shifted = x * std::f64::consts::LOG2_E + WHOLE;
    let k = shifted - WHOLE;
    let r = (x - k * HIGH) - k * LOW;
    let mut sum = 1.0 / 6_227_020_800.0;
    for divisor in DIVISORS {
        sum = sum * r + 1.0 / divisor;
    }
    f64::from_bits(sum.to_bits().wrapping_add(shifted.to_bits() << 52))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn powers_at_once<T: Scalar>(lowest: f64) {
        let n = 20_000;
        let powers: Vec<T> = (0..=n).map(|i| T::of(lowest * f64::from(i) / f64::from(n))).collect();
        let mut found = powers.clone();
        T::exp_each(&mut found);
        for (x, y) in powers.iter().zip(&found) {
            let exact = libm::exp(x.to_f64());
            assert!((y.to_f64() - exact).abs() <= 2.0 * T::EPSILON.to_f64() * exact, "{x:?}: {y:?}, {exact}");
        }
        assert!(found[0] == T::ONE);
        let mut beyond = [T::of(-1e30), T::LOWEST_POWER];
        T::exp_each(&mut beyond);
        assert!(beyond[0] == beyond[1] && beyond[0] >= T::SMALLEST_NORMAL);
    }

    #[test]
    fn powers_at_once_are_those_of_the_library() {
        powers_at_once::<f32>(-87.0);
        powers_at_once::<f64>(-708.0);
        powers_at_once::<f64>(-1.0);
    }
}
