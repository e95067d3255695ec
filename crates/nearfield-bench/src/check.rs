//! The answer a measurement must give, and the comparison that stops it where it does not.
//!
//! Devices round d² differently by a few units in the last place, so a pair of points whose distance is that close to
//! the radius may count or not. Everything else must be exact. With u = 2⁻²⁴, a squared distance computed in f32 by any
//! order of multiplications and additions is off by at most 5 u and a squared radius by u, relatively: a pair is
//! *certain* if d² ≤ r² (1 - 7 u) in f64, *possible* if d² ≤ r² (1 + 7 u).

use nearfield::{FixedRadius, GridSettings, NeighborSearch, UniformGrid, Vec3};
use rayon::prelude::*;

use crate::{Error, Result};

/// Unit roundoff of f32.
const U: f64 = 1.0 / (1u64 << 24) as f64;
/// Relative slack of d² that rounding can use up.
const SLACK: f64 = 7.0 * U;
/// Relative change of the radius that moves every boundary pair to one side on any device.
const RADIUS_SLACK: f64 = 8.0 * U;
/// Slack of d² outside of which even the changed radii must agree with f64.
const WIDE_SLACK: f64 = 32.0 * U;
/// Rows compared one by one.
const SAMPLE_ROWS: usize = 100;

/// What every answer over the points themselves must be.
#[derive(Debug, Clone)]
pub struct Expected {
    lowest: Vec<u32>,
    highest: Vec<u32>,
    sample: Vec<SampleRow>,
}

/// Checks rows of the `k` nearest points of all points, themselves included: the sampled rows name `k` points each once, none
/// of which is farther than the true k-th by more than rounding, in ascending order but for that.
///
/// # Errors
/// The first row that is wrong.
pub fn check_nearest(points: &[Vec3], k: u32, indices: &[u32]) -> Result<()> {
    let places = (k as usize).min(points.len());
    if indices.len() != places * points.len() {
        return Err(wrong(format!("{} places in rows of {places}, expected {}", indices.len(), places * points.len())));
    }
    let step = points.len().div_ceil(SAMPLE_ROWS).max(1);
    for query in (0..points.len()).step_by(step) {
        let dist2 = |i: usize| points[query].as_dvec3().distance_squared(points[i].as_dvec3());
        let mut all: Vec<f64> = (0..points.len()).into_par_iter().map(dist2).collect();
        let farthest = *all.select_nth_unstable_by(places - 1, f64::total_cmp).1 * (1.0 + SLACK);
        let row = &indices[query * places..(query + 1) * places];
        let found: Vec<f64> = row.iter().map(|&i| dist2(i as usize)).collect();
        let mut distinct = row.to_vec();
        distinct.sort_unstable();
        distinct.dedup();
        let ascends = found.windows(2).all(|pair| pair[0] <= pair[1] * (1.0 + SLACK));
        if distinct.len() != places || !ascends || found.iter().any(|&d2| d2 > farthest) {
            return Err(wrong(format!("query {query} has {row:?} at {found:?}, the farthest should be at {farthest}")));
        }
    }
    Ok(())
}

/// A row by a plain loop in f64; indices ascending.
#[derive(Debug, Clone)]
struct SampleRow {
    query: usize,
    certain: Vec<u32>,
    possible: Vec<u32>,
}

impl Expected {
    /// Bounds of every count by the grid on the CPU with a radius a little smaller and larger, and the rows of 100
    /// queries by a plain loop in f64; the first is checked against the second.
    ///
    /// # Errors
    /// As the grid; where grid and loop differ.
    pub fn of(points: &[Vec3], radius: f32) -> Result<Self> {
        Self::around(points, points, radius)
    }

    /// The same for queries that are other places.
    ///
    /// # Errors
    /// As [`Expected::of`].
    pub fn around(points: &[Vec3], queries: &[Vec3], radius: f32) -> Result<Self> {
        let grid = UniformGrid::build(points, &GridSettings::for_radius(radius))?;
        let count = |change: f64| -> Result<Vec<u32>> {
            let radius = (f64::from(radius) * (1.0 + change)) as f32;
            Ok(grid.count(&FixedRadius::new(radius).queries(queries))?.into_vec())
        };
        let (lowest, highest) = (count(-RADIUS_SLACK)?, count(RADIUS_SLACK)?);
        let step = queries.len().div_ceil(SAMPLE_ROWS).max(1);
        let mut sample = Vec::new();
        for query in (0..queries.len()).step_by(step) {
            let (lowest, highest) = (lowest[query] as usize, highest[query] as usize);
            let [surely, certain, possible, perhaps] = rows_in_f64(points, queries[query], radius);
            if !(surely.len() <= lowest && lowest <= highest && highest <= perhaps.len()) {
                let (surely, perhaps) = (surely.len(), perhaps.len());
                return Err(wrong(format!(
                    "the reference counts {lowest} to {highest} neighbours of query {query}, a plain loop {surely} to {perhaps}"
                )));
            }
            sample.push(SampleRow { query, certain, possible });
        }
        Ok(Self { lowest, highest, sample })
    }

