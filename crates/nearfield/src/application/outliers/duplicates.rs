//! Duplicates: points that are there already, exactly or within a tolerance.

use std::collections::HashMap;

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
    // Points without another that near stay; only the others depend on each other, and are few in most clouds.
    let mut originals: Vec<u32> = (0..n as u32).collect();
    let mut open = Vec::new();
    for first in (0..n).step_by(BLOCK) {
        watch.report("duplicates", first as u64, n as u64)?;
        let places = first..n.min(first + BLOCK);
        // The point itself is one.
        let has_other = |place: usize| tree.has_within(&ordered.position(place), tolerance, 2);
        let found: Vec<bool> = places.clone().into_par_iter().with_min_len(TASK).map(has_other).collect();
        open.extend(places.zip(found).filter(|(_, has)| *has).map(|(place, _)| ordered.ids()[place]));
    }
    open.sort_unstable();
    let mut staying = Staying::none(finite.points(), tolerance);
    staying.decide(&open, watch, |id, original| originals[id as usize] = original)?;
    watch.report("duplicates", n as u64, n as u64)?;
    Ok(Duplicates::of(&finite, originals))
}

/// Points that stay, in a hash grid. They are farther apart than the tolerance: only a few fit into a cell, however many points there are.
pub(super) struct Staying<'a, T: Scalar> {
    points: &'a [Vector<T>],
    tolerance: T,
    /// How far points within the tolerance are apart along an axis, at most.
    reach: f64,
    /// Edge of a cell: a ball meets two or three along an axis.
    cell: f64,
    /// The place in `members` of the last one in each cell. Numbers of cells are whole f64 as bits, which no coordinate is too large for.
    last: HashMap<[u64; 3], u32>,
    /// Those that stay, and the place of the one before in the cell; `u32::MAX` where there is none.
    members: Vec<[u32; 2]>,
}

impl<'a, T: Scalar> Staying<'a, T> {
    /// None of the points yet; the tolerance is above 0.
    pub(super) fn none(points: &'a [Vector<T>], tolerance: T) -> Self {
        // Rounded distances at the tolerance may be of points a hair farther apart.
        let reach = tolerance.to_f64() * any_dimension::RADIUS_SLACK;
        Self { points, tolerance, reach, cell: 2.0 * reach, last: HashMap::new(), members: Vec::new() }
    }

    /// Adds a point that stays.
    pub(super) fn add(&mut self, id: u32) {
        let cell = self.points[id as usize].map(|x| self.number(x.to_f64()).to_bits());
        let before = self.last.insert(cell, self.members.len() as u32).unwrap_or(u32::MAX);
        self.members.push([id, before]);
    }

    /// Decides the `open` points, whose indices ascend: each stays unless one before it is within the tolerance that does. All that stay
    /// among the others and are near to one of them are there already. `take` gets each with its original.
    ///
    /// # Errors
    /// `Interrupted`.
    pub(super) fn decide(&mut self, open: &[u32], watch: &mut Watch<'_>, mut take: impl FnMut(u32, u32)) -> Result<()> {
        for (done, &id) in open.iter().enumerate() {
            if done % BLOCK == 0 {
                watch.report("duplicates of duplicates", done as u64, open.len() as u64)?;
            }
            let original = self.original(id);
            if original == id {
                self.add(id);
            }
            take(id, original);
        }
        Ok(())
    }

    /// The smallest index before `id` of those within the tolerance; else `id`.
    fn original(&self, id: u32) -> u32 {
        let at = self.points[id as usize];
        // Rounding keeps the order of numbers: what is within the reach has a number between these.
        let [xs, ys, zs] = at.map(|x| {
            let x = x.to_f64();
            [self.number(x - self.reach), self.number(x + self.reach)]
        });
        let (tolerance2, mut original) = (self.tolerance * self.tolerance, id);
        for x in cells(xs) {
            for y in cells(ys) {
                for z in cells(zs) {
                    let mut place = self.last.get(&[x, y, z]).copied().unwrap_or(u32::MAX);
                    while let Some(&[other, before]) = self.members.get(place as usize) {
                        let dist2 = any_dimension::dist2(&at, &self.points[other as usize]);
                        if other < original && dist2 <= tolerance2 {
                            original = other;
                        }
                        place = before;
                    }
                }
            }
        }
        original
    }

