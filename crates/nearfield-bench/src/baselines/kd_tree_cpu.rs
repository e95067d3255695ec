//! Exact search by the kd-tree of kiddo on the CPU, all threads: the queries are shared out by rayon, as kiddo answers one at
//! a time.

use std::borrow::Cow;
use std::num::NonZero;
use std::panic::{AssertUnwindSafe, catch_unwind};

use kiddo::SquaredEuclidean;
use kiddo::immutable::float::kdtree::ImmutableKdTree;
use nearfield::{Error, Result};
use rayon::prelude::*;

use super::points::{Points, Queries};
use super::rows::{KnnRows, RangeRows};
use super::{check_k, check_radius};

/// Points of a leaf: kiddo's default.
const LEAF: usize = 32;
/// Dimensions that a tree can have.
const DIMENSIONS: std::ops::RangeInclusive<usize> = 2..=16;

/// kiddo's immutable kd-tree over points of 2 to 16 dimensions.
pub struct KdTree<'a> {
    points: Cow<'a, Points>,
    tree: Box<dyn OneQuery>,
}

/// A tree whose number of dimensions is known inside only.
trait OneQuery: Send + Sync {
    /// The nearest `k`, in order of distance.
    fn nearest(&self, query: &[f32], k: NonZero<usize>, row: &mut Vec<(f32, u32)>);
    /// All with d² ≤ `limit`, in any order.
    fn within(&self, query: &[f32], limit: f32, row: &mut Vec<u32>);
}

type Tree<const D: usize> = ImmutableKdTree<f32, u32, D, LEAF>;

impl<const D: usize> OneQuery for Tree<D> {
    fn nearest(&self, query: &[f32], k: NonZero<usize>, row: &mut Vec<(f32, u32)>) {
        let found = self.nearest_n::<SquaredEuclidean>(&position(query), k);
        row.extend(found.into_iter().map(|n| (n.distance, n.item)));
    }

    fn within(&self, query: &[f32], limit: f32, row: &mut Vec<u32>) {
        let found = self.within_unsorted_exclusive::<SquaredEuclidean>(&position(query), limit, true);
        row.extend(found.into_iter().map(|n| n.item));
    }
}

fn position<const D: usize>(point: &[f32]) -> [f32; D] {
    std::array::from_fn(|axis| point[axis])
}

fn build<const D: usize>(points: &Points) -> Box<dyn OneQuery> {
    let positions: Vec<[f32; D]> = (0..points.len()).map(|i| position(points.get(i))).collect();
    Box::new(Tree::<D>::new_from_slice(&positions))
}

impl<'a> KdTree<'a> {
    /// Builds the tree, on one thread.
    ///
    /// # Errors
    /// `Unsupported` beyond 16 dimensions, and for points that kiddo's build panics on.
    pub fn build(points: &'a Points) -> Result<Self> {
        Self::over(Cow::Borrowed(points))
    }

