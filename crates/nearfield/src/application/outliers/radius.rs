//! Radius outliers: points with few others near them.

use super::indices;
use crate::Result;
use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, Place, positive};
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::query::FixedRadiusN;
use crate::structure::{AabbTreeN, AabbTreeNSettings};

/// What radius outliers are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadiusOutlierSettings {
    /// How near neighbours are, in the unit of the points, above 0; a point at exactly this distance is near.
    pub radius: f64,
    /// Fewest neighbours of a point that stays, not counting itself.
    pub min_neighbors: u32,
}

impl RadiusOutlierSettings {
    /// Points with fewer than `min_neighbors` others within `radius` are outliers.
    pub fn new(radius: f64, min_neighbors: u32) -> Self {
        Self { radius, min_neighbors }
    }
}

/// Who stays, and by what measure.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RadiusOutliers {
    /// `[n]` whether the point stays.
    pub kept: Vec<bool>,
    /// `[n]` other points within the radius; 0 of invalid points.
    pub neighbors: Vec<u32>,
    /// Indices of the points with a NaN or infinite coordinate, ascending.
    pub invalid: Vec<u32>,
}

impl RadiusOutliers {
    /// Indices of the points that stay, ascending.
    pub fn kept_indices(&self) -> Vec<u32> {
        indices(&self.kept)
    }
}

/// Points with too few others within a radius, as PCL's `RadiusOutlierRemoval`.
///
/// Open3D's `remove_radius_outlier` keeps the same points, except that a neighbour at exactly the radius is outside there: it asks for
/// more than `nb_points` within the radius and counts the point itself.
///
/// ```
/// use nearfield::application::{RadiusOutlierSettings, Watch, radius_outliers};
///
/// let points = [0.0, 0.5, 1.0, 9.0].map(|x| [x, 0.0, 0.0]);
/// let found = radius_outliers(&points, &RadiusOutlierSettings::new(0.5, 2), &mut Watch::none())?;
/// assert_eq!((found.neighbors, found.kept), (vec![1, 2, 1, 0], vec![false, true, false, false]));
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// # Errors
/// `InvalidSetting`; `CoordinateBeyond`, `TooMany` for the points; `Interrupted`.
pub fn radius_outliers<T: Scalar>(
    points: &[Vector<T>],
    settings: &RadiusOutlierSettings,
    watch: &mut Watch<'_>,
) -> Result<RadiusOutliers> {
    let radius: T = positive("radius", settings.radius)?;
    let finite = FinitePoints::of(points)?;
    watch.report("neighbours", 0, 2)?;
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    watch.report("neighbours", 1, 2)?;
    let counts = tree.count(&FixedRadiusN::new(radius).exclude_self())?;
    watch.report("neighbours", 2, 2)?;
    Ok(decide(&finite, counts.as_slice().to_vec(), settings))
}

/// Who stays, by the number of others near the finite points.
pub(super) fn decide<P: Place>(
    finite: &FinitePoints<'_, P>,
    neighbors: Vec<u32>,
    settings: &RadiusOutlierSettings,
) -> RadiusOutliers {
    let kept = neighbors.iter().map(|&found| found >= settings.min_neighbors).collect();
    RadiusOutliers {
        kept: finite.spread(kept, false),
        neighbors: finite.spread(neighbors, 0),
        invalid: finite.invalid(),
    }
}
