//! Where the samples begin, and how far they look.

use std::borrow::Cow;
use std::collections::HashSet;

use rayon::prelude::*;

use super::{WlopSettings, WlopVariant};
use crate::application::{Length, spacing};
use crate::geometry::Scalar;
use crate::geometry::generate::random::SplitMix64;
use crate::geometry::vector::Vector;
use crate::query::NearestFew;
use crate::structure::AabbTreeN;
use crate::structure::aabb_tree::any_dimension;
use crate::{Error, Result};

/// Radii where none is asked for, in spacings of the samples: of the paper's h, which then holds some three rings, and of R.
const DEFAULT_H: f64 = 12.0;
const DEFAULT_R: f64 = 6.0;
/// Neighbours that CGAL averages the spacing of points over, and radii in that.
const CGAL_NEAREST: usize = 6;
const CGAL_R: f64 = 8.0;
/// Points of a task.
const TASK: usize = 256;

/// The samples as they begin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WlopStart<'a, T> {
    /// So many different points, chosen at random; the same for the same seed on every machine. No two are at one place while points
    /// at others are left: samples at one place never part.
    Random {
        /// How many, at most as many as there are points.
        count: usize,
        /// Any number.
        seed: u64,
    },
    /// The points with these indices. Samples at one place never part, but count.
    Indices(&'a [u32]),
    /// Samples of the caller's own, anywhere; those at one place as above.
    Positions(&'a [Vector<T>]),
}

/// `count` different numbers below `n`, in ascending order; each such set is as likely as any other.
///
/// # Errors
/// `InvalidSetting` where `count` is larger than `n`.
pub fn random_subset(n: usize, count: usize, seed: u64) -> Result<Vec<u32>> {
    check_count(n, count)?;
    let mut chosen: Vec<u32> = shuffled(n, seed).take(count).collect();
    chosen.sort_unstable();
    Ok(chosen)
}

/// As [`random_subset`], but of points at one place only one, unless there are fewer places than points asked for. The same subset
/// where all points are at different places.
///
/// - `point`: the point with an index below `n`
fn random_places<T: Scalar>(n: usize, count: usize, seed: u64, point: impl Fn(usize) -> Vector<T>) -> Result<Vec<u32>> {
    check_count(n, count)?;
    // Adding zero turns -0 into 0: both are one place.
    let place = |index: u32| point(index as usize).map(|x| (x + T::ZERO).to_f64().to_bits());
    let mut taken = HashSet::with_capacity(count);
    let (mut chosen, mut repeated) = (Vec::with_capacity(count), Vec::new());
    for index in shuffled(n, seed) {
        if chosen.len() == count {
            break;
        }
        let among = if taken.insert(place(index)) { &mut chosen } else { &mut repeated };
        among.push(index);
    }
    repeated.truncate(count - chosen.len());
    chosen.append(&mut repeated);
    chosen.sort_unstable();
    Ok(chosen)
}

fn check_count(n: usize, count: usize) -> Result<()> {
    if count <= n {
        return Ok(());
    }
    Err(Error::InvalidSetting {
        setting: "number of samples",
        found: format!("{count} of {n} points"),
        expected: "at most the number of points, as each is one of them at first",
    })
}

/// All numbers below `n` in a random order.
fn shuffled(n: usize, seed: u64) -> impl Iterator<Item = u32> {
    let mut random = SplitMix64::stream(seed, 0);
    let mut all: Vec<u32> = (0..n as u32).collect();
    (0..n).map(move |place| {
        let other = place + random.below((n - place) as u64) as usize;
        all.swap(place, other);
        all[place]
    })
}

impl<T: Scalar> WlopStart<'_, T> {
    /// `[s]` positions of the samples.
    ///
    /// - `point`: the point with an index below `n`
    ///
    /// # Errors
    /// `InvalidSetting` for more samples than points and for indices beyond them.
    pub(super) fn positions(&self, n: usize, point: impl Fn(usize) -> Vector<T>) -> Result<Vec<Vector<T>>> {
        let of = |indices: &[u32]| indices.iter().map(|&index| point(index as usize)).collect();
        match self {
            Self::Random { count, seed } => Ok(of(&random_places(n, *count, *seed, &point)?)),
            Self::Positions(positions) => Ok(positions.to_vec()),
            Self::Indices(indices) => match indices.iter().find(|&&index| index as usize >= n) {
                None => Ok(of(indices)),
                Some(index) => Err(Error::InvalidSetting {
                    setting: "indices of the first samples",
                    found: format!("{index} of {n} points"),
                    expected: "indices below the number of points",
                }),
            },
        }
    }
}

