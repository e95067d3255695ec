//! Answers of the baselines: rows of the k nearest, and lists of what lies within a radius.

use nearfield::query::Stage;

/// Index that stands for "no more points".
pub const NONE: u32 = u32::MAX;

/// Rows of `k` places in query order, nearest first, ties by lower index. Where a method found fewer points a row ends
/// with [`NONE`] and an infinite distance.
#[derive(Debug, Clone, PartialEq)]
pub struct KnnRows {
    k: usize,
    ids: Vec<u32>,
    dist2: Vec<f32>,
}

impl KnnRows {
    /// Of `[q × k]` indices and squared distances.
    ///
    /// # Panics
    /// If k is 0, the lengths differ or are no multiple of k.
    pub fn new(k: usize, ids: Vec<u32>, dist2: Vec<f32>) -> Self {
        assert!(k > 0 && ids.len() == dist2.len() && ids.len().is_multiple_of(k), "rows should be whole");
        Self { k, ids, dist2 }
    }

    /// Puts the nearest `k` of each row's candidates first; candidates may stand in any order.
    pub(super) fn of_candidates(k: usize, rows: Vec<Vec<(f32, u32)>>) -> Self {
        let (mut ids, mut dist2) = (Vec::with_capacity(k * rows.len()), Vec::with_capacity(k * rows.len()));
        for mut row in rows {
            row.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            row.resize(row.len().max(k), (f32::INFINITY, NONE));
            ids.extend(row[..k].iter().map(|c| c.1));
            dist2.extend(row[..k].iter().map(|c| c.0));
        }
        Self::new(k, ids, dist2)
    }

    /// Rows as a kernel leaves them: the largest f32 stands where there is no point.
    pub(super) fn of_device(k: usize, ids: Vec<u32>, mut dist2: Vec<f32>) -> Self {
        for (dist2, _) in dist2.iter_mut().zip(&ids).filter(|(_, id)| **id == NONE) {
            *dist2 = f32::INFINITY;
        }
        Self::new(k, ids, dist2)
    }

    /// Places of a row.
    pub fn k(&self) -> usize {
        self.k
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.ids.len() / self.k
    }

    /// Whether there is no query.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// `[q × k]` indices.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// `[q × k]` squared distances.
    pub fn dist2(&self) -> &[f32] {
        &self.dist2
    }

    /// Indices found by query `i`.
    ///
    /// # Panics
    /// If there is no such query.
    pub fn row(&self, i: usize) -> &[u32] {
        let row = &self.ids[i * self.k..(i + 1) * self.k];
        &row[..row.iter().position(|&id| id == NONE).unwrap_or(self.k)]
    }

    /// Squared distances of what query `i` found.
    ///
    /// # Panics
    /// If there is no such query.
    pub fn row_dist2(&self, i: usize) -> &[f32] {
        &self.dist2[i * self.k..i * self.k + self.row(i).len()]
    }

    /// Mean number of points found by a query.
    pub fn mean_found(&self) -> f64 {
        self.ids.iter().filter(|&&id| id != NONE).count() as f64 / self.len().max(1) as f64
    }

    /// What of the rows lies within the closed ball d² ≤ r² in f32: how a search for the nearest answers a range search,
    /// at most k a query.
    pub fn within(&self, radius: f32) -> RangeRows {
        let inside = |i| {
            let row = self.row(i).iter().zip(self.row_dist2(i));
            row.filter(|(_, dist2)| **dist2 <= radius * radius).map(|(&id, _)| id).collect()
        };
        RangeRows::of_rows((0..self.len()).map(inside).collect())
    }
}

/// Compressed sparse rows in query order: the points that a method found within a radius, in any order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RangeRows {
    /// `[q + 1]` where each row starts, and the end of the last.
    pub offsets: Vec<u64>,
    /// Indices into the points.
    pub ids: Vec<u32>,
}

impl RangeRows {
    /// Of one vector a row.
    pub fn of_rows(rows: Vec<Vec<u32>>) -> Self {
        let mut offsets = Vec::with_capacity(rows.len() + 1);
        offsets.push(0);
        offsets.extend(rows.iter().scan(0, |end, row| {
            *end += row.len() as u64;
            Some(*end)
        }));
        Self { offsets, ids: rows.concat() }
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is no query.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Indices found by query `i`.
    ///
    /// # Panics
    /// If there is no such query.
    pub fn row(&self, i: usize) -> &[u32] {
        &self.ids[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }

    /// Points found by each query.
    pub fn counts(&self) -> Vec<u32> {
        self.offsets.windows(2).map(|w| (w[1] - w[0]) as u32).collect()
    }

    /// The same rows, each in ascending order.
    pub fn sorted(mut self) -> Self {
        for i in 0..self.len() {
            self.ids[self.offsets[i] as usize..self.offsets[i + 1] as usize].sort_unstable();
        }
        self
    }

    /// Mean number of points found by a query.
    pub fn mean_found(&self) -> f64 {
        self.ids.len() as f64 / self.len().max(1) as f64
    }
}

/// An answer and the times of its stages.
#[derive(Debug, Clone)]
pub struct Timed<T> {
    /// The answer.
    pub answer: T,
    /// Stages in order, by the device's clock; empty where it has none.
    pub stages: Vec<Stage>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidates_are_put_in_order_and_short_rows_filled() {
        let rows = KnnRows::of_candidates(2, vec![vec![(4.0, 9), (1.0, 7), (1.0, 3)], vec![(2.0, 5)]]);
        assert_eq!(rows.ids(), [3, 7, 5, NONE]);
        assert_eq!(rows.dist2(), [1.0, 1.0, 2.0, f32::INFINITY]);
        assert_eq!((rows.row(1), rows.row_dist2(1), rows.mean_found()), (&[5][..], &[2.0][..], 1.5));
    }

    #[test]
    fn rows_within_a_radius_hold_its_border() {
        let rows = KnnRows::of_candidates(2, vec![vec![(0.25, 9), (0.0625, 7)], vec![(0.26, 5)]]).within(0.5);
        assert_eq!((rows.counts(), rows.row(0)), (vec![2, 0], &[7, 9][..]));
    }
}
