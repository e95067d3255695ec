//! Poisson-disk samples of an exact number, by eliminating the others (Yuksel2015).

use rayon::prelude::*;

use super::heap::Heap;
use crate::application::Watch;
use crate::application::finite_points::FinitePoints;
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::query::NearestFew;
use crate::structure::{AabbTreeN, AabbTreeNSettings};
use crate::{Error, Result};

/// Of the paper: how the weights limit the smallest distance, r_min = r_max (1 − (m / n)^γ) β.
const GAMMA: f64 = 1.5;
const BETA: f64 = 0.65;
/// Weights are whole numbers of 2⁻³²: sums of them and differences are exact, whatever their order, and equal weights are equal. No point has
/// more than 2³² neighbours, each of at most 1.
const UNITS: f64 = (1u64 << 32) as f64;
/// Nearest points that a point shares the area around it with where that is to be estimated.
const SHARED_BY: usize = 16;
/// Points of a task, points between two reports, and neighbours between two while points are eliminated one by one.
const TASK: usize = 128;
const BLOCK: usize = 1 << 12;
const VISITED: u64 = 1 << 22;

/// What the points fill; it says how far apart so many samples can be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Extent {
    /// A surface of unknown area, which is estimated from the 16 nearest of each point: Σ π d₁₆² / 16.
    Surface,
    /// A volume of unknown size, estimated in the same way.
    Solid,
    /// A surface of this area.
    Area(f64),
    /// A volume of this size.
    Volume(f64),
}

/// How many samples of what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoissonDiskSettings {
    /// How many points stay; at most as many as there are.
    pub count: usize,
    /// What the points fill.
    pub extent: Extent,
}

impl PoissonDiskSettings {
    /// So many points of a surface.
    pub fn new(count: usize) -> Self {
        Self { count, extent: Extent::Surface }
    }
}

/// Points that stay.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoissonDisk {
    /// `[count]` indices, ascending.
    pub indices: Vec<u32>,
    /// The radius of so many disks or balls in the densest packing: samples cannot all be farther apart than twice that. 0 where all
    /// points stay, or none.
    pub radius: f64,
    /// Indices of the points with a NaN or infinite coordinate, ascending.
    pub invalid: Vec<u32>,
}

/// So many points, far from each other: those with the heaviest neighbourhood are eliminated one by one until the number is left.
///
/// ```
/// use nearfield::application::{Extent, PoissonDiskSettings, Watch, poisson_disk};
///
/// let points: Vec<[f64; 3]> = (0..10_000).map(|i| [f64::from(i % 100) * 0.01, f64::from(i / 100) * 0.01, 0.0]).collect();
/// let settings = PoissonDiskSettings { count: 1000, extent: Extent::Area(1.0) };
/// let samples = poisson_disk(&points, &settings, &mut Watch::none())?;
/// assert_eq!(samples.indices.len(), 1000);
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// Weights are those of the paper, (1 − d / 2r)⁸ with distances from below limited; a fifth of the points or less gives the evenest
/// samples. They are rounded to 2⁻³². Of points that are equally heavy the one with the largest index goes first.
///
/// Cost: two searches with the radius 2r a point, in which the number of neighbours grows with n / count; all together with n² / count. No
/// neighbour is kept in memory. Where n / count is above about 50, make fewer points first, by a random subset or a voxel grid: samples are
/// hardly less even for it.
///
/// # Errors
/// `InvalidSetting` for more samples than there are finite points, and for areas or volumes that are not above 0, or cannot be
/// estimated because all points coincide; `CoordinateBeyond`, `TooMany` for the points; `Interrupted`.
pub fn poisson_disk<T: Scalar>(
    points: &[Vector<T>],
    settings: &PoissonDiskSettings,
    watch: &mut Watch<'_>,
) -> Result<PoissonDisk> {
    let finite = FinitePoints::of(points)?;
    let (n, count) = (finite.points().len(), settings.count);
    if count > n {
        let found = format!("{count} of {n} points");
        return Err(Error::InvalidSetting { setting: "number of samples", found, expected: "at most all points" });
    }
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    let all_or_none = count == 0 || count == n;
    let radius = if all_or_none { 0.0 } else { settings.extent.radius(count, &tree)? };
    let done =
        |kept: Vec<u32>| PoissonDisk { indices: finite.renamed(kept, u32::MAX), radius, invalid: finite.invalid() };
    if all_or_none {
        return Ok(done((0..count as u32).collect()));
    }
    let weight = Weight::of(radius, count as f64 / n as f64);
    let reach = T::of(weight.reach);
    let (ordered, mut weights) = (tree.ordered_points(), vec![0u64; n]);
    for first in (0..n).step_by(BLOCK) {
        watch.report("weights", first as u64, n as u64)?;
        let places = first..n.min(first + BLOCK);
        let sum = |place: usize| {
            let (id, mut sum) = (ordered.ids()[place], 0u64);
            tree.for_each_within(&ordered.position(place), reach, |other, dist2| {
                sum += if other == id { 0 } else { weight.at(dist2.to_f64()) };
            });
            sum
        };
        let sums: Vec<u64> = places.clone().into_par_iter().with_min_len(TASK).map(sum).collect();
        places.zip(sums).for_each(|(place, sum)| weights[ordered.ids()[place] as usize] = sum);
    }
    let (mut heap, mut visited) = (Heap::of(weights), VISITED);
    while heap.len() > count {
        if visited >= VISITED {
            visited = 0;
            watch.report("elimination", (n - heap.len()) as u64, (n - count) as u64)?;
        }
        let Some(heaviest) = heap.pop() else { break };
        tree.for_each_within(&finite.points()[heaviest as usize], reach, |other, dist2| {
            visited += 1;
            if heap.holds(other) {
                heap.lighten(other, weight.at(dist2.to_f64()));
            }
        });
    }
    watch.report("elimination", (n - count) as u64, (n - count) as u64)?;
    Ok(done((0..n as u32).filter(|&id| heap.holds(id)).collect()))
}

