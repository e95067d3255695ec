//! The grid on the GPU: entries of all points and their sort.

use std::sync::Arc;

use glam::Vec3;

use super::layout::{LevelRule, MultiLevelLayout};
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline};
use crate::structure::BuildStage;
use crate::structure::cell_sort::{CellSorter, EntryOrder, SortedPoints};
use crate::structure::on_gpu::{DevicePoint, Effort, GpuStructure, upload_points};
use crate::structure::uniform_grid::most_effort;
use crate::{Error, Result};

/// Invocations of a workgroup of the build kernels.
const WORKGROUP: u32 = 256;
/// Conditions of the layout's functions.
const FEATURES: [(&str, bool); 2] = [("hashed", true), ("periodic", false)];

/// Points in blocks by level, each sorted by cell, on the GPU.
///
/// The radius of a question is that of who asks; it finds the points of each level within the reach that the grid's [`LevelRule`] gives.
/// Answers of `dist2 <= radius²` hold for the reach.
#[derive(Debug)]
pub struct GpuMultiLevelGrid {
    gpu: Gpu,
    layout: MultiLevelLayout,
    layout_buffer: Buffer<MultiLevelLayout>,
    points: Buffer<DevicePoint>,
    ids: Buffer<u32>,
    starts: Buffer<u32>,
}

/// Everything that builds of grids of one layout share: pipelines and scratch memory. Keep it to build again as points move.
#[derive(Debug)]
pub struct MultiLevelGridBuilder {
    gpu: Gpu,
    layout: MultiLevelLayout,
    layout_buffer: Buffer<MultiLevelLayout>,
    compute_entries: Arc<Pipeline>,
    sorter: CellSorter,
}

impl MultiLevelGridBuilder {
    /// A builder for points inside `bounds`; those outside stay exact, only slower to search.
    ///
    /// - `levels`: number of points and radius of each level, in the order of their blocks; 1 to 8
    /// - `order`: of the points of one table entry
    ///
    /// # Errors
    /// As [`MultiLevelLayout::new`]; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, levels: &[(usize, f32)], rule: LevelRule, bounds: &Aabb, order: EntryOrder) -> Result<Self> {
        let layout = MultiLevelLayout::new(levels, rule, bounds)?;
        let sorter = CellSorter::new(gpu, layout.n_points as usize, layout.table_size(), order)?;
        let features = [&FEATURES[..], &sorter.features()].concat();
        let accesses = [vec![Access::Uniform, Access::Read], sorter.accesses()].concat();
        let kernel = Kernel {
            features: &features,
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new("package::structure::multi_level_grid::build", "compute_entries", &accesses, WORKGROUP)
        };
        Ok(Self {
            layout_buffer: gpu.uniform("layout of a grid of several levels", &layout)?,
            compute_entries: gpu.prepare(&kernel)?,
            gpu: gpu.clone(),
            layout,
            sorter,
        })
    }

    /// Builds the grid of these points.
    ///
    /// - `points`: `[n]` xyz and the index that answers use as bits of w, in blocks by level; trusted to be finite and within ±1e18
    ///
    /// # Errors
    /// `LengthMismatch` for another number of points, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(&self, points: &Buffer<DevicePoint>) -> Result<GpuMultiLevelGrid> {
        let mut grid = GpuMultiLevelGrid {
            gpu: self.gpu.clone(),
            layout: self.layout,
            layout_buffer: self.layout_buffer.clone(),
            points: self.gpu.buffer("sorted points", points.len())?,
            ids: self.gpu.buffer("indices of sorted points", points.len())?,
            starts: self.gpu.buffer("grid table", self.layout.table_size() as usize + 1)?,
        };
        let mut commands = self.gpu.commands("grid of several levels");
        self.record_rebuild(&mut commands, points, &mut grid)?;
        commands.submit()?;
        Ok(grid)
    }

    /// Records a build of these points in the memory of a grid that this builder made: nothing runs before the commands are submitted, and
    /// nothing is read back.
    ///
    /// # Errors
    /// `LengthMismatch` for another number of points, or a grid of another builder; `OutOfDeviceMemory`.
    pub fn record_rebuild(
        &self,
        commands: &mut Commands,
        points: &Buffer<DevicePoint>,
        grid: &mut GpuMultiLevelGrid,
    ) -> Result<()> {
        let n = self.layout.n_points as usize;
        if points.len() != n || grid.layout != self.layout {
            let (found, expected) = (points.len() as u64, n as u64);
            return Err(Error::LengthMismatch { what: "points to build a grid of", found, expected });
        }
        let bindings: [Bind; 2] = [(&self.layout_buffer).into(), points.into()];
        self.sorter.record_entries(commands, &self.compute_entries, &bindings);
        let sorted = SortedPoints { points: &grid.points, ids: &grid.ids, starts: Some(&grid.starts) };
        self.sorter.record(commands, points, &sorted)
    }
}

impl GpuMultiLevelGrid {
    /// The levels.
    pub fn layout(&self) -> &MultiLevelLayout {
        &self.layout
    }
}

impl GpuStructure for GpuMultiLevelGrid {
    const NAME: &'static str = "multi-level-grid";

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    fn points(&self) -> &Buffer<DevicePoint> {
        &self.points
    }

    fn shares_queries(&self) -> bool {
        true
    }

    fn traverse_module(&self) -> &'static str {
        "package::structure::multi_level_grid::traverse"
    }

    fn most_effort(&self, radius: f32, queries: Option<&Aabb>) -> Result<Effort> {
        let in_step = self.gpu.limits().subgroup.map_or(64, |(_, largest)| largest);
        let starts = self.gpu.read(&self.starts)?;
        let mut most = Effort { candidates: 0, rounds: self.layout.n_levels.into() };
        for level in self.layout.levels() {
            let first = level.first_entry as usize;
            // As if its table stood alone.
            let table = &starts[first..=first + level.grid.table_size as usize];
            let own: Vec<u32> = table.iter().map(|start| start - table[0]).collect();
            let reach = self.layout.reach(radius, level);
            let effort = most_effort(&level.grid, &own, reach, queries, in_step);
            most.candidates = most.candidates.saturating_add(effort.candidates);
            most.rounds = most.rounds.saturating_add(effort.rounds);
        }
        Ok(most)
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        FEATURES.to_vec()
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![
            (Access::Uniform, (&self.layout_buffer).into()),
            (Access::Read, (&self.points).into()),
            (Access::Read, (&self.starts).into()),
        ]
    }

    /// In the order in which they are given.
    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>> {
        upload_points(&self.gpu, "queries", queries, 0)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &[]
    }

    fn memory_bytes(&self) -> u64 {
        self.points.bytes() + self.ids.bytes() + self.starts.bytes() + self.layout_buffer.bytes()
    }
}
