//! `nearfield render`: a picture by light transport, sample by sample.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::{Film, GpuPathTracer, PathCounters, PathSettings, PathTracer, Scene};
use nearfield::structure::GpuRayStructure;
use nearfield::{RaySearch, RayTask};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::input::file_name;
use crate::interrupt;
use crate::options::{Common, PictureSize};
use crate::progress::{CountBar, Progress};
use crate::ray_structure::{Built, Rays, Structure, StructureArgs, failed};
use crate::render_picture::{self, Development, PictureFormat};
use crate::render_scene::{Source, Up};
use crate::report::{self, Times, grouped, milliseconds, rounded};

const EXAMPLES: &str = "Examples:
  nearfield render bunny.obj --spp 64 -o bunny.png
  nearfield render scan.ply --up z -o scan.png
  nearfield render scene.toml --spp 256 --size 1280x720 -o scene.exr
  nearfield render cornell-box -o cornell.png

A mesh (PLY, OBJ with its MTL, STL) stands in a room like the Cornell box; without its MTL file it is light grey. --up z
turns a mesh whose z points up, as scans have it; the room's y is up.
`cornell-box` is the Cornell box itself.

A scene file (.toml) places meshes, materials, lights and the camera; files lie relative to it, and only [[mesh]] must be there:
  [camera]
  direction = [0.0, -0.3, -1.0]    # frames everything; or position and target
  fov = 40.0                       # degrees, upper to lower edge

  [[mesh]]
  file = 'bunny.obj'
  material = 'gold'                # else its MTL, else light grey
  rotate = [0.0, 90.0, 0.0]        # degrees about x, then y, then z; also scale, translate

  [[material]]
  name = 'gold'
  kind = 'ggx'                     # lambert, mirror, dielectric or ggx
  color = [1.0, 0.8, 0.3]
  metallic = 1.0
  roughness = 0.3

  [[light]]
  position = [0.0, 3.0, 2.0]
  intensity = [10.0, 10.0, 10.0]

  [environment]
  radiance = [0.2, 0.2, 0.3]       # from everywhere
`room = true` at the top puts it all into the room. All keys, units and defaults: documentation of
`nearfield::application::read_scene`.

The picture is written every --every seconds while samples come in, and at the end. Ctrl-C ends after the sample that is under
way, writes the picture of what there is, and exits with code 130; a second Ctrl-C ends at once. PNG takes light
times --exposure, cut at 1, by the curve of sRGB; EXR keeps linear light in 32-bit floats.";

/// Render a scene, or a mesh in a room, by path tracing
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct RenderArgs {
    /// A scene file (.toml), a mesh, or cornell-box
    #[arg(value_name = "SCENE|MESH")]
    input: PathBuf,

    /// Samples a pixel
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,

    /// Most scatterings of a path
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(0..=1000))]
    depth: u32,

    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "800x640")]
    size: PictureSize,

    /// The direction of the mesh that is up in the room [default: y]; not for scene files, which say it themselves
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Up>,

    #[command(flatten)]
    structure: StructureArgs,

    /// Picks one of the equally likely pictures
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u32,

    /// What light is multiplied by in a PNG [default: 1.6 for a mesh in its room, else 1]
    #[arg(long, value_name = "X")]
    exposure: Option<f32>,

    /// Seconds after which the picture so far is written
    #[arg(long, value_name = "SECONDS", default_value_t = 15.0)]
    every: f64,

    /// The picture to write: OUT.png, OUT.exr, or - for PNG to standard output
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,

    /// Replace a file that exists
    #[arg(long)]
    force: bool,
}

/// Exposure at which the floor of the room is light, and no wall white.
pub(crate) const ROOM_EXPOSURE: f32 = 1.6;

/// What adds samples to a picture.
trait Tracer {
    /// One sample more for each pixel.
    fn pass(&mut self) -> nearfield::Result<()>;

    /// The picture so far.
    fn film(&self) -> nearfield::Result<Cow<'_, Film>>;

    fn counters(&self) -> PathCounters;
}

/// The stages on the CPU; rays are cast wherever the structure is.
struct OnCpu<'a> {
    tracer: PathTracer<'a>,
    film: Film,
}

impl Tracer for OnCpu<'_> {
    fn pass(&mut self) -> nearfield::Result<()> {
        self.tracer.render_pass(&mut self.film)
    }

    fn film(&self) -> nearfield::Result<Cow<'_, Film>> {
        Ok(Cow::Borrowed(&self.film))
    }

    fn counters(&self) -> PathCounters {
        self.tracer.counters()
    }
}

impl<S: GpuRayStructure> Tracer for GpuPathTracer<'_, S> {
    fn pass(&mut self) -> nearfield::Result<()> {
        self.render_pass()
    }

    fn film(&self) -> nearfield::Result<Cow<'_, Film>> {
        self.film().map(Cow::Owned)
    }

    fn counters(&self) -> PathCounters {
        self.counters()
    }
}

