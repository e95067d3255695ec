//! `nearfield heatmap`: how much work each pixel's ray takes in a structure over a mesh.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::io::{Format, Polygons};
use nearfield::query::{Clock, Stage};
use nearfield::{HitRecord, Ray, RayTask, RayWork, TriMesh, Vec3};
use rayon::prelude::*;

use crate::exit::Failure;
use crate::heatmap_report::Summary;
use crate::input::{Input, file_name};
use crate::options::{Common, PictureSize};
use crate::picture::{self, Camera, Colors, Up};
use crate::progress::Progress;
use crate::ray_structure::{Built, Structure, StructureArgs, failed};
use crate::report::{self, Times, milliseconds};
use crate::{heatmap_picture, heatmap_report};

const EXAMPLES: &str = "Examples:
  nearfield heatmap bunny.obj --leaf 200 -o leaves.png
  nearfield heatmap bunny.obj --structure triangle-bvh --metric node-visits --colors perceptual -o boxes.png --csv boxes.csv

One ray goes through the centre of each pixel of --size, from a camera that has all of the mesh in view; the closest hit is
searched. The picture has one pixel a ray, title and legend around them. Colours go from 0 to the largest value.

triangle-tests counts triangles tested, node-visits inner nodes of a tree passed or boxes of a hierarchy tested, leaf-visits
leaves entered, rope-steps ropes followed from leaf to leaf. `touched` pixels are those with a count above 0.

--csv writes one row a pixel, row by row from the upper left: x, y, triangle (empty where none is hit), t (in units of the
mesh), triangle_tests, node_visits, leaf_visits, rope_steps.

--corners three reads the first three corners of each face and leaves the rest of it away, as Accel did: a file of quads
gives a mesh with holes.";

/// Draw the work of each pixel's ray, as triangle tests or steps through a tree
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct HeatmapArgs {
    /// A mesh: PLY, OBJ or STL, or - for standard input
    input: PathBuf,

    #[command(flatten)]
    structure: StructureArgs,

    /// What is counted
    #[arg(long, value_name = "M", default_value = "triangle-tests")]
    metric: Metric,

    /// Rays across and down
    #[arg(long, value_name = "WxH", default_value = "750x750")]
    size: PictureSize,

    /// The scale: accel is green for 0 and red for the most, perceptual dark violet to yellow
    #[arg(long, value_name = "C", default_value = "accel")]
    colors: Scheme,

    /// The direction that is up in the picture [default: guessed from the shape]
    #[arg(long, value_name = "AXIS")]
    up: Option<Up>,

    /// Corners of faces that are read
    #[arg(long, value_name = "C", default_value = "all")]
    corners: Corners,

    /// The picture to write: OUT.png, or - for standard output
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// Write the numbers too, one row a pixel
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,

    /// Print everything as one JSON object
    #[arg(long)]
    json: bool,

    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Replace files that exist
    #[arg(long)]
    force: bool,
}

/// What is counted; the number is its place in the four counters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Metric {
    TriangleTests,
    NodeVisits,
    LeafVisits,
    RopeSteps,
}

impl Metric {
    /// All, in the order of [`RayWork`].
    pub(crate) const ALL: [Self; 4] = [Self::TriangleTests, Self::NodeVisits, Self::LeafVisits, Self::RopeSteps];

