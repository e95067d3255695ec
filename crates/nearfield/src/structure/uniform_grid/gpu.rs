//! The uniform grid on the GPU: entries of all points and their sort, in one submission.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::effort::Balls;
use super::{GridLayout, GridSettings};
use crate::geometry::{Aabb, Period, validate};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline};
use crate::structure::cell_sort::{CellSorter, EntryOrder, SortedPoints};
use crate::structure::on_gpu::{DevicePoint, Effort, GpuStructure, upload_points};
use crate::structure::{BuildStage, CpuStructure, UniformGrid};
use crate::{Error, Result};

/// Invocations of a workgroup of the build kernels.
const WORKGROUP: u32 = 256;

/// Longest radius, in cells, of balls that are searched in pairs: the rows of two balls have ever less in common as they become
/// thinner. On an H200 with uniform-1m pairs count in 0.19 ms where single queries take 0.21 at a radius of one cell; at one and a half
/// both take 0.29, at two pairs take 0.33 and single queries 0.26.
const MOST_CELLS_A_PAIRS_RADIUS: f32 = 1.25;

/// Points sorted by cell, on the GPU.
#[derive(Debug)]
pub struct GpuUniformGrid {
    gpu: Gpu,
    pub(super) layout: GridLayout,
    layout_buffer: Buffer<GridLayout>,
    points: Buffer<DevicePoint>,
    ids: Buffer<u32>,
    starts: Buffer<u32>,
    period: Period,
    stages: Vec<BuildStage>,
}

impl GpuUniformGrid {
    /// Copies the points to the device and sorts them by cell there.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more), `InvalidSetting`, `OutOfDeviceMemory`
    /// (16 bytes a point must fit one binding), `DeviceLost`.
    pub fn build(gpu: &Gpu, points: &[Vec3], settings: &GridSettings) -> Result<Self> {
        validate::points(points)?;
        let start = Instant::now();
        let bounds = settings.bounds_of(points);
        let input = upload_points(gpu, "points", points, 0)?;
        let mut grid = Self::build_on_device(gpu, &input, &bounds, settings)?;
        grid.stages.insert(0, BuildStage::on_host("upload", start));
        Ok(grid)
    }

    /// Sorts points that are on the device already.
    ///
    /// - `points`: `[n]` xyz, and the index that answers use as bits of w (usually 0 … n − 1)
    /// - `bounds`: where they lie; points outside stay exact, only slower to search, but in a periodic domain all must
    ///   be inside
    ///
    /// The coordinates are trusted to be finite and within ±1e18.
    ///
    /// # Errors
    /// `InvalidSetting`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build_on_device(
        gpu: &Gpu,
        points: &Buffer<DevicePoint>,
        bounds: &Aabb,
        settings: &GridSettings,
    ) -> Result<Self> {
        let mut builder = GridBuilder::new(gpu, points.len(), bounds, settings)?;
        builder.build(points)
    }

    /// Geometry of the grid.
    pub fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// `[table_size + 1]` place of the first point of each table entry.
    pub fn starts(&self) -> &Buffer<u32> {
        &self.starts
    }
}

/// Everything that builds of grids of one size and layout share: pipelines and scratch memory. Keep it to build again
/// as points move.
#[derive(Debug)]
pub struct GridBuilder {
    gpu: Gpu,
    layout: GridLayout,
    layout_buffer: Buffer<GridLayout>,
    period: Period,
    compute_entries: Arc<Pipeline>,
    sorter: CellSorter,
}

