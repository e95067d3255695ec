//! The question for the k nearest points, however far they are or within a radius, and its answer.
//!
//! The search in a tree starts at the smallest node around the query that has k points, which gives a first distance, and
//! then looks at every node that can hold something nearer; a radius bounds that distance from the start, and the search
//! then starts at a node about as wide as the radius where that is smaller. Source: Friedman1977, who start in the leaf of a kd-tree.
//! Cost: 8 bytes a neighbour.

mod by_pack;
mod cpu;

use glam::Vec3;

use super::{FixedRadius, Neighbor, Queries, Radius, Report, RowOrder, rows};
use crate::{Error, Result};

/// A search for the `k` nearest points of every point of a structure, or of other query points: however far they are, or
/// with [`Knn::within`] only those in the closed ball of a radius.
///
/// Neighbours are ordered by squared distance in f32, ties by lower index; a query that is itself a point of the
/// structure is its own nearest neighbour unless [`Knn::exclude_self`] is set. Exact duplicates are neighbours at
/// distance 0. The nearest neighbour is k = 1; k = 0 finds nothing. With a radius a point is a neighbour when its
/// squared distance is ≤ radius², both in f32, as in [`FixedRadius`]; radius 0 finds exact duplicates.
///
/// ```
/// use nearfield::{Knn, KnnSearch, LinearOctree, OctreeSettings, Vec3};
///
/// let points = [Vec3::ZERO, Vec3::new(3.0, 0.0, 0.0), Vec3::new(4.0, 0.0, 0.0)];
/// let tree = LinearOctree::build(&points, &OctreeSettings::default())?;
/// let nearest = tree.knn(&Knn::new(1).exclude_self())?;
/// assert_eq!((nearest.row(0), nearest.row(1), nearest.row(2)), (&[1][..], &[2][..], &[1][..]));
/// let near = tree.knn(&Knn::new(1).exclude_self().within(1.0))?;
/// assert_eq!((near.row(0), near.row(1), near.row(2)), (&[][..], &[2][..], &[1][..]));
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Knn<'a> {
    /// How many neighbours of each query.
    pub k: u32,
    /// Who asks.
    pub queries: Queries<'a>,
    /// How far neighbours may be, in the unit of the coordinates; `None` for any distance.
    pub radius: Option<Radius<'a>>,
    /// Leave out the query point itself (the same index; exact duplicates stay). Only with [`Queries::Points`].
    pub exclude_self: bool,
    /// Largest size in bytes of the answer in host memory; `None` for no limit.
    pub max_bytes: Option<u64>,
}

/// Bytes of a neighbour in the answer: index and distance.
const ENTRY_BYTES: u64 = 8;

/// A radius that reaches every point from every query, and whose square is an f32.
pub(in crate::query) const EVERYWHERE: f32 = 1.8e19;

impl<'a> Knn<'a> {
    /// The `k` nearest points of every point of the structure.
    pub fn new(k: u32) -> Self {
        Self { k, queries: Queries::Points, radius: None, exclude_self: false, max_bytes: None }
    }

    /// Asks around other points.
    pub fn queries(mut self, queries: &'a [Vec3]) -> Self {
        self.queries = Queries::Other(queries);
        self
    }

    /// Finds only points within `radius` of the query, the sphere included.
    pub fn within(mut self, radius: f32) -> Self {
        self.radius = Some(Radius::One(radius));
        self
    }

    /// As [`Knn::within`], with a radius for each query.
    pub fn within_each(mut self, radii: &'a [f32]) -> Self {
        self.radius = Some(Radius::Each(radii));
        self
    }

    /// Leaves out the query point itself.
    pub fn exclude_self(mut self) -> Self {
        self.exclude_self = true;
        self
    }

    /// Limits the size of the answer in host memory.
    pub fn max_bytes(mut self, limit: u64) -> Self {
        self.max_bytes = Some(limit);
        self
    }

