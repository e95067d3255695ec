//! How the points of a cloud fill cells as large as a radius, measured on a sample of cells.
//!
//! A few thousand points, evenly spaced in the caller's order, choose the cells: those they lie in. Then all points of
//! these cells are counted, so that the counts are exact. A cell is met as often as it has points among those chosen; the
//! mean over cells weighs each by the inverse of its count. Cost: one pass over the points, two milliseconds a million on
//! two cores, and memory for the cells of the sample.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Aabb, Period};
use crate::parallel::reduce;

/// Points that choose cells: the 99th percentile of their cells then rests on some forty of them.
const SAMPLE: usize = 4096;
/// Points that one thread counts at a time.
const CHUNK: usize = 1 << 16;
/// Slots of the table a cell of the sample, of which most points meet an empty one.
const SLOTS_A_CELL: usize = 16;

/// How points fill cells of one size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Occupancy {
    /// Points in an occupied cell, on average over these cells.
    pub(super) a_cell: f64,
    /// Points in the cell of a point, itself included, on average over the points.
    pub(super) a_point: f64,
    /// Points in the cell of a point, of which 99 % of the points have no more.
    pub(super) high: u32,
    /// Points in the fullest cell that was met.
    pub(super) most: u32,
    /// Part of the cells in the bounds that have points; at most 1.
    pub(super) share: f64,
}

impl Occupancy {
    /// Measures points that are all finite in cells with this edge; `None` without points, or where the edge is not a
    /// positive number whose inverse is finite.
    pub(super) fn of(points: &[Vec3], edge: f32, period: &Period) -> Option<Self> {
        let inverse = 1.0 / edge;
        if points.is_empty() || !(edge > 0.0 && edge.is_finite() && inverse.is_finite()) {
            return None;
        }
        let bounds = reduce::bounds(points);
        let cells = Cells { low: bounds.min, inverse, period: *period };
        let step = points.len().div_ceil(SAMPLE);
        let sample: Vec<u64> = points.iter().step_by(step).map(|&p| cells.key_of(p)).collect();
        let table = Table::of(&sample);
        let counts = table.count(points, &cells);
        let mut of_points: Vec<u32> = sample.iter().map(|&key| counts[table.slot(key)]).collect();
        of_points.sort_unstable();
        let n = of_points.len() as f64;
        let occupied = points.len() as f64 * of_points.iter().map(|&c| 1.0 / f64::from(c.max(1))).sum::<f64>() / n;
        Some(Self {
            a_cell: points.len() as f64 / occupied,
            a_point: of_points.iter().map(|&c| f64::from(c)).sum::<f64>() / n,
            high: of_points[(of_points.len() - 1) * 99 / 100],
            most: of_points[of_points.len() - 1],
            share: (occupied / cells.number_in(&bounds)).min(1.0),
        })
    }
}

/// Cells of one size from the low corner of the bounds on.
struct Cells {
    low: Vec3,
    inverse: f32,
    period: Period,
}

impl Cells {
    /// A number of the cell that hardly any other has: a hash of its coordinates, never 0.
    #[inline(always)]
    fn key_of(&self, point: Vec3) -> u64 {
        let mut offset = point - self.low;
        if self.period.is_periodic() {
            offset -= self.period.lengths() * (offset * self.period.inverse()).floor();
        }
        let [x, y, z] = (offset * self.inverse).floor().to_array().map(|c| u64::from(c.to_bits()));
        // A product for each coordinate and one round of the finalizer of SplitMix64 (Steele2014).
        let mixed = x.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f).rotate_left(21);
        let mixed = (mixed ^ z.wrapping_mul(0x1656_67b1_9e37_79f9).rotate_left(42)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed ^ mixed >> 31) | 1
    }

    /// Number of cells in the bounds, or in a period where that is less.
    fn number_in(&self, bounds: &Aabb) -> f64 {
        let lengths = self.period.lengths();
        let along = |axis: usize| {
            let extent = bounds.extent()[axis];
            let cells = |length: f32| f64::from(length) * f64::from(self.inverse);
            let is_whole_period = lengths[axis] > 0.0 && extent >= lengths[axis];
            if is_whole_period { cells(lengths[axis]).ceil() } else { cells(extent).floor() + 1.0 }
        };
        along(0) * along(1) * along(2)
    }
}

/// The cells of the sample, by open addressing; 0 is an empty slot.
struct Table {
    keys: Vec<u64>,
}

impl Table {
    fn of(sample: &[u64]) -> Self {
        let mut table = Self { keys: vec![0; (sample.len() * SLOTS_A_CELL).next_power_of_two()] };
        for &key in sample {
            let slot = table.slot(key);
            table.keys[slot] = key;
        }
        table
    }

    /// Where the key stands, or the empty slot where it would stand.
    #[inline(always)]
    fn slot(&self, key: u64) -> usize {
        let mask = self.keys.len() - 1;
        let mut slot = (key >> 20) as usize & mask;
        while self.keys[slot] != 0 && self.keys[slot] != key {
            slot = (slot + 1) & mask;
        }
        slot
    }