/// What a neighbour at some distance weighs.
struct Weight {
    /// 2 r_max: farther ones weigh nothing.
    reach: f64,
    /// 2 r_min: nearer ones weigh no more.
    least: f64,
}

impl Weight {
    /// For this share of the points.
    fn of(radius: f64, share: f64) -> Self {
        let reach = 2.0 * radius;
        Self { reach, least: reach * (1.0 - share.powf(GAMMA)) * BETA }
    }

    /// In units of 2⁻³².
    fn at(&self, dist2: f64) -> u64 {
        let weight = (1.0 - dist2.sqrt().max(self.least) / self.reach).max(0.0);
        (weight.powi(8) * UNITS).round() as u64
    }
}

impl Extent {
    /// The radius of so many disks or balls in the densest packing.
    ///
    /// # Errors
    /// `InvalidSetting`.
    fn radius<T: Scalar>(&self, count: usize, tree: &AabbTreeN<T, 3>) -> Result<f64> {
        use std::f64::consts::PI;
        let of_area = |area: f64| (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt();
        let of_volume = |volume: f64| (volume / (4.0 * 2f64.sqrt() * count as f64)).cbrt();
        let (size, radius) = match *self {
            Self::Area(area) => (area, of_area(area)),
            Self::Volume(volume) => (volume, of_volume(volume)),
            Self::Surface => {
                let area = shares(tree, |distance| PI * distance * distance);
                (area, of_area(area))
            }
            Self::Solid => {
                let volume = shares(tree, |distance| 4.0 / 3.0 * PI * distance.powi(3));
                (volume, of_volume(volume))
            }
        };
        let has_square = crate::application::finite_points::positive::<T>("radius", 2.0 * radius).is_ok();
        if size > 0.0 && radius.is_finite() && has_square {
            return Ok(radius);
        }
        let found = format!("{size} of {} points", tree.len());
        let expected = "an area or volume above 0; give it where it cannot be estimated from the points";
        Err(Error::InvalidSetting { setting: "extent of the points", found, expected })
    }
}

/// The sum over all points of what a ball to the k-th nearest holds, by k.
fn shares<T: Scalar>(tree: &AabbTreeN<T, 3>, of_ball: impl Fn(f64) -> f64 + Sync) -> f64 {
    let (points, k) = (tree.ordered_points(), SHARED_BY.min(tree.len().saturating_sub(1)));
    let share = |few: &mut NearestFew<T>, place: usize| {
        tree.nearest_few(&points.position(place), T::of(f64::INFINITY), few);
        few.found().last().map_or(0.0, |farthest| of_ball(farthest.0.to_f64().sqrt()) / k.max(1) as f64)
    };
    let shares: Vec<f64> =
        (0..tree.len()).into_par_iter().with_min_len(TASK).map_init(|| NearestFew::new(k + 1), share).collect();
    shares.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_fall_with_the_distance_between_their_limits() {
        let weight = Weight::of(0.5, 0.25);
        // (1 − 0.125) · 0.65
        assert!((weight.least - 0.56875).abs() < 1e-12);
        assert_eq!(weight.at(0.0), weight.at(weight.least * weight.least));
        assert_eq!(weight.at(0.64), (0.2f64.powi(8) * UNITS).round() as u64);
        assert_eq!((weight.at(1.0), weight.at(4.0)), (0, 0));
    }

    #[test]
    fn the_area_of_a_square_is_found() {
        let at = |i: u32| f64::from(i) / 64.0;
        let points: Vec<[f64; 3]> = (0..4096).map(|i| [at(i % 64), at(i / 64), 3.0]).collect();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
        let found = Extent::Surface.radius(100, &tree).unwrap();
        let expected = Extent::Area(1.0).radius(100, &tree).unwrap();
        assert!((found / expected - 1.0).abs() < 0.1, "{found}, {expected}");
        // The hexagonal packing of 100 disks in a unit square.
        assert!((expected - 0.053_728_496_591).abs() < 1e-9, "{expected}");
    }
}