    /// Smallest and largest right total.
    pub fn total(&self) -> (u64, u64) {
        (self.lowest.iter().map(|&c| u64::from(c)).sum(), self.highest.iter().map(|&c| u64::from(c)).sum())
    }

    /// Mean neighbours of a query, itself included.
    pub fn mean(&self) -> f64 {
        self.total().0 as f64 / self.lowest.len().max(1) as f64
    }

    /// Checks a total.
    ///
    /// # Errors
    /// The bounds and the total, where it is outside.
    pub fn check_total(&self, total: u64) -> Result<()> {
        let (lowest, highest) = self.total();
        if (lowest..=highest).contains(&total) {
            return Ok(());
        }
        Err(wrong(format!("{total} neighbours in all, expected {lowest} to {highest}")))
    }

    /// Checks the number of neighbours of every query.
    ///
    /// # Errors
    /// The first count that is wrong.
    pub fn check_counts(&self, counts: &[u32]) -> Result<()> {
        if counts.len() != self.lowest.len() {
            return Err(wrong(format!("{} counts, expected {}", counts.len(), self.lowest.len())));
        }
        for (query, &count) in counts.iter().enumerate() {
            let (lowest, highest) = (self.lowest[query], self.highest[query]);
            if !(lowest..=highest).contains(&count) {
                return Err(wrong(format!("query {query} has {count} neighbours, expected {lowest} to {highest}")));
            }
        }
        self.check_total(counts.iter().map(|&c| u64::from(c)).sum())
    }

    /// Checks a list: monotone offsets that end with the indices, every row's length, and the sampled rows in full.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check_list(&self, offsets: &[u64], indices: &[u32]) -> Result<()> {
        let ends = (offsets.first().copied(), offsets.last().copied());
        if ends != (Some(0), Some(indices.len() as u64)) {
            return Err(wrong(format!("offsets run from and to {ends:?}, expected 0 and {}", indices.len())));
        }
        if let Some(at) = offsets.windows(2).position(|w| w[1] < w[0]) {
            return Err(wrong(format!("offset {} is smaller than offset {at}", at + 1)));
        }
        let lengths: Vec<u32> = offsets.windows(2).map(|w| (w[1] - w[0]) as u32).collect();
        self.check_counts(&lengths)?;
        for row in &self.sample {
            let mut found = indices[offsets[row.query] as usize..offsets[row.query + 1] as usize].to_vec();
            found.sort_unstable();
            row.check(&found)?;
        }
        Ok(())
    }

    /// Share of the neighbours of the sampled queries that a list holds which may miss some.
    ///
    /// # Errors
    /// The first sampled row with a point twice, or with one that is no neighbour.
    pub fn recall(&self, offsets: &[u64], indices: &[u32]) -> Result<f64> {
        if offsets.len() != self.lowest.len() + 1 || offsets.last() != Some(&(indices.len() as u64)) {
            let (rows, expected) = (offsets.len().saturating_sub(1), self.lowest.len());
            return Err(wrong(format!("{rows} rows with {} indices, expected {expected} whole rows", indices.len())));
        }
        let (mut hits, mut certain) = (0, 0);
        for row in &self.sample {
            let mut found = indices[offsets[row.query] as usize..offsets[row.query + 1] as usize].to_vec();
            found.sort_unstable();
            let found_certain = row.certain.iter().filter(|id| found.binary_search(id).is_ok()).copied().collect();
            SampleRow { query: row.query, certain: found_certain, possible: row.possible.clone() }.check(&found)?;
            hits += row.certain.iter().filter(|id| found.binary_search(id).is_ok()).count();
            certain += row.certain.len();
        }
        Ok(if certain == 0 { 1.0 } else { hits as f64 / certain as f64 })
    }

    /// Checks rows of start and length in any order: together they are all indices, each once.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check_rows(&self, starts: &[u32], lengths: &[u32], indices: &[u32]) -> Result<()> {
        let mut rows: Vec<(u32, u32)> = starts.iter().copied().zip(lengths.iter().copied()).collect();
        rows.retain(|&(_, length)| length > 0);
        rows.sort_unstable();
        let mut end = 0u64;
        for (start, length) in rows {
            if u64::from(start) != end {
                return Err(wrong(format!("a row starts at {start} where {end} is the next free place")));
            }
            end += u64::from(length);
        }
        if end != indices.len() as u64 {
            return Err(wrong(format!("rows end at {end}, expected {}", indices.len())));
        }
        let mut offsets = vec![0u64];
        let mut ordered = Vec::with_capacity(indices.len());
        for (&start, &length) in starts.iter().zip(lengths) {
            ordered.extend_from_slice(&indices[start as usize..(start + length) as usize]);
            offsets.push(ordered.len() as u64);
        }
        self.check_list(&offsets, &ordered)
    }
}

