//! `nearfield smooth`: points moved onto the smooth surface that they suggest.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::application::{
    GpuMlsProjection, GpuMlsSmoothing, Length, MlsPoints, MlsReport, PlaneSearch, PointFlags, Support,
};
use nearfield::geometry::{Attribute, Column};
use nearfield::gpu::DeviceChoice;
use nearfield::io::{Format, WriteOptions, write_atomically, write_cloud};
use nearfield::{
    AabbTreeN, AabbTreeNSettings, AabbTreeSettings, GpuAabbTree, MlsMethod, MlsProjection, MlsSettings, MlsSmoothing,
    PointCloud, Vec3,
};

use crate::exit::Failure;
use crate::fallback;
use crate::input::{Input, file_name, searchable};
use crate::interrupt;
use crate::options::{CloudOptions, Common, Framing};
use crate::output;
use crate::progress::{CountBar, Progress};
use crate::report::{Times, grouped, milliseconds};
use crate::smooth_picture::{self, Smoothed};
use crate::smooth_report::{self, Told};

const EXAMPLES: &str = "Examples:
  nearfield smooth scan.ply --method apss --radius 6x -o smooth.ply --picture smooth.png
  nearfield smooth scan.xyz --method pss --k 40 --iterations 5 -o smooth.xyz
  nearfield smooth scan.ply --method rimls --radius 1% --mode project -o sharp.ply

Methods: apss fits spheres, rimls and bilateral keep edges; these three need oriented normals, which `nearfield normals`
makes. pss fits a plane with a polynomial of --degree over it, jet one of degree 2 to the --k nearest; they need none.

In mode smooth all points move in every iteration and are what the next one is fitted to. In mode project the surface stays
that of the points as they were, and each point moves onto it until it rests. Number and order of the points stay; a point
that could not be moved is left where it was, and the attribute `flags` of the output says why (bits: few-neighbors 1,
degenerate 2, outside 4, limited 8, not-converged 16, invalid 32). Ctrl-C ends after the iteration that is under way, writes
what there is and exits with code 130.";

/// Smooth the points of a cloud by moving least squares
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct SmoothArgs {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// The surface that is fitted
    #[arg(long, value_name = "METHOD", default_value = "apss")]
    pub(crate) method: Method,

    /// Radius of the neighbourhood: a length such as 0.25, a part of the diagonal such as 1%, or spacings such as 6x [default: 6x]
    #[arg(long, value_name = "LENGTH", conflicts_with = "k")]
    pub(crate) radius: Option<Length>,

    /// Fit to the N nearest points, instead of those within a radius
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=1000))]
    pub(crate) k: Option<u32>,

    /// Iterations; in mode project the most steps of a point
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) iterations: u32,

    /// What the points are fitted to: each other as they move, or all as they were
    #[arg(long, value_name = "MODE", default_value = "smooth")]
    pub(crate) mode: Mode,

    /// Degree of the polynomial of pss, 0 to 3 [default: 2]
    #[arg(long, value_name = "N")]
    degree: Option<u8>,

    /// Find the plane of pss by the full search about each point's foot
    #[arg(long)]
    full: bool,

    /// Where to compute: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,

    /// The smoothed cloud, or - for standard output
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// Draw the cloud before and after, side by side, into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    #[command(flatten)]
    framing: Framing,

    #[command(flatten)]
    pub(crate) files: CloudOptions,
}

/// The surfaces by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Method {
    Apss,
    Pss,
    Rimls,
    Bilateral,
    Jet,
}

/// What points are fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Mode {
    Smooth,
    Project,
}

impl Mode {
    pub(crate) fn name(self) -> &'static str {
        if self == Self::Smooth { "smooth" } else { "project" }
    }
}

/// What moves points, wherever it runs.
trait Smoother {
    fn iterate(&mut self) -> nearfield::Result<MlsReport>;

    /// Whether further iterations change nothing.
    fn is_done(&self) -> bool {
        false
    }

    fn points(&self) -> nearfield::Result<MlsPoints>;
}

fn on_host(positions: &[[f32; 3]], normals: &[[f32; 3]], flags: &[PointFlags]) -> MlsPoints {
    let vectors = |from: &[[f32; 3]]| from.iter().map(|v| Vec3::from_array(*v)).collect();
    MlsPoints { positions: vectors(positions), normals: vectors(normals), mean_curvatures: None, flags: flags.to_vec() }
}

impl Smoother for MlsSmoothing<f32> {
    fn iterate(&mut self) -> nearfield::Result<MlsReport> {
        self.iterate()
    }

    fn points(&self) -> nearfield::Result<MlsPoints> {
        Ok(on_host(self.positions(), self.normals(), self.flags()))
    }
}

impl Smoother for MlsProjection<'_, f32> {
    fn iterate(&mut self) -> nearfield::Result<MlsReport> {
        self.iterate()
    }

    fn is_done(&self) -> bool {
        self.is_done()
    }

    fn points(&self) -> nearfield::Result<MlsPoints> {
        Ok(on_host(self.positions(), self.normals(), self.flags()))
    }
}