    /// Number of the cell of a coordinate. Adding zero turns -0 into 0.
    fn number(&self, x: f64) -> f64 {
        (x / self.cell).floor() + 0.0
    }
}

/// Numbers of cells from one to another, as bits. Those beyond 2⁵³ are farther apart than 1.
fn cells([low, high]: [f64; 2]) -> impl Iterator<Item = u64> {
    let next = |number: &f64| Some((number + 1.0).max(number.next_up()));
    std::iter::successors(Some(low), next).take_while(move |&number| number <= high).map(f64::to_bits)
}

/// For each point the one with the smallest index at its place, by sorting.
pub(super) fn at_one_place<T: Scalar>(points: &[Vector<T>]) -> Vec<u32> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generate::random::SplitMix64;

    #[test]
    fn many_points_within_the_tolerance_are_decided_at_once() {
        // Pairs of them are more than can be looked at.
        let mut points = vec![[1.0f32, -2.0, 0.5]; 200_000];
        let (mut told, mut total) = (0, 0);
        let mut tell = |progress: crate::application::Progress| {
            (told, total) = (told + 1, progress.total);
            std::ops::ControlFlow::Continue(())
        };
        let found = duplicates(&points, 0.25, &mut Watch::new(&mut tell)).unwrap();
        assert!(found.originals.iter().all(|&original| original == 0) && found.kept_indices() == [0]);
        assert!(told > 2 * total / 4096, "{told} reports");
        // All within the tolerance of each other, and the first one last along the axis.
        points.iter_mut().enumerate().for_each(|(i, point)| point[0] = 1.0 - i as f32 / (1 << 20) as f32);
        let found = duplicates(&points, 0.5, &mut Watch::none()).unwrap();
        assert!(found.originals.iter().all(|&original| original == 0));
    }

    fn is_the_loop<T: Scalar>(corner: f64, step: f64, tolerance: f64) {
        let mut random = SplitMix64::stream(9, 0);
        let mut point = || [(); 3].map(|()| T::of(corner + step * (random.below(12) as f64 - 6.0)));
        let points: Vec<Vector<T>> = (0..1500).map(|_| point()).collect();
        let tolerance2 = T::of(tolerance) * T::of(tolerance);
        let mut staying: Vec<u32> = Vec::new();
        let mut original = |i: u32| {
            let near = |s: &u32| any_dimension::dist2(&points[*s as usize], &points[i as usize]) <= tolerance2;
            staying.iter().copied().find(near).unwrap_or_else(|| {
                staying.push(i);
                i
            })
        };
        let expected: Vec<u32> = (0..1500).map(&mut original).collect();
        let found = duplicates(&points, tolerance, &mut Watch::none()).unwrap();
        assert_eq!(found.originals, expected, "{corner}, {step}, {tolerance}");
    }

    #[test]
    fn originals_are_those_of_the_loop_wherever_the_points_are() {
        // At borders of cells, at distances that are rounded, and where cells are smaller than the last place of a coordinate.
        for (corner, step, tolerance) in [
            (0.0, 0.25, 0.25),
            (-0.3, 0.1, 0.1),
            (7.7, 0.1, 0.3),
            (1e6, 0.25, 0.5),
            (1e6, 1.0, 1e-15),
            (-1e9, 64.0, 65.0),
        ] {
            is_the_loop::<f32>(corner, step, tolerance);
            is_the_loop::<f64>(corner, step, tolerance);
        }
        is_the_loop::<f64>(1e100, 1e84, 1.5e84);
        is_the_loop::<f64>(1e100, 1e84, 1e-100);
    }

    #[test]
    fn cells_are_counted_up_to_the_largest_numbers() {
        let from = |low, high| cells([low, high]).map(f64::from_bits).collect::<Vec<f64>>();
        assert_eq!(from(-1.0, 1.0), [-1.0, 0.0, 1.0]);
        let large = 2f64.powi(53);
        assert_eq!(from(large - 1.0, large + 4.0), [large - 1.0, large, large + 2.0, large + 4.0]);
        assert_eq!(from(-large - 2.0, 1.0 - large), [-large - 2.0, -large, 1.0 - large]);
    }
}
