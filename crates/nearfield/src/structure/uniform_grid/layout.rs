//! Where a cell is, which table entry it has, and which cells a ball can touch. `layout.wesl` is the twin of this file.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::GridSettings;
use crate::geometry::Aabb;
use crate::geometry::distance::{LENGTH_SLACK, PERIOD_SLACK, RADIUS_SLACK, WRAP_SLACK};

/// Most cells on one axis: every cell number is exact in f32.
const MAX_CELLS: f32 = (1 << 24) as f32;
/// A dense table has at most this many entries a point.
const DENSE_ENTRIES_PER_POINT: u64 = 8;
/// Geometry of a grid, in the bytes of the kernels' uniform.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GridLayout {
    /// Smallest corner of cell (0, 0, 0).
    pub origin: [f32; 3],
    /// Number of points.
    pub n_points: u32,
    /// Cells a unit of length, by axis.
    pub inverse_cell: [f32; 3],
    /// Number of table entries.
    pub table_size: u32,
    /// Cells by axis.
    pub cells: [u32; 3],
    /// 1 where rows are hashed, 0 where the table is dense.
    pub hashed: u32,
    /// Length of the period by axis; 0 where not periodic.
    pub period: [f32; 3],
    /// 1 where any axis is periodic.
    pub periodic: u32,
    /// One over the period; 0 where not periodic.
    pub inverse_period: [f32; 3],
    /// Largest distance of a point from the origin along a periodic axis; 0 where no axis is.
    pub farthest: f32,
}

/// Cells of one axis: `count` from `first` on, wrapping where the axis is periodic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CellRange {
    pub(crate) first: u32,
    pub(crate) count: u32,
}

impl GridLayout {
    /// The layout for `n_points` points inside `bounds`. Points outside stay exact on axes that are not periodic.
    pub fn new(n_points: u32, bounds: &Aabb, settings: &GridSettings) -> Self {
        let period = settings.period;
        let lengths = period.lengths();
        let empty = bounds.is_empty();
        let extent = Vec3::select(lengths.cmpgt(Vec3::ZERO), lengths, bounds.extent());
        let origin = if empty { Vec3::ZERO } else { bounds.min };
        let size = cell_size(n_points, extent, settings.cell_size);
        let cut = |refine_x: u32| {
            let size = Vec3::new(size / refine_x as f32, size, size);
            let (mut cells, mut inverse_cell) = ([1; 3], [0.0; 3]);
            for axis in 0..3 {
                // Cells grow where there would be too many to count exactly.
                let size = size[axis].max(extent[axis] / (0.5 * MAX_CELLS));
                if lengths[axis] > 0.0 {
                    let count = (extent[axis] / size).floor().clamp(1.0, MAX_CELLS);
                    cells[axis] = count as u32;
                    inverse_cell[axis] = count / lengths[axis];
                } else if extent[axis] > 0.0 && !empty {
                    inverse_cell[axis] = (1.0 / size).min(f32::MAX);
                    cells[axis] = (extent[axis] * inverse_cell[axis]).floor().clamp(0.0, MAX_CELLS - 1.0) as u32 + 1;
                }
            }
            (cells, inverse_cell, cells.iter().fold(1u64, |product, &c| product.saturating_mul(u64::from(c))))
        };
        // The finest cells along x whose table is still dense; if none is, the finest.
        // Numbers of entries have 32 bits.
        let dense_limit = (DENSE_ENTRIES_PER_POINT * u64::from(n_points)).clamp(4096, 1 << 31);
        let finest = (1..=settings.refine_x).rev().map(cut);
        let dense = finest.clone().find(|(_, _, entries)| *entries <= dense_limit);
        let hashed = dense.is_none();
        let (cells, inverse_cell, dense) = dense.unwrap_or_else(|| cut(settings.refine_x));
        let table_size = if hashed { (2 * u64::from(n_points)).next_power_of_two().min(1 << 31) } else { dense };
        Self {
            origin: origin.to_array(),
            n_points,
            inverse_cell,
            table_size: table_size as u32,
            cells,
            hashed: u32::from(hashed),
            period: lengths.to_array(),
            periodic: u32::from(period.is_periodic()),
            inverse_period: period.inverse().to_array(),
            farthest: if empty { 0.0 } else { farthest(bounds, origin, lengths) },
        }
    }