impl Smoother for GpuMlsSmoothing {
    fn iterate(&mut self) -> nearfield::Result<MlsReport> {
        self.iterate()
    }

    fn points(&self) -> nearfield::Result<MlsPoints> {
        self.points()
    }
}

impl Smoother for GpuMlsProjection<'_, GpuAabbTree> {
    fn iterate(&mut self) -> nearfield::Result<MlsReport> {
        self.iterate()
    }

    fn is_done(&self) -> bool {
        self.is_done()
    }

    fn points(&self) -> nearfield::Result<MlsPoints> {
        self.points()
    }
}

/// The points with what they are asked for.
struct Job<'a> {
    points: &'a [Vec3],
    /// The same for the CPU.
    arrays: &'a [[f32; 3]],
    normals: Option<&'a [Vec3]>,
    support: Support<'a, f32>,
    settings: MlsSettings,
    args: &'a SmoothArgs,
    common: &'a Common,
}

/// What came out.
struct Done {
    points: MlsPoints,
    reports: Vec<MlsReport>,
    interrupted: bool,
}

pub(crate) fn run(args: &SmoothArgs, common: &Common) -> Result<(), Failure> {
    let (to, settings) = (args.check()?, args.settings()?);
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let cloud = args.read(&settings, common, &mut notes)?;
    times.read = milliseconds(clock);

    progress.step("measuring the points");
    let clock = Instant::now();
    let arrays: Vec<[f32; 3]> = cloud.points.iter().map(Vec3::to_array).collect();
    let tree = AabbTreeN::build(&arrays, &AabbTreeNSettings::default()).map_err(Failure::Search)?;
    let support = match (args.k, args.radius) {
        (Some(k), _) => Support::Nearest(k),
        (None, length) => {
            let length = length.unwrap_or(DEFAULT_RADIUS);
            Support::Radius(length.resolve("radius", &tree).map_err(Failure::reading(&args.input))? as f32)
        }
    };
    times.build = milliseconds(clock);
    drop(progress);

    let clock = Instant::now();
    let job = Job {
        points: &cloud.points,
        arrays: &arrays,
        normals: cloud.normals.as_deref(),
        support,
        settings,
        args,
        common,
    };
    let on_device = fallback::on_gpu(&args.device, &mut notes, |gpu| Ok((gpu.name().to_owned(), job.on_gpu(gpu)?)));
    let (device, done) = match on_device.map_err(Failure::Search)? {
        Some(found) => found,
        None => ("cpu".to_owned(), job.on_cpu(&tree).map_err(Failure::Search)?),
    };
    times.query = milliseconds(clock);

    let smoothed = after(&cloud, &done.points);
    let clock = Instant::now();
    let options = WriteOptions { format: Some(to), force: args.files.force, ascii: args.files.formats.ascii };
    write_cloud(&args.output, &smoothed, &options).map_err(Failure::writing)?;
    times.write = milliseconds(clock);
    if let Some(path) = &args.picture {
        let clock = Instant::now();
        let shown = Smoothed {
            name: file_name(&args.input),
            before: &cloud.points,
            after: &smoothed.points,
            words: smooth_report::subtitle(args, &done.reports),
            up: args.framing.up,
        };
        let image = smooth_picture::draw(&shown, args.framing.size_for_two()).map_err(Failure::Search)?;
        write_atomically(path, args.files.force, |w| image.write_png(w)).map_err(Failure::writing)?;
        times.picture = milliseconds(clock);
    }
    let told = Told { args, support, points: cloud.len() as u64, reports: &done.reports, device, times, notes };
    told.tell(common, args.writes_to_stdout())?;
    if done.interrupted {
        let (made, all) = (done.reports.len(), args.iterations);
        let what = format!("interrupted after {made} of {all} iterations; the output holds what they gave");
        return Err(Failure::Interrupted(what));
    }
    Ok(())
}

/// The neighbourhood where none is asked for: some 28 neighbours on a surface sampled evenly.
const DEFAULT_RADIUS: Length = Length::Spacings(6.0);

impl SmoothArgs {
    /// Says what cannot work before the work is done; the format of the output.
    fn check(&self) -> Result<Format, Failure> {
        let stdout = |path: &Path| path == Path::new("-");
        let on_stdout = [self.files.json, stdout(&self.output), self.picture.as_deref().is_some_and(stdout)];
        if on_stdout.iter().filter(|uses| **uses).count() > 1 {
            return Err(Failure::Usage(
                "only one of --json, --output - and --picture - can have standard output".into(),
            ));
        }
        if let Some(path) = self.picture.as_deref().filter(|path| !stdout(path))
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
        {
            return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
        }
        let to = output::format(&self.output, self.files.formats.to)?;
        if !to.info().writes_cloud {
            return Err(Failure::Usage(format!("{to} is not written for points; `nearfield formats` lists what is")));
        }
        output::check(&self.output, self.files.force)?;
        self.picture.as_deref().map_or(Ok(()), |path| output::check(path, self.files.force))?;
        Ok(to)
    }