    /// Its name in words.
    pub(crate) fn name(self) -> &'static str {
        ["triangle tests", "node visits", "leaf visits", "rope steps"][self as usize]
    }

    /// A name that fits above the colour bar.
    pub(crate) fn short(self) -> &'static str {
        ["tests", "node visits", "leaf visits", "rope steps"][self as usize]
    }

    fn of(self, work: &RayWork) -> u32 {
        [work.triangle_tests, work.node_visits, work.leaf_visits, work.rope_steps][self as usize]
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Scheme {
    Accel,
    Perceptual,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Corners {
    All,
    Three,
}

/// Everything worth telling about a heat map.
pub(crate) struct Heatmap {
    pub(crate) name: String,
    pub(crate) triangles: u64,
    pub(crate) metric: Metric,
    pub(crate) size: PictureSize,
    pub(crate) built: Built,
    pub(crate) device: String,
    /// [rays], row by row from the upper left.
    pub(crate) records: Vec<HitRecord>,
    /// [rays]
    pub(crate) work: Vec<RayWork>,
    /// A metric each.
    pub(crate) summaries: [Summary; 4],
    pub(crate) stages: Vec<Stage>,
    pub(crate) times: Times,
    pub(crate) notes: Vec<String>,
}

impl Heatmap {
    /// [rays] the counts of a metric.
    pub(crate) fn values(&self, metric: Metric) -> impl Iterator<Item = u32> + '_ {
        self.work.iter().map(move |work| metric.of(work))
    }

    /// Milliseconds of casting on the device's own clock, where it has one.
    pub(crate) fn device_ms(&self) -> Option<f64> {
        let on_device = |stage: &&Stage| stage.clock == Clock::Device;
        let sum: f64 = self.stages.iter().filter(on_device).map(|stage| stage.milliseconds).sum();
        (sum > 0.0).then_some(sum)
    }
}

pub(crate) fn run(args: &HeatmapArgs, common: &Common) -> Result<(), Failure> {
    let plan = args.structure.plan(Structure::KdTree)?;
    args.check_outputs()?;
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let polygons = if args.corners == Corners::Three { Polygons::FirstThree } else { Polygons::Fans };
    let mesh = Input::open(&args.input, args.format, common)?.surface(polygons)?;
    times.read = milliseconds(clock);
    let rays = u64::from(args.size.width) * u64::from(args.size.height);
    let each = (size_of::<Ray>() + size_of::<HitRecord>() + size_of::<RayWork>()) as u64;
    common.allow("rays and their work", rays * each).map_err(Failure::Search)?;

    progress.step("building the structure");
    let task = RayTask::new(rays);
    let plan = plan.expecting(if args.metric == Metric::RopeSteps { task.with_ropes() } else { task });
    let warm = |search: &dyn nearfield::RaySearch, rays: &[Ray]| search.closest_hits_with_work(rays).map(drop);
    let built = Built::of(&mesh, &args.structure, plan, &mut times, &mut notes, warm)
        .map_err(|error| failed(&args.input, error))?;
    let rays = args.rays(&mesh);
    progress.step("casting rays");
    let clock = Instant::now();
    let (hits, work) = built.rays.search().closest_hits_with_work(&rays).map_err(Failure::Search)?;
    times.query = milliseconds(clock);
    progress.step("counting");
    let summaries = Metric::ALL.map(|metric| Summary::of(work.iter().map(|work| metric.of(work)).collect()));
    let mut map = Heatmap {
        name: file_name(&args.input),
        triangles: mesh.triangles.len() as u64,
        metric: args.metric,
        size: args.size,
        device: built.rays.search().device(),
        built,
        records: hits.records().to_vec(),
        work,
        summaries,
        stages: hits.report.stages,
        times,
        notes,
    };
    progress.step(format!("drawing {}", args.output.display()));
    let clock = Instant::now();
    let colors = if args.colors == Scheme::Accel { Colors::GreenRed } else { Colors::Perceptual };
    let image = heatmap_picture::draw(&map, colors);
    nearfield::io::write_atomically(&args.output, args.force, |w| image.write_png(w)).map_err(Failure::writing)?;
    map.times.picture = milliseconds(clock);
    if let Some(path) = &args.csv {
        progress.step(format!("writing {}", path.display()));
        let clock = Instant::now();
        nearfield::io::write_atomically(path, args.force, |w| heatmap_report::write_csv(&map, w))
            .map_err(Failure::writing)?;
        map.times.write = milliseconds(clock);
    }
    drop(progress);
    args.tell(&map, common)
}

impl HeatmapArgs {
    /// Says what cannot work before the work is done.
    fn check_outputs(&self) -> Result<(), Failure> {
        let stdout = Path::new("-");
        let to_stdout = [self.json, self.output == stdout, self.csv.as_deref() == Some(stdout)];
        if to_stdout.into_iter().filter(|&to| to).count() > 1 {
            return Err(Failure::Usage("only one of --json, --output - and --csv - can have standard output".into()));
        }
        let is = |path: &Path, extension| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension));
        if self.output != stdout && !is(&self.output, "png") {
            return Err(Failure::Usage(format!("--output {}: pictures are written as .png", self.output.display())));
        }
        if let Some(path) = self.csv.as_deref() {
            if path != stdout && !is(path, "csv") {
                return Err(Failure::Usage(format!("--csv {}: the table is written as .csv", path.display())));
            }
            crate::output::check(path, self.force)?;
        }
        crate::output::check(&self.output, self.force)
    }

    /// A ray through the centre of each pixel, row by row from the upper left.
    fn rays(&self, mesh: &TriMesh) -> Vec<Ray> {
        let corners: Vec<Vec3> = mesh.triangles.iter().flatten().map(|&v| mesh.vertices[v as usize]).collect();
        let format = self.format.or_else(|| Format::from_path(&self.input).ok());
        let modelling = matches!(format, Some(Format::Obj | Format::Ply));
        let extent = nearfield::Aabb::of_points(&corners).extent();
        let up = self.up.unwrap_or_else(|| picture::likely_up(extent, modelling));
        let camera = Camera::filled(&corners, up, self.size.width, self.size.height);
        let width = self.size.width as usize;
        let ray = |i: usize| {
            let (origin, direction) = camera.ray((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            Ray::new(origin.as_vec3(), direction.as_vec3())
        };
        (0..width * self.size.height as usize).into_par_iter().with_min_len(4096).map(ray).collect()
    }

    fn tell(&self, map: &Heatmap, common: &Common) -> Result<(), Failure> {
        if self.json {
            return report::print_json(&heatmap_report::json(map));
        }
        if common.quiet {
            return Ok(());
        }
        let lines = heatmap_report::lines(map);
        if [Some(&self.output), self.csv.as_ref()].into_iter().flatten().any(|path| path == Path::new("-")) {
            eprint!("{lines}");
            return Ok(());
        }
        report::print(&lines)
    }
}
