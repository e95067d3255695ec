//! What locally optimal projection can be asked for.

use super::WlopVariant;
use crate::application::Length;
use crate::{Error, Result};

/// The formula, the radius and the end of the iterations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WlopSettings {
    /// The formula.
    pub variant: WlopVariant,
    /// The paper's h under [`WlopVariant::Paper`] and [`WlopVariant::Best`], R under the others. Percent are of the diagonal of the
    /// points, spacings those of the samples as they begin. `None`: 12 spacings of the samples, 6 for the authors' R, and 8 of CGAL's
    /// average spacing of the points for CGAL's.
    pub radius: Option<Length>,
    /// Part of the repulsion that is taken, 0 to 0.5.
    pub mu: f64,
    /// Most iterations.
    pub iterations: u32,
    /// The samples rest once they move less than this on average, in spacings of the samples as they began; 0 for never.
    pub tolerance: f64,
    /// Whether points in crowded places count less (v). CGAL calls it `require_uniform_sampling` and leaves it out by default.
    pub weigh_inputs: bool,
    /// Samples around which the points, but one where the sample stands, are less dense than this part of the median of all samples have
    /// [`PointFlags::NO_ATTRACTION`](crate::application::PointFlags::NO_ATTRACTION): they stand on outliers.
    pub least_attraction: f64,
}

impl Default for WlopSettings {
    fn default() -> Self {
        Self::new(WlopVariant::default())
    }
}

impl WlopSettings {
    /// The settings of the variant's authors, but for the limit of iterations: 35 as CGAL has, 100 for the others.
    pub fn new(variant: WlopVariant) -> Self {
        Self {
            variant,
            radius: None,
            mu: if variant == WlopVariant::Authors { 0.5 } else { 0.45 },
            iterations: if variant == WlopVariant::Cgal { 35 } else { 100 },
            tolerance: 1e-3,
            weigh_inputs: variant != WlopVariant::Cgal,
            least_attraction: 0.05,
        }
    }

    /// With this radius.
    pub fn radius(mut self, radius: Length) -> Self {
        self.radius = Some(radius);
        self
    }

    /// With at most so many iterations.
    pub fn iterations(mut self, iterations: u32) -> Self {
        self.iterations = iterations;
        self
    }

    /// Whether the settings can be used.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn validate(&self) -> Result<()> {
        let wrong =
            |setting, found: f64, expected| Err(Error::InvalidSetting { setting, found: found.to_string(), expected });
        if !(0.0..=0.5).contains(&self.mu) {
            return wrong("mu", self.mu, "0 to 0.5");
        }
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            return wrong("tolerance", self.tolerance, "0 or a finite number of spacings above it");
        }
        if !(0.0..=1.0).contains(&self.least_attraction) {
            return wrong("least attraction", self.least_attraction, "a part of the median, 0 to 1");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_refused() {
        let settings = WlopSettings::default();
        assert!(settings.validate().is_ok());
        let wrong = [
            WlopSettings { mu: 0.51, ..settings },
            WlopSettings { mu: f64::NAN, ..settings },
            WlopSettings { tolerance: -1.0, ..settings },
            WlopSettings { tolerance: f64::INFINITY, ..settings },
            WlopSettings { least_attraction: 1.5, ..settings },
        ];
        for settings in wrong {
            assert!(matches!(settings.validate(), Err(Error::InvalidSetting { .. })), "{settings:?}");
        }
    }
}
