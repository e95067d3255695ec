//! Distance fields of samples on a device, in `f32`.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::bricks::EDGE;
use super::cpu::{empty_band, no_pseudonormals};
use super::samples::{OrientedSamples, measured_spacing, places, unit_normals};
use super::{DistanceField, DistanceMode, DistanceSettings, SignRule};
use crate::application::GpuWindingNumber;
use crate::geometry::{DistanceGrid, RegularGrid};
use crate::gpu::{Access, Bind, Buffer, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::compact::GpuCompact;
use crate::query::{FixedRadius, NeighborSearch};
use crate::structure::{AabbTreeSettings, BuildOrder, GpuAabbTree, GpuStructure};
use crate::{Error, Result};

/// Invocations of a workgroup; 4³ nodes of a brick.
const WORKGROUP: u32 = 64;
/// Samples of a leaf at most: the nearest is in one of a few leaves.
const LEAF: u32 = 8;
/// Workgroups of a brick.
const EIGHTHS: u64 = 8;
/// A NaN.
const UNDEFINED: u32 = 0x7fc0_0000;

/// What kernels know of a field, in the bytes of a uniform. `samples.wesl` has the twin.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[allow(missing_docs, reason = "said in samples.wesl")]
pub struct FieldParameters {
    pub grid_nodes: [u32; 3],
    pub n_bricks: u32,
    pub bricks: [u32; 3],
    pub mode: u32,
    pub radius: f32,
    pub radius2: f32,
    pub brick_radius: f32,
    pub spacing: f32,
    pub sigma: f32,
    pub undefined: u32,
    pub zero: u32,
    pub padding: u32,
}

/// Oriented samples on a device, in a tree that was built there.
#[derive(Debug)]
pub struct GpuOrientedSamples {
    gpu: Gpu,
    tree: GpuAabbTree,
    /// `[2n]` position and unit normal by index.
    samples: Buffer<[f32; 4]>,
    points: Vec<Vec3>,
    normals: Vec<[f32; 3]>,
    spacing: f32,
}

/// A field on a device.
#[derive(Debug)]
pub struct GpuDistanceField {
    gpu: Gpu,
    grid: RegularGrid,
    /// `[nodes]` the bits of f32.
    values: Buffer<u32>,
    nearest: Buffer<u32>,
    stages: Vec<StageTime>,
}

impl GpuDistanceField {
    /// The nodes.
    pub fn grid(&self) -> &RegularGrid {
        &self.grid
    }

    /// `[nodes]` the distances as the bits of f32, NaN where undefined.
    pub fn values(&self) -> &Buffer<u32> {
        &self.values
    }

    /// `[nodes]` index of the nearest sample, [`DistanceField::NONE`] where undefined.
    pub fn nearest(&self) -> &Buffer<u32> {
        &self.nearest
    }

    /// Times of the stages on the device.
    pub fn stages(&self) -> &[StageTime] {
        &self.stages
    }

    /// Reads the field back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read(&self) -> Result<DistanceField> {
        let values = bytemuck::allocation::cast_vec(self.gpu.read(&self.values)?);
        Ok(DistanceField { distances: DistanceGrid::new(self.grid, values)?, nearest: self.gpu.read(&self.nearest)? })
    }
}

impl GpuOrientedSamples {
    /// Copies the samples to the device and builds the tree there.
    ///
    /// # Errors
    /// As [`OrientedSamples::new`] and [`GpuAabbTree::build`].
    pub fn build(gpu: &Gpu, points: &[Vec3], normals: &[Vec3]) -> Result<Self> {
        let normals: Vec<[f32; 3]> = normals.iter().map(|n| n.to_array()).collect();
        let normals = unit_normals(points.len(), &normals)?;
        let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert).bucket_size(LEAF);
        let tree = GpuAabbTree::build(gpu, points, &settings)?;
        let quad = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        let both = points.iter().zip(&normals).flat_map(|(p, &n)| [quad(p.to_array()), quad(n)]);
        let samples = gpu.upload("oriented samples", &both.collect::<Vec<[f32; 4]>>())?;
        let queries: Vec<Vec3> = places(points.len()).map(|place| points[place]).collect();
        let diagonal = f64::from(crate::parallel::reduce::bounds(points).diagonal());
        let spacing = measured_spacing(diagonal, queries.len(), |radius| {
            let counts = tree.count(&FixedRadius::new(radius as f32).queries(&queries))?;
            Ok(counts.as_slice().iter().map(|&n| u64::from(n)).sum())
        })?;
        Ok(Self { gpu: gpu.clone(), tree, samples, points: points.to_vec(), normals, spacing: spacing as f32 })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// As [`OrientedSamples::spacing`].
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// The field over a grid whose origin is that of the samples, left on the device.
    ///
    /// # Errors
    /// As [`OrientedSamples::distance_field`]; `OutOfDeviceMemory` (4 bytes a node must fit one binding, twice),
    /// `Unsupported` on software devices that would end loops, `KernelRejected`, `DeviceLost`.
    pub fn distance_field(&self, grid: &RegularGrid, settings: &DistanceSettings) -> Result<GpuDistanceField> {
        settings.validate(grid)?;
        if settings.sign == Some(SignRule::Pseudonormal) {
            return Err(no_pseudonormals());
        }
        let run = Run::new(self, grid, settings)?;
        let mut stages = run.find_nearest(self)?;
        stages.extend(run.evaluate(self, settings)?);
        run.check(settings)?;
        let Run { gpu, grid, nearest, values, .. } = run;
        Ok(GpuDistanceField { gpu, grid, values, nearest, stages })
    }

