//! How good an approximate answer is: recall, distances and exact rows beside brute force.
//!
//! Every answer is also checked: a distance that is not that of its point, a point twice in a row or a row out of order
//! stops the measurement. Points that are as far as the k-th nearest count as found whichever of them a method took.

use super::points::{Points, Queries, dist2_in_f64, slack};
use super::rows::{KnnRows, RangeRows};
use super::{exact, wrong};
use crate::Result;

/// How good rows of the nearest are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnnQuality {
    /// Share of the k nearest that were found.
    pub recall: f64,
    /// Mean of (distance of the j-th found) / (distance of the j-th nearest), over all places where a point was found
    /// and the nearest is not at distance 0.
    pub distance_ratio: f64,
    /// Share of the rows that hold all of the k nearest.
    pub exact_rows: f64,
}

/// How good lists within a radius are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeQuality {
    /// Share of the points within the radius that were found; 1 where there is none.
    pub recall: f64,
    /// Mean number of points within the radius of a query.
    pub mean_neighbors: f64,
}

/// Judges the rows of `sample` by `exact`, whose row i belongs to query `sample[i]`.
///
/// # Errors
/// The first row that is no honest answer: see [`check_row`]; `found` and `exact` of other lengths than asked for.
pub fn of_knn(
    points: &Points,
    queries: Queries<'_>,
    sample: &[u32],
    found: &KnnRows,
    exact: &KnnRows,
) -> Result<KnnQuality> {
    let asking = queries.of(points);
    if (found.len(), exact.len(), found.k()) != (asking.len(), sample.len(), exact.k()) {
        return Err(wrong(format!("{} rows of {} places, expected {}", found.len(), found.k(), asking.len())));
    }
    let tie = 1.0 + 2.0 * slack(points.dimension());
    let (mut hits, mut wanted, mut ratios, mut ratio, mut exact_rows) = (0, 0, 0u64, 0.0, 0);
    for (i, &query) in sample.iter().enumerate() {
        let true_dist2 = |id: &u32| dist2_in_f64(asking.get(query as usize), points.get(*id as usize));
        check_row(points, queries, query as usize, found)?;
        let found: Vec<f64> = found.row(query as usize).iter().map(true_dist2).collect();
        let nearest: Vec<f64> = exact.row(i).iter().map(true_dist2).collect();
        let farthest = nearest.last().copied().unwrap_or(0.0) * tie;
        let row_hits = found.iter().filter(|&&dist2| dist2 <= farthest).count().min(nearest.len());
        (hits, wanted) = (hits + row_hits, wanted + nearest.len());
        exact_rows += usize::from(row_hits == nearest.len());
        for (found, nearest) in found.iter().zip(&nearest).filter(|(_, nearest)| **nearest > 0.0) {
            ratio += (found / nearest).sqrt();
            ratios += 1;
        }
    }
    let share = |part: usize, of: usize| if of == 0 { 1.0 } else { part as f64 / of as f64 };
    Ok(KnnQuality {
        recall: share(hits, wanted),
        distance_ratio: if ratios == 0 { 1.0 } else { ratio / ratios as f64 },
        exact_rows: share(exact_rows, sample.len()),
    })
}

/// Checks one row: indices of points, each once and never the one left out, with their distances, nearest first.
///
/// # Errors
/// What is wrong.
pub fn check_row(points: &Points, queries: Queries<'_>, query: usize, found: &KnnRows) -> Result<()> {
    let (ids, dist2) = (found.row(query), found.row_dist2(query));
    check_ids(points, queries, query, ids)?;
    let slack = slack(points.dimension());
    for (&id, &dist2) in ids.iter().zip(dist2) {
        let exact = dist2_in_f64(queries.of(points).get(query), points.get(id as usize));
        // Below the smallest normal number a device may say zero.
        if (f64::from(dist2) - exact).abs() > slack * exact + f64::from(f32::MIN_POSITIVE) {
            return Err(wrong(format!("query {query} has point {id} at d² = {dist2:e}, which is {exact:e}")));
        }
    }
    if dist2.windows(2).any(|w| w[0] > w[1]) {
        return Err(wrong(format!("the row of query {query} is not in order of distance: {dist2:?}")));
    }
    Ok(())
}

/// Judges the lists of `sample` by brute force.
///
/// Pairs so close to the radius that f32 may decide either way are not counted.
///
/// # Errors
/// The first list that has a point twice, one that does not exist, or one outside.
pub fn of_range(
    points: &Points,
    queries: Queries<'_>,
    sample: &[u32],
    radius: f32,
    found: &RangeRows,
) -> Result<RangeQuality> {
    if found.len() != queries.of(points).len() {
        return Err(wrong(format!("{} lists, expected {}", found.len(), queries.of(points).len())));
    }
    let slack = 2.0 * slack(points.dimension());
    let certain_limit = f64::from(radius) * f64::from(radius) * (1.0 - slack);
    let (mut hits, mut certain, mut mean) = (0usize, 0usize, 0usize);
    for (&query, near) in sample.iter().zip(exact::within(points, queries, sample, radius, slack)) {
        let ids = found.row(query as usize);
        check_ids(points, queries, query as usize, ids)?;
        let mut ids = ids.to_vec();
        ids.sort_unstable();
        if let Some(outside) = ids.iter().find(|id| near.binary_search_by_key(*id, |n| n.0).is_err()) {
            return Err(wrong(format!("query {query} lists point {outside}, which is not within {radius}")));
        }
        let inside = near.iter().filter(|n| n.1 <= certain_limit);
        hits += inside.clone().filter(|n| ids.binary_search(&n.0).is_ok()).count();
        certain += inside.count();
        mean += near.len();
    }
    Ok(RangeQuality {
        recall: if certain == 0 { 1.0 } else { hits as f64 / certain as f64 },
        mean_neighbors: mean as f64 / sample.len().max(1) as f64,
    })
}

