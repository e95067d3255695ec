//! Duplicates: points that are there already, exactly or within a tolerance.

use rayon::prelude::*;

use super::{BLOCK, TASK, indices};
use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, Place};
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::structure::aabb_tree::any_dimension;
use crate::structure::{AabbTreeN, AabbTreeNSettings};
use crate::{Error, Result};

/// Who stays, and whose duplicates the others are.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Duplicates {
    /// `[n]` whether the point stays.
    pub kept: Vec<bool>,
    /// `[n]` the point that stays for this one: itself, or of those within the tolerance the one with the smallest index;
    /// [`Duplicates::NONE`] of invalid points.
    pub originals: Vec<u32>,
    /// Indices of the points with a NaN or infinite coordinate, ascending.
    pub invalid: Vec<u32>,
}

impl Duplicates {
    /// The original of a point that is no place.
    pub const NONE: u32 = u32::MAX;

    /// Indices of the points that stay, ascending.
    pub fn kept_indices(&self) -> Vec<u32> {
        indices(&self.kept)
    }

    /// From the originals of the finite points.
    pub(super) fn of<P: Place>(finite: &FinitePoints<'_, P>, originals: Vec<u32>) -> Self {
        let kept = originals.iter().zip(0..).map(|(&original, i)| original == i).collect();
        let originals = finite.spread(finite.renamed(originals, Self::NONE), Self::NONE);
        Self { kept: finite.spread(kept, false), originals, invalid: finite.invalid() }
    }
}

/// Points within `tolerance` of one that stays and stands before them. In the caller's order a point stays where none that stays is within
/// the tolerance: so no two points that stay are that near, and every other one has one that near, with a smaller index.
///
/// ```
/// use nearfield::application::{Watch, duplicates};
///
/// let points = [0.0, 0.5, 1.0, 0.0].map(|x| [x, 0.0, 0.0]);
/// let exact = duplicates(&points, 0.0, &mut Watch::none())?;
/// assert_eq!(exact.originals, [0, 1, 2, 0]);
/// let near = duplicates(&points, 0.5, &mut Watch::none())?;
/// assert_eq!(near.kept, [true, false, true, false]);
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// - `tolerance`: 0 for points at exactly one place; a point at exactly the tolerance is a duplicate
///
/// # Errors
/// `InvalidSetting`; `CoordinateBeyond`, `TooMany` for the points; `Interrupted`.
pub fn duplicates<T: Scalar>(points: &[Vector<T>], tolerance: f64, watch: &mut Watch<'_>) -> Result<Duplicates> {
    let tolerance: T = radius(tolerance)?;
    let finite = FinitePoints::of(points)?;
    if tolerance == T::ZERO {
        watch.report("duplicates", 0, 1)?;
        let originals = at_one_place(finite.points());
        watch.report("duplicates", 1, 1)?;
        return Ok(Duplicates::of(&finite, originals));
    }
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    let (ordered, n) = (tree.ordered_points(), tree.len());
    // Points without any before them that near stay; only the others depend on each other, and are few in most clouds.
    let mut originals: Vec<u32> = (0..n as u32).collect();
    let mut doubtful = Vec::new();
    for first in (0..n).step_by(BLOCK) {
        watch.report("duplicates", first as u64, n as u64)?;
        let places = first..n.min(first + BLOCK);
        let has_before = |place: usize| {
            let mut has = false;
            tree.for_each_within(&ordered.position(place), tolerance, |other, _| has |= other < ordered.ids()[place]);
            has
        };
        let found: Vec<bool> = places.clone().into_par_iter().with_min_len(TASK).map(has_before).collect();
        doubtful.extend(places.zip(found).filter(|(_, has)| *has).map(|(place, _)| ordered.ids()[place]));
    }
    doubtful.sort_unstable();
    for (done, &id) in doubtful.iter().enumerate() {
        if done % BLOCK == 0 {
            watch.report("duplicates of duplicates", done as u64, doubtful.len() as u64)?;
        }
        let mut original = id;
        tree.for_each_within(&finite.points()[id as usize], tolerance, |other, _| {
            // All before this one are decided.
            if other < original && originals[other as usize] == other {
                original = other;
            }
        });
        originals[id as usize] = original;
    }
    watch.report("duplicates", n as u64, n as u64)?;
    Ok(Duplicates::of(&finite, originals))
}

/// For each point the one with the smallest index at its place, by sorting.
fn at_one_place<T: Scalar>(points: &[Vector<T>]) -> Vec<u32> {
    // Adding zero turns -0 into 0: both are one place.
    let place = |i: u32| points[i as usize].map(|x| x + T::ZERO);
    let order_of = |a: Vector<T>, b: Vector<T>| {
        a[0].compare(b[0]).then_with(|| a[1].compare(b[1])).then_with(|| a[2].compare(b[2]))
    };
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.par_sort_unstable_by(|&a, &b| order_of(place(a), place(b)).then(a.cmp(&b)));
    let mut originals = order.clone();
    let mut original = 0;
    for (k, &id) in order.iter().enumerate() {
        if k == 0 || place(id) != place(order[k - 1]) {
            original = id;
        }
        originals[id as usize] = original;
    }
    originals
}

/// A tolerance as a radius of searches.
///
/// # Errors
/// `InvalidSetting`.
pub(super) fn radius<T: Scalar>(tolerance: f64) -> Result<T> {
    let radius = T::of(tolerance);
    if tolerance >= 0.0 && (radius > T::ZERO) == (tolerance > 0.0) && any_dimension::radius(radius, None).is_ok() {
        return Ok(radius);
    }
    let expected = "0 for points at one place, or a length whose square is a normal number of the coordinates' type";
    Err(Error::InvalidSetting { setting: "tolerance", found: tolerance.to_string(), expected })
}
