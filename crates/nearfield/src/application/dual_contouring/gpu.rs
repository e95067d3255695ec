//! Dual contouring on a device: mark active cells, describe them, place vertices, join polygons, cut them into triangles.
//!
//! Memory: 12 bytes a node, some 80 an active cell and 130 a polygon with its vertex. Numbers of active cells, vertices and
//! polygons are read back between the stages, so that memory is taken for what there is.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::cell_table::TABLE;
use super::node_values::NodeValues;
use super::quads::Quad;
use super::settings::{ContourSettings, VertexMode};
use super::surface::{Contour, ContourReport, Sheet, position};
use super::untangle::untangle;
use crate::application::Watch;
use crate::geometry::RegularGrid;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::compact::GpuCompact;
use crate::parallel::scan::GpuScan;
use crate::{Error, Result};

use Access::{Read, ReadWrite, Uniform};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 64;
/// What is read back, such as vertices, that one thread takes together at least.
const TOGETHER: usize = 1 << 10;

/// What all stages share; twin of the struct in `parameters.wesl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ContourParameters {
    /// Node (0, 0, 0), relative to the grid's origin.
    pub corner: [f32; 3],
    /// Width of a cell.
    pub spacing: f32,
    /// Number of nodes along the axes.
    pub nodes: [u32; 3],
    /// Number of nodes.
    pub n_nodes: u32,
    /// The surface is where values, or their sizes, have this value.
    pub level: f32,
    /// 1 where sizes are meant.
    pub two_sided: u32,
    /// Part of the largest eigenvalue up to which others count as 0.
    pub threshold: f32,
    /// Active cells, once they are known.
    pub n_cells: u32,
}

/// An active cell; twin of the struct in `cell.wesl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct ContourCell {
    /// Number of its node.
    pub number: u32,
    /// Corners inside; from bit 8 on whether flipped; from bit 9 on cut edges.
    pub inside_cut: u32,
    /// Emitted edges; from bit 12 on first edges of sheets.
    pub emitted_heads: u32,
    /// Not used.
    pub padding: u32,
}

/// The surface of a field, by its values alone, contoured on a device: that of [`super::contour`] up to rounding.
///
/// Polygons are the same; a polygon whose diagonals are alike may be cut along the other one. Vertices that make
/// triangles flip or intersect are found and moved on the host, after the surface is read back.
///
/// # Errors
/// As [`super::contour`]; `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`.
pub fn contour_on_gpu(
    gpu: &Gpu,
    values: &NodeValues<'_, f32>,
    settings: &ContourSettings,
    watch: &mut Watch<'_>,
) -> Result<Contour<f32>> {
    watch.report("upload", 0, 1)?;
    let field = gpu.upload("values of a grid", values.raw())?;
    let (level, two_sided) = values.level();
    watch.report("contouring on the device", 0, 1)?;
    let mut contour = GpuContour::of(gpu, values.grid(), &field, level, two_sided, settings)?.read()?;
    if settings.mode == VertexMode::Untangled {
        untangle(&mut contour, watch)?;
    }
    Ok(contour)
}

/// A contoured surface on a device, with its vertices where the planes of their crossings meet, as in
/// [`VertexMode::Features`].
pub struct GpuContour {
    gpu: Gpu,
    grid: RegularGrid,
    vertices: Buffer<[f32; 4]>,
    sheets: Buffer<[f32; 4]>,
    quads: Buffer<[u32; 4]>,
    facings: Buffer<[f32; 4]>,
    triangles: Buffer<u32>,
    stages: Vec<StageTime>,
}

impl GpuContour {
    /// Of values that are on the device.
    ///
    /// - `values`: `[nz][ny][nx]` as in [`crate::geometry::DistanceGrid`]
    /// - `level`, `two_sided`: as [`NodeValues::at_level`] and [`NodeValues::two_sided`]; 0 and false for the field's own surface
    /// - `settings`: of these, the threshold
    ///
    /// # Errors
    /// `LengthMismatch` unless there is one value a node; `InvalidSetting`; `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`.
    pub fn of(
        gpu: &Gpu,
        grid: &RegularGrid,
        values: &Buffer<f32>,
        level: f32,
        two_sided: bool,
        settings: &ContourSettings,
    ) -> Result<Self> {
        settings.check()?;
        let (found, expected) = (values.len() as u64, grid.n_nodes() as u64);
        if found != expected {
            return Err(Error::LengthMismatch { what: "the values of a grid", found, expected });
        }
        let parameters = ContourParameters {
            corner: grid.corner().to_array(),
            spacing: grid.spacing(),
            nodes: grid.nodes(),
            n_nodes: grid.n_nodes() as u32,
            level,
            two_sided: u32::from(two_sided),
            threshold: settings.threshold as f32,
            n_cells: 0,
        };
        let table = gpu.upload("cycles of cells", &TABLE.words())?;
        let mut stages = Vec::new();
        let found = Found::of(gpu, values, parameters, &mut stages)?;
        let described = Described::of(gpu, values, &table, found, &mut stages)?;
        described.mesh(gpu, grid, &table, stages)
    }