fn check_ids(points: &Points, queries: Queries<'_>, query: usize, ids: &[u32]) -> Result<()> {
    let mut sorted = ids.to_vec();
    sorted.sort_unstable();
    if let Some(twice) = sorted.windows(2).find(|w| w[0] == w[1]) {
        return Err(wrong(format!("query {query} has point {} twice", twice[0])));
    }
    if let Some(&last) = sorted.last().filter(|&&last| last as usize >= points.len()) {
        return Err(wrong(format!("query {query} has point {last} of {}", points.len())));
    }
    if queries.left_out(query).is_some_and(|id| sorted.binary_search(&id).is_ok()) {
        return Err(wrong(format!("query {query} has itself")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points 0 to 9 on a line; the three nearest of each.
    fn line() -> (Points, Vec<u32>, KnnRows) {
        let points = Points::new(2, (0..10).flat_map(|i| [i as f32, 0.0]).collect()).expect("points");
        let sample = exact::sample(10, 10);
        let rows = exact::knn(&points, Queries::Points, &sample, 3);
        (points, sample, rows)
    }

    fn with(rows: &KnnRows, changes: &[(usize, u32, f32)]) -> KnnRows {
        let (mut ids, mut dist2) = (rows.ids().to_vec(), rows.dist2().to_vec());
        for &(place, id, distance) in changes {
            (ids[place], dist2[place]) = (id, distance);
        }
        KnnRows::new(rows.k(), ids, dist2)
    }

    #[test]
    fn exact_rows_have_all_and_ratio_one() {
        let (points, sample, rows) = line();
        let quality = of_knn(&points, Queries::Points, &sample, &rows, &rows).expect("honest rows");
        assert_eq!(quality, KnnQuality { recall: 1.0, distance_ratio: 1.0, exact_rows: 1.0 });
    }

    #[test]
    fn planted_misses_lower_recall_and_raise_the_ratio() {
        let (points, sample, rows) = line();
        // Query 0 has 0, 1, 2: the last becomes 4, twice as far. Query 9 loses its last.
        let missed = with(&rows, &[(2, 4, 16.0), (29, super::super::rows::NONE, f32::INFINITY)]);
        let quality = of_knn(&points, Queries::Points, &sample, &missed, &rows).expect("honest rows");
        assert_eq!((quality.recall, quality.exact_rows), (28.0 / 30.0, 0.8));
        // 19 places are compared: 30 less the ten at distance 0 and the lost one. One of them is 2.
        assert_eq!(quality.distance_ratio, 20.0 / 19.0);
    }

    #[test]
    fn points_at_the_same_distance_are_as_good() {
        let points = Points::new(2, vec![0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 1.0]).expect("points");
        let exact = exact::knn(&points, Queries::Points, &[0], 2);
        assert_eq!(exact.row(0), [0, 1]);
        let rows = exact::knn(&points, Queries::Points, &exact::sample(4, 4), 2);
        let found = with(&rows, &[(1, 3, 1.0)]);
        let quality = of_knn(&points, Queries::Points, &[0], &found, &exact).expect("honest rows");
        assert_eq!((quality.recall, quality.exact_rows), (1.0, 1.0));
    }

    #[test]
    fn dishonest_rows_are_refused() {
        let (points, sample, rows) = line();
        for (what, changes) in [
            ("a point twice", vec![(1, 0, 0.0)]),
            ("a wrong distance", vec![(2, 4, 4.0)]),
            ("out of order", vec![(1, 2, 4.0), (2, 1, 1.0)]),
            ("no such point", vec![(2, 10, 100.0)]),
        ] {
            let planted = with(&rows, &changes);
            let error = of_knn(&points, Queries::Points, &sample, &planted, &rows).expect_err(what);
            assert!(error.to_string().contains("wrong answer"), "{what}: {error}");
        }
        of_knn(&points, Queries::PointsWithoutSelf, &sample, &rows, &rows).expect_err("the query itself");
    }

    #[test]
    fn planted_misses_and_extras_in_lists_are_seen() {
        let (points, sample, _) = line();
        let rows: Vec<Vec<u32>> = exact::within(&points, Queries::Points, &sample, 1.5, 0.0)
            .iter()
            .map(|r| r.iter().map(|n| n.0).collect())
            .collect();
        let judge =
            |rows: &[Vec<u32>]| of_range(&points, Queries::Points, &sample, 1.5, &RangeRows::of_rows(rows.to_vec()));
        let quality = judge(&rows).expect("an honest list");
        assert_eq!(quality, RangeQuality { recall: 1.0, mean_neighbors: 2.8 });
        let mut missed = rows.clone();
        missed[4].pop();
        missed[5].clear();
        assert_eq!(judge(&missed).expect("an honest list").recall, 24.0 / 28.0);
        for extra in [7, 3, 11] {
            let mut planted = rows.clone();
            planted[4].push(extra);
            judge(&planted).expect_err("outside, twice, or no point");
        }
    }
}