    /// Number of points in the cell of each slot.
    fn count(&self, points: &[Vec3], cells: &Cells) -> Vec<u32> {
        let none = || vec![0u32; self.keys.len()];
        let add = |mut counts: Vec<u32>, chunk: &[Vec3]| {
            for &point in chunk {
                // Points in cells that are not of the sample count in an empty slot, which nobody asks for.
                counts[self.slot(cells.key_of(point))] += 1;
            }
            counts
        };
        let sum = |mut a: Vec<u32>, b: Vec<u32>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
            a
        };
        points.par_chunks(CHUNK).fold(none, add).reduce(none, sum)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generate::{CloudKind, cloud};

    fn lattice(edge: u32) -> Vec<Vec3> {
        let at = |i: u32| i as f32 + 0.25;
        (0..edge.pow(3)).map(|i| Vec3::new(at(i % edge), at(i / edge % edge), at(i / edge / edge))).collect()
    }

    #[test]
    fn a_lattice_fills_every_cell_alike() {
        // Sixteen times two points an axis.
        let found = Occupancy::of(&lattice(32), 2.0, &Period::NONE).unwrap();
        assert_eq!(found, Occupancy { a_cell: 8.0, a_point: 8.0, high: 8, most: 8, share: 1.0 });
        let alone = Occupancy::of(&lattice(32), 0.5, &Period::NONE).unwrap();
        assert_eq!((alone.a_cell, alone.a_point, alone.most), (1.0, 1.0, 1));
        // 32 of the 63 cells an axis are occupied.
        assert!((alone.share - (32.0f64 / 63.0).powi(3)).abs() < 1e-9, "{alone:?}");
    }

    #[test]
    fn random_points_fill_cells_by_poisson() {
        let points = cloud(CloudKind::Uniform, 200_000, 7).points;
        let edge = (4.0f32 / 200_000.0).cbrt();
        let found = Occupancy::of(&points, edge, &Period::NONE).unwrap();
        // With λ = 4: a point has λ others in its cell, an occupied cell has λ / (1 − e^−λ) points.
        let mean = 4.0 / (1.0 - (-4.0f64).exp());
        assert!((found.a_point - 5.0).abs() < 0.15 && (found.a_cell - mean).abs() < 0.15, "{found:?}");
        assert!((10..=12).contains(&found.high) && found.most < 20, "{found:?}");
        assert!((found.share - 0.98).abs() < 0.08, "{found:?}");
    }

    #[test]
    fn counts_of_clusters_are_those_of_all_cells() {
        let points = cloud(CloudKind::Clustered, 50_000, 7).points;
        let edge = 0.01;
        let found = Occupancy::of(&points, edge, &Period::NONE).unwrap();
        let low = reduce::bounds(&points).min;
        let mut counts = std::collections::HashMap::new();
        for &p in &points {
            *counts.entry(((p - low) * (1.0 / edge)).floor().to_array().map(|c| c as i32)).or_insert(0u64) += 1;
        }
        let n = points.len() as f64;
        let a_cell = n / counts.len() as f64;
        let a_point = counts.values().map(|c| (c * c) as f64).sum::<f64>() / n;
        assert!((found.a_cell / a_cell - 1.0).abs() < 0.1, "{found:?}, {a_cell}");
        assert!((found.a_point / a_point - 1.0).abs() < 0.1, "{found:?}, {a_point}");
        assert_eq!(u64::from(found.most), *counts.values().max().unwrap());
    }

    #[test]
    fn outliers_and_equal_points_are_no_trouble() {
        let mut points = vec![Vec3::ONE; 9000];
        points.push(Vec3::splat(1e18));
        let found = Occupancy::of(&points, 1e-3, &Period::NONE).unwrap();
        assert_eq!((found.high, found.most), (9000, 9000));
        assert!(found.share < 1e-30 && found.a_cell > 1000.0, "{found:?}");
        assert_eq!(Occupancy::of(&[], 1.0, &Period::NONE), None);
        for edge in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-45] {
            assert_eq!(Occupancy::of(&points, edge, &Period::NONE), None, "{edge}");
        }
    }

    #[test]
    fn images_of_a_period_are_one_cell() {
        let period = Period::new(Vec3::new(4.0, 0.0, 0.0)).unwrap();
        let points: Vec<Vec3> = (0..800).map(|i| Vec3::new((i % 40) as f32, (i / 40) as f32, 0.0)).collect();
        // Cells x mod 4: ten points of 40 share each.
        let found = Occupancy::of(&points, 1.0, &period).unwrap();
        assert_eq!((found.a_point, found.high, found.most), (10.0, 10, 10));
        assert!((found.a_cell - 10.0).abs() < 1e-9 && (found.share - 1.0).abs() < 1e-9, "{found:?}");
    }
}