    /// The same cells with hashed rows and a table of a power of two, whether or not a dense table would be small enough.
    #[cfg(feature = "gpu")]
    pub(in crate::structure) fn hashed(self) -> Self {
        let table_size = (2 * u64::from(self.n_points)).next_power_of_two().min(1 << 31) as u32;
        Self { hashed: 1, table_size, ..self }
    }

    /// The longest radius whose balls touch at most 3 × 3 rows of cells; infinite where there is one cell for everything.
    #[cfg(feature = "gpu")]
    pub(crate) fn reach(&self) -> f32 {
        let edge =
            |axis: usize| if self.inverse_cell[axis] > 0.0 { 1.0 / self.inverse_cell[axis] } else { f32::INFINITY };
        let rows = edge(1).min(edge(2));
        if rows.is_finite() { rows } else { edge(0) }
    }

    /// Bits that hold every table entry's number.
    pub fn key_bits(&self) -> u32 {
        32 - (self.table_size - 1).leading_zeros()
    }

    /// The cell of a point. Monotone on each axis that is not periodic; points outside the bounds count to the border.
    #[inline(always)]
    pub fn cell_of(&self, point: Vec3) -> [u32; 3] {
        [0, 1, 2].map(|axis| self.cell_on(axis, point[axis]))
    }

    #[inline(always)]
    fn cell_on(&self, axis: usize, coordinate: f32) -> u32 {
        let mut offset = coordinate - self.origin[axis];
        if self.period[axis] > 0.0 {
            offset -= self.period[axis] * (offset * self.inverse_period[axis]).floor();
        }
        // The conversion rounds down what is not negative; a call of `floor` would take longer than all the rest.
        (offset * self.inverse_cell[axis]).clamp(0.0, (self.cells[axis] - 1) as f32) as u32
    }

    /// The table entry at which row (y, z) begins.
    #[inline(always)]
    pub fn row_start(&self, y: u32, z: u32) -> u32 {
        if self.hashed == 0 {
            return (z * self.cells[1] + y) * self.cells[0];
        }
        // Two rounds of multiply and shift over the primes of Teschner2003: its plain xor leaves low bits regular.
        let mut h = y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
        h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
        h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
        (h ^ (h >> 15)) & (self.table_size - 1)
    }

    /// The table entry of a cell.
    #[inline(always)]
    pub fn entry_of(&self, [x, y, z]: [u32; 3]) -> u32 {
        let entry = self.row_start(y, z).wrapping_add(x);
        if self.hashed == 0 { entry } else { entry & (self.table_size - 1) }
    }

    /// The cells on `axis` that can hold a point within `radius` of the interval from `low` to `high`.
    #[inline]
    pub(crate) fn cells_near(&self, axis: usize, low: f32, high: f32, radius: f32) -> CellRange {
        let cells = self.cells[axis];
        let mut reach = radius * RADIUS_SLACK + LENGTH_SLACK;
        if self.period[axis] == 0.0 {
            let first = self.cell_on(axis, low - reach);
            let last = self.cell_on(axis, high + reach);
            return CellRange { first, count: last - first + 1 };
        }
        let far = (low - self.origin[axis]).abs().max((high - self.origin[axis]).abs());
        reach += self.period[axis] * PERIOD_SLACK + (far + self.farthest) * WRAP_SLACK;
        let turns = ((low - self.origin[axis]) * self.inverse_period[axis]).floor();
        let low = (low - self.origin[axis]) - self.period[axis] * turns;
        let high = (high - self.origin[axis]) - self.period[axis] * turns;
        let first = ((low - reach) * self.inverse_cell[axis]).floor();
        let count = ((high + reach) * self.inverse_cell[axis]).floor() - first + 1.0;
        if count >= cells as f32 {
            return CellRange { first: 0, count: cells };
        }
        CellRange { first: (first as i64).rem_euclid(i64::from(cells)) as u32, count: count as u32 }
    }

