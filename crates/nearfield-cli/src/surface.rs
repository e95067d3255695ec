//! What `mesh` and `offset` share: the field they start from, the surface they take from it, its file and its summary.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::{
    self, Contour, ContourReport, ContourSettings, DistanceMode, DistanceSettings, GpuMeshDistance, GpuOrientedSamples,
    MeshDistance, NodeValues, OrientedSamples, SignRule, VertexMode, Watch, contour, contour_on_gpu,
};
use nearfield::geometry::mesh_topology::MeshTopology;
use nearfield::geometry::{DistanceGrid, RegularGrid};
use nearfield::gpu::DeviceChoice;
use nearfield::io::{Format, Polygons, WriteOptions, read_distance_grid, write_mesh};
use nearfield::{Aabb, DVec3, Error, PointCloud, TriMesh, Vec3};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::fallback::on_gpu;
use crate::input::{Input, file_name, searchable};
use crate::interrupt;
use crate::options::{Common, PictureSize};
use crate::output;
use crate::progress::Progress;
use crate::report::{grouped, milliseconds, print, print_json, rounded, shown_ms};
use crate::surface_picture;

/// Options of both.
#[derive(Debug, Args)]
pub(crate) struct SurfaceArgs {
    /// Points with normals, a mesh, or a field that `nearfield sdf` wrote (.vti)
    pub(crate) input: PathBuf,

    /// Nodes along the longest side of the grid; a field has its own
    #[arg(long, value_name = "N", default_value_t = 257)]
    pub(crate) resolution: u32,

    /// Where distances and surface are computed: auto, cpu, gpu, or a device of `nearfield devices`; distances from
    /// meshes are computed on the CPU
    #[arg(long, value_name = "D", default_value = "auto")]
    device: DeviceChoice,

    /// The mesh to write
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// What a distance from points is: nearest, plane, imls or apss [default: plane]
    #[arg(long, value_name = "MODE")]
    mode: Option<DistanceMode>,

    /// Rule of the sign: normal, winding-number or pseudonormal [default: normal for points, pseudonormal for closed
    /// meshes, winding-number for others]
    #[arg(long, value_name = "RULE")]
    sign: Option<SignRule>,

    /// Keep vertices where the planes of their crossings meet: sharp features, and triangles that may intersect
    #[arg(long)]
    features: bool,

    /// Part of the largest eigenvalue up to which others count as 0 [default: 0.1, with --features 0.001]
    #[arg(long, value_name = "X")]
    threshold: Option<f64>,

    /// Take the vertices of a mesh as points, by their normals
    #[arg(long)]
    points: bool,

    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,

    /// Render the surface in a room into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "800x640", requires = "picture")]
    picture_size: PictureSize,

    /// Print the summary as one JSON object
    #[arg(long)]
    json: bool,

    /// Format of points or a mesh, where the extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Format of the output, where its extension does not say it
    #[arg(long, value_name = "F")]
    to: Option<Format>,

    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// What distances are taken from.
pub(crate) enum Source {
    Field(DistanceGrid),
    Mesh(TriMesh),
    Points(PointCloud),
}

impl Source {
    /// Origin and box.
    pub(crate) fn bounds(&self) -> (DVec3, Aabb) {
        match self {
            Self::Field(field) => (field.grid().origin(), field.grid().bounds()),
            Self::Mesh(mesh) => (mesh.origin, mesh.bounds()),
            Self::Points(cloud) => (cloud.origin, cloud.bounds()),
        }
    }

    fn kind(&self) -> (&'static str, u64) {
        match self {
            Self::Field(field) => ("nodes", field.values().len() as u64),
            Self::Mesh(mesh) => ("triangles", mesh.triangles.len() as u64),
            Self::Points(cloud) => ("points", cloud.len() as u64),
        }
    }
}

/// How the subcommand makes its surface.
pub(crate) trait Plan {
    /// The grid for the field of a source that is no field, and its band in grid widths.
    fn grid(&self, source: &Source, resolution: u32) -> nearfield::Result<(RegularGrid, f64)>;

    /// Says what of the field cannot work.
    fn check(&self, _: &DistanceGrid) -> nearfield::Result<()> {
        Ok(())
    }