    /// The tree of the winding number of the samples, built on the CPU.
    fn winding(&self) -> Result<GpuWindingNumber> {
        let points: Vec<[f32; 3]> = self.points.iter().map(|p| p.to_array()).collect();
        let samples = OrientedSamples::new(&points, &self.normals)?;
        let settings = DistanceSettings::default().sign(SignRule::WindingNumber);
        let winding = samples.winding(&settings)?.expect("a winding number should be there where it is asked for");
        GpuWindingNumber::upload(&self.gpu, &winding)
    }
}

/// The buffers of one field.
struct Run {
    gpu: Gpu,
    grid: RegularGrid,
    parameters: Buffer<FieldParameters>,
    axes: Buffer<f32>,
    n_bricks: usize,
    n_samples: usize,
    nearest: Buffer<u32>,
    values: Buffer<u32>,
    /// `[2]` nodes whose loops the device would have ended, and 1 where a node has a nearest sample.
    outcome: Buffer<u32>,
}

impl Run {
    fn new(samples: &GpuOrientedSamples, grid: &RegularGrid, settings: &DistanceSettings) -> Result<Self> {
        let (gpu, nodes) = (&samples.gpu, grid.nodes());
        let bricks = nodes.map(|n| n.div_ceil(EDGE));
        let radius = settings.radius(grid).min(1e18) as f32;
        let n_bricks: usize = bricks.iter().map(|&n| n as usize).product();
        let mode = DistanceMode::ALL.iter().position(|&mode| mode == settings.mode).unwrap_or(0) as u32;
        let half_edge = 0.5 * (EDGE - 1) as f32 * grid.spacing();
        let parameters = FieldParameters {
            grid_nodes: nodes,
            n_bricks: n_bricks as u32,
            bricks,
            mode,
            radius,
            radius2: radius * radius,
            brick_radius: half_edge * 3f32.sqrt() * 1.001 + grid.bounds().diagonal() * f32::EPSILON,
            spacing: samples.spacing,
            sigma: settings.smoothing as f32 * samples.spacing,
            undefined: UNDEFINED,
            zero: 0,
            padding: 0,
        };
        let axis = |axis: usize| (0..nodes[axis]).map(move |i| grid.coordinate(axis, i) as f32);
        let axes: Vec<f32> = (0..3).flat_map(axis).collect();
        Ok(Self {
            gpu: gpu.clone(),
            grid: *grid,
            parameters: gpu.uniform("field parameters", &parameters)?,
            axes: gpu.upload("coordinates of nodes", &axes)?,
            n_bricks,
            n_samples: samples.len(),
            nearest: gpu.buffer("nearest samples of nodes", grid.n_nodes())?,
            values: gpu.buffer("distances of nodes", grid.n_nodes())?,
            outcome: gpu.upload("outcome of a field", &[0, 0])?,
        })
    }

    /// Finds the nearest sample of each node.
    fn find_nearest(&self, samples: &GpuOrientedSamples) -> Result<Vec<StageTime>> {
        let gpu = &self.gpu;
        let flags = gpu.buffer::<u32>("bricks in the band", self.n_bricks)?;
        let middles = gpu.buffer::<u32>("nearest samples of bricks", self.n_bricks)?;
        // Behind the numbers stands how many there are.
        let filled = gpu.buffer::<u32>("bricks to fill", self.n_bricks + 1)?;
        let count = gpu.buffer::<u32>("number of bricks to fill", 1)?;
        let [layout, points, nodes] = tree_bindings(samples);
        let binds = [
            (&self.parameters).into(),
            (&self.axes).into(),
            (&flags).into(),
            layout,
            points,
            nodes,
            (&middles).into(),
            (&filled).into(),
            (&self.nearest).into(),
            (&self.outcome).into(),
        ];
        let [classify, fill] = [nearest_kernel(gpu, "classify_bricks")?, nearest_kernel(gpu, "fill_bricks")?];
        let compact = GpuCompact::new(gpu, self.n_bricks)?;
        let undefine = gpu.pipeline(&Kernel {
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new("package::application::distance_field::undefine", "undefine", &UNDEFINE, WORKGROUP)
        })?;
        let mut commands = gpu.commands("bricks of a field");
        commands.stage("bricks");
        commands.dispatch(&classify, &binds, Workgroups::Covering(self.n_bricks as u64));
        compact.record(&mut commands, &flags, &filled, &count, self.n_bricks)?;
        let mut stages = commands.run()?;
        let n_filled = gpu.read(&count)?;
        gpu.write(&filled, self.n_bricks, &n_filled)?;
        let n_nodes = self.grid.n_nodes() as u64;
        let parameters = gpu.uniform("number of nodes", &[n_nodes as u32, 0, 0, 0])?;
        let mut commands = gpu.commands("nearest samples of a field");
        commands.stage("nearest");
        commands.dispatch(&undefine, &[(&parameters).into(), (&self.nearest).into()], Workgroups::Covering(n_nodes));
        let invocations = u64::from(n_filled[0]) * EIGHTHS * u64::from(WORKGROUP);
        commands.dispatch(&fill, &binds, Workgroups::Covering(invocations));
        stages.extend(commands.run()?);
        Ok(stages)
    }

