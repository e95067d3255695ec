//! The uniform grid on the CPU.

use std::ops::Range;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::{GridLayout, GridSettings};
use crate::geometry::{Aabb, OrderedPoints, Period, validate};
use crate::parallel::radix_sort;
use crate::structure::{BuildStage, CpuStructure, Packed, merge_spans};
use crate::{Error, Result};

/// Most points of a pack: enough to share the look-up of spans, few enough to keep the pack's box small.
const PACK: usize = 32;

/// Points sorted by cell, on the CPU.
#[derive(Debug, Clone)]
pub struct UniformGrid {
    pub(super) layout: GridLayout,
    pub(super) points: OrderedPoints,
    pub(super) starts: Vec<u32>,
    pub(super) packs: Vec<u32>,
    period: Period,
    stages: Vec<BuildStage>,
}

impl UniformGrid {
    /// Sorts the points by cell.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more), `InvalidSetting`, `OutOfMemory`.
    pub fn build(points: &[Vec3], settings: &GridSettings) -> Result<Self> {
        let mut stages = Vec::new();
        let mut clock = Instant::now();
        let mut stage = |name| {
            stages.push(BuildStage::on_host(name, clock));
            clock = Instant::now();
        };
        settings.validate()?;
        validate::points(points)?;
        let bounds = settings.bounds_of(points);
        let layout = GridLayout::new(points.len() as u32, &bounds, settings);
        stage("bounds");
        let (keys, order) = sorted_entries(&layout, points)?;
        stage("sort");
        let points = OrderedPoints::gather(points, &order);
        stage("gather");
        let starts = entry_starts(&keys, layout.table_size)?;
        let packs = packs(&layout, points.len(), |i| points.position(i));
        stage("table");
        Ok(Self { layout, points, starts, packs, period: settings.period, stages })
    }

    /// Geometry of the grid.
    pub fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Number of table entries that hold at least one point.
    pub fn occupied_entries(&self) -> usize {
        self.starts.windows(2).filter(|w| w[0] < w[1]).count()
    }
}

/// Table entries of the points in ascending order, and the points' indices in that order, ties by index.
fn sorted_entries(layout: &GridLayout, points: &[Vec3]) -> Result<(Vec<u32>, Vec<u32>)> {
    let mut keys: Vec<u32> =
        points.par_iter().with_min_len(1 << 12).map(|&p| layout.entry_of(layout.cell_of(p))).collect();
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    radix_sort::sort_pairs(&mut keys, &mut order, 0..layout.key_bits())?;
    Ok((keys, order))
}

/// For each table entry the place of its first point, and the number of points at the end.
fn entry_starts(keys: &[u32], table_size: u32) -> Result<Vec<u32>> {
    /// Entries that one thread fills.
    const CHUNK: usize = 1 << 16;
    let len = table_size as usize + 1;
    let mut starts: Vec<u32> = bytemuck::allocation::try_zeroed_vec(len).map_err(|()| Error::OutOfMemory {
        what: "the table of the grid",
        needed: 4 * len as u64,
        available: 0,
    })?;
    starts.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, starts)| {
        let first = chunk * CHUNK;
        let mut place = keys.partition_point(|&key| (key as usize) < first);
        for (entry, start) in (first..).zip(starts) {
            while keys.get(place).is_some_and(|&key| (key as usize) < entry) {
                place += 1;
            }
            *start = place as u32;
        }
    });
    Ok(starts)
}

/// Cuts an order into packs: runs of at most [`PACK`] points of one row that span at most `refine` cells more than one
/// radius along x.
fn packs(layout: &GridLayout, n: usize, position: impl Fn(usize) -> Vec3 + Sync) -> Vec<u32> {
    // Blocks are cut independently: a pack that a block border splits in two costs one look-up.
    const BLOCK: usize = 1 << 14;
    let cut = |block: usize| {
        let (first, end) = (block * BLOCK, n.min((block + 1) * BLOCK));
        let mut packs = Vec::with_capacity((end - first) / 8);
        let (mut pack, mut pack_cell) = (first, [u32::MAX; 3]);
        for i in first..end {
            let cell = layout.cell_of(position(i));
            let near = cell[1] == pack_cell[1] && cell[2] == pack_cell[2] && cell[0].abs_diff(pack_cell[0]) < 2;
            if !near || i - pack >= PACK {
                packs.push(i as u32);
                (pack, pack_cell) = (i, cell);
            }
        }
        packs
    };
    let mut packs: Vec<u32> = (0..n.div_ceil(BLOCK)).into_par_iter().flat_map_iter(cut).collect();
    packs.push(n as u32);
    packs
}

impl CpuStructure for UniformGrid {
    const NAME: &'static str = "uniform-grid";

    fn search(&self) -> &'static str {
        "row-runs"
    }

    fn points(&self) -> &OrderedPoints {
        &self.points
    }

    fn period(&self) -> Period {
        self.period
    }

    fn packs(&self) -> &[u32] {
        &self.packs
    }

    fn pack_queries(&self, queries: &[Vec3]) -> Result<Packed> {
        let (_, order) = sorted_entries(&self.layout, queries)?;
        let packs = packs(&self.layout, order.len(), |i| queries[order[i] as usize]);
        Ok(Packed { order, packs })
    }

    fn spans_near(&self, region: &Aabb, radius: f32, spans: &mut Vec<Range<usize>>) {
        let first = spans.len();
        let few_rows = self.layout.entry_runs(region, radius, |entries| {
            let span = self.starts[entries.start as usize] as usize..self.starts[entries.end as usize] as usize;
            if !span.is_empty() {
                spans.push(span);
            }
        });
        if !few_rows {
            spans.push(0..self.points.len());
        } else if self.layout.hashed == 1 {
            // Rows whose hashes collide share entries: each place must still be met once.
            let mut own = spans.split_off(first);
            merge_spans(&mut own);
            spans.append(&mut own);
        }
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.points.memory_bytes() + 4 * (self.starts.len() + self.packs.len()) as u64
    }
}
