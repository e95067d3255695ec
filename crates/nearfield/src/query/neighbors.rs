//! The answers: rows of neighbours, counts, and the nearest neighbour.

use super::Report;

/// One neighbour of a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbor {
    /// Index into the points as the caller gave them.
    pub index: u32,
    /// Squared distance.
    pub dist2: f32,
}

impl Neighbor {
    /// Distance.
    pub fn distance(&self) -> f32 {
        self.dist2.sqrt()
    }
}

/// Neighbours of every query as compressed sparse rows, in query order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Neighbors {
    pub(crate) offsets: Vec<u64>,
    pub(crate) indices: Vec<u32>,
    pub(crate) distances: Option<Vec<f32>>,
    pub(crate) cut: Vec<CutRow>,
    /// What ran.
    pub report: Report,
}

/// A row that the caller's cap made shorter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CutRow {
    /// The query.
    pub query: u32,
    /// How many of its neighbours are not in the list.
    pub missing: u32,
}

/// Mean, smallest and largest number of neighbours a query.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Summary {
    /// Sum over all queries.
    pub total: u64,
    /// Mean; 0 without queries.
    pub mean: f64,
    /// Smallest; 0 without queries.
    pub min: u32,
    /// Largest; 0 without queries.
    pub max: u32,
}

impl Summary {
    /// Summary of row lengths.
    pub fn of(lengths: impl Iterator<Item = u32>) -> Self {
        let (mut n, mut total, mut min, mut max) = (0u64, 0u64, u32::MAX, 0u32);
        for length in lengths {
            n += 1;
            total += u64::from(length);
            min = min.min(length);
            max = max.max(length);
        }
        if n == 0 {
            return Self::default();
        }
        Self { total, mean: total as f64 / n as f64, min, max }
    }
}

impl Neighbors {
    /// Number of rows, one a query.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Whether there is no query.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `[q + 1]` monotone: row i is `indices[offsets[i]..offsets[i + 1]]`.
    pub fn offsets(&self) -> &[u64] {
        &self.offsets
    }

    /// `[nnz]` indices into the points as the caller gave them.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// `[nnz]` distances (not squared), where asked for.
    pub fn distances(&self) -> Option<&[f32]> {
        self.distances.as_deref()
    }

    /// Neighbours of query `i`.
    ///
    /// # Panics
    /// If `i` is not below [`Neighbors::len`].
    pub fn row(&self, i: usize) -> &[u32] {
        &self.indices[self.range(i)]
    }

    /// Distances of the neighbours of query `i`, where asked for.
    ///
    /// # Panics
    /// If `i` is not below [`Neighbors::len`].
    pub fn row_distances(&self, i: usize) -> Option<&[f32]> {
        self.distances.as_ref().map(|d| &d[self.range(i)])
    }

    fn range(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i] as usize..self.offsets[i + 1] as usize
    }

    /// Rows shortened by `max_neighbors`, ascending by query, with how many neighbours each lost.
    pub fn cut(&self) -> &[CutRow] {
        &self.cut
    }

    /// Mean, smallest and largest row.
    pub fn summary(&self) -> Summary {
        Summary::of(self.offsets.windows(2).map(|w| (w[1] - w[0]) as u32))
    }

    /// Offsets, indices and distances, for callers that need the vectors.
    pub fn into_parts(self) -> (Vec<u64>, Vec<u32>, Option<Vec<f32>>) {
        (self.offsets, self.indices, self.distances)
    }
}

/// Number of neighbours of every query.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Counts {
    pub(crate) counts: Vec<u32>,
    /// What ran.
    pub report: Report,
}

impl Counts {
    /// `[q]` counts in query order.
    pub fn as_slice(&self) -> &[u32] {
        &self.counts
    }

    /// Mean, smallest and largest count.
    pub fn summary(&self) -> Summary {
        Summary::of(self.counts.iter().copied())
    }

    /// The counts themselves.
    pub fn into_vec(self) -> Vec<u32> {
        self.counts
    }
}

/// The nearest point within the radius of every query.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Nearest {
    pub(crate) indices: Vec<u32>,
    pub(crate) dist2: Vec<f32>,
    /// What ran.
    pub report: Report,
}

impl Nearest {
    /// Index that stands for "no point within the radius".
    pub const NONE: u32 = u32::MAX;

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// Whether there is no query.
    pub fn is_empty(&self) -> bool {
        self.indices.is_empty()
    }

    /// The nearest point of query `i`, ties by lower index; `None` where the ball is empty.
    ///
    /// # Panics
    /// If `i` is not below [`Nearest::len`].
    pub fn get(&self, i: usize) -> Option<Neighbor> {
        let index = self.indices[i];
        (index != Self::NONE).then(|| Neighbor { index, dist2: self.dist2[i] })
    }

    /// `[q]` indices, [`Nearest::NONE`] where the ball is empty.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// `[q]` squared distances, infinite where the ball is empty.
    pub fn dist2(&self) -> &[f32] {
        &self.dist2
    }
}

/// Rows as start and length, standing in the order in which they were finished: for callers that need no
/// monotone offsets, and cheaper to make than [`Neighbors`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NeighborRows {
    pub(crate) starts: Vec<u64>,
    pub(crate) lengths: Vec<u32>,
    pub(crate) indices: Vec<u32>,
    /// What ran.
    pub report: Report,
}

impl NeighborRows {
    /// Number of rows, one a query.
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// Whether there is no query.
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// Neighbours of query `i`.
    ///
    /// # Panics
    /// If `i` is not below [`NeighborRows::len`].
    pub fn row(&self, i: usize) -> &[u32] {
        let start = self.starts[i] as usize;
        &self.indices[start..start + self.lengths[i] as usize]
    }

    /// Mean, smallest and largest row.
    pub fn summary(&self) -> Summary {
        Summary::of(self.lengths.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_slices_between_offsets() {
        let list = Neighbors { offsets: vec![0, 2, 2, 5], indices: vec![4, 1, 0, 2, 3], ..Neighbors::default() };
        assert_eq!(list.len(), 3);
        assert_eq!((list.row(0), list.row(1), list.row(2)), (&[4, 1][..], &[][..], &[0, 2, 3][..]));
        assert_eq!(list.summary(), Summary { total: 5, mean: 5.0 / 3.0, min: 0, max: 3 });
    }

    #[test]
    fn summary_of_nothing_is_zero() {
        assert_eq!(Neighbors::default().summary(), Summary::default());
    }
}