    /// Computes the distances, and their signs where these are by winding number.
    fn evaluate(&self, samples: &GpuOrientedSamples, settings: &DistanceSettings) -> Result<Vec<StageTime>> {
        let gpu = &self.gpu;
        let [layout, points, nodes] = tree_bindings(samples);
        let binds = [
            (&self.parameters).into(),
            (&self.axes).into(),
            (&samples.samples).into(),
            layout,
            points,
            nodes,
            (&self.nearest).into(),
            (&self.values).into(),
            (&self.outcome).into(),
        ];
        let all = || Workgroups::Covering(self.grid.n_nodes() as u64);
        let evaluate = pipeline(gpu, "evaluate", "evaluate_distances", &EVALUATE)?;
        let winding = (settings.sign == Some(SignRule::WindingNumber)).then(|| samples.winding()).transpose()?;
        let mut commands = gpu.commands("distances of a field");
        commands.stage("distances").dispatch(&evaluate, &binds, all());
        if let Some(winding) = &winding {
            let [nx, ny, nz] = self.grid.nodes();
            let grid_nodes = gpu.uniform("nodes of a field", &[nx, ny, nz, 0])?;
            let [layout, expansions, elements] = winding.bindings();
            let binds = [
                (&grid_nodes).into(),
                layout,
                expansions,
                elements,
                (&self.axes).into(),
                (&self.nearest).into(),
                (&self.values).into(),
                (&self.outcome).into(),
            ];
            let sign = pipeline(gpu, "winding_sign", "apply_winding_sign", &winding_sign_accesses())?;
            commands.stage("sign").dispatch(&sign, &binds, all());
        }
        commands.run()
    }

    /// Refuses fields that were not computed to their end, and those without a value.
    fn check(&self, settings: &DistanceSettings) -> Result<()> {
        let outcome = self.gpu.read(&self.outcome)?;
        let [unfinished, any] = [outcome[0], outcome[1]];
        if unfinished > 0 {
            return Err(Error::Unsupported {
                what: format!(
                    "a distance field on {}, which would have ended the loops of {unfinished} nodes,",
                    self.gpu.name()
                ),
                advice: "use the CPU",
            });
        }
        let bounds = self.grid.bounds();
        if any == 0 {
            let between = format!("{} samples and the grid from {} to {}", self.n_samples, bounds.min, bounds.max);
            return Err(empty_band(settings, &self.grid, &between));
        }
        Ok(())
    }
}

use Access::{Read, ReadWrite, Uniform};

const UNDEFINE: [Access; 2] = [Uniform, ReadWrite];
const NEAREST: [Access; 10] = [Uniform, Read, ReadWrite, Uniform, Read, Read, ReadWrite, Read, ReadWrite, ReadWrite];
const EVALUATE: [Access; 9] = [Uniform, Read, Read, Uniform, Read, Read, Read, ReadWrite, ReadWrite];

fn winding_sign_accesses() -> [Access; 8] {
    let [layout, expansions, elements] = GpuWindingNumber::ACCESSES;
    [Uniform, layout, expansions, elements, Read, Read, ReadWrite, ReadWrite]
}

fn pipeline(gpu: &Gpu, module: &str, entry: &str, bindings: &[Access]) -> Result<Arc<Pipeline>> {
    gpu.pipeline(&Kernel {
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        features: &[("short_loops", gpu.limits().loop_rounds.is_some()), ("periodic", false), ("excludes", false)],
        ..Kernel::new(&format!("package::application::distance_field::{module}"), entry, bindings, WORKGROUP)
    })
}

fn nearest_kernel(gpu: &Gpu, entry: &str) -> Result<Arc<Pipeline>> {
    pipeline(gpu, "nearest", entry, &NEAREST)
}

/// Layout, points and nodes of the tree: bindings 3 to 5 of all kernels here.
fn tree_bindings(samples: &GpuOrientedSamples) -> [Bind; 3] {
    let binds: Vec<Bind> = samples.tree.bindings().into_iter().map(|(_, bind)| bind).collect();
    binds.try_into().expect("a tree should have three bindings")
}