    fn writes_to_stdout(&self) -> bool {
        [Some(&self.output), self.picture.as_ref()].into_iter().flatten().any(|path| path.as_path() == Path::new("-"))
    }

    fn settings(&self) -> Result<MlsSettings, Failure> {
        if self.method != Method::Pss && (self.degree.is_some() || self.full) {
            let option = if self.full { "--full" } else { "--degree" };
            return Err(Failure::Usage(format!("{option} belongs to --method pss")));
        }
        let plane = if self.full { PlaneSearch::Full } else { PlaneSearch::Fast };
        let method = match self.method {
            Method::Apss => MlsMethod::APSS,
            Method::Pss => MlsMethod::Pss { degree: self.degree.unwrap_or(2), plane },
            Method::Rimls => MlsMethod::RIMLS,
            Method::Bilateral => MlsMethod::BILATERAL,
            Method::Jet => MlsMethod::Jet,
        };
        let settings = MlsSettings { most_steps: self.iterations, ..MlsSettings::new(method) };
        settings.validate().map_err(Failure::Search)?;
        Ok(settings)
    }

    /// The cloud, with normals where the method needs them.
    fn read(&self, settings: &MlsSettings, common: &Common, notes: &mut Vec<String>) -> Result<PointCloud, Failure> {
        let input = Input::open(&self.input, self.files.formats.format, common)?;
        if let Some(mesh) = input.mesh()? {
            let triangles = grouped(mesh.triangles.len() as u64);
            notes.push(format!("{triangles} triangles are left out, the vertices are smoothed"));
        }
        let cloud = searchable(input.cloud()?, &self.input, self.files.drop_invalid, notes)?;
        if cloud.normals.is_none() && settings.method.needs_normals() {
            let name = settings.method.name();
            let file = crate::exit::shown(&self.input);
            return Err(Failure::Usage(format!(
                "{file} has no normals, which --method {name} needs: make them with `nearfield normals {file} -o WITH-NORMALS.ply`, \
                 or use --method pss"
            )));
        }
        // Points, normals and states of both, and the tree.
        common.allow("smoothing", 200 * cloud.len() as u64).map_err(Failure::Search)?;
        Ok(cloud)
    }
}

impl Job<'_> {
    fn on_gpu(&self, gpu: &nearfield::Gpu) -> nearfield::Result<Done> {
        let (points, normals) = (self.points, self.normals);
        if self.args.mode == Mode::Smooth {
            return self.iterate(GpuMlsSmoothing::new(gpu, points, normals, &self.support, &self.settings)?);
        }
        let tree = GpuAabbTree::build(gpu, points, &AabbTreeSettings::default())?;
        self.iterate(GpuMlsProjection::new(&tree, normals, points, &self.support, &self.settings)?)
    }

    fn on_cpu(&self, tree: &AabbTreeN<f32, 3>) -> nearfield::Result<Done> {
        let normals: Option<Vec<[f32; 3]>> = self.normals.map(|normals| normals.iter().map(Vec3::to_array).collect());
        let (points, normals) = (self.arrays, normals.as_deref());
        if self.args.mode == Mode::Smooth {
            return self.iterate(MlsSmoothing::new(points, normals, &self.support, &self.settings)?);
        }
        self.iterate(MlsProjection::new(tree, normals, points, &self.support, &self.settings)?)
    }

    /// Iterates until all is done or the user wants to end, and tells each time.
    fn iterate(&self, mut smoother: impl Smoother) -> nearfield::Result<Done> {
        interrupt::watch();
        let bar = CountBar::start(self.common, self.args.iterations.into(), "iterations");
        let mut reports = Vec::new();
        for iteration in 1..=self.args.iterations {
            let report = smoother.iterate()?;
            bar.show(iteration.into(), &format!("mean move {:.3e}", report.mean_move));
            reports.push(report);
            if interrupt::asked() || smoother.is_done() {
                break;
            }
        }
        let interrupted = interrupt::asked() && reports.len() < self.args.iterations as usize && !smoother.is_done();
        Ok(Done { points: smoother.points()?, reports, interrupted })
    }
}

/// The cloud with the points moved: their new normals where it had any, and the flags where there are some.
fn after(cloud: &PointCloud, points: &MlsPoints) -> PointCloud {
    let mut after = PointCloud { points: points.positions.clone(), ..cloud.clone() };
    after.normals = cloud.normals.as_ref().map(|_| points.normals.clone());
    if points.flags.iter().any(|flags| !flags.is_empty()) {
        after.attributes.retain(|attribute| attribute.name != "flags");
        let values = Column::U8(points.flags.iter().map(|flags| flags.0 as u8).collect());
        after.attributes.push(Attribute { name: "flags".to_owned(), values });
    }
    after
}
