//! `nearfield resample`: a few samples, evenly on the surface that many noisy points suggest.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::application::{Length, Snap, WlopSettings, WlopStart, WlopVariant};
use nearfield::gpu::DeviceChoice;
use nearfield::io::{Format, WriteOptions, write_atomically, write_cloud};
use nearfield::{AabbTreeN, AabbTreeNSettings, GpuWlop, PointCloud, Vec3, Wlop};

use crate::exit::{Failure, shown};
use crate::fallback;
use crate::input::{Input, file_name, searchable};
use crate::options::{CloudOptions, Common, Framing};
use crate::output;
use crate::progress::Progress;
use crate::report::{Times, grouped, milliseconds};
use crate::resample_report::Told;
use crate::resample_work::{Done, output_cloud, resample, watched};
use crate::smooth_picture::{self, Smoothed};

const EXAMPLES: &str = "Examples:
  nearfield resample scan.ply --count 20000 -o even.ply --picture even.png
  nearfield resample scan.xyz --count 5000 --radius 2% --drop-unattracted -o even.xyz
  nearfield resample oriented.ply --count 20000 --snap apss -o even.ply

The samples are random points at first (--seed). Each is then drawn to the points around it and pushed away by the other
samples, until they move less than a thousandth of their spacing on average. Variants: best is accurate and even; paper is
as published (Huang 2009), authors as in its authors' later program, cgal as in CGAL 5.5. The radius is the paper's h for
paper and best, and half of that for the others; where it is small for the noise of the points, a note says so.

Samples on outliers keep near them: the attribute `flags` of the output tells them (bits: few-neighbors 1,
no-attraction 64), and --drop-unattracted leaves them out. Ctrl-C ends after the iterations that are under way, writes what
there is and exits with code 130.";

/// Resample a cloud evenly by locally optimal projection
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct ResampleArgs {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// Number of samples
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) count: u32,

    /// The formula that moves the samples
    #[arg(long, value_name = "VARIANT", default_value = "best")]
    variant: Variant,

    /// How far samples see: a length such as 0.25, a part of the diagonal such as 2%, or spacings of the samples such as 12x [default:
    /// by the variant]
    #[arg(long, value_name = "LENGTH")]
    radius: Option<Length>,

    /// Most iterations [default: 100, of cgal 35]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,

    /// Part of the repulsion that is taken, 0 to 0.5 [default: 0.45, of authors 0.5]
    #[arg(long, value_name = "PART")]
    mu: Option<f64>,

    /// Chooses the first samples
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,

    /// Move the samples at the end to the nearest points, or onto their algebraic spheres, which takes oriented normals
    #[arg(long, value_name = "TO")]
    pub(crate) snap: Option<SnapTo>,

    /// Leave out samples that no points attract
    #[arg(long)]
    drop_unattracted: bool,

    /// Where to compute: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,

    /// The samples, or - for standard output
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,

    /// Draw the points and the samples, side by side, into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    #[command(flatten)]
    framing: Framing,

    #[command(flatten)]
    pub(crate) files: CloudOptions,
}

/// The variants by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Variant {
    Best,
    Paper,
    Authors,
    Cgal,
}

/// Where samples go at the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum SnapTo {
    Nearest,
    Apss,
}

pub(crate) fn run(args: &ResampleArgs, common: &Common) -> Result<(), Failure> {
    let (to, settings) = (args.check()?, args.settings()?);
    let (mut times, mut notes) = (Times::default(), Vec::new());
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let cloud = args.read(common, &mut notes)?;
    times.read = milliseconds(clock);

    progress.step("building the tree");
    let clock = Instant::now();
    let points: Vec<[f32; 3]> = cloud.points.iter().map(Vec3::to_array).collect();
    let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default()).map_err(Failure::Search)?;
    times.build = milliseconds(clock);
    drop(progress);

    let clock = Instant::now();
    let start = WlopStart::Random { count: args.count as usize, seed: args.seed };
    let words = "choosing the first samples";
    let on_gpu = |gpu: &nearfield::Gpu| {
        let wlop = watched(common, words, |watch| GpuWlop::new(gpu, &cloud.points, &start, &settings, watch))?;
        Ok((gpu.name().to_owned(), resample(&tree, wlop.radius(), wlop, &settings, common)?))
    };
    let on_cpu = || {
        let wlop = watched(common, words, |watch| Wlop::new(&tree, &start, &settings, watch))?;
        resample(&tree, wlop.radius(), wlop, &settings, common)
    };
    let (device, mut done) = match fallback::on_gpu(&args.device, &mut notes, on_gpu).map_err(wrong_question)? {
        Some(found) => found,
        None => ("cpu".to_owned(), on_cpu().map_err(wrong_question)?),
    };
    notes.append(&mut done.notes);
    let unattracted = done.samples.unattracted();
    if args.drop_unattracted {
        done.samples.keep_attracted();
    }
    let snapped = args.snapped((&tree, &cloud), &settings, &mut done, &mut notes, common)?;
    times.query = milliseconds(clock);

    let clock = Instant::now();
    let resampled = output_cloud(&cloud, &done.samples);
    let options = WriteOptions { format: Some(to), force: args.files.force, ascii: args.files.formats.ascii };
    write_cloud(&args.output, &resampled, &options).map_err(Failure::writing)?;
    times.write = milliseconds(clock);
    let told = Told {
        args,
        settings: &settings,
        points: cloud.len() as u64,
        done: &done,
        unattracted,
        snapped,
        noise: done.noise,
        device,
        times,
        notes,
    };
    let picture = args.draw(&cloud, &resampled, &told.subtitle())?;
    told.with_picture(picture).tell(common)?;
    if done.interrupted {
        let (made, all) = (done.reports.len(), settings.iterations);
        let what = format!("interrupted after {made} of {all} iterations; the output holds what they gave");
        return Err(Failure::Interrupted(what));
    }
    Ok(())
}

