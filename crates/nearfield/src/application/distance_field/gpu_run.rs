//! One distance field on a device: what is nearest to each node, by bricks, and the stages that samples and meshes share.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::bricks::EDGE;
use super::cpu::empty_band;
use super::{DistanceField, DistanceMode, DistanceSettings};
use crate::application::GpuWindingNumber;
use crate::geometry::RegularGrid;
use crate::gpu::Access::{Read, ReadWrite, Uniform};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::compact::GpuCompact;
use crate::{Error, Result};

/// Invocations of a workgroup; 4³ nodes of a brick.
const WORKGROUP: u32 = 64;
/// Workgroups of a brick.
const EIGHTHS: u64 = 8;
/// A NaN.
const UNDEFINED: u32 = 0x7fc0_0000;

const UNDEFINE: [Access; 2] = [Uniform, ReadWrite];

/// What kernels know of a field, in the bytes of a uniform. `field.wesl` has the twin.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[allow(missing_docs, reason = "said in field.wesl")]
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

/// A field on a device.
#[derive(Debug)]
pub struct GpuDistanceField {
    pub(super) gpu: Gpu,
    grid: RegularGrid,
    pub(super) parameters: Buffer<FieldParameters>,
    /// Numbers of the bricks that may have values, ascending, there and here.
    pub(super) filled: Buffer<u32>,
    pub(super) filled_bricks: Vec<u32>,
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
        Ok(DistanceField { distances: self.read_distances()?, nearest: self.gpu.read(&self.nearest)? })
    }
}

/// What distances are from, as kernels have it bound.
#[derive(Debug)]
pub(super) struct Surface<'a> {
    /// The module that finds what is nearest.
    pub(super) module: &'static str,
    /// Bindings 3 to 5.
    pub(super) accesses: [Access; 3],
    pub(super) binds: [Bind; 3],
    /// Conditions of the module, beside those of all kernels here.
    pub(super) features: &'a [(&'a str, bool)],
    /// Of what it has how many.
    pub(super) what: &'static str,
    pub(super) n: usize,
    /// Distance of neighbouring samples; 0 for triangles.
    pub(super) spacing: f32,
}

