//! Whether a radius is wide enough for the noise of the points.

use super::WlopVariant;
use crate::Result;
use crate::application::{Length, MlsMethod, MlsProjection, MlsSettings, PointFlags, Support};
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::structure::AabbTreeN;

/// Points whose distances to the surface around them are looked at.
const LOOKED_AT: usize = 1000;
/// Mean neighbours below which a fit follows the noise; as many nearest are then fitted to.
const FEWEST: u32 = 64;
/// Part of the deviation of a normal distribution that half of its absolute values are below.
const MEDIAN: f64 = 0.674_489_75;
/// The width of the attraction is to be at least so many deviations of the noise. Below some three samples leave the surface: on a
/// torus with noise of 0.02, h / 4 = 0.05 left them farther from it than the points are.
const DEVIATIONS: f64 = 5.0;

/// How a radius and the noise of points go together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseCheck {
    /// Estimated standard deviation of the points across the surface.
    pub deviation: f64,
    /// The paper's h / 4.
    pub width: f64,
}

impl NoiseCheck {
    /// Whether the radius is too small: samples may follow the noise and leave the surface.
    pub fn is_too_small(&self) -> bool {
        self.width < DEVIATIONS * self.deviation
    }

    /// The least radius that is not, of the variant that was asked for.
    pub fn least_radius(&self, variant: WlopVariant) -> f64 {
        DEVIATIONS * self.deviation / variant.width(1.0)
    }
}

/// Compares the noise of the points, as some of them tell, with the width of a variant's attraction.
///
/// - `tree`: over the points
/// - `radius`: as the variant takes it
///
/// `None` where no point has enough neighbours to tell.
///
/// # Errors
/// `InvalidSetting` for a radius that cannot be searched.
pub fn noise_check<T: Scalar>(tree: &AabbTreeN<T, 3>, variant: WlopVariant, radius: T) -> Result<Option<NoiseCheck>> {
    let width = variant.width(radius.to_f64());
    let found = estimate_noise(tree, T::of(2.0 * width))?;
    Ok(found.map(|deviation| NoiseCheck { deviation, width }))
}

/// The standard deviation of points across the surface that they suggest: from the median distance of a thousand of them, or of all,
/// to heights of degree 2 fitted within `radius` of each, which bends do not add to, or to the 64 nearest where that holds fewer. Noise
/// wider than what is fitted to is underestimated. `None` where no point has enough neighbours.
///
/// # Errors
/// `InvalidSetting` for a radius that cannot be searched.
pub fn estimate_noise<T: Scalar>(tree: &AabbTreeN<T, 3>, radius: T) -> Result<Option<f64>> {
    let points = tree.ordered_points();
    if points.is_empty() {
        return Ok(None);
    }
    let looked_at = points.len().min(LOOKED_AT);
    let place = |i: usize| (i as u64 * points.len() as u64 / looked_at as u64) as usize;
    let queries: Vec<Vector<T>> = (0..looked_at).map(|i| points.position(place(i))).collect();
    // One step, whatever its length.
    let any = Length::Absolute(f64::from(f32::MIN_POSITIVE));
    let settings = MlsSettings { most_steps: 1, accuracy: any, ..MlsSettings::new(MlsMethod::PSS) };
    let mut fitted = MlsProjection::new(tree, None, &queries, &Support::Radius(radius), &settings)?;
    if fitted.iterate()?.mean_neighbors < f64::from(FEWEST) {
        fitted = MlsProjection::new(tree, None, &queries, &Support::Nearest(FEWEST), &settings)?;
        fitted.iterate()?;
    }
    let failed = |flags: PointFlags| flags.0 & (PointFlags::FEW_NEIGHBORS.0 | PointFlags::DEGENERATE.0) != 0;
    let told = queries.iter().zip(fitted.positions()).zip(fitted.flags()).filter(|(_, flags)| !failed(**flags));
    let mut distances: Vec<f64> =
        told.map(|((from, to), _)| vector::norm(vector::subtract(*to, *from)).to_f64()).collect();
    if distances.is_empty() {
        return Ok(None);
    }
    let middle = distances.len() / 2;
    let median = *distances.select_nth_unstable_by(middle, f64::total_cmp).1;
    Ok(Some(median / MEDIAN))
}
