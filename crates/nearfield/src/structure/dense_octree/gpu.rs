//! The dense octree on the GPU: keys, sort, gather, starts, one dispatch a level, and the scan of null cells, in one
//! submission.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::cpu::Walk;
use super::{CellLayout, CellState, DenseOctree, DenseOctreeSettings};
use crate::curve::{Curve, Domain, Octant};
use crate::geometry::{OrderedPoints, validate};
use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::histogram::GpuHistogram;
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::scan::GpuScan;
use crate::structure::BuildStage;
use crate::structure::on_gpu::{DevicePoint, upload_points};
use crate::{Error, Result};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 256;

const BUILD: &str = "package::structure::dense_octree::build";
const NUMBER: &str = "package::structure::dense_octree::number";
const LOCATE: &str = "package::structure::dense_octree::locate";

/// Points sorted along a curve under full arrays of cells, on the GPU.
#[derive(Debug)]
pub struct GpuDenseOctree {
    gpu: Gpu,
    layout: CellLayout,
    curve: Curve,
    domain: Domain,
    domain_buffer: Buffer<Domain>,
    points: Buffer<DevicePoint>,
    order: Buffer<u32>,
    starts: Buffer<u32>,
    states: Buffer<u32>,
    nulls_before: Buffer<u32>,
    n_nodes: usize,
    stages: Vec<BuildStage>,
}

impl GpuDenseOctree {
    /// Copies the points to the device, sorts them by the cell at the finest level, and prunes the cells from there up.
    ///
    /// # Errors
    /// `InvalidSetting` for more than eight levels; `NonFinite`, `CoordinateTooLarge`, `TooMany` (more than 2³¹ points);
    /// `OutsideDomain` where a domain is given and does not hold every point; `OutOfDeviceMemory`, before anything is
    /// allocated if the limit of the settings or of the context would be passed; `DeviceLost`.
    pub fn build(gpu: &Gpu, points: &[Vec3], settings: &DenseOctreeSettings) -> Result<Self> {
        let start = Instant::now();
        check_memory(gpu, settings, points.len(), (points.len() * size_of::<DevicePoint>()) as u64)?;
        let domain = settings.domain_of(points)?;
        let input = upload_points(gpu, "points", points, 0)?;
        let mut tree = Self::from_input(gpu, &input, &domain, settings)?;
        tree.stages.insert(0, BuildStage::on_host("upload", start));
        Ok(tree)
    }

