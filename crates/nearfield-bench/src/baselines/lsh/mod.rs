//! Locality-sensitive hashing for Euclidean distance with several tables. Sources: Datar2004 (the hash functions),
//! Pan2011 (tables by sorting on the GPU), Sundaram2013 (several tables, each point met once).
//!
//! A table projects points on M random directions, cuts each projection into pieces of width W, and puts points with the
//! same M pieces into one bucket. Near points mostly share a bucket in some of L tables. A query looks at its own bucket in
//! each table, and the k nearest candidates are its answer, or those within a radius.
//!
//! Differs from Pan2011, whose tables stand below a tree of random projections and are probed in several buckets: here the
//! hash alone parts the points, and one bucket a table is probed. Pieces are mixed into 32 bits; buckets that collide add
//! candidates and lose none. Directions are rounded to multiples of 2⁻⁶, so that coordinates of few bits have the same
//! hashes on every device.
//!
//! Cost: L · M projections and a distance a candidate; 12 · L bytes a point beside its coordinates. Many duplicates are one
//! bucket, of which a query looks at the first `bucket_limit` points.
//!
//! Invariants: the same seed and points give the same tables; a candidate counts in the first table in which it shares
//! the query's hash and nowhere else; so each is met once. [`mod@reference`] is the same definition, written plainly.

mod family;
mod gpu;
pub mod reference;

pub use family::HashFamily;
pub use gpu::{GpuLsh, LshRows};

use nearfield::{Error, Result};

/// How wide the pieces of a projection are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PieceWidth {
    /// That wide.
    Fixed(f32),
    /// So many times the median distance of the k-th nearest of 64 points, spread over all.
    OfNearest {
        /// Which nearest, the point itself not counted.
        k: usize,
        /// How many times its distance; 4 in Datar2004.
        factor: f32,
    },
}

/// How tables are made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LshSettings {
    /// Tables (L), 1 to 64: recall rises with their number.
    pub tables: usize,
    /// Projections of a table (M), 1 to 32: buckets shrink with their number, and recall falls.
    pub projections: usize,
    /// Width of the pieces (W): buckets grow with it.
    pub width: PieceWidth,
    /// Points of a bucket that a query looks at, at least 1.
    pub bucket_limit: usize,
    /// Picks the projections.
    pub seed: u64,
}

impl LshSettings {
    /// Eight tables of eight projections for the k nearest.
    pub fn for_k(k: usize) -> Self {
        let width = PieceWidth::OfNearest { k, factor: 4.0 };
        Self { tables: 8, projections: 8, width, bucket_limit: 4096, seed: 1 }
    }

    /// With another number of tables.
    pub fn tables(mut self, tables: usize) -> Self {
        self.tables = tables;
        self
    }

    /// With another number of projections.
    pub fn projections(mut self, projections: usize) -> Self {
        self.projections = projections;
        self
    }

    /// With another width.
    pub fn width(mut self, width: PieceWidth) -> Self {
        self.width = width;
        self
    }

    /// With another limit.
    pub fn bucket_limit(mut self, limit: usize) -> Self {
        self.bucket_limit = limit;
        self
    }

    /// With other projections.
    pub fn seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub fn validate(&self) -> Result<()> {
        let width_of = |name, value: f32, possible| (name, format!("{value:e}"), possible, "between 1e-15 and 1e18");
        let is_width = |value: f32| (1e-15..=1e18).contains(&value);
        let width = match self.width {
            PieceWidth::Fixed(width) => width_of("width", width, is_width(width)),
            PieceWidth::OfNearest { k: 0, .. } => ("k", "0".to_owned(), false, "at least 1"),
            PieceWidth::OfNearest { factor, .. } => width_of("factor of the width", factor, is_width(factor)),
        };
        let checks = [
            ("tables", self.tables.to_string(), (1..=64).contains(&self.tables), "1 to 64"),
            ("projections", self.projections.to_string(), (1..=32).contains(&self.projections), "1 to 32"),
            (
                "bucket limit",
                self.bucket_limit.to_string(),
                (1..1 << 31).contains(&self.bucket_limit),
                "1 to 2147483647",
            ),
            width,
        ];
        match checks.into_iter().find(|(_, _, possible, _)| !possible) {
            None => Ok(()),
            Some((setting, found, _, expected)) => Err(Error::InvalidSetting { setting, found, expected }),
        }
    }
}