    /// Positions relative to the grid's origin, in x, y, z; as many as there are vertices.
    pub fn vertices(&self) -> &Buffer<[f32; 4]> {
        &self.vertices
    }

    /// Three indices into the vertices a triangle, counter-clockwise seen from outside.
    pub fn triangles(&self) -> &Buffer<u32> {
        &self.triangles
    }

    /// Times of the stages on the device.
    pub fn stages(&self) -> &[StageTime] {
        &self.stages
    }

    /// Reads the surface back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read(&self) -> Result<Contour<f32>> {
        let gpu = &self.gpu;
        let xyz = |[x, y, z, _]: [f32; 4]| [x, y, z];
        let words = gpu.read(&self.sheets)?;
        let sheet = |words: &[[f32; 4]]| Sheet {
            cell: self.grid.node(words[0][3].to_bits() as usize).expect("a cell should be in the grid"),
            place: xyz(words[0]),
            mass: xyz(words[1]),
            middle: xyz(words[2]),
        };
        let sheets: Vec<Sheet<f32>> = words.par_chunks_exact(3).with_min_len(TOGETHER).map(sheet).collect();
        let (vertices, facings) = (gpu.read(&self.quads)?, gpu.read(&self.facings)?);
        let quad = |(&vertices, &[x, y, z, facing]): (&[u32; 4], &[f32; 4])| {
            let facing = facing as u8;
            Quad { vertices, axis: facing & 3, upwards: facing & 4 == 4, normal: [x, y, z] }
        };
        let quads: Vec<Quad<f32>> = vertices.par_iter().zip(&facings).with_min_len(TOGETHER).map(quad).collect();
        let triangles = gpu.read(&self.triangles)?;
        let cuts = quads.par_iter().zip(triangles.par_chunks_exact(6)).with_min_len(TOGETHER);
        let other = cuts.map(|(quad, cut)| cut[0] != quad.vertices[0]).collect();
        let place = |sheet: &Sheet<f32>| position(&self.grid, sheet.cell, sheet.place);
        let vertices = sheets.par_iter().with_min_len(TOGETHER).map(place).collect();
        Ok(Contour { grid: self.grid, sheets, quads, other, vertices, report: ContourReport::default() })
    }
}

/// The active cells by number.
struct Found {
    parameters: ContourParameters,
    /// Flags of nodes, later the places of active cells.
    slots: Buffer<u32>,
    numbers: Buffer<u32>,
}

impl Found {
    fn of(gpu: &Gpu, values: &Buffer<f32>, parameters: ContourParameters, stages: &mut Vec<StageTime>) -> Result<Self> {
        let n = values.len();
        let mark = pipeline(gpu, "mark_cells", &[Uniform, Read, ReadWrite])?;
        let compact = GpuCompact::new(gpu, n)?;
        let slots = gpu.buffer("active cells by node", n)?;
        let numbers = gpu.buffer("nodes of active cells", n)?;
        let count = gpu.buffer("number of active cells", 1)?;
        let shared = gpu.uniform("contour parameters", &parameters)?;
        let mut commands = gpu.commands("find active cells");
        let binds = [(&shared).into(), values.into(), (&slots).into()];
        commands.stage("mark").dispatch(&mark, &binds, Workgroups::Covering(n as u64));
        commands.stage("compact");
        compact.record(&mut commands, &slots, &numbers, &count, n)?;
        let count = commands.read_back(&count)?;
        stages.extend(commands.run()?);
        let n_cells = count.values()?[0];
        Ok(Self { parameters: ContourParameters { n_cells, ..parameters }, slots, numbers })
    }
}

/// The active cells with their crossings.
struct Described {
    parameters: ContourParameters,
    slots: Buffer<u32>,
    cells: Buffer<ContourCell>,
    crossings: Buffer<[f32; 4]>,
    first_vertex: Buffer<u32>,
    first_quad: Buffer<u32>,
    n_vertices: usize,
    n_quads: usize,
}