/// Everything worth telling.
struct Told<'a> {
    args: &'a RenderArgs,
    triangles: u64,
    samples: u32,
    dropped: u64,
    counters: PathCounters,
    stages_on: &'static str,
    device: String,
    built: &'a Built,
    times: Times,
    notes: Vec<String>,
}

pub(crate) fn run(args: &RenderArgs, common: &Common) -> Result<(), Failure> {
    let plan = args.structure.plan(Structure::Auto)?.expecting(args.task());
    let format = args.check()?;
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let scene = args.source().read(common, &mut notes)?;
    times.read = milliseconds(clock);
    let pixels = u64::from(args.size.width) * u64::from(args.size.height);
    common.allow("the picture", 12 * pixels).map_err(Failure::Search)?;

    progress.step("building the structure");
    let built = Built::of(&scene.mesh, &args.structure, plan, &mut times, &mut notes, |_, _| Ok(()))
        .map_err(|error| failed(&args.input, error))?;
    let triangles = scene.mesh.triangles.len() as u64;
    let clock = Instant::now();
    let (mut tracer, stages_on) = args.tracer(scene, &built, &mut notes).map_err(Failure::Search)?;
    times.open += milliseconds(clock);
    drop(progress);

    let clock = Instant::now();
    let replaces = args.render(tracer.as_mut(), format, common)?;
    times.query = milliseconds(clock);
    let clock = Instant::now();
    let film = tracer.film().map_err(Failure::Search)?;
    render_picture::write(&args.output, &film, args.development(format, true), replaces)?;
    times.picture = milliseconds(clock);
    let samples = film.samples();
    let dropped = film.dropped();
    let told = Told {
        args,
        triangles,
        samples,
        dropped,
        counters: tracer.counters(),
        stages_on,
        device: built.rays.search().device(),
        built: &built,
        times,
        notes,
    };
    told.tell(common)?;
    if samples < args.spp {
        let what = format!("interrupted after {samples} of {} samples a pixel; the picture holds them", args.spp);
        return Err(Failure::Interrupted(what));
    }
    Ok(())
}

impl RenderArgs {
    /// Says what cannot work before the work is done.
    fn check(&self) -> Result<PictureFormat, Failure> {
        let format = PictureFormat::of(&self.output)?;
        if self.json && self.output == Path::new("-") {
            return Err(Failure::Usage("only one of --json and --output - can have standard output".into()));
        }
        if let Some(exposure) = self.exposure.filter(|exposure| !(exposure.is_finite() && *exposure > 0.0)) {
            return Err(Failure::Usage(format!("--exposure {exposure}: expected a finite number above 0")));
        }
        if !(self.every > 0.0 && self.every.is_finite()) {
            return Err(Failure::Usage(format!("--every {}: expected a finite number of seconds above 0", self.every)));
        }
        self.source().check()?;
        crate::output::check(&self.output, self.force)?;
        Ok(format)
    }