    /// As [`KdTree::build`], of points that the tree keeps.
    ///
    /// # Errors
    /// As [`KdTree::build`].
    pub fn build_owned(points: Points) -> Result<KdTree<'static>> {
        KdTree::over(Cow::Owned(points))
    }

    fn over(points: Cow<'a, Points>) -> Result<Self> {
        let builds = [
            build::<2>,
            build::<3>,
            build::<4>,
            build::<5>,
            build::<6>,
            build::<7>,
            build::<8>,
            build::<9>,
            build::<10>,
            build::<11>,
            build::<12>,
            build::<13>,
            build::<14>,
            build::<15>,
            build::<16>,
        ];
        let dimension = points.dimension();
        let build = dimension.checked_sub(*DIMENSIONS.start()).and_then(|i| builds.get(i)).ok_or_else(|| {
            let what = format!("a kd-tree of {dimension} dimensions");
            Error::Unsupported { what, advice: "2 to 16 dimensions have one" }
        })?;
        let tree = catch_unwind(AssertUnwindSafe(|| build(&points))).map_err(|_| Error::Unsupported {
            what: format!("kiddo's kd-tree of these {} points", points.len()),
            advice: "its build panicked; leave this baseline out",
        })?;
        Ok(Self { points, tree })
    }

    /// The k nearest of every query; ties at the k-th distance in kiddo's order.
    ///
    /// # Errors
    /// `InvalidSetting` for k; `LengthMismatch` for queries of another dimension.
    pub fn knn(&self, queries: Queries<'_>, k: usize) -> Result<KnnRows> {
        check_k(k)?;
        let asking = self.asking(queries)?;
        let one_more = matches!(queries, Queries::PointsWithoutSelf);
        let wanted = NonZero::new(k + usize::from(one_more)).expect("k should be positive");
        let row = |i: usize| {
            let mut row = Vec::with_capacity(wanted.get());
            if !self.points.is_empty() {
                self.tree.nearest(asking.get(i), wanted, &mut row);
            }
            row.retain(|candidate| Some(candidate.1) != queries.left_out(i));
            row
        };
        let rows = (0..asking.len()).into_par_iter().with_min_len(64).map(row).collect();
        Ok(KnnRows::of_candidates(k, rows))
    }

    /// The points of every query with d² ≤ r².
    ///
    /// # Errors
    /// `InvalidRadius`; `LengthMismatch` for queries of another dimension.
    pub fn list_within(&self, queries: Queries<'_>, radius: f32) -> Result<RangeRows> {
        Ok(RangeRows::of_rows(self.each_within(queries, radius, |row| row)?))
    }

    /// How many points every query has with d² ≤ r².
    ///
    /// # Errors
    /// As [`KdTree::list_within`].
    pub fn count_within(&self, queries: Queries<'_>, radius: f32) -> Result<Vec<u32>> {
        self.each_within(queries, radius, |row| row.len() as u32)
    }

    fn each_within<T: Send>(
        &self,
        queries: Queries<'_>,
        radius: f32,
        make: impl Fn(Vec<u32>) -> T + Sync,
    ) -> Result<Vec<T>> {
        check_radius(radius)?;
        let asking = self.asking(queries)?;
        let row = |i: usize| {
            let mut row = Vec::new();
            if !self.points.is_empty() {
                self.tree.within(asking.get(i), radius * radius, &mut row);
            }
            row.retain(|&id| Some(id) != queries.left_out(i));
            make(row)
        };
        Ok((0..asking.len()).into_par_iter().with_min_len(64).map(row).collect())
    }

    fn asking<'b>(&'b self, queries: Queries<'b>) -> Result<&'b Points> {
        let asking = queries.of(&self.points);
        self.points.check_same_dimension(asking)?;
        Ok(asking)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{exact, recall};
    use super::*;

    #[test]
    fn every_dimension_gives_what_brute_force_gives() {
        for dimension in DIMENSIONS {
            let points = Points::uniform(1500, dimension, 5).expect("points");
            let others = Points::uniform(200, dimension, 6).expect("points");
            let tree = KdTree::build(&points).expect("a tree");
            for queries in [Queries::Points, Queries::PointsWithoutSelf, Queries::Other(&others)] {
                let sample = exact::sample(queries.of(&points).len(), 100);
                let nearest = exact::knn(&points, queries, &sample, 10);
                let rows = tree.knn(queries, 10).expect("rows");
                let quality = recall::of_knn(&points, queries, &sample, &rows, &nearest).expect("honest rows");
                assert_eq!((quality.recall, quality.exact_rows), (1.0, 1.0), "{dimension} {queries:?}");
                let radius = nearest.row_dist2(0)[6].sqrt();
                let lists = tree.list_within(queries, radius).expect("lists");
                let quality = recall::of_range(&points, queries, &sample, radius, &lists).expect("honest lists");
                assert_eq!(quality.recall, 1.0, "{dimension} {queries:?}");
                assert_eq!(lists.counts(), tree.count_within(queries, radius).expect("counts"));
            }
        }
    }

    #[test]
    fn few_points_duplicates_and_none_are_answered_or_refused() {
        for n in [0, 1, 2, 33, 100] {
            let points = Points::new(3, vec![0.5; 3 * n]).expect("points");
            let rows = KdTree::build(&points).and_then(|tree| tree.knn(Queries::Points, 5));
            match rows {
                Ok(rows) => assert!((0..n).all(|i| rows.row(i).len() == n.min(5)), "{n} equal points"),
                Err(error) => assert!(matches!(error, Error::Unsupported { .. }) && n > LEAF, "{n}: {error}"),
            }
        }
        let points = Points::uniform(10, 17, 1).expect("points");
        assert!(matches!(KdTree::build(&points), Err(Error::Unsupported { .. })));
        let (points, other) = (Points::uniform(10, 3, 1).expect("points"), Points::uniform(10, 4, 1).expect("points"));
        let tree = KdTree::build(&points).expect("a tree");
        assert!(matches!(
            tree.knn(Queries::Other(&other), 3),
            Err(Error::LengthMismatch { found: 4, expected: 3, .. })
        ));
        assert!(matches!(tree.count_within(Queries::Points, f32::NAN), Err(Error::InvalidRadius { .. })));
        assert!(matches!(tree.knn(Queries::Points, 0), Err(Error::InvalidSetting { .. })));
    }
}