impl GridBuilder {
    /// A builder for `n_points` points inside `bounds`, those of a table entry in the order in which they are given.
    ///
    /// # Errors
    /// `InvalidSetting`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, n_points: usize, bounds: &Aabb, settings: &GridSettings) -> Result<Self> {
        Self::with_order(gpu, n_points, bounds, settings, EntryOrder::AsGiven)
    }

    /// The same with a choice of that order. [`EntryOrder::Any`] is the faster one for points that move: answers hold the same neighbours, but
    /// those of a row may stand in another order from build to build.
    ///
    /// # Errors
    /// As [`GridBuilder::new`].
    pub fn with_order(
        gpu: &Gpu,
        n_points: usize,
        bounds: &Aabb,
        settings: &GridSettings,
        order: EntryOrder,
    ) -> Result<Self> {
        settings.validate()?;
        let (layout, period) = (GridLayout::new(n_points as u32, bounds, settings), settings.period);
        let sorter = CellSorter::new(gpu, layout.n_points as usize, layout.table_size, order)?;
        Ok(Self {
            layout_buffer: gpu.uniform("grid layout", &layout)?,
            compute_entries: compute_entries(gpu, &layout, period, &sorter)?,
            gpu: gpu.clone(),
            layout,
            period,
            sorter,
        })
    }

    /// Builds the grid of these points, which may have moved since the last build.
    ///
    /// # Errors
    /// `LengthMismatch` for another number of points, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(&mut self, points: &Buffer<DevicePoint>) -> Result<GpuUniformGrid> {
        let sorted = self.gpu.buffer("sorted points", points.len())?;
        let ids = self.gpu.buffer("indices of sorted points", points.len())?;
        let starts = self.gpu.buffer("grid table", self.layout.table_size as usize + 1)?;
        let mut commands = self.gpu.commands("uniform grid build");
        self.record(&mut commands, points, (&sorted, &ids), &starts)?;
        let stages = commands.run()?;
        Ok(GpuUniformGrid {
            gpu: self.gpu.clone(),
            layout: self.layout,
            layout_buffer: self.layout_buffer.clone(),
            points: sorted,
            ids,
            starts,
            period: self.period,
            stages: stages.iter().filter_map(BuildStage::on_device).collect(),
        })
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
        grid: &mut GpuUniformGrid,
    ) -> Result<()> {
        if grid.layout != self.layout {
            let (found, expected) = (u64::from(grid.layout.n_points), u64::from(self.layout.n_points));
            return Err(Error::LengthMismatch { what: "points of a grid of another builder", found, expected });
        }
        self.record(commands, points, (&grid.points, &grid.ids), &grid.starts)
    }

    /// Records the build into `commands`.
    ///
    /// # Errors
    /// `LengthMismatch`, `OutOfDeviceMemory`.
    fn record(
        &self,
        commands: &mut Commands,
        points: &Buffer<DevicePoint>,
        (sorted, ids): (&Buffer<DevicePoint>, &Buffer<u32>),
        starts: &Buffer<u32>,
    ) -> Result<()> {
        let n = self.layout.n_points as usize;
        if points.len() != n {
            let (found, expected) = (points.len() as u64, n as u64);
            return Err(Error::LengthMismatch { what: "points to build a grid of", found, expected });
        }
        let bindings: [Bind; 2] = [(&self.layout_buffer).into(), points.into()];
        self.sorter.record_entries(commands, &self.compute_entries, &bindings);
        self.sorter.record(commands, points, &SortedPoints { points: sorted, ids, starts: Some(starts) })
    }
}

/// The kernel that finds the entries of points.
fn compute_entries(gpu: &Gpu, layout: &GridLayout, period: Period, sorter: &CellSorter) -> Result<Arc<Pipeline>> {
    let features = [&features(layout, period)[..], &sorter.features()].concat();
    let accesses = [vec![Access::Uniform, Access::Read], sorter.accesses()].concat();
    gpu.prepare(&Kernel {
        features: &features,
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new("package::structure::uniform_grid::build", "compute_entries", &accesses, WORKGROUP)
    })
}

fn features(layout: &GridLayout, period: Period) -> [(&'static str, bool); 2] {
    [("hashed", layout.hashed == 1), ("periodic", period.is_periodic())]
}

impl GpuStructure for GpuUniformGrid {
    const NAME: &'static str = <UniformGrid as CpuStructure>::NAME;

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    fn points(&self) -> &Buffer<DevicePoint> {
        &self.points
    }

    fn ids(&self) -> Option<&Buffer<u32>> {
        Some(&self.ids)
    }

    fn shares_queries(&self) -> bool {
        true
    }

    fn traverse_module(&self) -> &'static str {
        "package::structure::uniform_grid::traverse"
    }

    fn pairs_module(&self, radius: f32) -> Option<&'static str> {
        let rows_of_cells = |axis: usize| radius * self.layout.inverse_cell[axis];
        let serves = self.layout.hashed == 0 && !self.period.is_periodic();
        (serves && rows_of_cells(1).max(rows_of_cells(2)) <= MOST_CELLS_A_PAIRS_RADIUS)
            .then_some("package::structure::uniform_grid::find_pairs")
    }

    fn most_effort(&self, radius: f32, queries: Option<&Aabb>) -> Result<Effort> {
        let in_step = self.gpu.limits().subgroup.map_or(super::effort::MOST_IN_STEP, |(_, largest)| largest);
        Ok(super::effort::most(&self.layout, &self.gpu.read(&self.starts)?, &Balls { radius, queries }, in_step))
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        features(&self.layout, self.period).to_vec()
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![
            (Access::Uniform, (&self.layout_buffer).into()),
            (Access::Read, (&self.points).into()),
            (Access::Read, (&self.starts).into()),
        ]
    }

    /// Sorted by the cells that they lie in, so that neighbouring invocations walk the same cells.
    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>> {
        let input = upload_points(&self.gpu, "queries", queries, 0)?;
        let layout = GridLayout { n_points: queries.len() as u32, ..self.layout };
        let layout_buffer = self.gpu.uniform("grid layout of the queries", &layout)?;
        let sorted = self.gpu.buffer("sorted queries", queries.len())?;
        let ids = self.gpu.buffer("indices of sorted queries", queries.len())?;
        let sorter = CellSorter::without_table(&self.gpu, queries.len(), layout.table_size)?;
        let mut commands = self.gpu.commands("sort queries");
        let compute = compute_entries(&self.gpu, &layout, self.period, &sorter)?;
        sorter.record_entries(&mut commands, &compute, &[(&layout_buffer).into(), (&input).into()]);
        sorter.record(&mut commands, &input, &SortedPoints { points: &sorted, ids: &ids, starts: None })?;
        commands.submit()?;
        Ok(sorted)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.points.bytes() + self.ids.bytes() + self.starts.bytes() + self.layout_buffer.bytes()
    }
}
