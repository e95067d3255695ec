//! Points into the order of the table entries that they belong to, on the GPU: what builds of grids share.

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
    table_size: usize,
    key_bits: u32,
    /// `[n]`, written by the grid.
    keys: Buffer<u32>,
    /// `[table_size]`, counted by the grid.
    counts: Buffer<u32>,
    scan: GpuScan,
    way: Way,
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
    /// `[table_size + 1]` place of the first point of each entry.
    pub(super) starts: &'a Buffer<u32>,
}

impl CellSorter {
    /// A plan; its memory is 8 (`Any`) or 12 bytes a point and what a sort needs, and 4 an entry.
    ///
    /// # Errors
    /// As [`GpuScan::new`] and [`GpuRadixSort::new`].
    pub(super) fn new(gpu: &Gpu, n_points: usize, table_size: usize, order: EntryOrder) -> Result<Self> {
        let pipeline = |entry, accesses: &[Access]| {
            gpu.pipeline(&Kernel {
                constants: &[("WORKGROUP", f64::from(WORKGROUP))],
                ..Kernel::new("package::structure::cell_sort", entry, accesses, WORKGROUP)
            })
        };
        let way = match order {
            EntryOrder::AsGiven => Way::Sort {
                sort: Box::new(GpuRadixSort::new(gpu, n_points)?),
                sorted_keys: gpu.buffer("sorted table entries", n_points)?,
                order: gpu.buffer("order of points", n_points)?,
                gather: pipeline("gather_points", &[Uniform, Read, ReadWrite, ReadWrite, Read])?,
            },
            EntryOrder::Any => Way::Place {
                ranks: gpu.buffer("numbers of points in their entries", n_points)?,
                place: pipeline("place_points", &[Uniform, Read, ReadWrite, ReadWrite, Read, Read, Read])?,
            },
        };
        let parameters = CellSort { n_points: n_points as u32, padding_0: 0, padding_1: 0, padding_2: 0 };
        Ok(Self {
            parameters: gpu.uniform("points to sort by entry", &parameters)?,
            n_points,
            table_size,
            key_bits: u32::BITS - (table_size as u32).saturating_sub(1).leading_zeros(),
            keys: gpu.buffer("table entries of points", n_points)?,
            counts: gpu.buffer("points of table entries", table_size)?,
            scan: GpuScan::new(gpu, table_size)?,
            way,
        })
    }

    /// Whether kernels that count write ranks.
    pub(super) fn ranks_points(&self) -> bool {
        matches!(self.way, Way::Place { .. })
    }

    /// How the bindings of [`CellSorter::record_entries`] are used.
    pub(super) fn accesses(&self) -> Vec<Access> {
        vec![ReadWrite; if self.ranks_points() { 3 } else { 2 }]
    }

    /// Records the grid's kernel that writes keys `[n]`, counts points of entries `[table_size]` and, where points are ranked, writes how many were
    /// counted in its entry before each `[n]`; these follow `bindings`.
    pub(super) fn record_entries(&self, commands: &mut Commands, compute: &Arc<Pipeline>, bindings: &[Bind]) {
        let mut all = bindings.to_vec();
        all.extend([(&self.keys).into(), (&self.counts).into()]);
        if let Way::Place { ranks, .. } = &self.way {
            all.push(ranks.into());
        }
        let covering = Workgroups::Covering(self.n_points as u64);
        commands.stage("entries").clear(&self.counts).dispatch(compute, &all, covering);
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
        match &self.way {
            Way::Sort { sort, sorted_keys, order, gather } => {
                commands.stage("sort");
                sort.record_from(commands, &self.keys, None, sorted_keys, order, self.n_points, 0..self.key_bits)?;
                bindings.push(order.into());
                commands.stage("gather").dispatch(gather, &bindings, covering);
                commands.stage("table");
                self.scan.record(commands, &self.counts, sorted.starts, self.table_size)
            }
            Way::Place { ranks, place } => {
                commands.stage("table");
                self.scan.record(commands, &self.counts, sorted.starts, self.table_size)?;
                bindings.extend([(&self.keys).into(), ranks.into(), sorted.starts.into()]);
                commands.stage("place").dispatch(place, &bindings, covering);
                Ok(())
            }
        }
    }
}
