//! `nearfield sdf`: signed distances on a regular grid, from points with normals or from a mesh.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::{
    self, DistanceField, DistanceMode, DistanceSettings, GpuMeshDistance, GpuOrientedSamples, MeshDistance,
    OrientedSamples, SignRule, Watch, grid_around,
};
use nearfield::geometry::RegularGrid;
use nearfield::gpu::DeviceChoice;
use nearfield::io::{Format, GridFormat, Polygons, write_atomically, write_distance_grid};
use nearfield::{Aabb, Error, PointCloud, TriMesh};
use serde_json::json;

use crate::exit::Failure;
use crate::fallback::on_gpu;
use crate::input::{Input, file_name, searchable};
use crate::interrupt;
use crate::options::{Common, Length, PictureSize};
use crate::output;
use crate::progress::Progress;
use crate::report::{Times, grouped, milliseconds, print, print_json, shown_ms};
use crate::sdf_picture::{self, Axis, Slice};

const EXAMPLES: &str = "Examples:
  nearfield sdf scan.ply -o field.vti --picture slice.png
  nearfield sdf bunny.obj --resolution 129 --sign winding-number -o field.vti
  nearfield sdf scan.ply --spacing 0.2% --band 20 --mode apss -o field.npz

Distances are negative inside. Nodes with nothing within --band grid widths are undefined (NaN). From points, which need normals
(`nearfield normals`), --mode says what a distance is: nearest, to the nearest point (as in the literature, rough near the
surface); plane, to its tangent plane; imls, the mean of the planes around it; apss, to the sphere fitted to them, for noisy
points. From a mesh, the distance is that of the closest point of its triangles, exact.

The sign: normal, by the normals of the points; pseudonormal, by the faces, edges and corners of a mesh, exact where it is closed;
winding-number, where there are holes, thin walls or faces turned against each other.

Written are .vti (VTK ImageData, for ParaView), .npz (values [nz, ny, nx], origin, spacing, nearest) or .raw (f32, x
fastest) with a .json beside it.";

/// Signed distances on a regular grid, from points with normals or from a mesh
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct SdfArgs {
    /// Points with normals or a mesh: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// Nodes along the longest side, the band on both sides included
    #[arg(long, value_name = "N", default_value_t = 257, conflicts_with = "spacing")]
    resolution: u32,

    /// Distance of neighbouring nodes, as a length or a part of the diagonal such as 0.5%
    #[arg(long, value_name = "LENGTH")]
    spacing: Option<Length>,

    /// Distance up to which nodes have a value, in grid widths
    #[arg(long, value_name = "WIDTHS", default_value_t = 4.0)]
    band: f64,

    /// What a distance from points is: nearest, plane, imls or apss [default: plane]
    #[arg(long, value_name = "MODE")]
    mode: Option<DistanceMode>,

    /// Width of the weights of imls and apss, in spacings of the points
    #[arg(long, value_name = "SPACINGS", default_value_t = 1.0)]
    smoothing: f64,

    /// Rule of the sign: normal, winding-number or pseudonormal [default: normal for points, pseudonormal for closed meshes,
    /// winding-number for others]
    #[arg(long, value_name = "RULE")]
    sign: Option<SignRule>,

    /// Take the vertices of a mesh as points, by their normals
    #[arg(long)]
    points: bool,

    /// Where to compute: auto, cpu, gpu, or a device of `nearfield devices`
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,

    /// The field to write: .vti, .npz or .raw
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Draw a slice with lines of equal distance into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    /// Longer side of the picture in pixels, as a size WxH that it fits into
    #[arg(long, value_name = "WxH", default_value = "1200x900", requires = "picture")]
    picture_size: PictureSize,

    /// Axis across which the slice lies [default: that of the shortest side]
    #[arg(long, value_name = "AXIS", requires = "picture")]
    slice: Option<Axis>,

    /// Place of the slice from 0 to 1 along its axis
    #[arg(long, value_name = "PLACE", default_value_t = 0.5, requires = "picture")]
    slice_at: f64,

    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,

    /// Print the summary as one JSON object
    #[arg(long)]
    json: bool,

    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// What the distance is from.
enum Surface {
    Points(PointCloud),
    Mesh(TriMesh),
}

/// Everything worth telling.
struct Told<'a> {
    surface: &'a Surface,
    field: &'a DistanceField,
    settings: DistanceSettings,
    sign: SignRule,
    device: String,
    times: Times,
    notes: Vec<String>,
}

