//! One query at a time, without an answer in memory: what an application computes from neighbours, it computes while they are
//! found.

use super::nearest::Best;
use crate::geometry::Scalar;
use crate::structure::AabbTreeN;
use crate::structure::aabb_tree::any_dimension::{dist2_to_box, reach};

/// The nearest points of one query, and the memory to find those of the next.
///
/// ```
/// use nearfield::{AabbTreeN, AabbTreeNSettings, query::NearestFew};
///
/// let tree = AabbTreeN::build(&[[0.0f64], [1.0], [5.0]], &AabbTreeNSettings::default())?;
/// let mut few = NearestFew::new(2);
/// tree.nearest_few(&[4.0], f64::INFINITY, &mut few);
/// assert_eq!(few.found(), [(1.0, 2), (9.0, 1)]);
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct NearestFew<T> {
    best: Best<T>,
}

impl<T: Scalar> NearestFew<T> {
    /// Room for at most `k` points.
    pub fn new(k: usize) -> Self {
        Self { best: Best::new(k) }
    }

    /// Squared distance and index of what was found, the nearest first, ties by lower index.
    pub fn found(&self) -> &[(T, u32)] {
        self.best.hits()
    }
}

impl<T: Scalar, const D: usize> AabbTreeN<T, D> {
    /// Calls `visit(index, squared distance)` for every point within `radius` of `query`, a point at exactly the radius
    /// included, in the order of the tree: the same order from run to run. Radii that are NaN, negative or infinite and
    /// queries that are not finite meet nothing.
    ///
    /// One traversal; callers run many queries side by side themselves.
    pub fn for_each_within(&self, query: &[T; D], radius: T, mut visit: impl FnMut(u32, T)) {
        let ids = self.ordered_points().ids();
        self.for_each_place_within(query, radius, |place, dist2| visit(ids[place], dist2));
    }

    /// The same with the place of each point in the order of the tree.
    #[inline(always)]
    pub(crate) fn for_each_place_within(&self, query: &[T; D], radius: T, mut visit: impl FnMut(usize, T)) {
        if self.is_empty() || !(radius >= T::ZERO && radius.is_finite()) || query.iter().any(|x| !x.is_finite()) {
            return;
        }
        let (points, radius2, reach) = (self.ordered_points(), radius * radius, reach(radius));
        let reach2 = reach * reach;
        self.descend(
            0,
            |node| dist2_to_box(query, node) <= reach2,
            |leaf| {
                points.for_each_dist2(self.places(leaf), query, |place, dist2| {
                    if dist2 <= radius2 {
                        visit(place, dist2);
                    }
                });
            },
        );
    }

    /// Whether at least `least` points are within `radius` of `query`, a point at exactly the radius included: a count that ends as
    /// soon as there are enough. Radii that are NaN, negative or infinite and queries that are not finite have none.
    pub fn has_within(&self, query: &[T; D], radius: T, least: u32) -> bool {
        if least == 0 {
            return true;
        }
        if self.is_empty() || !(radius >= T::ZERO && radius.is_finite()) || query.iter().any(|x| !x.is_finite()) {
            return false;
        }
        let (points, radius2, reach) = (self.ordered_points(), radius * radius, reach(radius));
        let reach2 = reach * reach;
        let mut found = 0;
        self.descend_while(
            0,
            |node| dist2_to_box(query, node) <= reach2,
            |leaf| {
                points.for_each_dist2(self.places(leaf), query, |_, dist2| found += u32::from(dist2 <= radius2));
                found < least
            },
        );
        found >= least
    }

    /// Fills `few` with the points nearest to `query` among those within `radius`, which may be infinite. Radii that are NaN
    /// or negative and queries that are not finite find nothing.
    pub fn nearest_few(&self, query: &[T; D], radius: T, few: &mut NearestFew<T>) {
        let radius2 = if radius >= T::ZERO { radius * radius } else { -T::ONE };
        few.best.begin(radius2);
        if !self.is_empty() && radius2 >= T::ZERO && few.best.k() > 0 && query.iter().all(|x| x.is_finite()) {
            let points = self.ordered_points();
            self.nearest_first(query, radius2, |leaf| {
                points
                    .for_each_dist2(self.places(leaf), query, |place, dist2| few.best.add(points.ids()[place], dist2));
                few.best.reach2()
            });
        }
        few.best.finish();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::AabbTreeNSettings;
    use crate::structure::aabb_tree::any_dimension::dist2;

    fn points() -> Vec<[f64; 3]> {
        let at = |i: u32, prime: u32| f64::from(i * prime % 101) / 101.0;
        (0..700).map(|i| [at(i, 7), at(i, 31), at(i * i, 3)]).collect()
    }

    #[test]
    fn visits_are_those_of_brute_force() {
        let points = points();
        let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).unwrap();
        for (query, radius) in [([0.3, 0.4, 0.5], 0.2), ([5.0, 5.0, 5.0], 1.0), (points[3], 0.0), ([0.5; 3], 3.0)] {
            let mut found = Vec::new();
            tree.for_each_within(&query, radius, |index, d2| found.push((index, d2)));
            found.sort_unstable_by_key(|hit| hit.0);
            let all = points.iter().zip(0..).map(|(p, i)| (i, dist2(&query, p)));
            let expected: Vec<(u32, f64)> = all.filter(|hit| hit.1 <= radius * radius).collect();
            assert_eq!(found, expected);
            let n = expected.len() as u32;
            for least in [0, 1, n / 2, n, n + 1] {
                assert_eq!(tree.has_within(&query, radius, least), n >= least, "{least} of {n}");
            }
            let mut few = NearestFew::new(9);
            tree.nearest_few(&query, radius, &mut few);
            let mut nearest = expected.clone();
            nearest.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            let nearest: Vec<(f64, u32)> = nearest.iter().take(9).map(|&(i, d2)| (d2, i)).collect();
            assert_eq!(few.found(), nearest);
        }
    }

    #[test]
    fn nothing_is_near_what_is_no_question() {
        let tree = AabbTreeN::build(&points(), &AabbTreeNSettings::default()).unwrap();
        let mut few = NearestFew::new(3);
        for (query, radius) in [([f64::NAN, 0.0, 0.0], 1.0), ([0.5; 3], f64::NAN), ([0.5; 3], -1.0)] {
            tree.for_each_within(&query, radius, |_, _| panic!("a point should not be met"));
            tree.nearest_few(&query, radius, &mut few);
            assert!(few.found().is_empty() && !tree.has_within(&query, radius, 1));
        }
    }
}