/// What cannot be asked of these points is the question's fault; who ends the work before the iterations gets nothing.
fn wrong_question(error: nearfield::Error) -> Failure {
    match error {
        nearfield::Error::InvalidSetting { .. } => Failure::Usage(error.to_string()),
        nearfield::Error::Interrupted { .. } => Failure::Interrupted(format!("{error}; nothing was written")),
        other => Failure::Search(other),
    }
}

impl ResampleArgs {
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

    pub(crate) fn writes_to_stdout(&self) -> bool {
        [Some(&self.output), self.picture.as_ref()].into_iter().flatten().any(|path| path.as_path() == Path::new("-"))
    }

    fn settings(&self) -> Result<WlopSettings, Failure> {
        let settings = WlopSettings::new(match self.variant {
            Variant::Best => WlopVariant::Best,
            Variant::Paper => WlopVariant::Paper,
            Variant::Authors => WlopVariant::Authors,
            Variant::Cgal => WlopVariant::Cgal,
        });
        let settings = WlopSettings {
            radius: self.radius,
            mu: self.mu.unwrap_or(settings.mu),
            iterations: self.iterations.unwrap_or(settings.iterations),
            ..settings
        };
        settings.validate().map_err(Failure::Search)?;
        Ok(settings)
    }

    /// The cloud, with normals where they are needed.
    fn read(&self, common: &Common, notes: &mut Vec<String>) -> Result<PointCloud, Failure> {
        let input = Input::open(&self.input, self.files.formats.format, common)?;
        if let Some(mesh) = input.mesh()? {
            let triangles = grouped(mesh.triangles.len() as u64);
            notes.push(format!("{triangles} triangles are left out, the vertices are resampled"));
        }
        let cloud = searchable(input.cloud()?, &self.input, self.files.drop_invalid, notes)?;
        if cloud.normals.is_none() && self.snap == Some(SnapTo::Apss) {
            let file = shown(&self.input);
            return Err(Failure::Usage(format!(
                "{file} has no normals, which --snap apss needs: make them with `nearfield normals {file} -o WITH-NORMALS.ply`, or \
                 use --snap nearest"
            )));
        }
        // Points and weights of both sides and the trees.
        common.allow("resampling", 120 * cloud.len() as u64).map_err(Failure::Search)?;
        Ok(cloud)
    }

    /// Snaps the samples where that is asked for, unless the user wants to end; the mean length of their moves.
    fn snapped(
        &self,
        (tree, cloud): (&AabbTreeN<f32, 3>, &PointCloud),
        settings: &WlopSettings,
        done: &mut Done,
        notes: &mut Vec<String>,
        common: &Common,
    ) -> Result<Option<f64>, Failure> {
        let Some(to) = self.snap else { return Ok(None) };
        let normals: Vec<[f32; 3]> = match &cloud.normals {
            Some(normals) if to == SnapTo::Apss => normals.iter().map(Vec3::to_array).collect(),
            _ => Vec::new(),
        };
        let radius = 2.0 * settings.variant.width(done.radius.into()) as f32;
        let snap = match to {
            SnapTo::Nearest => Snap::Nearest,
            SnapTo::Apss => Snap::Apss { normals: &normals, radius },
        };
        match watched(common, "snapping", |watch| done.samples.snap(tree, snap, watch)) {
            Ok(moved) => Ok(Some(moved)),
            Err(nearfield::Error::Interrupted { .. }) => {
                done.interrupted = true;
                notes.push("interrupted before the samples were snapped".to_owned());
                Ok(None)
            }
            Err(error) => Err(Failure::Search(error)),
        }
    }

    /// Draws points and samples where that is asked for; the time of it.
    fn draw(&self, cloud: &PointCloud, resampled: &PointCloud, words: &str) -> Result<f64, Failure> {
        let Some(path) = &self.picture else { return Ok(0.0) };
        let clock = Instant::now();
        let shown = Smoothed {
            name: file_name(&self.input),
            before: &cloud.points,
            after: &resampled.points,
            words: words.to_owned(),
            up: self.framing.up,
        };
        let image = smooth_picture::draw(&shown, self.framing.size_for_two()).map_err(Failure::Search)?;
        write_atomically(path, self.files.force, |w| image.write_png(w)).map_err(Failure::writing)?;
        Ok(milliseconds(clock))
    }
}

impl SnapTo {
    pub(crate) fn name(self) -> &'static str {
        if self == Self::Nearest { "the nearest points" } else { "algebraic spheres" }
    }
}