/// The buffers of one field, and what is recorded to fill them.
pub(super) struct Run<'a> {
    gpu: Gpu,
    grid: RegularGrid,
    pub(super) parameters: Buffer<FieldParameters>,
    pub(super) axes: Buffer<f32>,
    n_bricks: usize,
    surface: Surface<'a>,
    /// Numbers of the bricks to fill; behind them stands how many there are.
    filled: Buffer<u32>,
    n_filled: usize,
    pub(super) nearest: Buffer<u32>,
    pub(super) values: Buffer<u32>,
    /// `[2]` nodes whose loops the device would have ended, and 1 where a node has a nearest sample.
    pub(super) outcome: Buffer<u32>,
    stages: Vec<StageTime>,
    commands: Commands,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        gpu: &Gpu,
        surface: Surface<'a>,
        grid: &RegularGrid,
        settings: &DistanceSettings,
    ) -> Result<Self> {
        let nodes = grid.nodes();
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
            spacing: surface.spacing,
            sigma: settings.smoothing as f32 * surface.spacing,
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
            surface,
            filled: gpu.buffer("bricks to fill", n_bricks + 1)?,
            n_filled: 0,
            nearest: gpu.buffer("nearest samples of nodes", grid.n_nodes())?,
            values: gpu.buffer("distances of nodes", grid.n_nodes())?,
            outcome: gpu.upload("outcome of a field", &[0, 0])?,
            stages: Vec::new(),
            commands: gpu.commands("distances of a field"),
        })
    }

    /// Finds the bricks to fill, and records finding what is nearest to each node of them.
    pub(super) fn find_nearest(mut self) -> Result<Self> {
        let gpu = self.gpu.clone();
        let flags = gpu.buffer::<u32>("bricks in the band", self.n_bricks)?;
        let middles = gpu.buffer::<u32>("nearest samples of bricks", self.n_bricks)?;
        let count = gpu.buffer::<u32>("number of bricks to fill", 1)?;
        let [third, fourth, fifth] = self.surface.binds.clone();
        let binds = |flags_or_seeds: &Buffer<u32>| {
            [
                (&self.parameters).into(),
                (&self.axes).into(),
                flags_or_seeds.into(),
                third.clone(),
                fourth.clone(),
                fifth.clone(),
                (&middles).into(),
                (&self.filled).into(),
                (&self.nearest).into(),
                (&self.outcome).into(),
            ]
        };
        let classify = self.nearest_kernel("classify_bricks")?;
        let [refine, fill] = [self.nearest_kernel("refine_bricks")?, self.nearest_kernel("fill_bricks")?];
        let compact = GpuCompact::new(&gpu, self.n_bricks)?;
        let undefine = gpu.prepare(&Kernel {
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new("package::application::distance_field::undefine", "undefine", &UNDEFINE, WORKGROUP)
        })?;
        let mut commands = gpu.commands("bricks of a field");
        commands.stage("bricks");
        commands.dispatch(&classify, &binds(&flags), Workgroups::Covering(self.n_bricks as u64));
        compact.record(&mut commands, &flags, &self.filled, &count, self.n_bricks)?;
        let n_filled = commands.read_back(&count)?;
        let stages = commands.run()?;
        let n_filled = n_filled.values()?;
        gpu.write(&self.filled, self.n_bricks, &n_filled)?;
        let n_nodes = self.grid.n_nodes() as u64;
        let parameters = gpu.uniform("number of nodes", &[n_nodes as u32, 0, 0, 0])?;
        let eighths = u64::from(n_filled[0]) * EIGHTHS;
        let seeds = gpu.buffer::<u32>("nearest samples of eighths of bricks", eighths as usize)?;
        let mut commands = gpu.commands("distances of a field");
        commands.stage("nearest");
        commands.dispatch(&undefine, &[(&parameters).into(), (&self.nearest).into()], Workgroups::Covering(n_nodes));
        commands.dispatch(&refine, &binds(&seeds), Workgroups::Covering(eighths));
        let invocations = eighths * u64::from(WORKGROUP);
        commands.dispatch(&fill, &binds(&seeds), Workgroups::Covering(invocations));
        (self.n_filled, self.stages, self.commands) = (n_filled[0] as usize, stages, commands);
        Ok(self)
    }

    fn nearest_kernel(&self, entry: &str) -> Result<Arc<Pipeline>> {
        let [third, fourth, fifth] = self.surface.accesses;
        let accesses = [Uniform, Read, ReadWrite, third, fourth, fifth, ReadWrite, Read, ReadWrite, ReadWrite];
        let fills = [("package::application::distance_field::surface", Fill::Module(self.surface.module))];
        pipeline(&self.gpu, "nearest", entry, &accesses, &fills, self.surface.features)
    }

    /// Records the distances by a kernel, and their signs where these are by winding number.
    pub(super) fn evaluate(
        mut self,
        evaluate: &Arc<Pipeline>,
        binds: &[Bind],
        winding: Option<&GpuWindingNumber>,
    ) -> Result<Self> {
        let gpu = &self.gpu;
        let n_nodes = self.grid.n_nodes() as u64;
        self.commands.stage("distances").dispatch(evaluate, binds, Workgroups::Covering(n_nodes));
        if let Some(winding) = winding {
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
            let sign = pipeline(gpu, "winding_sign", "apply_winding_sign", &winding_sign_accesses(), &[], &[])?;
            self.commands.stage("sign").dispatch(&sign, &binds, Workgroups::Covering(n_nodes));
        }
        Ok(self)
    }

    /// Runs what is recorded. The field; refuses one that was not computed to its end, and one without a value.
    pub(super) fn finish(self, settings: &DistanceSettings) -> Result<GpuDistanceField> {
        let Self { mut commands, mut stages, .. } = self;
        let outcome = commands.read_back(&self.outcome)?;
        let filled_bricks = commands.read_back(&self.filled.first(self.n_filled))?;
        stages.extend(commands.run()?);
        let outcome = outcome.values()?;
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
            let Surface { n, what, .. } = self.surface;
            let between = format!("{n} {what} and the grid from {} to {}", bounds.min, bounds.max);
            return Err(empty_band(settings, &self.grid, &between));
        }
        let filled_bricks = filled_bricks.values()?;
        let Self { gpu, grid, parameters, filled, nearest, values, .. } = self;
        Ok(GpuDistanceField { gpu, grid, parameters, filled, filled_bricks, values, nearest, stages })
    }
}

fn winding_sign_accesses() -> [Access; 8] {
    let [layout, expansions, elements] = GpuWindingNumber::ACCESSES;
    [Uniform, layout, expansions, elements, Read, Read, ReadWrite, ReadWrite]
}

/// A kernel of a module here.
pub(super) fn pipeline(
    gpu: &Gpu,
    module: &str,
    entry: &str,
    bindings: &[Access],
    fills: &[(&str, Fill<'_>)],
    more: &[(&str, bool)],
) -> Result<Arc<Pipeline>> {
    let usual = [("short_loops", gpu.limits().loop_rounds.is_some()), ("periodic", false), ("excludes", false)];
    gpu.prepare(&Kernel {
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        features: &[&usual[..], more].concat(),
        fills,
        ..Kernel::new(&format!("package::application::distance_field::{module}"), entry, bindings, WORKGROUP)
    })
}
