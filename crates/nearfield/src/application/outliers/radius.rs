//! Radius outliers: points with few others near them.

use rayon::prelude::*;

use super::{BLOCK, TASK, indices};
use crate::Result;
use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, Place, positive};
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
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
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    let (ordered, n) = (tree.ordered_points(), tree.len());
    let mut neighbors = vec![0; n];
    for first in (0..n).step_by(BLOCK) {
        watch.report("neighbours", first as u64, n as u64)?;
        let places = first..n.min(first + BLOCK);
        let others = |place: usize| {
            let mut within = 0u32;
            tree.for_each_within(&ordered.position(place), radius, |_, _| within += 1);
            // The point itself is one of them.
            within - 1
        };
        let found: Vec<u32> = places.clone().into_par_iter().with_min_len(TASK).map(others).collect();
        places.zip(found).for_each(|(place, others)| neighbors[ordered.ids()[place] as usize] = others);
    }
    watch.report("neighbours", n as u64, n as u64)?;
    Ok(decide(&finite, neighbors, settings))
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