    /// What is rendered.
    fn source(&self) -> Source<'_> {
        Source { path: &self.input, up: self.up, size: self.size }
    }

    /// The rays that a structure is chosen for: a path of up to ten scatterings casts about five, those to lights included.
    fn task(&self) -> RayTask {
        const RAYS_OF_A_PATH: u64 = 5;
        let pixels = u64::from(self.size.width) * u64::from(self.size.height);
        RayTask::new(RAYS_OF_A_PATH * pixels * u64::from(self.spp))
    }

    fn development(&self, format: PictureFormat, is_last: bool) -> Development {
        let usual = if self.source().is_mesh() { ROOM_EXPOSURE } else { 1.0 };
        Development { format, exposure: self.exposure.unwrap_or(usual), is_last }
    }

    /// What adds samples, and where its stages run.
    fn tracer<'a>(
        &self,
        scene: Scene,
        built: &'a Built,
        notes: &mut Vec<String>,
    ) -> nearfield::Result<(Box<dyn Tracer + 'a>, &'static str)> {
        let settings = PathSettings { depth: self.depth, seed: self.seed, ..PathSettings::default() };
        let on_device: nearfield::Result<Option<Box<dyn Tracer + 'a>>> = match &built.rays {
            Rays::Cpu(_) => Ok(None),
            Rays::GpuBruteForce(structure) => self.on_gpu(&scene, structure, settings).map(Some),
            Rays::GpuKdTree(structure) => self.on_gpu(&scene, structure, settings).map(Some),
            Rays::GpuTriangleBvh(structure) => self.on_gpu(&scene, structure, settings).map(Some),
        };
        match on_device {
            Ok(Some(tracer)) => return Ok((tracer, "device")),
            Ok(None) => {}
            Err(error @ nearfield::Error::Unsupported { .. }) => {
                notes.push(format!("paths are followed on the CPU and rays cast on the device: {error}"));
            }
            Err(error) => return Err(error),
        }
        let search: &dyn RaySearch = built.rays.search();
        let film = Film::new(self.size.width, self.size.height)?;
        Ok((Box::new(OnCpu { tracer: PathTracer::new(scene, search, settings)?, film }), "cpu"))
    }

    /// A tracer whose stages run on the device. It casts the rays of a small picture first: devices that end long loops
    /// refuse some structures only then.
    fn on_gpu<'a, S: GpuRayStructure>(
        &self,
        scene: &Scene,
        structure: &'a S,
        settings: PathSettings,
    ) -> nearfield::Result<Box<dyn Tracer + 'a>> {
        GpuPathTracer::new(scene.clone(), structure, settings, 8, 8)?.render_pass()?;
        let (width, height) = (self.size.width, self.size.height);
        Ok(Box::new(GpuPathTracer::new(scene.clone(), structure, settings, width, height)?))
    }

    /// Adds samples until there are enough or the user wants to end; writes the picture now and then. Returns whether
    /// the next picture may replace a file: an earlier one of ours, or any by `--force`.
    fn render(&self, tracer: &mut dyn Tracer, format: PictureFormat, common: &Common) -> Result<bool, Failure> {
        interrupt::watch();
        let bar = CountBar::start(common, self.spp.into(), "samples");
        let (mut replaces, mut written) = (self.force, Instant::now());
        for sample in 1..=self.spp {
            tracer.pass().map_err(Failure::Search)?;
            let counters = tracer.counters();
            let speed = format!("{}, {}", samples_a_second(&counters), mrays(&counters));
            bar.show(sample.into(), &speed);
            if interrupt::asked() {
                break;
            }
            let due = written.elapsed().as_secs_f64() >= self.every;
            if due && sample < self.spp && self.output != Path::new("-") {
                let film = tracer.film().map_err(Failure::Search)?;
                // A disk that is full for a while costs this picture, not the samples.
                match render_picture::write(&self.output, &film, self.development(format, false), replaces) {
                    Ok(()) => replaces = true,
                    Err(failure) => bar.note(failure.message()),
                }
                written = Instant::now();
            }
        }
        Ok(replaces)
    }
}

fn samples_a_second(counters: &PathCounters) -> String {
    format!("{:.2} Msamples/s", counters.paths_a_second() * 1e-6)
}

fn mrays(counters: &PathCounters) -> String {
    format!("{:.2} Mrays/s", counters.mrays_a_second())
}

impl Told<'_> {
    fn tell(&self, common: &Common) -> Result<(), Failure> {
        if self.args.json {
            return report::print_json(&self.json());
        }
        if common.quiet {
            return Ok(());
        }
        if self.args.output == Path::new("-") {
            eprint!("{}", self.lines());
            return Ok(());
        }
        report::print(&self.lines())
    }

    fn json(&self) -> Value {
        json!({
            "scene": file_name(&self.args.input),
            "triangles": self.triangles,
            "width": self.args.size.width,
            "height": self.args.size.height,
            "samples": self.samples,
            "samples_asked": self.args.spp,
            "samples_dropped": self.dropped,
            "depth": self.args.depth,
            "seed": self.args.seed,
            "device": self.device,
            "stages_on": self.stages_on,
            "structure": self.built.json(),
            "paths": self.counters.paths,
            "rays": self.counters.rays,
            "shadow_rays": self.counters.shadow_rays,
            "paths_per_second": self.counters.paths_a_second(),
            "mrays_per_second": self.counters.mrays_a_second(),
            "seconds": rounded(self.counters.seconds),
            "milliseconds": self.times.json(),
            "notes": self.notes,
        })
    }

    fn lines(&self) -> String {
        let size = self.args.size;
        let mut rows = vec![
            ("scene", format!("{}, {} triangles", file_name(&self.args.input), grouped(self.triangles))),
            (
                "picture",
                format!(
                    "{} x {}, {} samples a pixel, depth {}",
                    size.width,
                    size.height,
                    grouped(self.samples.into()),
                    self.args.depth
                ),
            ),
            ("device", format!("{}, stages on the {}", self.device, self.stages_on)),
            ("structure", self.built.line()),
            ("rays", format!("{} and {} to lights", grouped(self.counters.rays), grouped(self.counters.shadow_rays))),
            ("speed", format!("{}, {}", samples_a_second(&self.counters), mrays(&self.counters))),
            ("time", self.times.line()),
        ];
        if self.dropped > 0 {
            rows.push(("note", format!("{} samples were not finite and are left out", grouped(self.dropped))));
        }
        rows.extend(self.notes.iter().map(|note| ("note", note.clone())));
        rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect()
    }
}