/// What the counts of some queries over the points themselves must be: for sets that are too large to be counted a second time.
#[derive(Debug, Clone)]
pub struct ExpectedOfSome {
    points: usize,
    /// A query, its smallest and its largest right count.
    bounds: Vec<(usize, usize, usize)>,
}

impl ExpectedOfSome {
    /// Of about so many queries, spread evenly over the points, by a plain loop in f64.
    pub fn of(points: &[Vec3], radius: f32, queries: usize) -> Self {
        let step = points.len().div_ceil(queries.max(1)).max(1);
        let bounds = |query: usize| {
            let [_, certain, possible, _] = rows_in_f64(points, points[query], radius);
            (query, certain.len(), possible.len())
        };
        Self { points: points.len(), bounds: (0..points.len()).step_by(step).map(bounds).collect() }
    }

    /// Checks counts of all points by those of these queries.
    ///
    /// # Errors
    /// Another number of counts; the first count that is wrong.
    pub fn check_counts(&self, counts: &[u32]) -> Result<()> {
        if counts.len() != self.points {
            return Err(wrong(format!("{} counts, expected {}", counts.len(), self.points)));
        }
        for &(query, lowest, highest) in &self.bounds {
            let count = counts[query];
            if !(lowest..=highest).contains(&(count as usize)) {
                return Err(wrong(format!("query {query} has {count} neighbours, expected {lowest} to {highest}")));
            }
        }
        Ok(())
    }
}

impl SampleRow {
    fn check(&self, found: &[u32]) -> Result<()> {
        let query = self.query;
        if let Some(twice) = found.windows(2).find(|w| w[0] == w[1]) {
            return Err(wrong(format!("query {query} has neighbour {} twice", twice[0])));
        }
        if let Some(missing) = self.certain.iter().find(|i| found.binary_search(i).is_err()) {
            return Err(wrong(format!("query {query} lacks its neighbour {missing}")));
        }
        if let Some(extra) = found.iter().find(|i| self.possible.binary_search(i).is_err()) {
            return Err(wrong(format!("query {query} has {extra}, which is no neighbour")));
        }
        Ok(())
    }
}

/// Points near a query by a plain loop: with the slacks -wide, -rounding, +rounding, +wide.
fn rows_in_f64(points: &[Vec3], query: Vec3, radius: f32) -> [Vec<u32>; 4] {
    let (center, radius) = (query.as_dvec3(), f64::from(radius));
    let radius2 = radius * radius;
    let perhaps: Vec<(u32, f64)> = points
        .par_iter()
        .enumerate()
        .with_min_len(1 << 14)
        .map(|(i, p)| (i as u32, p.as_dvec3().distance_squared(center)))
        .filter(|&(_, d2)| d2 <= radius2 * (1.0 + WIDE_SLACK))
        .collect();
    [-WIDE_SLACK, -SLACK, SLACK, WIDE_SLACK].map(|slack| {
        let inside = perhaps.iter().filter(|&&(_, d2)| d2 <= radius2 * (1.0 + slack));
        inside.map(|&(i, _)| i).collect()
    })
}

/// The error of an answer that is wrong.
pub(crate) fn wrong(what: String) -> Error {
    format!("wrong answer: {what}").into()
}

#[cfg(test)]
mod tests {
    use nearfield::geometry::generate::{CloudKind, cloud};

    use super::*;

    #[test]
    fn nearest_points_are_checked_by_distance_order_and_number() {
        let points: Vec<Vec3> = (0..10).map(|i| Vec3::new((i * i) as f32, 0.0, 0.0)).collect();
        let mut indices = Vec::new();
        for query in 0..points.len() {
            let mut order: Vec<u32> = (0..10).collect();
            order.sort_by(|&a, &b| {
                let dist2 = |i: u32| points[query].distance_squared(points[i as usize]);
                dist2(a).total_cmp(&dist2(b))
            });
            indices.extend_from_slice(&order[..3]);
        }
        assert!(check_nearest(&points, 3, &indices).is_ok());
        for (place, other) in [(2, 9), (1, indices[0]), (0, indices[2])] {
            let mut planted = indices.clone();
            planted[place] = other;
            assert!(check_nearest(&points, 3, &planted).is_err(), "place {place}");
        }
        assert!(check_nearest(&points, 3, &indices[3..]).is_err());
    }
    use crate::sets::Set;

