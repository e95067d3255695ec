//! Smoothing kernels of fluids: how much a neighbour counts by its distance. Twin of smoothing.wesl.

use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use crate::application::particles::Dimensions;
use crate::{Error, Result};

/// How much a neighbour counts by its distance, as a density: the integral over space is 1. All vanish at the support.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SmoothingKernel {
    /// The cubic spline (Monaghan1992).
    #[default]
    CubicSpline,
    /// Wendland's C² function of the fourth order (Wendland1995).
    Wendland,
    /// (support² − r²)³ for values (Mueller2003).
    Poly6,
    /// (support − r)³, whose gradient does not vanish at the centre (Desbrun1996).
    Spiky,
}

impl SmoothingKernel {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::CubicSpline, Self::Wendland, Self::Poly6, Self::Spiky];

    /// Its name: "cubic-spline", "wendland", "poly6", "spiky".
    pub fn name(self) -> &'static str {
        match self {
            Self::CubicSpline => "cubic-spline",
            Self::Wendland => "wendland",
            Self::Poly6 => "poly6",
            Self::Spiky => "spiky",
        }
    }

    /// # Errors
    /// `InvalidSetting` for kernels that are not smooth enough, or are too flat in the middle, for forces by their gradients.
    pub(in crate::application::particles) fn validate_for_gradients(self) -> Result<()> {
        if matches!(self, Self::CubicSpline | Self::Wendland) {
            return Ok(());
        }
        let expected = "cubic-spline or wendland";
        Err(Error::InvalidSetting { setting: "smoothing of the fluid", found: self.name().to_owned(), expected })
    }

    /// The factor that makes the integral 1.
    pub fn norm(self, dimensions: Dimensions, support: f64) -> f64 {
        let (h2, h3) = (support.powi(2), support.powi(3));
        match (self, dimensions) {
            (Self::CubicSpline, Dimensions::Two) => 40.0 / (7.0 * PI * h2),
            (Self::CubicSpline, Dimensions::Three) => 8.0 / (PI * h3),
            (Self::Wendland, Dimensions::Two) => 7.0 / (PI * h2),
            (Self::Wendland, Dimensions::Three) => 21.0 / (2.0 * PI * h3),
            (Self::Poly6, Dimensions::Two) => 4.0 / (PI * h2),
            (Self::Poly6, Dimensions::Three) => 315.0 / (64.0 * PI * h3),
            (Self::Spiky, Dimensions::Two) => 10.0 / (PI * h2),
            (Self::Spiky, Dimensions::Three) => 15.0 / (PI * h3),
        }
    }

    /// The kernel at a distance of `q` supports, before the factor.
    #[inline]
    pub fn shape(self, q: f64) -> f64 {
        let rest = (1.0 - q).max(0.0);
        match self {
            Self::CubicSpline if q <= 0.5 => 6.0 * q * q * (q - 1.0) + 1.0,
            Self::CubicSpline => 2.0 * rest.powi(3),
            Self::Wendland => rest.powi(4) * (4.0 * q + 1.0),
            Self::Poly6 => (1.0 - q * q).max(0.0).powi(3),
            Self::Spiky => rest.powi(3),
        }
    }

    /// The derivative of [`SmoothingKernel::shape`].
    #[inline]
    pub fn slope(self, q: f64) -> f64 {
        let rest = (1.0 - q).max(0.0);
        match self {
            Self::CubicSpline if q <= 0.5 => 6.0 * q * (3.0 * q - 2.0),
            Self::CubicSpline => -6.0 * rest * rest,
            Self::Wendland => -20.0 * q * rest.powi(3),
            Self::Poly6 => -6.0 * q * (1.0 - q * q).max(0.0).powi(2),
            Self::Spiky => -3.0 * rest * rest,
        }
    }
}

impl fmt::Display for SmoothingKernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for SmoothingKernel {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|kernel| kernel.name() == name);
        known.ok_or_else(|| Error::InvalidSetting {
            setting: "smoothing kernel",
            found: name.to_owned(),
            expected: "cubic-spline, wendland, poly6 or spiky",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_integrate_to_one() {
        const STEPS: usize = 20_000;
        for kernel in SmoothingKernel::ALL {
            for (dimensions, support) in
                [(Dimensions::Two, 0.3_f64), (Dimensions::Three, 0.3), (Dimensions::Three, 7.0)]
            {
                let width = 1.0 / STEPS as f64;
                let shell = |q: f64| match dimensions {
                    Dimensions::Two => 2.0 * PI * q * support.powi(2),
                    Dimensions::Three => 4.0 * PI * q * q * support.powi(3),
                };
                // By midpoints: the error is below the square of the width.
                let at = |i| (i as f64 + 0.5) * width;
                let integral: f64 = (0..STEPS).map(|i| kernel.shape(at(i)) * shell(at(i)) * width).sum();
                let one = integral * kernel.norm(dimensions, support);
                assert!((one - 1.0).abs() < 1e-6, "{} in {dimensions:?}: {one}", kernel.name());
            }
        }
    }

    #[test]
    fn slopes_are_differences_of_shapes() {
        const STEP: f64 = 1e-6;
        for kernel in SmoothingKernel::ALL {
            for i in 1..100 {
                let q = f64::from(i) / 100.0;
                let difference = (kernel.shape(q + STEP) - kernel.shape(q - STEP)) / (2.0 * STEP);
                assert!((difference - kernel.slope(q)).abs() < 1e-5, "{} at {q}", kernel.name());
            }
            assert_eq!((kernel.shape(1.0), kernel.slope(1.0), kernel.shape(1.5)), (0.0, 0.0, 0.0));
        }
    }
}