pub(crate) fn run(args: &SdfArgs, common: &Common) -> Result<(), Failure> {
    args.check()?;
    interrupt::watch();
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let surface = args.surface(common, &mut notes)?;
    times.read = milliseconds(clock);
    let settings = args.settings(&surface, common)?;
    let grid = args.grid(&surface)?;
    settings.validate(&grid).map_err(Failure::Search)?;

    progress.step("computing distances");
    let clock = Instant::now();
    let mut tell = |step: application::Progress| {
        progress.step(format!("{}: {} %", step.stage, 100 * step.done / step.total.max(1)));
        if interrupt::asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let computed = args.compute(&surface, &grid, &settings, &mut notes, &mut Watch::new(&mut tell));
    let (field, sign, device) = computed.map_err(|error| match error {
        Error::Interrupted { .. } => Failure::Interrupted(error.to_string()),
        Error::NoNormals { .. } => Failure::Read(args.input.clone(), error),
        other => Failure::Search(other),
    })?;
    times.query = milliseconds(clock);

    if let Some(path) = &args.output {
        progress.step(format!("writing {}", path.display()));
        let clock = Instant::now();
        write_distance_grid(path, &field.distances, Some(&field.nearest), args.force).map_err(Failure::writing)?;
        times.write = milliseconds(clock);
    }
    if let Some(path) = &args.picture {
        progress.step(format!("drawing {}", path.display()));
        let clock = Instant::now();
        let slice = Slice::new(&field.distances, args.slice, args.slice_at);
        let image = sdf_picture::draw(&slice, &file_name(&args.input), args.picture_size);
        write_atomically(path, args.force, |w| image.write_png(w)).map_err(Failure::writing)?;
        times.picture = milliseconds(clock);
    }
    drop(progress);
    args.tell(&Told { surface: &surface, field: &field, settings, sign, device, times, notes }, common)
}

impl SdfArgs {
    /// Says what cannot work before the work is done.
    fn check(&self) -> Result<(), Failure> {
        if let Some(path) = self.picture.as_deref().filter(|p| *p != Path::new("-"))
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
        {
            return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
        }
        if self.json && self.picture.as_deref() == Some(Path::new("-")) {
            return Err(Failure::Usage("only one of --json and --picture - can have standard output".into()));
        }
        if !(0.0..=1.0).contains(&self.slice_at) {
            return Err(Failure::Usage(format!("--slice-at {}: expected a place from 0 to 1", self.slice_at)));
        }
        if let Some(path) = &self.output {
            let format = GridFormat::from_path(path).map_err(|error| Failure::Usage(error.to_string()))?;
            output::check(path, self.force)?;
            if format == GridFormat::Raw {
                output::check(&path.with_extension("json"), self.force)?;
            }
        }
        self.picture.iter().try_for_each(|path| output::check(path, self.force))
    }

    fn surface(&self, common: &Common, notes: &mut Vec<String>) -> Result<Surface, Failure> {
        let input = Input::open(&self.input, self.format, common)?;
        if !self.points && input.mesh()?.is_some() {
            return Ok(Surface::Mesh(input.surface(Polygons::Fans)?));
        }
        let cloud = searchable(input.cloud()?, &self.input, self.drop_invalid, notes)?;
        if cloud.is_empty() {
            return Err(Failure::Read(self.input.clone(), Error::NoNormals { points: 0, without: 0, first: 0 }));
        }
        Ok(Surface::Points(cloud))
    }

    fn settings(&self, surface: &Surface, common: &Common) -> Result<DistanceSettings, Failure> {
        if let (Surface::Mesh(_), Some(mode)) = (surface, self.mode) {
            return Err(Failure::Usage(format!(
                "--mode {mode} is for points, and the distance from a mesh is exact; --points takes its vertices"
            )));
        }
        let settings = DistanceSettings::default().mode(self.mode.unwrap_or_default()).band(self.band);
        let settings = settings.smoothing(self.smoothing);
        Ok(DistanceSettings { sign: self.sign, max_bytes: common.memory_left(0), ..settings })
    }

    fn grid(&self, surface: &Surface) -> Result<RegularGrid, Failure> {
        let (origin, bounds) = match surface {
            Surface::Points(cloud) => (cloud.origin, cloud.bounds()),
            Surface::Mesh(mesh) => (mesh.origin, mesh.bounds()),
        };
        let grid = match self.spacing {
            None => grid_around(origin, &bounds, self.resolution, self.band),
            Some(length) => {
                let width = length.within(&bounds);
                let band = if self.band.is_finite() { self.band as f32 } else { 4.0 };
                let held = Aabb::new(bounds.min - band * width, bounds.max + band * width);
                RegularGrid::over(origin, &held, width)
            }
        };
        grid.map_err(Failure::Search)
    }

    /// The field, the rule of its sign, and where it was computed.
    fn compute(
        &self,
        surface: &Surface,
        grid: &RegularGrid,
        settings: &DistanceSettings,
        notes: &mut Vec<String>,
        watch: &mut Watch<'_>,
    ) -> nearfield::Result<(DistanceField, SignRule, String)> {
        let cloud = match surface {
            Surface::Mesh(mesh) => {
                let mesh = MeshDistance::new(mesh)?;
                let closure = mesh.closure();
                if !closure.is_closed() {
                    notes.push(format!(
                        "the mesh is not closed: {} border edges, {} edges of more than two triangles, {} between \
                         triangles turned against each other",
                        closure.border_edges, closure.crowded_edges, closure.turned_edges
                    ));
                }
                let sign = settings.sign.unwrap_or_else(|| mesh.usual_sign());
                let mut device = "cpu".to_owned();
                let there = on_gpu(&self.device, notes, |gpu| {
                    gpu.name().clone_into(&mut device);
                    GpuMeshDistance::upload(gpu, &mesh)?.distance_field(grid, settings)?.read()
                })?;
                return match there {
                    Some(field) => Ok((field, sign, device)),
                    None => Ok((mesh.distance_field(grid, settings, watch)?, sign, "cpu".to_owned())),
                };
            }
            Surface::Points(cloud) => cloud,
        };
        let sign = settings.sign.unwrap_or(SignRule::Normal);
        let normals = cloud.normals.as_deref().unwrap_or_default();
        let mut device = "cpu".to_owned();
        let there = on_gpu(&self.device, notes, |gpu| {
            gpu.name().clone_into(&mut device);
            GpuOrientedSamples::build(gpu, &cloud.points, normals)?.distance_field(grid, settings)?.read()
        })?;
        if let Some(field) = there {
            return Ok((field, sign, device));
        }
        let arrays = |vectors: &[nearfield::Vec3]| vectors.iter().map(|v| v.to_array()).collect::<Vec<[f32; 3]>>();
        let samples = OrientedSamples::new(&arrays(&cloud.points), &arrays(normals))?;
        Ok((samples.distance_field(grid, settings, watch)?, sign, "cpu".to_owned()))
    }

    fn tell(&self, told: &Told<'_>, common: &Common) -> Result<(), Failure> {
        let grid = told.field.distances.grid();
        let defined = told.field.n_defined() as u64;
        let inside = told.field.distances.values().iter().filter(|&&v| v < 0.0).count() as u64;
        let (kind, number) = match told.surface {
            Surface::Points(cloud) => ("points", cloud.len() as u64),
            Surface::Mesh(mesh) => ("triangles", mesh.triangles.len() as u64),
        };
        let mode = match told.surface {
            Surface::Points(_) => told.settings.mode.name(),
            Surface::Mesh(_) => "exact",
        };
        if self.json {
            return print_json(&json!({
                kind: number,
                "nodes": grid.nodes(),
                "origin": grid.world_corner().to_array(),
                "spacing": grid.spacing(),
                "band": if told.settings.band.is_finite() { json!(told.settings.band) } else { json!("inf") },
                "mode": mode,
                "sign": told.sign.name(),
                "defined": defined,
                "inside": inside,
                "device": told.device,
                "milliseconds": told.times.json(),
                "notes": told.notes,
            }));
        }
        let [nx, ny, nz] = grid.nodes();
        let nodes = grouped(grid.n_nodes() as u64);
        let mut rows = vec![
            (kind, grouped(number)),
            ("grid", format!("{nx} × {ny} × {nz} nodes ({nodes}), {} apart", grid.spacing())),
            ("distance", format!("{mode}, sign by {}", told.sign)),
            (
                "in the band",
                format!("{} nodes within {} widths, {} inside", grouped(defined), told.settings.band, grouped(inside)),
            ),
            ("device", told.device.clone()),
            ("time", format!("read {}, distances {}", shown_ms(told.times.read), shown_ms(told.times.query))),
        ];
        rows.extend(told.notes.iter().map(|note| ("note", note.clone())));
        let lines: String = rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect();
        if common.quiet {
            return Ok(());
        }
        if self.picture.as_deref() == Some(Path::new("-")) {
            eprint!("{lines}");
            return Ok(());
        }
        print(&lines)
    }
}