    /// Calls `visit` with each run of table entries that a box grown by `radius` touches; entries of one run are
    /// consecutive. Returns false, without a call, where there would be more runs than points.
    pub(crate) fn entry_runs(&self, region: &Aabb, radius: f32, mut visit: impl FnMut(Range<u32>)) -> bool {
        let [x, y, z] = [0, 1, 2].map(|axis| self.cells_near(axis, region.min[axis], region.max[axis], radius));
        if u64::from(y.count) * u64::from(z.count) > u64::from(self.n_points).max(64) {
            return false;
        }
        let wrapped = |cell: u32, cells: u32| if cell >= cells { cell - cells } else { cell };
        for k in 0..z.count {
            let row_z = wrapped(z.first + k, self.cells[2]);
            for j in 0..y.count {
                let row = self.row_start(wrapped(y.first + j, self.cells[1]), row_z);
                let before_wrap = x.count.min(self.cells[0] - x.first);
                self.row_runs(row, x.first, before_wrap, &mut visit);
                self.row_runs(row, 0, x.count - before_wrap, &mut visit);
            }
        }
        true
    }

    /// The one or two runs of entries for `count` cells of a row.
    #[inline(always)]
    fn row_runs(&self, row: u32, first: u32, count: u32, visit: &mut impl FnMut(Range<u32>)) {
        if count == 0 {
            return;
        }
        if self.hashed == 0 {
            return visit(row + first..row + first + count);
        }
        let start = row.wrapping_add(first) & (self.table_size - 1);
        let count = count.min(self.table_size);
        let before_end = count.min(self.table_size - start);
        visit(start..start + before_end);
        if count > before_end {
            visit(0..count - before_end);
        }
    }
}

/// Largest distance of a corner from the origin along a periodic axis.
fn farthest(bounds: &Aabb, origin: Vec3, lengths: Vec3) -> f32 {
    let corner = (bounds.min - origin).abs().max((bounds.max - origin).abs());
    Vec3::select(lengths.cmpgt(Vec3::ZERO), corner, Vec3::ZERO).max_element()
}