    /// The values whose surface is taken.
    fn values<'a>(&self, field: &'a DistanceGrid) -> nearfield::Result<NodeValues<'a, f32>>;

    /// A line and a value for the summary.
    fn told(&self) -> Option<(&'static str, String, Value)> {
        None
    }
}

/// Milliseconds of the stages.
#[derive(Debug, Default)]
struct Clocks {
    read: f64,
    field: f64,
    surface: f64,
    topology: f64,
    write: f64,
    picture: f64,
}

impl Clocks {
    fn named(&self) -> [(&'static str, f64); 6] {
        [
            ("read", self.read),
            ("distances", self.field),
            ("surface", self.surface),
            ("checks", self.topology),
            ("write", self.write),
            ("picture", self.picture),
        ]
    }
}

/// Everything worth telling.
struct Told<'a> {
    source: &'a Source,
    grid: RegularGrid,
    report: ContourReport,
    topology: MeshTopology,
    devices: [String; 2],
    clocks: Clocks,
    notes: Vec<String>,
}

pub(crate) fn run(
    args: &SurfaceArgs,
    make: impl FnOnce(&Source) -> Result<Box<dyn Plan>, Failure>,
    common: &Common,
) -> Result<(), Failure> {
    let to = args.check()?;
    interrupt::watch();
    let (mut clocks, mut notes) = (Clocks::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let mut source = args.source(common, &mut notes)?;
    clocks.read = milliseconds(clock);
    let plan = make(&source)?;

    let mut tell = |step: application::Progress| {
        progress.step(format!("{}: {} %", step.stage, 100 * step.done / step.total.max(1)));
        if interrupt::asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let mut watch = Watch::new(&mut tell);
    let failed = |error| args.failed(error);
    let clock = Instant::now();
    let (field, field_device) = match &mut source {
        // The values move; what is told of the source is the number of nodes.
        Source::Field(field) => (field.clone(), "the input".to_owned()),
        source => args.field(source, plan.as_ref(), common, &mut notes, &mut watch).map_err(failed)?,
    };
    clocks.field = milliseconds(clock);

    let clock = Instant::now();
    plan.check(&field).map_err(failed)?;
    let values = plan.values(&field).map_err(failed)?;
    let (surface, device) = args.contour(&values, &mut notes, &mut watch).map_err(failed)?;
    clocks.surface = milliseconds(clock);
    let clock = Instant::now();
    let (grid, report, mesh) = (*surface.grid(), *surface.report(), surface.mesh());
    drop(surface);
    let topology = MeshTopology::of(&mesh);
    clocks.topology = milliseconds(clock);
    if mesh.triangles.is_empty() {
        notes.push("there is no surface: no two neighbouring nodes with values have different signs".to_owned());
    }

    progress.step(format!("writing {}", args.output.display()));
    let clock = Instant::now();
    let options = WriteOptions { format: Some(to), force: args.force, ascii: false };
    write_mesh(&args.output, &mesh, &options).map_err(Failure::writing)?;
    clocks.write = milliseconds(clock);
    if let Some(path) = args.picture.as_ref().filter(|_| !mesh.triangles.is_empty()) {
        progress.step(format!("drawing {}", path.display()));
        let clock = Instant::now();
        surface_picture::draw(mesh, path, args.picture_size, args.force)?;
        clocks.picture = milliseconds(clock);
    }
    drop(progress);
    let devices = [field_device, device];
    args.tell(&Told { source: &source, grid, report, topology, devices, clocks, notes }, plan.as_ref(), common)
}

impl SurfaceArgs {
    /// Says what cannot work before the work is done; the format of the output.
    fn check(&self) -> Result<Format, Failure> {
        let stdout = |path: &Path| path == Path::new("-");
        let picture = self.picture.as_deref();
        let to_stdout = [self.json, stdout(&self.output), picture.is_some_and(stdout)];
        if to_stdout.iter().filter(|&&is| is).count() > 1 {
            let what = "only one of --json, --output - and --picture - can have standard output";
            return Err(Failure::Usage(what.into()));
        }
        if let Some(path) = picture.filter(|path| !stdout(path))
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
        {
            return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
        }
        let to = output::format(&self.output, self.to)?;
        if !to.info().writes_mesh {
            return Err(Failure::Usage(format!("{to} is not written for meshes; `nearfield formats` lists what is")));
        }
        output::check(&self.output, self.force)?;
        picture.map_or(Ok(()), |path| output::check(path, self.force))?;
        Ok(to)
    }

    fn source(&self, common: &Common, notes: &mut Vec<String>) -> Result<Source, Failure> {
        if self.input.extension().is_some_and(|e| e.eq_ignore_ascii_case("vti")) {
            let size = std::fs::metadata(&self.input).map_or(0, |metadata| metadata.len());
            common.allow("the input", 2 * size).map_err(Failure::Search)?;
            return Ok(Source::Field(read_distance_grid(&self.input).map_err(Failure::reading(&self.input))?));
        }
        let input = Input::open(&self.input, self.format, common)?;
        if !self.points && input.mesh()?.is_some() {
            return Ok(Source::Mesh(input.surface(Polygons::Fans)?));
        }
        let cloud = searchable(input.cloud()?, &self.input, self.drop_invalid, notes)?;
        if cloud.is_empty() {
            return Err(Failure::Read(self.input.clone(), Error::NoNormals { points: 0, without: 0, first: 0 }));
        }
        Ok(Source::Points(cloud))
    }

    fn failed(&self, error: Error) -> Failure {
        match error {
            Error::Interrupted { .. } => Failure::Interrupted(format!("{error}; nothing is written")),
            Error::NoNormals { .. } => Failure::Read(self.input.clone(), error),
            other => Failure::Search(other),
        }
    }

    /// The field of points or a mesh, and where it was computed.
    fn field(
        &self,
        source: &Source,
        plan: &dyn Plan,
        common: &Common,
        notes: &mut Vec<String>,
        watch: &mut Watch<'_>,
    ) -> nearfield::Result<(DistanceGrid, String)> {
        let (grid, band) = plan.grid(source, self.resolution)?;
        let settings = DistanceSettings::default().mode(self.mode.unwrap_or_default()).band(band);
        let settings = DistanceSettings { sign: self.sign, max_bytes: common.memory_left(0), ..settings };
        let cloud = match source {
            Source::Field(field) => return Ok((field.clone(), "the input".to_owned())),
            Source::Mesh(mesh) => {
                let mesh = MeshDistance::new(mesh)?;
                let mut device = "cpu".to_owned();
                let there = on_gpu(&self.device, notes, |gpu| {
                    gpu.name().clone_into(&mut device);
                    GpuMeshDistance::upload(gpu, &mesh)?.distances(&grid, &settings)
                })?;
                return match there {
                    Some(distances) => Ok((distances, device)),
                    None => Ok((mesh.distance_field(&grid, &settings, watch)?.distances, "cpu".to_owned())),
                };
            }
            Source::Points(cloud) => cloud,
        };
        let normals = cloud.normals.as_deref().unwrap_or_default();
        let mut device = "cpu".to_owned();
        let there = on_gpu(&self.device, notes, |gpu| {
            gpu.name().clone_into(&mut device);
            GpuOrientedSamples::build(gpu, &cloud.points, normals)?.distances(&grid, &settings)
        })?;
        if let Some(distances) = there {
            return Ok((distances, device));
        }
        let arrays = |vectors: &[Vec3]| vectors.iter().map(|v| v.to_array()).collect::<Vec<[f32; 3]>>();
        let samples = OrientedSamples::new(&arrays(&cloud.points), &arrays(normals))?;
        Ok((samples.distance_field(&grid, &settings, watch)?.distances, "cpu".to_owned()))
    }

    fn contour(
        &self,
        values: &NodeValues<'_, f32>,
        notes: &mut Vec<String>,
        watch: &mut Watch<'_>,
    ) -> nearfield::Result<(Contour<f32>, String)> {
        let usual = if self.features { ContourSettings::features() } else { ContourSettings::default() };
        let settings = ContourSettings { threshold: self.threshold.unwrap_or(usual.threshold), ..usual };
        let mut device = "cpu".to_owned();
        let mut again = Vec::new();
        let there = on_gpu(&self.device, &mut again, |gpu| {
            gpu.name().clone_into(&mut device);
            contour_on_gpu(gpu, values, &settings, watch)
        })?;
        notes.extend(again.into_iter().filter(|note| !notes.contains(note)).collect::<Vec<_>>());
        match there {
            Some(surface) => Ok((surface, device)),
            None => Ok((contour(values, &settings, watch)?, "cpu".to_owned())),
        }
    }

    fn tell(&self, told: &Told<'_>, plan: &dyn Plan, common: &Common) -> Result<(), Failure> {
        if self.json {
            return print_json(&self.json(told, plan));
        }
        if common.quiet {
            return Ok(());
        }
        let lines = self.lines(told, plan);
        if [Some(&self.output), self.picture.as_ref()].iter().any(|path| path.is_some_and(|p| p == Path::new("-"))) {
            eprint!("{lines}");
            return Ok(());
        }
        print(&lines)
    }

    fn json(&self, told: &Told<'_>, plan: &dyn Plan) -> Value {
        let (kind, number) = told.source.kind();
        let topology = &told.topology;
        let mut value = json!({
            "input": file_name(&self.input),
            kind: number,
            "grid": told.grid.nodes(),
            "spacing": told.grid.spacing(),
            "vertices": topology.vertices,
            "mesh_triangles": topology.triangles,
            "closed": topology.is_closed(),
            "manifold": topology.is_manifold(),
            "oriented": topology.is_oriented(),
            "euler_number": topology.euler_number(),
            "components": topology.components,
            "boundary_loops": topology.boundary_loops,
            "boundary_length": topology.boundary_length,
            "mode": if self.features { VertexMode::Features } else { VertexMode::Untangled }.name(),
            "vertices_clamped": told.report.clamped,
            "vertices_averaged": told.report.averaged,
            "vertices_rounded": told.report.rounded,
            "intersections_left": told.report.intersections,
            "flipped_left": told.report.flipped,
            "device_of_distances": told.devices[0],
            "device": told.devices[1],
            "milliseconds": told.clocks.named().iter().map(|&(name, ms)| (name.to_owned(), rounded(ms))).collect::<serde_json::Map<_, _>>(),
            "notes": told.notes,
        });
        if let (Some((name, _, told)), Value::Object(fields)) = (plan.told(), &mut value) {
            fields.insert(name.to_owned(), told);
        }
        value
    }

    fn lines(&self, told: &Told<'_>, plan: &dyn Plan) -> String {
        let (kind, number) = told.source.kind();
        let topology = &told.topology;
        let [nx, ny, nz] = told.grid.nodes();
        let border = match topology.boundary_loops {
            0 => "closed".to_owned(),
            n => format!("open: {} border loops, {} long", grouped(n), topology.boundary_length as f32),
        };
        let mut rows = vec![(kind, grouped(number))];
        rows.extend(plan.told().map(|(name, text, _)| (name, text)));
        rows.extend([
            ("grid", format!("{nx} × {ny} × {nz} nodes, {} apart", told.grid.spacing())),
            ("mesh", format!("{} vertices, {} triangles", grouped(topology.vertices), grouped(topology.triangles))),
            (
                "surface",
                format!("{border}, {} components, Euler number {}", topology.components, topology.euler_number()),
            ),
        ]);
        let report = &told.report;
        let moved = report.clamped + report.averaged + report.rounded;
        if moved > 0 {
            rows.push(("moved", format!("{} vertices, so that no triangles flip or intersect", grouped(moved))));
        }
        let times = told.clocks.named().into_iter().filter(|(_, ms)| *ms > 0.0);
        let times: Vec<String> = times.map(|(name, ms)| format!("{name} {}", shown_ms(ms))).collect();
        rows.push(("device", format!("distances on {}, surface on {}", told.devices[0], told.devices[1])));
        rows.push(("time", times.join(", ")));
        rows.extend(told.notes.iter().map(|note| ("note", note.clone())));
        rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect()
    }
}
