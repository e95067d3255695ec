//! Brute force in f64 on the CPU: what the baselines are judged by.

use rayon::prelude::*;

use super::points::{Points, Queries, dist2_in_f64, slack};
use super::rows::KnnRows;

/// At most `most` numbers below `n`, evenly spread: the queries that are judged.
pub fn sample(n: usize, most: usize) -> Vec<u32> {
    let step = n.div_ceil(most.max(1)).max(1);
    (0..n).step_by(step).map(|i| i as u32).collect()
}

/// The exact k nearest points of each query of `sample`, a row for each of them.
///
/// # Panics
/// If k is 0, a query of the sample does not exist or has another dimension.
pub fn knn(points: &Points, queries: Queries<'_>, sample: &[u32], k: usize) -> KnnRows {
    let (asking, places) = (queries.of(points), k.min(points.len()));
    let row = |&query: &u32| {
        let (center, left_out) = (asking.get(query as usize), queries.left_out(query as usize));
        let distance = |i: usize| (dist2_in_f64(center, points.get(i)), i as u32);
        let mut all: Vec<_> = (0..points.len()).map(distance).filter(|d| Some(d.1) != left_out).collect();
        let order = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if places > 0 && places < all.len() {
            all.select_nth_unstable_by(places - 1, order);
            all.truncate(places);
        }
        all.sort_unstable_by(order);
        all
    };
    let rows: Vec<Vec<(f64, u32)>> = sample.par_iter().map(row).collect();
    let rounded = |row: Vec<(f64, u32)>| row.into_iter().map(|(dist2, id)| (dist2 as f32, id)).collect();
    KnnRows::of_candidates(k, rows.into_iter().map(rounded).collect())
}

/// The points of each query of `sample` with d² ≤ r² · (1 + `slack`), and their squared distances.
pub(super) fn within(
    points: &Points,
    queries: Queries<'_>,
    sample: &[u32],
    radius: f32,
    slack: f64,
) -> Vec<Vec<(u32, f64)>> {
    let (asking, limit) = (queries.of(points), f64::from(radius) * f64::from(radius) * (1.0 + slack));
    let row = |&query: &u32| {
        let (center, left_out) = (asking.get(query as usize), queries.left_out(query as usize));
        let distance = |i: usize| (i as u32, dist2_in_f64(center, points.get(i)));
        (0..points.len()).map(distance).filter(|d| d.1 <= limit && Some(d.0) != left_out).collect()
    };
    sample.par_iter().map(row).collect()
}

/// Mean number of points within the radius of the sampled points, at least and at most: a pair so close to the radius that
/// f32 may decide either way may count or not.
pub(super) fn mean_within(points: &Points, sample: &[u32], radius: f32) -> (f64, f64) {
    let slack = 2.0 * slack(points.dimension());
    let near = within(points, Queries::Points, sample, radius, slack);
    let certain = f64::from(radius) * f64::from(radius) * (1.0 - slack);
    let least: usize = near.iter().map(|row| row.iter().filter(|n| n.1 <= certain).count()).sum();
    let most: usize = near.iter().map(Vec::len).sum();
    let mean = |total: usize| total as f64 / sample.len().max(1) as f64;
    (mean(least), mean(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_on_a_line_are_the_next_ones() {
        let points = Points::new(2, (0..10).flat_map(|i| [i as f32, 0.0]).collect()).expect("points");
        let rows = knn(&points, Queries::Points, &[0, 5], 3);
        assert_eq!((rows.row(0), rows.row(1)), (&[0, 1, 2][..], &[5, 4, 6][..]));
        let rows = knn(&points, Queries::PointsWithoutSelf, &[5], 12);
        assert_eq!(rows.row(0), [4, 6, 3, 7, 2, 8, 1, 9, 0]);
        assert_eq!(within(&points, Queries::Points, &[0], 1.0, 0.0), [[(0, 0.0), (1, 1.0)]]);
        assert_eq!(sample(10, 4), [0, 3, 6, 9]);
    }
}