/// The radius in the unit of the points.
///
/// - `inputs`: the tree over the points, where it is needed
///
/// # Errors
/// `InvalidSetting` where it is not a finite number above 0 with a square that is one, or refers to points or samples without a size
/// or a spacing; what `inputs` returns.
pub(super) fn radius<'a, T: Scalar>(
    settings: &WlopSettings,
    inputs: impl FnOnce() -> Result<Cow<'a, AabbTreeN<T, 3>>>,
    samples: &AabbTreeN<T, 3>,
) -> Result<T> {
    let radius = match (settings.radius, settings.variant) {
        (Some(length @ Length::Percent(_)), _) => length.resolve("radius", inputs()?.as_ref())?,
        (Some(length), _) => length.resolve("radius", samples)?,
        (None, WlopVariant::Cgal) => {
            Length::Absolute(CGAL_R * cgal_spacing(inputs()?.as_ref())).resolve("radius", samples)?
        }
        (None, WlopVariant::Authors) => Length::Spacings(DEFAULT_R).resolve("radius", samples)?,
        (None, _) => Length::Spacings(DEFAULT_H).resolve("radius", samples)?,
    };
    any_dimension::radius(T::of(radius), None)?;
    match T::of(radius) {
        radius if radius > T::ZERO => Ok(radius),
        _ => Err(Error::InvalidSetting {
            setting: "radius",
            found: radius.to_string(),
            expected: "a length above 0 in the precision of the points",
        }),
    }
}

/// What `CGAL::compute_average_spacing` gives for six neighbours: the mean distance of the seven nearest, the point itself among
/// them.
fn cgal_spacing<T: Scalar>(tree: &AabbTreeN<T, 3>) -> f64 {
    let points = tree.ordered_points();
    let places: Vec<usize> = (0..points.len()).collect();
    let means: Vec<f64> = places
        .par_iter()
        .with_min_len(TASK)
        .map_init(
            || NearestFew::new(CGAL_NEAREST + 1),
            |few, &place| {
                tree.nearest_few(&points.position(place), T::of(f64::INFINITY), few);
                let sum: f64 = few.found().iter().map(|hit| hit.0.to_f64().sqrt()).sum();
                sum / few.found().len() as f64
            },
        )
        .collect();
    means.iter().sum::<f64>() / means.len().max(1) as f64
}

/// The mean distance of nearest samples; 0 where all are at one place.
pub(super) fn sample_spacing<T: Scalar>(samples: &AabbTreeN<T, 3>) -> f64 {
    spacing(samples).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::AabbTreeNSettings;

    #[test]
    fn subsets_are_of_different_numbers_and_follow_the_seed() {
        let subset = random_subset(1000, 300, 7).unwrap();
        assert!(subset.len() == 300 && subset.windows(2).all(|pair| pair[0] < pair[1]) && subset[299] < 1000);
        assert_eq!(subset, random_subset(1000, 300, 7).unwrap());
        assert_ne!(subset, random_subset(1000, 300, 8).unwrap());
        assert_eq!(random_subset(5, 5, 1).unwrap(), [0, 1, 2, 3, 4]);
        assert!(random_subset(0, 0, 1).unwrap().is_empty());
        assert!(random_subset(5, 6, 1).is_err_and(|error| error.to_string().contains("6 of 5 points")));
        // Each of ten numbers is in 300 of 1,000 subsets of three, within five deviations of 14.5.
        let mut drawn = [0; 10];
        (0..1000).for_each(|seed| random_subset(10, 3, seed).unwrap().iter().for_each(|&i| drawn[i as usize] += 1));
        assert!(drawn.iter().all(|n| (228..372).contains(n)), "{drawn:?}");
    }

    #[test]
    fn places_are_repeated_only_where_none_is_left() {
        // Ten places, at each as many points as its number says, from 1 on; zeros of both signs are one.
        let points: Vec<[f32; 3]> =
            (0..10u8).flat_map(|i| vec![[f32::from(i), 0.0, 1.0]; 1 + usize::from(i)]).collect();
        let signed = |index: usize| points[index].map(|x| if x == 0.0 && index % 2 == 1 { -x } else { x });
        let n = points.len();
        for seed in 0..20 {
            for count in [0, 1, 9, 10, 11, n] {
                let chosen = random_places(n, count, seed, signed).unwrap();
                assert_eq!(chosen, random_places(n, count, seed, signed).unwrap());
                assert!(chosen.len() == count && chosen.windows(2).all(|pair| pair[0] < pair[1]));
                let places: HashSet<u32> = chosen.iter().map(|&i| points[i as usize][0].to_bits()).collect();
                assert_eq!(places.len(), count.min(10), "{chosen:?}");
            }
        }
        let apart = |index: usize| [index as f64, 0.0, 0.0];
        assert_eq!(random_places(1000, 300, 7, apart).unwrap(), random_subset(1000, 300, 7).unwrap());
        assert!(random_places(5, 6, 1, apart).is_err_and(|error| error.to_string().contains("6 of 5 points")));
    }

    #[test]
    fn the_spacing_of_cgal_counts_the_point_itself() {
        // A row of points at distance 1: the six nearest of one inside are at 1, 1, 2, 2, 3, 3.
        let row: Vec<[f64; 3]> = (0..101u8).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let tree = AabbTreeN::build(&row, &AabbTreeNSettings::default()).unwrap();
        // At the ends 1 to 6, then 1 1 2 3 4 5, then 1 1 2 2 3 4.
        let expected = (95.0 * 12.0 + 2.0 * (21.0 + 16.0 + 13.0)) / 7.0 / 101.0;
        assert!((cgal_spacing(&tree) - expected).abs() < 1e-12);
    }
}
