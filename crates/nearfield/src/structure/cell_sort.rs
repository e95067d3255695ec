//! Points into the order of the table entries that they belong to, on the GPU: what builds of grids share.
//!
//! Source: Green2010, who sorts, and its counting variant by atomics. Cost: a sort of n keys of as many bits as the table's size has, or an atomic a point
//! and a write of 20 bytes in random order; a scan of the table. Counting is the faster one up to some two million points (uniform-1m on an H200:
//! 0.083 ms instead of 0.117; uniform-10m: 1.51 instead of 0.75, where points are in random order), and for points that are nearly in order.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::DevicePoint;
use crate::Result;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::scan::GpuScan;

use Access::{Read, ReadWrite, Uniform};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 256;

/// In which order the points of one table entry stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EntryOrder {
    /// As in the input, so that every build of the same points gives the same memory. They are sorted.
    #[default]
    AsGiven,
    /// Any, which may differ from build to build. They are counted and placed, which takes less time where no entry has
    /// thousands of points.
    Any,
}

/// `CellSort` in cell_sort.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct CellSort {
    /// Points.
    pub n_points: u32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
    /// Unused.
    pub padding_2: u32,
}

/// A plan to sort points of one number by the entries of a table of one size, and its scratch memory.
#[derive(Debug)]
pub(super) struct CellSorter {
    parameters: Buffer<CellSort>,
    n_points: usize,
    key_bits: u32,
    /// `[n]`, written by the grid.
    keys: Buffer<u32>,
    table: Option<Table>,
    way: Way,
}

/// What the table of a grid takes.
#[derive(Debug)]
struct Table {
    size: usize,
    /// `[size]`, counted by the grid.
    counts: Buffer<u32>,
    scan: GpuScan,
}

#[derive(Debug)]
enum Way {
    Sort { sort: Box<GpuRadixSort<u32>>, sorted_keys: Buffer<u32>, order: Buffer<u32>, gather: Arc<Pipeline> },
    Place { ranks: Buffer<u32>, place: Arc<Pipeline> },
}

/// What a sort fills.
pub(super) struct SortedPoints<'a> {
    /// `[n]` the points by entry.
    pub(super) points: &'a Buffer<DevicePoint>,
    /// `[n]` their indices.
    pub(super) ids: &'a Buffer<u32>,
    /// `[table_size + 1]` place of the first point of each entry; `None` from a plan without a table.
    pub(super) starts: Option<&'a Buffer<u32>>,
}

impl CellSorter {
    /// A plan; its memory is 8 (`Any`) or 12 bytes a point and what a sort needs, and 4 an entry.
    ///
    /// # Errors
    /// As [`GpuScan::new`] and [`GpuRadixSort::new`].
    pub(super) fn new(gpu: &Gpu, n_points: usize, table_size: u32, order: EntryOrder) -> Result<Self> {
        let size = table_size as usize;
        let counts = gpu.buffer("points of table entries", size)?;
        let table = Table { size, counts, scan: GpuScan::new(gpu, size)? };
        let way = match order {
            EntryOrder::AsGiven => Way::sort(gpu, n_points)?,
            EntryOrder::Any => Way::Place {
                ranks: gpu.buffer("numbers of points in their entries", n_points)?,
                place: pipeline(gpu, "place_points", &[Uniform, Read, ReadWrite, ReadWrite, Read, Read, Read])?,
            },
        };
        Self::of_parts(gpu, n_points, table_size, Some(table), way)
    }

    /// A plan that only sorts: no table is made.
    ///
    /// # Errors
    /// As [`CellSorter::new`].
    pub(super) fn without_table(gpu: &Gpu, n_points: usize, table_size: u32) -> Result<Self> {
        Self::of_parts(gpu, n_points, table_size, None, Way::sort(gpu, n_points)?)
    }

    fn of_parts(gpu: &Gpu, n_points: usize, table_size: u32, table: Option<Table>, way: Way) -> Result<Self> {
        let parameters = CellSort { n_points: n_points as u32, padding_0: 0, padding_1: 0, padding_2: 0 };
        Ok(Self {
            parameters: gpu.uniform("points to sort by entry", &parameters)?,
            n_points,
            key_bits: u32::BITS - table_size.saturating_sub(1).leading_zeros(),
            keys: gpu.buffer("table entries of points", n_points)?,
            table,
            way,
        })
    }

    /// Conditions of the kernel of [`CellSorter::record_entries`].
    pub(super) fn features(&self) -> [(&'static str, bool); 2] {
        [("counted", self.table.is_some()), ("ranked", matches!(self.way, Way::Place { .. }))]
    }

    /// How its bindings behind the grid's own are used.
    pub(super) fn accesses(&self) -> Vec<Access> {
        vec![ReadWrite; 1 + self.features().iter().filter(|(_, is_set)| *is_set).count()]
    }

    /// Records the grid's kernel that writes keys `[n]` and, as [`CellSorter::features`] say, counts points of entries `[table_size]` and writes how
    /// many were counted in its entry before each `[n]`; these follow `bindings`.
    pub(super) fn record_entries(&self, commands: &mut Commands, compute: &Arc<Pipeline>, bindings: &[Bind]) {
        let mut all = bindings.to_vec();
        all.push((&self.keys).into());
        commands.stage("entries");
        if let Some(table) = &self.table {
            commands.clear(&table.counts);
            all.push((&table.counts).into());
        }
        if let Way::Place { ranks, .. } = &self.way {
            all.push(ranks.into());
        }
        commands.dispatch(compute, &all, Workgroups::Covering(self.n_points as u64));
    }

    /// Records the sort of `points` by the entries of [`CellSorter::record_entries`].
    ///
    /// # Errors
    /// `OutOfDeviceMemory`.
    pub(super) fn record(
        &self,
        commands: &mut Commands,
        points: &Buffer<DevicePoint>,
        sorted: &SortedPoints<'_>,
    ) -> Result<()> {
        let mut bindings = vec![(&self.parameters).into(), points.into(), sorted.points.into(), sorted.ids.into()];
        let covering = Workgroups::Covering(self.n_points as u64);
        if let Way::Sort { sort, sorted_keys, order, gather } = &self.way {
            commands.stage("sort");
            sort.record_from(commands, &self.keys, None, sorted_keys, order, self.n_points, 0..self.key_bits)?;
            bindings.push(order.into());
            commands.stage("gather").dispatch(gather, &bindings, covering.clone());
        }
        let (Some(table), Some(starts)) = (&self.table, sorted.starts) else { return Ok(()) };
        commands.stage("table");
        table.scan.record(commands, &table.counts, starts, table.size)?;
        if let Way::Place { ranks, place } = &self.way {
            bindings.extend([(&self.keys).into(), ranks.into(), starts.into()]);
            commands.stage("place").dispatch(place, &bindings, covering);
        }
        Ok(())
    }
}

impl Way {
    fn sort(gpu: &Gpu, n_points: usize) -> Result<Self> {
        Ok(Self::Sort {
            sort: Box::new(GpuRadixSort::new(gpu, n_points)?),
            sorted_keys: gpu.buffer("sorted table entries", n_points)?,
            order: gpu.buffer("order of points", n_points)?,
            gather: pipeline(gpu, "gather_points", &[Uniform, Read, ReadWrite, ReadWrite, Read])?,
        })
    }
}

fn pipeline(gpu: &Gpu, entry: &'static str, accesses: &[Access]) -> Result<Arc<Pipeline>> {
    gpu.prepare(&Kernel {
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new("package::structure::cell_sort", entry, accesses, WORKGROUP)
    })
}