    /// Sorts points that are on the device already.
    ///
    /// - `points`: `[n]` xyz, and a word that is left alone; a point's index is its place here
    /// - `domain`: the cube that the root is, instead of the one in the settings; points outside count to its border
    ///
    /// The coordinates are trusted to be finite and within ±1e18.
    ///
    /// # Errors
    /// `InvalidSetting`, `TooMany`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build_on_device(
        gpu: &Gpu,
        points: &Buffer<DevicePoint>,
        domain: &Domain,
        settings: &DenseOctreeSettings,
    ) -> Result<Self> {
        check_memory(gpu, settings, points.len(), 0)?;
        Self::from_input(gpu, points, domain, settings)
    }

    fn from_input(
        gpu: &Gpu,
        input: &Buffer<DevicePoint>,
        domain: &Domain,
        settings: &DenseOctreeSettings,
    ) -> Result<Self> {
        let layout = settings.layout()?;
        let mut tree = Self {
            gpu: gpu.clone(),
            layout,
            curve: settings.curve,
            domain: *domain,
            domain_buffer: gpu.uniform("domain", domain)?,
            points: gpu.buffer("sorted points", input.len())?,
            order: gpu.buffer("order of points", input.len())?,
            starts: gpu.buffer("starts of the finest cells", layout.finest() + 1)?,
            states: gpu.buffer("states of cells", layout.cells())?,
            nulls_before: gpu.buffer("null cells before each", layout.cells() + 1)?,
            n_nodes: 0,
            stages: vec![],
        };
        let mut commands = gpu.commands("dense octree build");
        tree.record_build(&mut commands, input)?;
        let stages = commands.run()?;
        tree.stages = stages.iter().filter_map(BuildStage::on_device).collect();
        let nulls = gpu.read_range(&tree.nulls_before, layout.cells()..layout.cells() + 1)?[0];
        tree.n_nodes = layout.cells() - nulls as usize;
        Ok(tree)
    }

    fn record_build(&self, commands: &mut Commands, input: &Buffer<DevicePoint>) -> Result<()> {
        let (gpu, layout) = (&self.gpu, self.layout);
        let (n, n_finest, levels) = (input.len(), layout.finest(), layout.levels());
        let parameters = |level: u32| gpu.uniform("dense octree parameters", &[n as u32, levels, level, 0]);
        let own = parameters(levels)?;
        let keys = gpu.buffer("keys of points", n)?;
        let sorted_keys = gpu.buffer("sorted keys", n)?;
        let counts = gpu.buffer("points of the finest cells", n_finest + 1)?;
        let flags = gpu.buffer("null flags", layout.cells())?;
        let histogram = GpuHistogram::new(gpu, n_finest)?;
        let sort = GpuRadixSort::new(gpu, n)?;
        let scan = GpuScan::new(gpu, layout.cells())?;
        let pipeline = |entry, bindings: &[Access]| self.pipeline(BUILD, entry, bindings, &self.hilbert());
        use Access::{Read, ReadWrite, Uniform};

        commands.stage("keys").dispatch(
            &pipeline("compute_keys", &[Uniform, Uniform, Read, ReadWrite])?,
            &[(&own).into(), (&self.domain_buffer).into(), input.into(), (&keys).into()],
            Workgroups::Covering(n as u64),
        );
        commands.stage("sort");
        sort.record_from(commands, &keys, None, &sorted_keys, &self.order, n, 0..3 * levels)?;
        commands.stage("gather").dispatch(
            &pipeline("gather_points", &[Uniform, Read, Read, ReadWrite])?,
            &[(&own).into(), input.into(), (&self.order).into(), (&self.points).into()],
            Workgroups::Covering(n as u64),
        );
        commands.stage("starts");
        histogram.record(commands, &keys, &counts, n)?;
        scan.record(commands, &counts, &self.starts, n_finest)?;
        commands.stage("prune").dispatch(
            &pipeline("mark_finest", &[Uniform, Read, ReadWrite])?,
            &[(&own).into(), (&self.starts).into(), (&self.states).into()],
            Workgroups::Covering(n_finest as u64),
        );
        let prune_level = pipeline("prune_level", &[Uniform, ReadWrite])?;
        for level in (0..levels).rev() {
            let bindings = [(&parameters(level)?).into(), (&self.states).into()];
            commands.dispatch(&prune_level, &bindings, Workgroups::Covering(layout.level(level).len() as u64));
        }
        commands.stage("count nulls").dispatch(
            &pipeline("flag_nulls", &[Uniform, Read, ReadWrite])?,
            &[(&own).into(), (&self.states).into(), (&flags).into()],
            Workgroups::Covering(layout.cells() as u64),
        );
        scan.record(commands, &flags, &self.nulls_before, layout.cells())
    }

    fn hilbert(&self) -> [(&'static str, bool); 1] {
        [("hilbert", self.curve == Curve::Hilbert)]
    }

    fn pipeline(
        &self,
        module: &str,
        entry: &str,
        bindings: &[Access],
        features: &[(&str, bool)],
    ) -> Result<Arc<Pipeline>> {
        let constants = [("WORKGROUP", f64::from(WORKGROUP))];
        let kernel = Kernel::new(module, entry, bindings, WORKGROUP);
        self.gpu.prepare(&Kernel { features, constants: &constants, ..kernel })
    }

    /// Where cells stand in the arrays.
    pub fn layout(&self) -> CellLayout {
        self.layout
    }

    /// The order of the cells.
    pub fn curve(&self) -> Curve {
        self.curve
    }

    /// The cube that the root is.
    pub fn domain(&self) -> &Domain {
        &self.domain
    }

    /// `[n]` the points along the curve, as they were given.
    pub fn points(&self) -> &Buffer<DevicePoint> {
        &self.points
    }

    /// `[n]` the caller's indices in that order.
    pub fn order(&self) -> &Buffer<u32> {
        &self.order
    }

    /// `[8^k + 1]` place of the first point of each cell of the finest level.
    pub fn starts(&self) -> &Buffer<u32> {
        &self.starts
    }

    /// `[cells of all levels]` states, as numbers of [`CellState`], in the order of [`CellLayout`].
    pub fn states(&self) -> &Buffer<u32> {
        &self.states
    }

    /// `[cells of all levels + 1]` null cells before each place, and all of them.
    pub fn nulls_before(&self) -> &Buffer<u32> {
        &self.nulls_before
    }

    /// Nodes of the tree: cells that are not null.
    pub fn n_nodes(&self) -> usize {
        self.n_nodes
    }

    /// Copies the whole tree back.
    ///
    /// # Errors
    /// `OutOfMemory`, `OutOfDeviceMemory` for the staging memory, `DeviceLost`.
    pub fn read(&self) -> Result<DenseOctree> {
        let (sorted, order) = (self.gpu.read(&self.points)?, self.gpu.read(&self.order)?);
        let mut points = vec![Vec3::ZERO; sorted.len()];
        for (&[x, y, z, _], &id) in sorted.iter().zip(&order) {
            points[id as usize] = Vec3::new(x, y, z);
        }
        Ok(DenseOctree {
            layout: self.layout,
            curve: self.curve,
            domain: self.domain,
            points: OrderedPoints::gather(&points, &order),
            starts: self.gpu.read(&self.starts)?,
            states: self.gpu.read(&self.states)?.into_iter().map(state_of_word).collect(),
            nulls_before: self.gpu.read(&self.nulls_before)?,
            stages: self.stages.clone(),
        })
    }

    /// The leaf that holds each query, empty ones included; `None` for a query outside the domain.
    ///
    /// As on the CPU, but that a device may take a query for inside that is less than 1.2e-38 below a face, where f32 are
    /// not normal.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn locate(&self, queries: &[Vec3]) -> Result<Vec<Option<Octant>>> {
        validate::coordinates("queries", queries)?;
        let queries = upload_points(&self.gpu, "queries", queries, 0)?;
        let leaves = self.gpu.read(&self.locate_on_device(&queries)?)?;
        Ok(leaves.into_iter().map(|bits| Octant::from_bits(bits.into())).collect())
    }

    /// As [`GpuDenseOctree::locate`] for queries on the device: the bits of each leaf's octant, 0 outside the domain.
    ///
    /// # Errors
    /// `TooMany` beyond 2³¹ queries, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn locate_on_device(&self, queries: &Buffer<DevicePoint>) -> Result<Buffer<u32>> {
        check_len("queries", queries.len())?;
        let n = queries.len();
        let parameters = self.gpu.uniform("locate parameters", &[n as u32, self.layout.levels(), 0, 0])?;
        let leaves = self.gpu.buffer("leaves of queries", n)?;
        let bindings = [Access::Uniform, Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        let mut commands = self.gpu.commands("locate");
        commands.dispatch(
            &self.pipeline(LOCATE, "locate", &bindings, &self.hilbert())?,
            &[
                (&parameters).into(),
                (&self.domain_buffer).into(),
                queries.into(),
                (&self.states).into(),
                (&leaves).into(),
            ],
            Workgroups::Covering(n as u64),
        );
        commands.submit()?;
        Ok(leaves)
    }

    /// Number of each cell in the post-order walk `[cells of all levels]`; `u32::MAX` for cells that are null.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `OutOfMemory`, `DeviceLost`.
    pub fn post_order_numbers(&self) -> Result<Vec<u32>> {
        self.gpu.read(&self.numbers_on_device(Walk::PostOrder)?.0)
    }

    /// As [`GpuDenseOctree::post_order_numbers`], left on the device, and the time it took.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn post_order_numbers_on_device(&self) -> Result<(Buffer<u32>, Vec<BuildStage>)> {
        self.numbers_on_device(Walk::PostOrder)
    }

    /// Number of each cell in the pre-order walk `[cells of all levels]`; `u32::MAX` for cells that are null.
    ///
    /// # Errors
    /// As [`GpuDenseOctree::post_order_numbers`].
    pub fn pre_order_numbers(&self) -> Result<Vec<u32>> {
        self.gpu.read(&self.numbers_on_device(Walk::PreOrder)?.0)
    }

    /// The nodes in post-order `[n_nodes]`: children before their parent.
    ///
    /// # Errors
    /// As [`GpuDenseOctree::post_order_numbers`].
    pub fn post_order(&self) -> Result<Vec<(Octant, CellState)>> {
        self.nodes(Walk::PostOrder)
    }

    /// The nodes in pre-order `[n_nodes]`: a parent before its children.
    ///
    /// # Errors
    /// As [`GpuDenseOctree::post_order_numbers`].
    pub fn pre_order(&self) -> Result<Vec<(Octant, CellState)>> {
        self.nodes(Walk::PreOrder)
    }

    fn numbers_on_device(&self, walk: Walk) -> Result<(Buffer<u32>, Vec<BuildStage>)> {
        let parameters = self.gpu.uniform("walk parameters", &[self.layout.levels(), 0, 0, 0])?;
        let numbers = self.gpu.buffer("numbers of cells", self.layout.cells())?;
        let bindings = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        let features = [("pre_order", walk == Walk::PreOrder)];
        let mut commands = self.gpu.commands("number cells");
        commands.stage("number cells").dispatch(
            &self.pipeline(NUMBER, "number_cells", &bindings, &features)?,
            &[(&parameters).into(), (&self.states).into(), (&self.nulls_before).into(), (&numbers).into()],
            Workgroups::Covering(self.layout.cells() as u64),
        );
        let stages = commands.run()?.iter().filter_map(BuildStage::on_device).collect();
        Ok((numbers, stages))
    }

    fn nodes(&self, walk: Walk) -> Result<Vec<(Octant, CellState)>> {
        let (numbers, _) = self.numbers_on_device(walk)?;
        let parameters = self.gpu.uniform("walk parameters", &[self.layout.levels(), 0, 0, 0])?;
        let nodes = self.gpu.buffer::<[u32; 2]>("nodes in order", self.n_nodes)?;
        let bindings = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        let features = [("pre_order", walk == Walk::PreOrder)];
        let mut commands = self.gpu.commands("order nodes");
        commands.dispatch(
            &self.pipeline(NUMBER, "order_nodes", &bindings, &features)?,
            &[(&parameters).into(), (&self.states).into(), (&numbers).into(), (&nodes).into()],
            Workgroups::Covering(self.layout.cells() as u64),
        );
        commands.submit()?;
        let node = |[bits, state]: [u32; 2]| {
            let octant = Octant::from_bits(bits.into()).expect("the device should write octants");
            (octant, state_of_word(state))
        };
        Ok(self.gpu.read(&nodes)?.into_iter().map(node).collect())
    }

    /// Times of the build.
    pub fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    /// Bytes of device memory held, points included.
    pub fn memory_bytes(&self) -> u64 {
        let words = [&self.order, &self.starts, &self.states, &self.nulls_before];
        self.domain_buffer.bytes() + self.points.bytes() + words.iter().map(|buffer| buffer.bytes()).sum::<u64>()
    }
}

fn state_of_word(word: u32) -> CellState {
    CellState::of_word(word).expect("the device should write states")
}

/// Checks the bytes of a build, with those of its input if it is still to be uploaded, against the limits of settings and
/// context.
fn check_memory(gpu: &Gpu, settings: &DenseOctreeSettings, n_points: usize, input: u64) -> Result<()> {
    check_len("points", n_points)?;
    let needed = input + DenseOctreeSettings::bytes_on_gpu(settings.layout()?, n_points);
    let available = gpu.memory_available().min(settings.max_memory);
    if needed > available {
        return Err(Error::OutOfDeviceMemory { what: "a dense octree".into(), needed, available });
    }
    Ok(())
}

/// Checks that indices stay below 2³², also one round of a grid behind the last element.
fn check_len(what: &'static str, len: usize) -> Result<()> {
    let (found, limit) = (len as u64, 1 << 31);
    if found > limit {
        return Err(Error::TooMany { what, found, limit, advice: "work in parts, or on the CPU" });
    }
    Ok(())
}
