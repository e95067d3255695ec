//! Clusters of points: by density (DBSCAN), and by distance alone (Euclidean clusters).
//!
//! DBSCAN (Ester1996): a point with at least `min_points` points within `eps`, itself among them and the ball closed, is a core
//! point. Core points within `eps` of each other are of one cluster; a point that is no core point but has one within `eps`
//! is at the border of its cluster; all others are noise. What the paper leaves to the order of work is fixed here as in
//! scikit-learn: clusters are numbered by their smallest core index, and a border point joins the adjacent cluster with the
//! smallest one. So the labels follow from the points and their order alone, on any device and for any number of threads.
//!
//! No list of neighbours is kept: three passes ask the query layer who is near and keep 4 to 16 bytes a point. The first counts until
//! there are enough; the second joins trees of core points, without locks: the root with the larger index is hooked below the
//! smaller one by compare and exchange (Jayanti2016), so a tree's root is the smallest index of its cluster; the third looks for the
//! clusters of border points. On the device an attempt to join ends after a fixed number of steps and says so; the host then runs
//! the pass again over flattened trees, so no invocation ever waits for another.
//!
//! Cost: three searches of all points, O(n) memory. When to use: `dbscan` where noise lies between the clusters, `euclidean_clusters`
//! where empty space does.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
mod labels;
mod union_find;

pub use cpu::{dbscan, euclidean_clusters};
#[cfg(feature = "gpu")]
pub use gpu::{GpuClusters, dbscan_on_gpu, euclidean_clusters_on_gpu};

use crate::query::Stage;
use crate::{Error, Result};

/// What DBSCAN is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DbscanSettings {
    /// How near neighbours are, in the unit of the points, above 0; a point at exactly this distance is near.
    pub eps: f64,
    /// Fewest points within `eps` of a core point, itself among them; at least 1.
    pub min_points: u32,
}

/// What Euclidean clusters are asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EuclideanSettings {
    /// Points at most so far apart are of one cluster; above 0.
    pub radius: f64,
    /// Clusters of fewer points are left out; at least 1.
    pub min_size: u64,
    /// Clusters of more points are left out.
    pub max_size: u64,
}

impl DbscanSettings {
    /// Core points have `min_points` points within `eps`.
    pub fn new(eps: f64, min_points: u32) -> Self {
        Self { eps, min_points }
    }

    fn validate(&self) -> Result<()> {
        at_least_one("min_points", self.min_points.into())
    }
}

impl EuclideanSettings {
    /// Clusters of any size.
    pub fn new(radius: f64) -> Self {
        Self { radius, min_size: 1, max_size: u64::MAX }
    }

    fn validate(&self) -> Result<()> {
        at_least_one("min_size", self.min_size)?;
        if self.min_size <= self.max_size {
            return Ok(());
        }
        let found = format!("{} below min_size = {}", self.max_size, self.min_size);
        Err(Error::InvalidSetting { setting: "max_size", found, expected: "no less than min_size" })
    }
}

fn at_least_one(setting: &'static str, found: u64) -> Result<()> {
    if found > 0 {
        return Ok(());
    }
    Err(Error::InvalidSetting { setting, found: found.to_string(), expected: "1 or more" })
}

/// Clusters that were found but left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LeftOut {
    /// How many.
    pub clusters: u64,
    /// The points in them.
    pub points: u64,
}

/// Which cluster each point is in.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Clusters {
    /// `[n]` the cluster of each point, from 0 on in the order of their smallest core index; [`Clusters::NONE`] for noise, for
    /// points of clusters that were left out, and for invalid points.
    pub labels: Vec<i32>,
    /// `[n]` whether it is a core point; for Euclidean clusters all valid points are.
    pub is_core: Vec<bool>,
    /// Number of clusters.
    pub n_clusters: u32,
    /// Euclidean clusters with fewer points than wanted.
    pub too_small: LeftOut,
    /// Euclidean clusters with more points than wanted.
    pub too_large: LeftOut,
    /// Indices of the points with a NaN or infinite coordinate, ascending: they count for nothing.
    pub invalid: Vec<u32>,
    /// Times of the passes.
    pub stages: Vec<Stage>,
}

impl Clusters {
    /// The label of points in no cluster, as in scikit-learn.
    pub const NONE: i32 = -1;

    /// `[n_clusters]` points of each cluster.
    pub fn sizes(&self) -> Vec<u64> {
        let mut sizes = vec![0; self.n_clusters as usize];
        self.labels.iter().filter(|label| **label >= 0).for_each(|&label| sizes[label as usize] += 1);
        sizes
    }

    /// Number of points in no cluster.
    pub fn unlabelled(&self) -> u64 {
        self.labels.iter().filter(|label| **label < 0).count() as u64
    }
}
