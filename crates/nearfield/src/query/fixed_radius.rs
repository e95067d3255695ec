//! The question: which points lie in the closed ball around each query.

use glam::Vec3;

use crate::geometry::validate;
use crate::{Error, Result};

/// A fixed-radius query over all points of a structure, or over other query points.
///
/// A point is a neighbour when its squared distance is ≤ radius², both in f32: the ball is closed, and radius 0 finds
/// exact duplicates. A query that is itself a point of the structure is its own neighbour unless
/// [`FixedRadius::exclude_self`] is set.
///
/// ```
/// use nearfield::{FixedRadius, RowOrder, Vec3};
///
/// let probes = [Vec3::ZERO, Vec3::ONE];
/// let nearest_ten = FixedRadius::new(0.25).queries(&probes).order(RowOrder::Distance).max_neighbors(10);
/// let for_each_its_own = FixedRadius::each(&[0.1, 0.2]).queries(&probes);
/// # let _ = (nearest_ten, for_each_its_own);
/// ```
#[derive(Debug, Clone, Copy)]
pub struct FixedRadius<'a> {
    /// Who asks.
    pub queries: Queries<'a>,
    /// Radius, in the unit of the coordinates; true length, never squared.
    pub radius: Radius<'a>,
    /// Leave out the query point itself (the same index; exact duplicates stay). Only with [`Queries::Points`].
    pub exclude_self: bool,
    /// Keep at most this many neighbours a row: the nearest, ties by lower index. The answer says which rows were cut.
    pub max_neighbors: Option<u32>,
    /// Order within a row of a list.
    pub order: RowOrder,
    /// Whether a list carries distances.
    pub distances: bool,
    /// Largest size in bytes of the answer in host memory; `None` for no limit.
    pub max_bytes: Option<u64>,
}

/// The query points.
#[derive(Debug, Clone, Copy)]
pub enum Queries<'a> {
    /// Every point of the structure, in the caller's order.
    Points,
    /// Other points, in the same frame as those of the structure.
    Other(&'a [Vec3]),
}

/// One radius for all, or one for each query.
#[derive(Debug, Clone, Copy)]
pub enum Radius<'a> {
    /// The same for every query.
    One(f32),
    /// `[q]` radii in the order of the queries.
    Each(&'a [f32]),
}

/// Order of the neighbours within a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RowOrder {
    /// The order in which they were found: the same from run to run on one device, otherwise unspecified.
    #[default]
    Unspecified,
    /// Ascending index.
    Index,
    /// Ascending distance, ties by ascending index.
    Distance,
}

#[cfg(feature = "gpu")]
impl Radius<'_> {
    /// As kernels take it: 1 and nothing where each query has its own, else 0 and the radius of all.
    pub(super) fn parameters(&self) -> (u32, f32) {
        match *self {
            Radius::One(radius) => (0, radius),
            Radius::Each(_) => (1, 0.0),
        }
    }
}

impl<'a> FixedRadius<'a> {
    /// All points within `radius` of every point of the structure.
    pub fn new(radius: f32) -> Self {
        Self::with(Radius::One(radius))
    }

    /// A radius for each query.
    pub fn each(radii: &'a [f32]) -> Self {
        Self::with(Radius::Each(radii))
    }

    fn with(radius: Radius<'a>) -> Self {
        Self {
            queries: Queries::Points,
            radius,
            exclude_self: false,
            max_neighbors: None,
            order: RowOrder::Unspecified,
            distances: false,
            max_bytes: None,
        }
    }

    /// Asks around other points.
    pub fn queries(mut self, queries: &'a [Vec3]) -> Self {
        self.queries = Queries::Other(queries);
        self
    }

    /// Leaves out the query point itself.
    pub fn exclude_self(mut self) -> Self {
        self.exclude_self = true;
        self
    }

    /// Keeps the nearest `cap` neighbours of each query.
    pub fn max_neighbors(mut self, cap: u32) -> Self {
        self.max_neighbors = Some(cap);
        self
    }

    /// Orders each row.
    pub fn order(mut self, order: RowOrder) -> Self {
        self.order = order;
        self
    }

    /// Adds distances to a list.
    pub fn distances(mut self) -> Self {
        self.distances = true;
        self
    }

    /// Limits the size of the answer in host memory.
    pub fn max_bytes(mut self, limit: u64) -> Self {
        self.max_bytes = Some(limit);
        self
    }

    /// Number of queries, given the number of points of the structure.
    pub fn len(&self, points: usize) -> usize {
        match self.queries {
            Queries::Points => points,
            Queries::Other(queries) => queries.len(),
        }
    }

    /// Largest radius; 0 without queries.
    pub fn largest_radius(&self) -> f32 {
        match self.radius {
            Radius::One(radius) => radius,
            Radius::Each(radii) => radii.iter().copied().fold(0.0, f32::max),
        }
    }

    /// Radius of query `i`.
    #[inline(always)]
    pub(crate) fn radius_of(&self, i: usize) -> f32 {
        match self.radius {
            Radius::One(radius) => radius,
            Radius::Each(radii) => radii[i],
        }
    }

    /// Checks the question against a structure of `points` points.
    ///
    /// # Errors
    /// `InvalidRadius`, `LengthMismatch` (radii), `NonFinite` or `CoordinateTooLarge` (queries), `InvalidSetting`
    /// (`exclude_self` with other queries), `TooMany` (2³² queries or more).
    pub fn validate(&self, points: usize) -> Result<()> {
        let n_queries = self.len(points);
        if n_queries as u64 >= u64::from(u32::MAX) {
            return Err(Error::TooMany {
                what: "queries",
                found: n_queries as u64,
                limit: u64::from(u32::MAX) - 1,
                advice: "ask in several calls",
            });
        }
        match self.radius {
            Radius::One(radius) => validate::radius(radius, None)?,
            Radius::Each(radii) => {
                if radii.len() != n_queries {
                    let (found, expected) = (radii.len() as u64, n_queries as u64);
                    return Err(Error::LengthMismatch { what: "the array of radii", found, expected });
                }
                for (i, &radius) in radii.iter().enumerate() {
                    validate::radius(radius, Some(i as u64))?;
                }
            }
        }
        if let Queries::Other(queries) = self.queries {
            if self.exclude_self {
                return Err(Error::InvalidSetting {
                    setting: "exclude_self",
                    found: "true with separate queries".into(),
                    expected: "false, or queries that are the points themselves",
                });
            }
            validate::coordinates("queries", queries)?;
        }
        Ok(())
    }
}
