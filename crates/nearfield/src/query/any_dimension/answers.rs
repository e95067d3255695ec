//! The answers: counts, rows of neighbours, rows of nearest neighbours, and what was done to find them.

use crate::query::{Report, Summary};

/// What a search of a tree has done.
///
/// The searches give the same answers and differ here: [`crate::TreeSearch::Coherent`] makes fewer traversals than
/// [`crate::TreeSearch::Primary`] and keeps candidates, which the others do not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SearchWork {
    /// Ways through the tree to find points: one a query, or one a pack. The way to the leaf that a query of another set
    /// touches is not among them.
    pub traversals: u64,
    /// Boxes looked at on all ways; on a device without those on the way to that leaf.
    pub nodes: u64,
    /// Entries of the candidate list that is kept in memory: points beside the pack that they may be neighbours of.
    pub candidates: u64,
    /// Distances computed between a query and a point.
    pub tests: u64,
}

impl std::ops::AddAssign for SearchWork {
    fn add_assign(&mut self, other: Self) {
        self.traversals += other.traversals;
        self.nodes += other.nodes;
        self.candidates += other.candidates;
        self.tests += other.tests;
    }
}

/// Number of neighbours of every query.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CountsN {
    pub(crate) counts: Vec<u32>,
    /// What was done.
    pub work: SearchWork,
    /// What ran.
    pub report: Report,
}

impl CountsN {
    /// `[q]` counts in query order.
    pub fn as_slice(&self) -> &[u32] {
        &self.counts
    }

    /// Mean, smallest and largest count.
    pub fn summary(&self) -> Summary {
        Summary::of(self.counts.iter().copied())
    }
}

/// Neighbours of every query as compressed sparse rows, in query order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NeighborsN<T> {
    pub(crate) offsets: Vec<u64>,
    pub(crate) indices: Vec<u32>,
    pub(crate) dist2: Vec<T>,
    /// What was done.
    pub work: SearchWork,
    /// What ran.
    pub report: Report,
}

impl<T> NeighborsN<T> {
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

    /// `[nnz]` squared distances.
    pub fn dist2(&self) -> &[T] {
        &self.dist2
    }

    /// Neighbours of query `i`.
    ///
    /// # Panics
    /// If `i` is not below [`NeighborsN::len`].
    pub fn row(&self, i: usize) -> &[u32] {
        &self.indices[self.range(i)]
    }

    /// Squared distances of the neighbours of query `i`.
    ///
    /// # Panics
    /// If `i` is not below [`NeighborsN::len`].
    pub fn row_dist2(&self, i: usize) -> &[T] {
        &self.dist2[self.range(i)]
    }

    fn range(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i] as usize..self.offsets[i + 1] as usize
    }

    /// Mean, smallest and largest row.
    pub fn summary(&self) -> Summary {
        Summary::of(self.offsets.windows(2).map(|ends| (ends[1] - ends[0]) as u32))
    }
}

/// The nearest points of every query: rows of `k` places in query order, nearest first, ties by lower index.
///
/// Where there are fewer than `k` points, a row ends with places that hold [`NearestN::NONE`] and an infinite distance.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NearestN<T> {
    pub(crate) k: usize,
    pub(crate) n_queries: usize,
    pub(crate) indices: Vec<u32>,
    pub(crate) dist2: Vec<T>,
    /// What was done.
    pub work: SearchWork,
    /// What ran.
    pub report: Report,
}

impl<T> NearestN<T> {
    /// Index that stands for "no more points".
    pub const NONE: u32 = u32::MAX;

    /// Places of a row: the `k` that was asked for.
    pub fn k(&self) -> usize {
        self.k
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.n_queries
    }

    /// Whether there is no query.
    pub fn is_empty(&self) -> bool {
        self.n_queries == 0
    }

    /// `[q × k]` indices into the points as the caller gave them, [`NearestN::NONE`] where there is no point.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// `[q × k]` squared distances, infinite where there is no point.
    pub fn dist2(&self) -> &[T] {
        &self.dist2
    }

    /// Neighbours of query `i`, without empty places.
    ///
    /// # Panics
    /// If `i` is not below [`NearestN::len`].
    pub fn row(&self, i: usize) -> &[u32] {
        let row = &self.indices[i * self.k..(i + 1) * self.k];
        &row[..row.partition_point(|&index| index != Self::NONE)]
    }

    /// Squared distances of the neighbours of query `i`, without empty places.
    ///
    /// # Panics
    /// If `i` is not below [`NearestN::len`].
    pub fn row_dist2(&self, i: usize) -> &[T] {
        &self.dist2[i * self.k..i * self.k + self.row(i).len()]
    }
}