impl Described {
    fn of(
        gpu: &Gpu,
        values: &Buffer<f32>,
        table: &Buffer<[u32; 2]>,
        found: Found,
        stages: &mut Vec<StageTime>,
    ) -> Result<Self> {
        let Found { parameters, slots, numbers } = found;
        let n = parameters.n_cells as usize;
        let access = [Uniform, Read, Read, Read, ReadWrite, ReadWrite, ReadWrite, ReadWrite, ReadWrite];
        let describe = pipeline(gpu, "describe_cells", &access)?;
        let scan = GpuScan::new(gpu, n)?;
        let cells = gpu.buffer("active cells", n)?;
        let crossings = gpu.buffer("crossings", 3 * n)?;
        let vertex_counts = gpu.buffer("vertices of cells", n)?;
        let quad_counts = gpu.buffer("polygons of cells", n)?;
        let first_vertex = gpu.buffer("first vertices of cells", n + 1)?;
        let first_quad = gpu.buffer("first polygons of cells", n + 1)?;
        let shared = gpu.uniform("contour parameters", &parameters)?;
        let mut commands = gpu.commands("describe active cells");
        let binds = [
            (&shared).into(),
            values.into(),
            table.into(),
            (&numbers).into(),
            (&slots).into(),
            (&cells).into(),
            (&vertex_counts).into(),
            (&quad_counts).into(),
            (&crossings).into(),
        ];
        commands.stage("describe").dispatch(&describe, &binds, Workgroups::Covering(n as u64));
        commands.stage("scan");
        scan.record(&mut commands, &vertex_counts, &first_vertex, n)?;
        scan.record(&mut commands, &quad_counts, &first_quad, n)?;
        let mut last = |sums: &Buffer<u32>| {
            let sum = gpu.buffer::<u32>("sum over cells", 1)?;
            commands.copy_from(sums, n, &sum).read_back(&sum)
        };
        let (n_vertices, n_quads) = (last(&first_vertex)?, last(&first_quad)?);
        stages.extend(commands.run()?);
        let [n_vertices, n_quads] = [n_vertices.values()?[0] as usize, n_quads.values()?[0] as usize];
        Ok(Self { parameters, slots, cells, crossings, first_vertex, first_quad, n_vertices, n_quads })
    }

    fn mesh(
        &self,
        gpu: &Gpu,
        grid: &RegularGrid,
        table: &Buffer<[u32; 2]>,
        mut stages: Vec<StageTime>,
    ) -> Result<GpuContour> {
        let sheets = gpu.buffer("sheets of the surface", 3 * self.n_vertices)?;
        let vertices = gpu.buffer("vertices of the surface", self.n_vertices)?;
        let quads = gpu.buffer("polygons of the surface", self.n_quads)?;
        let facings = gpu.buffer("facings of polygons", self.n_quads)?;
        let triangles = gpu.buffer("triangles of the surface", 6 * self.n_quads)?;
        let mut commands = gpu.commands("mesh");
        self.record_vertices(&mut commands, gpu, table, &sheets, &vertices)?;
        self.record_quads(&mut commands, gpu, table, &quads, &facings)?;
        let cut = pipeline(gpu, "quads", &[Uniform, Read, Read, Read, ReadWrite])?;
        let shared = gpu.uniform("contour parameters", &self.parameters)?;
        let binds = [(&shared).into(), (&vertices).into(), (&quads).into(), (&facings).into(), (&triangles).into()];
        commands.stage("triangles").dispatch(&cut, &binds, Workgroups::Covering(self.n_quads as u64));
        stages.extend(commands.run()?);
        let (gpu, grid) = (gpu.clone(), *grid);
        Ok(GpuContour { gpu, grid, vertices, sheets, quads, facings, triangles, stages })
    }

    fn record_vertices(
        &self,
        commands: &mut Commands,
        gpu: &Gpu,
        table: &Buffer<[u32; 2]>,
        sheets: &Buffer<[f32; 4]>,
        vertices: &Buffer<[f32; 4]>,
    ) -> Result<()> {
        let access = [Uniform, Read, Read, Read, Read, Read, ReadWrite, ReadWrite];
        let place = pipeline(gpu, "place_vertices", &access)?;
        let mut binds = self.cell_binds(gpu, table)?;
        binds.extend([sheets.into(), vertices.into()]);
        commands.stage("vertices").dispatch(&place, &binds, self.all_cells());
        Ok(())
    }

    fn record_quads(
        &self,
        commands: &mut Commands,
        gpu: &Gpu,
        table: &Buffer<[u32; 2]>,
        quads: &Buffer<[u32; 4]>,
        facings: &Buffer<[f32; 4]>,
    ) -> Result<()> {
        let access = [Uniform, Read, Read, Read, Read, Read, Read, ReadWrite, ReadWrite];
        let join = pipeline(gpu, "join_quads", &access)?;
        let mut binds = self.cell_binds(gpu, table)?;
        binds.extend([(&self.first_quad).into(), quads.into(), facings.into()]);
        commands.stage("polygons").dispatch(&join, &binds, self.all_cells());
        Ok(())
    }

    /// What the kernels over cells read first.
    fn cell_binds(&self, gpu: &Gpu, table: &Buffer<[u32; 2]>) -> Result<Vec<Bind>> {
        let shared = gpu.uniform("contour parameters", &self.parameters)?;
        Ok(vec![
            (&shared).into(),
            table.into(),
            (&self.slots).into(),
            (&self.cells).into(),
            (&self.crossings).into(),
            (&self.first_vertex).into(),
        ])
    }

    fn all_cells(&self) -> Workgroups {
        Workgroups::Covering(u64::from(self.parameters.n_cells))
    }
}

/// The kernel of a module of this folder; its entry has the module's name, but for the cutting of quads.
fn pipeline(gpu: &Gpu, module: &'static str, bindings: &[Access]) -> Result<std::sync::Arc<Pipeline>> {
    let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
    let path = format!("package::application::dual_contouring::{module}");
    let entry = if module == "quads" { "cut_quads" } else { module };
    gpu.prepare(&Kernel { constants, ..Kernel::new(&path, entry, bindings, WORKGROUP) })
}
