//! Where the curve is cut, and who owns a point.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use crate::curve::{Curve, Domain};
use crate::geometry::validate;
use crate::structure::LinearOctree;
use crate::{Error, Result};

/// Most parts.
pub const MAX_PARTS: u32 = 1 << 20;
/// One more than the largest key.
const END_OF_KEYS: u64 = 1 << 63;

/// Parts of the domain, each a contiguous range of the curve.
///
/// ```
/// use nearfield::application::Partition;
/// use nearfield::{LinearOctree, OctreeSettings, Vec3};
///
/// let points: Vec<Vec3> = (0..1000).map(|i| Vec3::new((i % 40) as f32, (i / 40) as f32, 0.0)).collect();
/// let tree = LinearOctree::build(&points, &OctreeSettings::default())?;
/// let partition = Partition::of_tree(&tree, 4)?;
/// assert!(partition.imbalance() < 1.1);
/// assert!(partition.owner(Vec3::new(39.0, 24.0, 0.0)) < 4);
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Partition {
    curve: Curve,
    domain: Domain,
    /// `[p − 1]` ascending: the first key of each part but the first.
    splitters: Vec<u64>,
    /// `[p]`
    work: Vec<f64>,
}

impl Partition {
    /// Splits points into `parts` of nearly equal number. Points of one cell at level 21 stay together.
    ///
    /// - `points`: those outside the domain count to its border cells
    /// - `parts`: 1 to [`MAX_PARTS`]; more than there are points leaves some empty
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany`; `InvalidSetting` for the number of parts.
    pub fn of_points(points: &[Vec3], parts: u32, curve: Curve, domain: &Domain) -> Result<Self> {
        check_parts(parts)?;
        validate::points(points)?;
        let mut keys: Vec<u64> = points.par_iter().with_min_len(1 << 12).map(|&p| domain.key_of(curve, p)).collect();
        keys.par_sort_unstable();
        let groups = keys.chunk_by(|a, b| a == b).map(|equal| (equal[0], equal.len() as f64));
        Ok(Self::of_groups(groups, parts, curve, domain))
    }

    /// Splits the leaves of a tree into `parts` with nearly equal numbers of points.
    ///
    /// # Errors
    /// As [`Partition::of_leaves`].
    pub fn of_tree(tree: &LinearOctree, parts: u32) -> Result<Self> {
        let weights: Vec<f64> = tree.leaves().map(|leaf| f64::from(tree.nodes()[leaf as usize].n_points())).collect();
        Self::of_leaves(tree, &weights, parts)
    }

    /// Splits the leaves of a tree into `parts` of nearly equal work. Leaves are never cut.
    ///
    /// - `weights`: `[leaves]` the work of each, in the order of [`LinearOctree::leaves`]; 0 or more. Where all are 0,
    ///   leaves count alike
    /// - `parts`: 1 to [`MAX_PARTS`]; more than there are leaves leaves some empty
    ///
    /// # Errors
    /// `LengthMismatch`; `InvalidSetting` for a weight that is negative or not finite, for weights whose sum is not
    /// finite, and for the number of parts.
    pub fn of_leaves(tree: &LinearOctree, weights: &[f64], parts: u32) -> Result<Self> {
        check_parts(parts)?;
        let expected = tree.leaves().count() as u64;
        if weights.len() as u64 != expected {
            return Err(Error::LengthMismatch { what: "weights of leaves", found: weights.len() as u64, expected });
        }
        let (setting, expected) = ("weight of a leaf", "finite numbers of 0 or more with a finite sum");
        if let Some(i) = weights.iter().position(|w| !w.is_finite() || *w < 0.0) {
            return Err(Error::InvalidSetting { setting, found: format!("{} at leaf {i}", weights[i]), expected });
        }
        let total: f64 = weights.iter().sum();
        if !total.is_finite() {
            return Err(Error::InvalidSetting { setting, found: format!("a sum of {total}"), expected });
        }
        let weight = |leaf: usize| if total == 0.0 { 1.0 } else { weights[leaf] };
        let keys = tree.leaves().map(|leaf| tree.nodes()[leaf as usize].octant.first_key());
        let groups = keys.enumerate().map(|(leaf, key)| (key, weight(leaf)));
        let mut partition = Self::of_groups(groups, parts, tree.curve(), tree.domain());
        if total == 0.0 {
            partition.work.fill(0.0);
        }
        Ok(partition)
    }

    /// Cuts a line of groups, each with its first key and its work, in front of the group where the work so far is
    /// nearest to k / p of all.
    ///
    /// A cut is at most half the largest group away from k / p, so a part has total / p ± the largest group.
    fn of_groups(groups: impl Iterator<Item = (u64, f64)>, parts: u32, curve: Curve, domain: &Domain) -> Self {
        let (mut first_keys, mut work_before) = (vec![], vec![0.0]);
        for (key, work) in groups {
            first_keys.push(key);
            work_before.push(work_before[work_before.len() - 1] + work);
        }
        let (n_groups, total) = (first_keys.len(), work_before[first_keys.len()]);
        let cut = |part: u32| {
            let wanted = total * (f64::from(part) / f64::from(parts));
            let behind = work_before.partition_point(|&work| work < wanted).min(n_groups);
            let before = behind.saturating_sub(1);
            if wanted - work_before[before] <= work_before[behind] - wanted { before } else { behind }
        };
        let cuts: Vec<usize> = (0..=parts)
            .map(|part| match part {
                0 => 0,
                last if last == parts => n_groups,
                part => cut(part),
            })
            .collect();
        // A part without groups gets no keys: those before the first group are the first part's that has one.
        let splitter = |&group: &usize| match group {
            0 => 0,
            group => first_keys.get(group).copied().unwrap_or(END_OF_KEYS),
        };
        let splitters = cuts[1..parts as usize].iter().map(splitter).collect();
        let work = cuts.windows(2).map(|ends| work_before[ends[1]] - work_before[ends[0]]).collect();
        Self { curve, domain: *domain, splitters, work }
    }

    /// Number of parts.
    pub fn parts(&self) -> u32 {
        self.work.len() as u32
    }

    /// The curve that was cut.
    pub fn curve(&self) -> Curve {
        self.curve
    }

    /// The cube that the curve fills.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// `[p − 1]` the first key of each part but the first; ascending, equal for parts without keys.
    pub fn splitters(&self) -> &[u64] {
        &self.splitters
    }

    /// The keys of a part.
    ///
    /// # Panics
    /// If there is no such part.
    pub fn range_of(&self, part: u32) -> Range<u64> {
        assert!(part < self.parts(), "part {part} of {}", self.parts());
        let first = if part == 0 { 0 } else { self.splitters[part as usize - 1] };
        first..self.splitters.get(part as usize).copied().unwrap_or(END_OF_KEYS)
    }

    /// `[p]` work of each part: points, or the sum of the leaves' weights.
    pub fn work(&self) -> &[f64] {
        &self.work
    }

    /// Largest over mean work: 1 is even; 1 without work.
    pub fn imbalance(&self) -> f64 {
        let total: f64 = self.work.iter().sum();
        let largest = self.work.iter().fold(0.0, |largest: f64, &work| largest.max(work));
        if total > 0.0 { largest * f64::from(self.parts()) / total } else { 1.0 }
    }

    /// The part that owns a key.
    #[inline]
    pub fn owner_of_key(&self, key: u64) -> u32 {
        self.splitters.partition_point(|&first| first <= key) as u32
    }

    /// The part in which a point lives, whether or not it was there when the curve was cut.
    ///
    /// - `point`: finite; outside the domain it lives where the nearest border cell by axis does
    #[inline]
    pub fn owner(&self, point: Vec3) -> u32 {
        self.owner_of_key(self.domain.key_of(self.curve, point))
    }

    /// The parts in which points live `[n]`.
    pub fn owners(&self, points: &[Vec3]) -> Vec<u32> {
        points.par_iter().with_min_len(1 << 12).map(|&point| self.owner(point)).collect()
    }
}

fn check_parts(parts: u32) -> Result<()> {
    if (1..=MAX_PARTS).contains(&parts) {
        return Ok(());
    }
    Err(Error::InvalidSetting { setting: "parts", found: parts.to_string(), expected: "1 to 1048576" })
}
