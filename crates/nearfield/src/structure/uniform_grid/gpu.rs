//! The uniform grid on the GPU: entries, sort, gather and table, in that order, in one submission.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::effort::Balls;
use super::{GridLayout, GridSettings};
use crate::geometry::{Aabb, Period, validate};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::scan::GpuScan;
use crate::structure::on_gpu::{DevicePoint, Effort, GpuStructure, device_points};
use crate::structure::{BuildStage, CpuStructure, UniformGrid};
use crate::{Error, Result};

/// Invocations of a workgroup of the build kernels.
const WORKGROUP: u32 = 256;

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
        let input = gpu.upload("points", &device_points(points, 0))?;
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
    gather_points: Arc<Pipeline>,
    sort: GpuRadixSort<u32>,
    scan: GpuScan,
    keys: Buffer<u32>,
    sorted_keys: Buffer<u32>,
    order: Buffer<u32>,
    counts: Buffer<u32>,
}

impl GridBuilder {
    /// A builder for `n_points` points inside `bounds`.
    ///
    /// # Errors
    /// `InvalidSetting`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, n_points: usize, bounds: &Aabb, settings: &GridSettings) -> Result<Self> {
        settings.validate()?;
        let layout = GridLayout::new(n_points as u32, bounds, settings);
        let features = features(&layout, settings.period, true);
        let compute = [Access::Uniform, Access::Read, Access::ReadWrite, Access::ReadWrite];
        let gather = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite, Access::ReadWrite];
        let constants = [("WORKGROUP", f64::from(WORKGROUP))];
        let kernel = |entry, bindings| Kernel {
            features: &features,
            constants: &constants,
            ..Kernel::new("package::structure::uniform_grid::build", entry, bindings, WORKGROUP)
        };
        Ok(Self {
            layout_buffer: gpu.uniform("grid layout", &layout)?,
            period: settings.period,
            compute_entries: gpu.pipeline(&kernel("compute_entries", &compute))?,
            gather_points: gpu.pipeline(&kernel("gather_points", &gather))?,
            sort: GpuRadixSort::new(gpu, n_points)?,
            scan: GpuScan::new(gpu, layout.table_size as usize)?,
            keys: gpu.buffer("table entries of points", n_points)?,
            sorted_keys: gpu.buffer("sorted table entries", n_points)?,
            order: gpu.buffer("order of points", n_points)?,
            counts: gpu.buffer("points of table entries", layout.table_size as usize)?,
            gpu: gpu.clone(),
            layout,
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
        let covering = Workgroups::Covering(n as u64);
        let layout: Bind = (&self.layout_buffer).into();
        commands.stage("entries").clear(&self.counts).dispatch(
            &self.compute_entries,
            &[layout.clone(), points.into(), (&self.keys).into(), (&self.counts).into()],
            covering.clone(),
        );
        commands.stage("sort");
        let bits = 0..self.layout.key_bits();
        self.sort.record_from(commands, &self.keys, None, &self.sorted_keys, &self.order, n, bits)?;
        commands.stage("gather").dispatch(
            &self.gather_points,
            &[layout, points.into(), (&self.order).into(), sorted.into(), ids.into()],
            covering,
        );
        commands.stage("table");
        self.scan.record(commands, &self.counts, starts, self.layout.table_size as usize)
    }
}

fn features(layout: &GridLayout, period: Period, counted: bool) -> [(&'static str, bool); 3] {
    [("hashed", layout.hashed == 1), ("periodic", period.is_periodic()), ("counted", counted)]
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

    fn traverse_module(&self) -> &'static str {
        "package::structure::uniform_grid::traverse"
    }

    fn most_effort(&self, radius: f32, queries: Option<&Aabb>) -> Result<Effort> {
        let in_step = self.gpu.limits().subgroup.map_or(super::effort::MOST_IN_STEP, |(_, largest)| largest);
        Ok(super::effort::most(&self.layout, &self.gpu.read(&self.starts)?, &Balls { radius, queries }, in_step))
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        features(&self.layout, self.period, false).to_vec()
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
        let input = self.gpu.upload("queries", &device_points(queries, 0))?;
        let layout = GridLayout { n_points: queries.len() as u32, ..self.layout };
        let layout_buffer = self.gpu.uniform("grid layout of the queries", &layout)?;
        let features = features(&layout, self.period, false);
        let compute = [Access::Uniform, Access::Read, Access::ReadWrite, Access::ReadWrite];
        let gather = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite, Access::ReadWrite];
        let constants = [("WORKGROUP", f64::from(WORKGROUP))];
        let kernel = |entry, bindings| Kernel {
            features: &features,
            constants: &constants,
            ..Kernel::new("package::structure::uniform_grid::build", entry, bindings, WORKGROUP)
        };
        let n = queries.len();
        let keys = self.gpu.buffer("query entries", n)?;
        let sorted_keys = self.gpu.buffer("sorted query entries", n)?;
        let order = self.gpu.buffer("query order", n)?;
        let sorted = self.gpu.buffer("sorted queries", n)?;
        let ids = self.gpu.buffer::<u32>("indices of sorted queries", n)?;
        let sort = GpuRadixSort::<u32>::new(&self.gpu, n)?;
        let covering = Workgroups::Covering(n as u64);
        let mut commands = self.gpu.commands("sort queries");
        commands.dispatch(
            &self.gpu.pipeline(&kernel("compute_entries", &compute))?,
            &[(&layout_buffer).into(), (&input).into(), (&keys).into(), (&ids).into()],
            covering.clone(),
        );
        sort.record_from(&mut commands, &keys, None, &sorted_keys, &order, n, 0..layout.key_bits())?;
        commands.dispatch(
            &self.gpu.pipeline(&kernel("gather_points", &gather))?,
            &[(&layout_buffer).into(), (&input).into(), (&order).into(), (&sorted).into(), (&ids).into()],
            covering,
        );
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
