//! How much a sample counts by its distance. `weight.wesl` is the twin of this file.
//!
//! The list is that of Ponca, of CGAL, MeshLab, PCL and Open3D: each falls from its largest value at the query to that at the
//! edge of the support. Those that reach 0 there with their derivatives give surfaces without steps.

use crate::geometry::Scalar;
use crate::{Error, Result};

/// Squares of distances below this, as a part of the squared radius, count as this much where a power of them is divided by.
const SMALLEST: f64 = 1e-12;

/// A weight by the distance d from the query as a part x = d / h of the radius h of the support; 0 beyond it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Weight {
    /// 1: every sample counts alike. Steps at the edge.
    Constant,
    /// (1 − x²)².
    Quadratic,
    /// (1 − x²)⁴: three continuous derivatives (Guennebaud2007). The default.
    Quartic,
    /// (1 − xⁿ)ᵐ.
    Power {
        /// n, 1 to 16.
        inner: u32,
        /// m, 1 to 16.
        outer: u32,
    },
    /// (1 − x)⁴ (1 + 4x) (Wendland1995).
    Wendland,
    /// 1 / x²: the surface goes through its samples.
    Singular,
    /// exp(−x² / (1 − x²)): all derivatives are continuous.
    CompactExponential,
    /// exp(−(widths · x)²), which is exp(−d² / g²) with g = h / widths, cut at the radius.
    Gaussian {
        /// Radius of the support in widths of the curve: at 3 the cut is at 1.2e-4 of the largest weight; at 1, as in PCL and
        /// Open3D, at 0.37 of it.
        widths: f64,
    },
}

impl Weight {
    /// The Gaussian whose cut does not show: three widths.
    pub const GAUSSIAN: Self = Self::Gaussian { widths: 3.0 };

    /// Whether the numbers in it can be used.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn validate(&self) -> Result<()> {
        let (found, expected) = match *self {
            Self::Gaussian { widths } if !(widths > 0.0 && widths <= 8.0) => {
                (format!("{widths} widths of a Gaussian"), "more than 0 and at most 8")
            }
            Self::Power { inner, outer } if !((1..=16).contains(&inner) && (1..=16).contains(&outer)) => {
                (format!("(1 − x^{inner})^{outer}"), "exponents from 1 to 16")
            }
            _ => return Ok(()),
        };
        Err(Error::InvalidSetting { setting: "weight", found, expected })
    }

    /// The weight and its first and second derivative with respect to y = x², at a y from 0 to 1.
    ///
    /// With respect to the distance the first is 2 d / h² times that by y.
    #[inline]
    pub fn derivatives<T: Scalar>(&self, y: T) -> [T; 3] {
        let (one, rest) = (T::ONE, (T::ONE - y).larger(T::ZERO));
        match *self {
            Self::Constant => [one, T::ZERO, T::ZERO],
            Self::Quadratic => [rest * rest, T::of(-2.0) * rest, T::of(2.0)],
            Self::Quartic => {
                let square = rest * rest;
                [square * square, T::of(-4.0) * square * rest, T::of(12.0) * square]
            }
            Self::Power { inner, outer } => power(y.larger(T::of(SMALLEST)), inner, outer),
            Self::Wendland => {
                let x = y.sqrt();
                let rest = (one - x).larger(T::ZERO);
                let square = rest * rest;
                let second = T::of(15.0) * square / x.larger(T::of(1e-6));
                [square * square * (one + T::of(4.0) * x), T::of(-10.0) * square * rest, second]
            }
            Self::Singular => {
                let inverse = one / y.larger(T::of(SMALLEST));
                [inverse, -inverse * inverse, T::of(2.0) * inverse * inverse * inverse]
            }
            Self::CompactExponential => {
                // Below this the exponential is 0 in both types.
                if rest <= T::of(1e-3) {
                    return [T::ZERO; 3];
                }
                let (value, inverse) = ((-y / rest).exp(), one / rest);
                let square = inverse * inverse;
                [value, -value * square, value * square * inverse * (inverse - T::of(2.0))]
            }
            Self::Gaussian { widths } => {
                let factor = T::of(widths * widths);
                let value = (-factor * y).exp();
                [value, -factor * value, factor * factor * value]
            }
        }
    }

    /// The weight at a y = x² from 0 to 1.
    #[inline(always)]
    pub fn at<T: Scalar>(&self, y: T) -> T {
        match self {
            Self::Quartic => {
                let rest = T::ONE - y;
                (rest * rest) * (rest * rest)
            }
            _ => self.derivatives(y)[0],
        }
    }

    /// The weight as kernels take it: which one, and its two numbers.
    #[cfg(feature = "gpu")]
    pub(super) fn parameters(&self) -> (u32, [f32; 2]) {
        match *self {
            Self::Constant => (0, [0.0; 2]),
            Self::Quadratic => (1, [0.0; 2]),
            Self::Quartic => (2, [0.0; 2]),
            Self::Power { inner, outer } => (3, [inner as f32, outer as f32]),
            Self::Wendland => (4, [0.0; 2]),
            Self::Singular => (5, [0.0; 2]),
            Self::CompactExponential => (6, [0.0; 2]),
            Self::Gaussian { widths } => (7, [(widths * widths) as f32, 0.0]),
        }
    }
}

