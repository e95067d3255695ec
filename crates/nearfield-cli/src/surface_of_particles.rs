//! `nearfield surface`: a mesh around the particles of a fluid.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::particles::{Checkpoint, ParticleSurface};
use nearfield::application::{self, ContourSettings, Watch, contour};
use nearfield::geometry::mesh_topology::MeshTopology;
use nearfield::io::{Format, WriteOptions, write_mesh};
use nearfield::{Error, PointCloud, Vec3};
use serde_json::json;

use crate::exit::Failure;
use crate::input::{Input, file_name, searchable};
use crate::interrupt;
use crate::options::{Common, PictureSize};
use crate::output;
use crate::progress::Progress;
use crate::report::{grouped, milliseconds, print, print_json, rounded, short, shown_ms};
use crate::spacing;
use crate::surface_picture;

const EXAMPLES: &str = "Examples:
  nearfield simulate dam-break --ply --vtp -o out
  nearfield surface out/frame-00020.ply --spacing 0.05 -o water.ply --picture water.png
  nearfield surface out/frame-00020.vtp --spacing 0.05 -o water.ply
  nearfield surface out/checkpoint.npz --spacing 0.05 -o water.obj

The surface lies half a spacing beyond the outer particles of a fluid at rest. It is closed, manifold and oriented; what it prints
says so. A checkpoint of a simulation is read like a frame.";

/// Spacing over the mean distance to the nearest particle, where no spacing is given: at random places the nearest is nearer.
const SPACING: f64 = 1.1;

/// Make a mesh around the particles of a fluid
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct SurfaceOfParticlesArgs {
    /// A frame: a file of points in any format, or a checkpoint of a simulation (.npz)
    #[arg(value_name = "FRAME")]
    input: PathBuf,

    /// Format of the frame, where its extension does not say it
    #[arg(long, value_name = "FORMAT")]
    format: Option<Format>,

    /// Distance of neighbouring particles at rest [default: from the distances to the nearest]
    #[arg(long, value_name = "LENGTH")]
    spacing: Option<f64>,

    /// Distance up to which particles count, in spacings
    #[arg(long, value_name = "SPACINGS", default_value_t = 2.0)]
    support: f64,

    /// Distance of the nodes of the grid, in spacings
    #[arg(long, value_name = "SPACINGS", default_value_t = 0.5)]
    cell: f64,

    /// The mesh to write: PLY, OBJ, STL or VTP
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// Format of the mesh, where its extension does not say it
    #[arg(long, value_name = "FORMAT")]
    to: Option<Format>,

    /// Draw the mesh, by path tracing
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,

    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "800x640")]
    picture_size: PictureSize,

    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,

    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