    /// Checks the question against a structure of `points` points.
    ///
    /// # Errors
    /// `InvalidRadius`, `LengthMismatch` (radii), `NonFinite` or `CoordinateTooLarge` (queries), `InvalidSetting` (`exclude_self` with other queries), `TooMany`
    /// (2³² queries or more), `OutOfMemory` where the answer would pass the limit or the memory of the host.
    pub fn validate(&self, points: usize) -> Result<()> {
        let within = self.as_fixed_radius();
        within.validate(points)?;
        let needed = (within.len(points) as u64).saturating_mul(u64::from(self.k)).saturating_mul(ENTRY_BYTES);
        // While the answer is put together, the rows that tasks found stand beside it.
        let available = self.max_bytes.unwrap_or(u64::MAX).min(rows::available_memory() / 2);
        if needed > available {
            return Err(Error::OutOfMemory { what: "the nearest neighbours", needed, available });
        }
        Ok(())
    }

    /// The same question as one with a radius, that reaches everything where there is none, and a cap: what structures
    /// without a search of their own answer.
    pub(super) fn as_fixed_radius(&self) -> FixedRadius<'a> {
        FixedRadius {
            queries: self.queries,
            exclude_self: self.exclude_self,
            max_neighbors: Some(self.k),
            order: RowOrder::Distance,
            radius: self.radius.unwrap_or(Radius::One(EVERYWHERE)),
            ..FixedRadius::new(EVERYWHERE).distances()
        }
    }

    /// Neighbours that each query can have in a structure of `points` points.
    pub(super) fn places(&self, points: usize) -> usize {
        (self.k as usize).min(points.saturating_sub(usize::from(self.exclude_self)))
    }
}

/// The nearest points of every query: rows of `k` places in query order, nearest first, ties by lower index.
///
/// Where there are fewer than `k` points, or fewer within the radius, a row ends with places that hold [`NearestNeighbors::NONE`] and an infinite
/// distance.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NearestNeighbors {
    pub(crate) k: usize,
    pub(crate) n_queries: usize,
    pub(crate) indices: Vec<u32>,
    pub(crate) distances: Vec<f32>,
    /// What ran.
    pub report: Report,
}

impl NearestNeighbors {
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

    /// `[q × k]` indices into the points as the caller gave them, [`NearestNeighbors::NONE`] where there is no point.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// `[q × k]` distances (not squared), infinite where there is no point.
    pub fn distances(&self) -> &[f32] {
        &self.distances
    }

    /// Number of neighbours of query `i`: `k`, or all the points there are within the radius.
    ///
    /// # Panics
    /// If `i` is not below [`NearestNeighbors::len`].
    pub fn found(&self, i: usize) -> usize {
        let row = &self.indices[i * self.k..(i + 1) * self.k];
        row.partition_point(|&index| index != Self::NONE)
    }

    /// Neighbours of query `i`, without empty places.
    ///
    /// # Panics
    /// If `i` is not below [`NearestNeighbors::len`].
    pub fn row(&self, i: usize) -> &[u32] {
        &self.indices[i * self.k..i * self.k + self.found(i)]
    }

    /// Distances of the neighbours of query `i`, without empty places.
    ///
    /// # Panics
    /// If `i` is not below [`NearestNeighbors::len`].
    pub fn row_distances(&self, i: usize) -> &[f32] {
        &self.distances[i * self.k..i * self.k + self.found(i)]
    }

    /// The nearest neighbour of query `i`; `None` where there is no point or k is 0.
    ///
    /// # Panics
    /// If `i` is not below [`NearestNeighbors::len`].
    pub fn nearest(&self, i: usize) -> Option<Neighbor> {
        let (&index, &distance) = self.row(i).first().zip(self.row_distances(i).first())?;
        Some(Neighbor { index, dist2: distance * distance })
    }

    /// Indices and distances, for callers that need the vectors.
    pub fn into_parts(self) -> (Vec<u32>, Vec<f32>) {
        (self.indices, self.distances)
    }
}

/// Search for the nearest points, whatever their distance.
///
/// All implementations give the same answer. On periodic axes the distance is that to the nearest image.
pub trait KnnSearch {
    /// The nearest points of every query.
    ///
    /// # Errors
    /// See [`Knn::validate`]; on a device `OutOfDeviceMemory`, `DeviceLost`, and on software renderers `Unsupported`
    /// where a kernel would need more loop rounds than they take.
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors>;
}
