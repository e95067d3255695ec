//! The questions: which points lie in the closed ball around each query, and which are the k nearest.

use crate::geometry::Scalar;
use crate::query::RowOrder;
use crate::structure::aabb_tree::any_dimension;
use crate::{Error, Result};

/// A search for all points within a radius of every point of a tree, or of other query points.
///
/// A point is a neighbour when its squared distance is ≤ radius², both in `T`: the ball is closed, and radius 0 finds
/// exact duplicates. A query that is itself a point of the tree is its own neighbour unless
/// [`FixedRadiusN::exclude_self`] is set.
#[derive(Debug, Clone, Copy)]
pub struct FixedRadiusN<'a, T, const D: usize> {
    /// Who asks.
    pub queries: QueriesN<'a, T, D>,
    /// Radius, in the unit of the coordinates; true length, never squared.
    pub radius: RadiusN<'a, T>,
    /// Leave out the query point itself (the same index; exact duplicates stay). Only with [`QueriesN::Points`].
    pub exclude_self: bool,
    /// Order within a row of a list.
    pub order: RowOrder,
    /// Largest size in bytes of the answer in host memory; `None` for no limit.
    pub max_bytes: Option<u64>,
}

/// The query points.
#[derive(Debug, Clone, Copy)]
pub enum QueriesN<'a, T, const D: usize> {
    /// Every point of the tree, in the caller's order.
    Points,
    /// Other points.
    Other(&'a [[T; D]]),
}

/// One radius for all, or one for each query.
#[derive(Debug, Clone, Copy)]
pub enum RadiusN<'a, T> {
    /// The same for every query.
    One(T),
    /// `[q]` radii in the order of the queries.
    Each(&'a [T]),
}

impl<T: Scalar> RadiusN<'_, T> {
    /// Radius of query `i`.
    #[inline(always)]
    pub(crate) fn of(&self, i: usize) -> T {
        match self {
            Self::One(radius) => *radius,
            Self::Each(radii) => radii[i],
        }
    }

    fn validate(&self, n_queries: usize) -> Result<()> {
        match self {
            Self::One(radius) => any_dimension::radius(*radius, None),
            Self::Each(radii) if radii.len() != n_queries => Err(Error::LengthMismatch {
                what: "the array of radii",
                found: radii.len() as u64,
                expected: n_queries as u64,
            }),
            Self::Each(radii) => {
                radii.iter().enumerate().try_for_each(|(i, &radius)| any_dimension::radius(radius, Some(i)))
            }
        }
    }
}

impl<T: Scalar, const D: usize> QueriesN<'_, T, D> {
    /// Number of queries, given the number of points of the tree.
    pub fn len(&self, points: usize) -> usize {
        match self {
            Self::Points => points,
            Self::Other(queries) => queries.len(),
        }
    }

    fn validate(&self, exclude_self: bool) -> Result<()> {
        let Self::Other(queries) = self else { return Ok(()) };
        if exclude_self {
            return Err(Error::InvalidSetting {
                setting: "exclude_self",
                found: "true with separate queries".into(),
                expected: "false, or queries that are the points themselves",
            });
        }
        any_dimension::coordinates("queries", queries)
    }
}

impl<'a, T: Scalar, const D: usize> FixedRadiusN<'a, T, D> {
    /// All points within `radius` of every point of the tree.
    pub fn new(radius: T) -> Self {
        Self::with(RadiusN::One(radius))
    }

    /// A radius for each query.
    pub fn each(radii: &'a [T]) -> Self {
        Self::with(RadiusN::Each(radii))
    }

    fn with(radius: RadiusN<'a, T>) -> Self {
        let (queries, order) = (QueriesN::Points, RowOrder::Unspecified);
        Self { queries, radius, exclude_self: false, order, max_bytes: None }
    }

    /// Asks around other points.
    pub fn queries(mut self, queries: &'a [[T; D]]) -> Self {
        self.queries = QueriesN::Other(queries);
        self
    }

    /// Leaves out the query point itself.
    pub fn exclude_self(mut self) -> Self {
        self.exclude_self = true;
        self
    }

    /// Orders each row.
    pub fn order(mut self, order: RowOrder) -> Self {
        self.order = order;
        self
    }

    /// Limits the size of the answer in host memory.
    pub fn max_bytes(mut self, limit: u64) -> Self {
        self.max_bytes = Some(limit);
        self
    }

    /// Checks the question against a tree of `points` points.
    ///
    /// # Errors
    /// `InvalidSetting` (radius, or `exclude_self` with other queries), `LengthMismatch` (radii), `NonFinite` or
    /// `CoordinateBeyond` (queries), `TooMany` (2³² − 1 queries or more).
    pub fn validate(&self, points: usize) -> Result<()> {
        self.radius.validate(self.queries.len(points))?;
        self.queries.validate(self.exclude_self)
    }
}

/// A search for the `k` nearest points of every point of a tree, or of other query points, however far they are or
/// within a radius.
///
/// Neighbours are ordered by squared distance in `T`, ties by lower index; a query that is itself a point of the tree is
/// its own nearest neighbour unless [`KnnN::exclude_self`] is set. k = 0 finds nothing.
#[derive(Debug, Clone, Copy)]
pub struct KnnN<'a, T, const D: usize> {
    /// How many neighbours of each query.
    pub k: u32,
    /// Who asks.
    pub queries: QueriesN<'a, T, D>,
    /// The closed ball that neighbours lie in; `None` for no limit.
    pub within: Option<RadiusN<'a, T>>,
    /// Leave out the query point itself (the same index; exact duplicates stay). Only with [`QueriesN::Points`].
    pub exclude_self: bool,
}

impl<'a, T: Scalar, const D: usize> KnnN<'a, T, D> {
    /// The `k` nearest points of every point of the tree.
    pub fn new(k: u32) -> Self {
        Self { k, queries: QueriesN::Points, within: None, exclude_self: false }
    }

    /// Asks around other points.
    pub fn queries(mut self, queries: &'a [[T; D]]) -> Self {
        self.queries = QueriesN::Other(queries);
        self
    }

    /// Leaves out points beyond a radius.
    pub fn within(mut self, radius: RadiusN<'a, T>) -> Self {
        self.within = Some(radius);
        self
    }

    /// Leaves out the query point itself.
    pub fn exclude_self(mut self) -> Self {
        self.exclude_self = true;
        self
    }

    /// Checks the question against a tree of `points` points.
    ///
    /// # Errors
    /// As [`FixedRadiusN::validate`]; `OutOfMemory` where the answer would pass the memory of the host.
    pub fn validate(&self, points: usize) -> Result<()> {
        let n_queries = self.queries.len(points);
        self.within.map_or(Ok(()), |radius| radius.validate(n_queries))?;
        self.queries.validate(self.exclude_self)?;
        let entry = (size_of::<T>() + size_of::<u32>()) as u64;
        let needed = (n_queries as u64).saturating_mul(u64::from(self.k)).saturating_mul(entry);
        // While the answer is put together, the rows that were found stand beside it.
        let available = crate::query::rows::available_memory() / 3;
        if needed > available {
            return Err(Error::OutOfMemory { what: "the nearest neighbours", needed, available });
        }
        Ok(())
    }
}