    fn case() -> (Expected, Vec<u64>, Vec<u32>) {
        let set: Set = "uniform-2k".parse().expect("a set");
        let (points, radius) = (set.points(), set.radius());
        let list = nearfield::BruteForce::build(&points).and_then(|b| b.list(&FixedRadius::new(radius)));
        let (offsets, indices, _) = list.expect("a list").into_parts();
        (Expected::of(&points, radius).expect("a reference"), offsets, indices)
    }

    #[test]
    fn lists_around_other_places_are_judged_by_them() {
        let set: Set = "uniform-2k".parse().expect("a set");
        let (points, radius) = (set.points(), set.radius());
        let queries: Vec<Vec3> = points.iter().take(300).map(|p| 0.5 * *p + 0.25).collect();
        let list =
            nearfield::BruteForce::build(&points).and_then(|b| b.list(&FixedRadius::new(radius).queries(&queries)));
        let (offsets, indices, _) = list.expect("a list").into_parts();
        let expected = Expected::around(&points, &queries, radius).expect("a reference");
        expected.check_list(&offsets, &indices).expect("the list is right");
        let other = Expected::around(&points, &points[..300], radius).expect("a reference");
        assert!(other.check_list(&offsets, &indices).is_err());
    }

    #[test]
    fn a_right_list_passes() {
        let (expected, offsets, indices) = case();
        expected.check_list(&offsets, &indices).expect("the list is right");
        expected.check_total(indices.len() as u64).expect("the total is right");
    }

    #[test]
    fn a_planted_total_is_caught() {
        let (expected, offsets, indices) = case();
        assert!(expected.check_total(indices.len() as u64 + 1).is_err());
        assert!(expected.check_total(indices.len() as u64 - 1).is_err());
        let mut counts: Vec<u32> = offsets.windows(2).map(|w| (w[1] - w[0]) as u32).collect();
        expected.check_counts(&counts).expect("the counts are right");
        // The total stays, two counts are wrong.
        counts[3] += 1;
        counts[4] -= 1;
        assert!(expected.check_counts(&counts).is_err());
    }

    #[test]
    fn counts_of_some_queries_are_those_of_all_and_a_planted_one_is_caught() {
        let points = cloud(CloudKind::Uniform, 2000, 7).points;
        let radius = 0.1;
        let counts = UniformGrid::build(&points, &GridSettings::for_radius(radius)).expect("a grid");
        let mut counts = counts.count(&FixedRadius::new(radius)).expect("counts").into_vec();
        let some = ExpectedOfSome::of(&points, radius, 50);
        assert_eq!(some.bounds.len(), 50);
        some.check_counts(&counts).expect("right counts");
        assert!(some.check_counts(&counts[1..]).is_err());
        counts[40] += 1;
        assert!(some.check_counts(&counts).is_err(), "one of every fortieth");
    }

    #[test]
    fn recall_counts_what_is_missing_and_refuses_what_is_no_neighbor() {
        let (expected, offsets, mut indices) = case();
        assert_eq!(expected.recall(&offsets, &indices).expect("honest rows"), 1.0);
        let none = vec![0; offsets.len()];
        assert_eq!(expected.recall(&none, &[]).expect("honest rows"), 0.0);
        indices[0] = indices[1];
        assert!(expected.recall(&offsets, &indices).is_err(), "an index twice");
        indices[0] = if indices[..offsets[1] as usize].contains(&1999) { 1998 } else { 1999 };
        assert!(expected.recall(&offsets, &indices).is_err(), "a foreign index");
        assert!(expected.recall(&offsets[1..], &indices).is_err(), "a row too few");
    }

    #[test]
    fn planted_rows_and_offsets_are_caught() {
        let (expected, mut offsets, mut indices) = case();
        let first = indices[0];
        indices[0] =
            if indices.contains(&1999) && !indices[..offsets[1] as usize].contains(&1999) { 1999 } else { 1998 };
        assert!(expected.check_list(&offsets, &indices).is_err(), "a foreign index");
        indices[0] = indices[1];
        assert!(expected.check_list(&offsets, &indices).is_err(), "an index twice");
        indices[0] = first;
        offsets.swap(5, 6);
        assert!(expected.check_list(&offsets, &indices).is_err(), "offsets not monotone");
    }
}