/// (1 − xⁿ)ᵐ and its derivatives by y = x².
fn power<T: Scalar>(y: T, n: u32, m: u32) -> [T; 3] {
    let to_the = |base: T, exponent: u32| (0..exponent).fold(T::ONE, |product, _| product * base);
    let (half, outer) = (T::of(f64::from(n) / 2.0), T::of(f64::from(m)));
    let a = to_the(y.sqrt(), n);
    let first = half * a / y;
    let second = half * (half - T::ONE) * a / (y * y);
    let rest = (T::ONE - a).larger(T::ZERO);
    let below = |steps: u32| if m >= steps { to_the(rest, m - steps) } else { T::ZERO };
    let (b1, b2) = (below(1), below(2));
    [to_the(rest, m), -outer * b1 * first, outer * (outer - T::ONE) * b2 * first * first - outer * b1 * second]
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) const ALL: [Weight; 10] = [
        Weight::Constant,
        Weight::Quadratic,
        Weight::Quartic,
        Weight::Power { inner: 3, outer: 2 },
        Weight::Power { inner: 2, outer: 4 },
        Weight::Wendland,
        Weight::Singular,
        Weight::CompactExponential,
        Weight::Gaussian { widths: 1.0 },
        Weight::GAUSSIAN,
    ];

    #[test]
    fn derivatives_are_those_of_the_values() {
        let step = 1e-5;
        for weight in ALL {
            weight.validate().unwrap();
            for y in [0.05, 0.25, 0.5, 0.81, 0.97] {
                let [value, first, second] = weight.derivatives(y);
                let (low, high) = (weight.derivatives(y - step), weight.derivatives(y + step));
                let slope = |of: usize| (high[of] - low[of]) / (2.0 * step);
                assert_eq!(weight.at(y), value);
                assert!((slope(0) - first).abs() < 1e-5 * (1.0 + first.abs()), "{weight:?} at {y}: {first}");
                assert!((slope(1) - second).abs() < 1e-4 * (1.0 + second.abs()), "{weight:?} at {y}: {second}");
                let rough = weight.derivatives(y as f32)[0];
                assert!((f64::from(rough) - value).abs() < 1e-5 * value.max(0.01), "{weight:?} at {y}: {rough}");
            }
        }
    }

    #[test]
    fn weights_have_their_values_at_both_ends() {
        for weight in ALL.iter().filter(|&&weight| weight != Weight::Singular) {
            assert!((weight.at(0.0f64) - 1.0).abs() < 1e-9, "{weight:?}");
            let edge = match weight {
                Weight::Constant => 1.0,
                Weight::Gaussian { widths } => libm::exp(-widths * widths),
                _ => 0.0,
            };
            assert!((weight.at(1.0f64) - edge).abs() < 1e-12, "{weight:?}");
        }
        // The power with 2 and 4 is the quartic one.
        assert!((Weight::Power { inner: 2, outer: 4 }.at(0.3f64) - Weight::Quartic.at(0.3)).abs() < 1e-15);
    }

    #[test]
    fn wrong_numbers_are_errors() {
        for weight in [
            Weight::Gaussian { widths: 0.0 },
            Weight::Gaussian { widths: f64::NAN },
            Weight::Power { inner: 0, outer: 1 },
            Weight::Power { inner: 2, outer: 17 },
        ] {
            assert!(matches!(weight.validate(), Err(Error::InvalidSetting { .. })), "{weight:?}");
        }
    }
}
