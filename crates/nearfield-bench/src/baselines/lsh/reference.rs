//! The tables and their probing, written plainly: what the GPU's answers are tested against.

use nearfield::Result;
use rayon::prelude::*;

use super::HashFamily;
use crate::baselines::points::{Points, Queries, dist2};
use crate::baselines::rows::{KnnRows, RangeRows};
use crate::baselines::{check_k, check_radius};

/// The tables of a hash family over points.
#[derive(Debug)]
pub struct Tables<'a> {
    family: &'a HashFamily,
    points: &'a Points,
    /// Of each table: the hash of every point.
    hashes: Vec<Vec<u32>>,
    /// Of each table: hash and index of every point, sorted.
    sorted: Vec<Vec<(u32, u32)>>,
}

impl<'a> Tables<'a> {
    /// Sorts the points into all tables.
    ///
    /// # Errors
    /// `LengthMismatch` where the family is for another dimension.
    pub fn build(points: &'a Points, family: &'a HashFamily) -> Result<Self> {
        check_dimension(points, family)?;
        let hash_all = |t| (0..points.len()).map(|i| family.hash(points.get(i), t)).collect();
        let hashes: Vec<Vec<u32>> = (0..family.tables()).into_par_iter().map(hash_all).collect();
        let sort = |hashes: &Vec<u32>| {
            let mut pairs: Vec<(u32, u32)> = hashes.iter().copied().zip(0..).collect();
            pairs.sort_unstable();
            pairs
        };
        let sorted = hashes.par_iter().map(sort).collect();
        Ok(Self { family, points, hashes, sorted })
    }

    /// What a query meets: the first points of its bucket in each table that shared none with it before.
    fn candidates(&self, query: &[f32]) -> Vec<u32> {
        let hashes: Vec<u32> = (0..self.sorted.len()).map(|t| self.family.hash(query, t)).collect();
        let mut met = Vec::new();
        for (table, sorted) in self.sorted.iter().enumerate() {
            let bucket = &sorted[sorted.partition_point(|pair| pair.0 < hashes[table])..];
            let bucket = bucket.iter().take(self.family.bucket_limit()).take_while(|pair| pair.0 == hashes[table]);
            let shared_before = |id: u32| (0..table).any(|t| self.hashes[t][id as usize] == hashes[t]);
            met.extend(bucket.map(|pair| pair.1).filter(|&id| !shared_before(id)));
        }
        met
    }

    fn rows(&self, queries: Queries<'_>, radius: Option<f32>) -> Result<Vec<Vec<(f32, u32)>>> {
        let asking = queries.of(self.points);
        self.points.check_same_dimension(asking)?;
        radius.map_or(Ok(()), check_radius)?;
        let limit = radius.map_or(f32::INFINITY, |r| r * r);
        let row = |i: usize| {
            let near = |id: u32| (dist2(asking.get(i), self.points.get(id as usize)), id);
            let met = self.candidates(asking.get(i)).into_iter().filter(|&id| Some(id) != queries.left_out(i));
            met.map(near).filter(|candidate| candidate.0 <= limit).collect()
        };
        Ok((0..asking.len()).into_par_iter().map(row).collect())
    }

    /// The k nearest candidates of every query, of those within `radius` where one is given.
    ///
    /// # Errors
    /// `InvalidSetting` for k; `LengthMismatch` for queries of another dimension.
    pub fn knn(&self, queries: Queries<'_>, k: usize, radius: Option<f32>) -> Result<KnnRows> {
        check_k(k)?;
        Ok(KnnRows::of_candidates(k, self.rows(queries, radius)?))
    }

    /// All candidates within a radius, each row in the order in which they are met.
    ///
    /// # Errors
    /// `LengthMismatch` for queries of another dimension.
    pub fn list_within(&self, queries: Queries<'_>, radius: f32) -> Result<RangeRows> {
        let ids = |row: Vec<(f32, u32)>| row.into_iter().map(|candidate| candidate.1).collect();
        Ok(RangeRows::of_rows(self.rows(queries, Some(radius))?.into_iter().map(ids).collect()))
    }
}

/// Checks that a family is for points of this dimension.
pub(super) fn check_dimension(points: &Points, family: &HashFamily) -> Result<()> {
    if points.dimension() == family.dimension() {
        return Ok(());
    }
    let (found, expected) = (points.dimension() as u64, family.dimension() as u64);
    Err(nearfield::Error::LengthMismatch { what: "coordinates of a point", found, expected })
}