pub(crate) fn run(args: &SurfaceOfParticlesArgs, common: &Common) -> Result<(), Failure> {
    let to = args.check()?;
    interrupt::watch();
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let cloud = args.read(common)?;
    let settings = args.settings(&cloud)?;
    let mut tell = |step: application::Progress| {
        progress.step(format!("{}: {} %", step.stage, 100 * step.done / step.total.max(1)));
        if interrupt::asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let mut watch = Watch::new(&mut tell);
    let failed = |error: Error| match error {
        Error::Interrupted { .. } => Failure::Interrupted(format!("{error}; nothing is written")),
        other => Failure::Search(other),
    };
    let clock = Instant::now();
    let field = settings.field(cloud.origin, &cloud.points, &mut watch).map_err(failed)?;
    let of_field = milliseconds(clock);
    let clock = Instant::now();
    let surface = contour(&(&field).into(), &ContourSettings::default(), &mut watch).map_err(failed)?;
    let (nodes, mesh) = (field.grid().nodes(), surface.mesh());
    let topology = MeshTopology::of(&mesh);
    let of_surface = milliseconds(clock);

    progress.step(format!("writing {}", args.output.display()));
    let options = WriteOptions { format: Some(to), force: args.force, ascii: false };
    write_mesh(&args.output, &mesh, &options).map_err(Failure::writing)?;
    if let Some(path) = &args.picture {
        progress.step(format!("drawing {}", path.display()));
        surface_picture::draw(mesh, path, args.picture_size, args.force)?;
    }
    drop(progress);
    if args.json {
        return print_json(&json!({
            "input": file_name(&args.input),
            "particles": cloud.len(),
            "radius": settings.radius,
            "support": settings.support,
            "cell": settings.cell,
            "grid": nodes,
            "vertices": topology.vertices,
            "mesh_triangles": topology.triangles,
            "closed": topology.is_closed(),
            "manifold": topology.is_manifold(),
            "oriented": topology.is_oriented(),
            "euler_number": topology.euler_number(),
            "components": topology.components,
            "milliseconds": { "field": rounded(of_field), "surface": rounded(of_surface) },
        }));
    }
    if common.quiet {
        return Ok(());
    }
    let [nx, ny, nz] = nodes;
    let border = if topology.is_closed() { "closed" } else { "open" };
    let lengths = [settings.radius, settings.support, settings.cell].map(|length| short(length as f32, 4));
    let rows = [
        ("particles", grouped(cloud.len() as u64)),
        ("lengths", format!("surface {} from them, support {}, cells {}", lengths[0], lengths[1], lengths[2])),
        ("grid", format!("{nx} × {ny} × {nz} nodes")),
        ("mesh", format!("{} vertices, {} triangles", grouped(topology.vertices), grouped(topology.triangles))),
        ("surface", format!("{border}, {} components, Euler number {}", topology.components, topology.euler_number())),
        ("time", format!("field {}, surface {}", shown_ms(of_field), shown_ms(of_surface))),
    ];
    let lines: String = rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect();
    if args.output == Path::new("-") {
        eprint!("{lines}");
        return Ok(());
    }
    print(&lines)
}

impl SurfaceOfParticlesArgs {
    /// Says what cannot work before the work is done; the format of the mesh.
    fn check(&self) -> Result<Format, Failure> {
        if self.json && self.output == Path::new("-") {
            return Err(Failure::Usage("only one of --json and --output - can have standard output".into()));
        }
        if let Some(path) = &self.picture {
            if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
                return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
            }
            output::check(path, self.force)?;
        }
        let to = output::format(&self.output, self.to)?;
        if !to.info().writes_mesh {
            return Err(Failure::Usage(format!("{to} is not written for meshes; `nearfield formats` lists what is")));
        }
        output::check(&self.output, self.force)?;
        Ok(to)
    }

    /// The particles: of a checkpoint, where it is one, else of a file of points.
    fn read(&self, common: &Common) -> Result<PointCloud, Failure> {
        let is_npz = self.input.extension().is_some_and(|e| e.eq_ignore_ascii_case("npz"));
        if is_npz
            && self.format.is_none()
            && let Ok(saved) = Checkpoint::read(&self.input)
        {
            let origin = saved.particles.positions.first().copied().unwrap_or_default();
            let points: Vec<Vec3> = saved.particles.positions.iter().map(|p| (*p - origin).as_vec3()).collect();
            return Ok(PointCloud { origin, points, ..PointCloud::default() });
        }
        let cloud = Input::open(&self.input, self.format, common)?.cloud()?;
        searchable(cloud, &self.input, false, &mut Vec::new())
    }

    fn settings(&self, cloud: &PointCloud) -> Result<ParticleSurface, Failure> {
        let spacing = match self.spacing {
            Some(spacing) => spacing,
            None => {
                let mean = spacing::spacing(&cloud.points).map_err(Failure::Search)?.mean;
                let too_few = || Failure::Usage("--spacing is needed for fewer than two particles".to_owned());
                SPACING * mean.ok_or_else(too_few)?
            }
        };
        let usual = ParticleSurface::of_spacing(spacing);
        Ok(ParticleSurface { support: self.support * spacing, cell: self.cell * spacing, ..usual })
    }
}
