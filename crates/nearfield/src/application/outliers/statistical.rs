//! Statistical outliers: the mean distance to the nearest points, against its mean and deviation over all points (Rusu2008).

use rayon::prelude::*;

use super::{BLOCK, TASK, indices};
use crate::application::Watch;
use crate::application::finite_points::FinitePoints;
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::query::NearestFew;
use crate::structure::{AabbTreeN, AabbTreeNSettings};
use crate::{Error, Result};

/// Which nearest points count, and who stays at the limit. The deviation is that of a sample, with n − 1, in both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum OutlierRule {
    /// As PCL's `StatisticalOutlierRemoval`: the `k` nearest beside the point itself. A point stays where its mean distance is at most
    /// the limit.
    #[default]
    Pcl,
    /// As Open3D's `remove_statistical_outlier`: the `k` nearest with the point itself, at distance 0, as one of them. A point stays
    /// where its mean distance is above 0 and below the limit. So points that coincide with k − 1 others are removed; they count for
    /// the number of points that mean and deviation are divided by, and not for their sums.
    Open3d,
}

/// What statistical outliers are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatisticalOutlierSettings {
    /// Nearest points whose mean distance is taken, at least 1; all others where there are fewer.
    pub k: u32,
    /// Standard deviations above the mean at which outliers begin.
    pub ratio: f64,
    /// Whose definition.
    pub rule: OutlierRule,
}

impl StatisticalOutlierSettings {
    /// By the rule of PCL.
    pub fn new(k: u32, ratio: f64) -> Self {
        Self { k, ratio, rule: OutlierRule::Pcl }
    }

    /// By another rule.
    pub fn rule(mut self, rule: OutlierRule) -> Self {
        self.rule = rule;
        self
    }

    pub(super) fn validate(&self) -> Result<()> {
        if self.k == 0 {
            return Err(Error::InvalidSetting { setting: "k", found: "0".into(), expected: "1 nearest point or more" });
        }
        if self.ratio.is_finite() {
            return Ok(());
        }
        let (found, expected) = (self.ratio.to_string(), "a finite number of standard deviations");
        Err(Error::InvalidSetting { setting: "ratio", found, expected })
    }

    /// How many are searched for, the point itself among them.
    pub(super) fn searched(&self) -> u32 {
        match self.rule {
            OutlierRule::Pcl => self.k.saturating_add(1),
            OutlierRule::Open3d => self.k,
        }
    }

    /// Those found that the sum of distances is not divided by.
    pub(super) fn uncounted(&self) -> u32 {
        match self.rule {
            OutlierRule::Pcl => 1,
            OutlierRule::Open3d => 0,
        }
    }
}

/// Who stays, and by what measure.
#[derive(Debug, Clone, PartialEq)]
pub struct StatisticalOutliers<T> {
    /// `[n]` whether the point stays.
    pub kept: Vec<bool>,
    /// `[n]` mean distance to the nearest points, 0 where there is no other point, NaN of invalid points.
    pub mean_distances: Vec<T>,
    /// Mean of these distances; 0 without points.
    pub mean: f64,
    /// Their standard deviation; 0 of fewer than two points.
    pub deviation: f64,
    /// Where outliers begin.
    pub limit: f64,
    /// Indices of the points with a NaN or infinite coordinate, ascending.
    pub invalid: Vec<u32>,
}

impl<T> StatisticalOutliers<T> {
    /// Indices of the points that stay, ascending.
    pub fn kept_indices(&self) -> Vec<u32> {
        indices(&self.kept)
    }
}

/// Points whose mean distance to their nearest is unusually large.
///
/// ```
/// use nearfield::application::{StatisticalOutlierSettings, Watch, statistical_outliers};
///
/// let mut points: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10), 0.0]).collect();
/// points.push([50.0, 0.0, 0.0]);
/// let found = statistical_outliers(&points, &StatisticalOutlierSettings::new(8, 2.0), &mut Watch::none())?;
/// assert_eq!(found.kept.iter().position(|kept| !kept), Some(100));
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// Distances are those of the coordinates' type; each point's are summed in f64, nearest first, and mean and deviation are sums in f64 in
/// the caller's order: the same bits for any number of threads.
///
/// # Errors
/// `InvalidSetting`; `CoordinateBeyond`, `TooMany` for the points; `Interrupted`.
pub fn statistical_outliers<T: Scalar>(
    points: &[Vector<T>],
    settings: &StatisticalOutlierSettings,
    watch: &mut Watch<'_>,
) -> Result<StatisticalOutliers<T>> {
    settings.validate()?;
    let finite = FinitePoints::of(points)?;
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    let (ordered, n) = (tree.ordered_points(), tree.len());
    let k = (settings.searched() as usize).min(n);
    let mut distances = vec![T::ZERO; n];
    for first in (0..n).step_by(BLOCK) {
        watch.report("nearest", first as u64, n as u64)?;
        let places = first..n.min(first + BLOCK);
        let mean = |few: &mut NearestFew<T>, place: usize| {
            tree.nearest_few(&ordered.position(place), T::of(f64::INFINITY), few);
            let sum: f64 = few.found().iter().map(|hit| hit.0.to_f64().sqrt()).sum();
            let counted = few.found().len().saturating_sub(settings.uncounted() as usize);
            T::of(sum / counted.max(1) as f64)
        };
        let means: Vec<T> =
            places.clone().into_par_iter().with_min_len(TASK).map_init(|| NearestFew::new(k), mean).collect();
        places.zip(means).for_each(|(place, mean)| distances[ordered.ids()[place] as usize] = mean);
    }
    watch.report("nearest", n as u64, n as u64)?;
    Ok(decide(&finite, distances, settings))
}

/// Who stays, by the mean distances of the finite points.
pub(super) fn decide<T: Scalar, P: crate::application::finite_points::Place>(
    finite: &FinitePoints<'_, P>,
    distances: Vec<T>,
    settings: &StatisticalOutlierSettings,
) -> StatisticalOutliers<T> {
    let n = distances.len();
    let counts = |d: f64| settings.rule == OutlierRule::Pcl || d > 0.0;
    let each = || distances.iter().map(|d| d.to_f64()).filter(|&d| counts(d));
    let mean = each().sum::<f64>() / n.max(1) as f64;
    let deviation = (each().map(|d| (d - mean).powi(2)).sum::<f64>() / (n.max(2) - 1) as f64).sqrt();
    let limit = mean + settings.ratio * deviation;
    let stays = |distance: &T| {
        let distance = distance.to_f64();
        match settings.rule {
            OutlierRule::Pcl => distance <= limit,
            OutlierRule::Open3d => distance > 0.0 && distance < limit,
        }
    };
    StatisticalOutliers {
        kept: finite.spread(distances.iter().map(stays).collect(), false),
        mean_distances: finite.spread(distances, T::of(f64::NAN)),
        mean,
        deviation,
        limit,
        invalid: finite.invalid(),
    }
}