/// Edge length of a cell: as asked, or by density.
fn cell_size(n_points: u32, extent: Vec3, asked: f32) -> f32 {
    if asked > 0.0 {
        return asked;
    }
    // Two points a cell, if they filled their box evenly; flat and straight clouds by the axes they have.
    let axes = extent.to_array().into_iter().filter(|&e| e > 0.0);
    let dimension = axes.clone().count();
    if dimension == 0 {
        return 1.0;
    }
    let log_volume: f64 = axes.map(|e| f64::from(e).ln()).sum();
    let log_cells = (f64::from(n_points) / 2.0).max(1.0).ln();
    (((log_volume - log_cells) / dimension as f64).exp() as f32).max(f32::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Period;

    fn unit(n: u32, cell: f32) -> GridLayout {
        GridLayout::new(n, &Aabb::new(Vec3::ZERO, Vec3::ONE), &GridSettings::for_radius(cell))
    }

    #[test]
    fn tables_of_very_many_points_have_entries_of_32_bits() {
        let bounds = Aabb::new(Vec3::ZERO, Vec3::ONE);
        for n in [600_000_000, u32::MAX - 1] {
            let layout = GridLayout::new(n, &bounds, &GridSettings::for_radius(1.0 / 1620.0));
            let cells: u64 = layout.cells.iter().map(|&c| u64::from(c)).product();
            assert!(layout.hashed == 1 || u64::from(layout.table_size) == cells, "{layout:?}");
            assert!(layout.table_size <= 1 << 31, "{layout:?}");
        }
    }

    #[test]
    fn a_dense_table_numbers_cells_along_x() {
        let layout = unit(10_000, 0.25);
        assert_eq!((layout.hashed, layout.cells), (0, [17, 5, 5]));
        assert_eq!(layout.table_size, 17 * 5 * 5);
        assert_eq!(layout.entry_of([16, 4, 4]), layout.table_size - 1);
        assert_eq!(layout.cell_of(Vec3::new(1.0, 0.49, -7.0)), [16, 1, 0]);
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn the_reach_is_that_of_rows_where_there_are_any() {
        assert_eq!(unit(10_000, 0.25).reach(), 0.25);
        let of = |corner: Vec3| {
            let settings = GridSettings::for_radius(0.25);
            GridLayout::new(100, &Aabb::new(Vec3::ZERO, corner), &settings).reach()
        };
        assert_eq!(of(Vec3::X), 0.0625, "cells along x are a quarter as long");
        assert_eq!(of(Vec3::new(1.0, 0.0, 1.0)), 0.25);
        assert_eq!(of(Vec3::ZERO), f32::INFINITY);
    }

    #[test]
    fn an_outlier_a_million_cells_away_keeps_the_table_small() {
        let bounds = Aabb::new(Vec3::ZERO, Vec3::splat(1e6));
        let layout = GridLayout::new(1000, &bounds, &GridSettings::for_radius(1.0));
        assert_eq!((layout.hashed, layout.table_size), (1, 2048));
    }

    #[test]
    fn cells_near_hold_every_cell_within_the_radius() {
        let layout = unit(10_000, 0.25);
        assert_eq!(layout.cells_near(1, 0.5, 0.5, 0.125), CellRange { first: 1, count: 2 });
        assert_eq!(layout.cells_near(1, 0.3, 0.3, 0.01), CellRange { first: 1, count: 1 });
        assert_eq!(layout.cells_near(1, -5.0, 9.0, 1.0), CellRange { first: 0, count: 5 });
    }

    #[test]
    fn periodic_cells_wrap_and_never_repeat() {
        let period = Period::new(Vec3::ONE).unwrap();
        let settings = GridSettings::for_radius(0.25).periodic(period);
        let layout = GridLayout::new(10_000, &Aabb::new(Vec3::ZERO, Vec3::ONE), &settings);
        assert_eq!(layout.cells, [16, 4, 4]);
        assert_eq!(layout.cells_near(1, 0.1, 0.1, 0.2), CellRange { first: 3, count: 3 });
        assert_eq!(layout.cells_near(1, 7.1, 7.1, 0.2), CellRange { first: 3, count: 3 });
        assert_eq!(layout.cells_near(1, 0.1, 0.1, 9.0), CellRange { first: 0, count: 4 });
    }

    #[test]
    fn a_query_a_thousand_million_periods_away_reaches_every_cell() {
        let period = Period::new(Vec3::ONE).unwrap();
        let settings = GridSettings::for_radius(0.25).periodic(period);
        let layout = GridLayout::new(10_000, &Aabb::new(Vec3::ZERO, Vec3::splat(1000.0)), &settings);
        assert_eq!(layout.farthest, 1000.0);
        assert_eq!(layout.cells_near(1, 1e9, 1e9, 0.2), CellRange { first: 0, count: 4 });
    }

    #[test]
    fn hashed_runs_wrap_at_the_end_of_the_table() {
        let bounds = Aabb::new(Vec3::ZERO, Vec3::splat(1e6));
        let layout = GridLayout::new(8, &bounds, &GridSettings::for_radius(1.0));
        let mut entries = vec![];
        assert!(layout.entry_runs(&Aabb::new(Vec3::ZERO, Vec3::new(9.0, 0.0, 0.0)), 0.0, |run| entries.extend(run)));
        assert!(!entries.is_empty() && entries.iter().all(|&e| e < layout.table_size));
    }
}
