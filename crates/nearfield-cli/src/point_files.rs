//! What `filter`, `downsample` and `cluster` share: a cloud in, a cloud out, the watch over the work, and the report.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::application::{self, Length, Watch};
use nearfield::geometry::{Attribute, Column};
use nearfield::gpu::DeviceChoice;
use nearfield::io::{Format, WriteOptions, write_cloud};
use nearfield::{AabbTreeN, AabbTreeNSettings, Error, PointCloud, Vec3};
use serde_json::{Map, Value};

use crate::exit::Failure;
use crate::fallback;
use crate::input::{Input, searchable};
use crate::interrupt;
use crate::options::Common;
use crate::output;
use crate::progress::Progress;
use crate::report::{Times, grouped, milliseconds, print, print_json};

/// Files and formats of a command from points to points.
#[derive(Debug, Args)]
pub(crate) struct PointFiles {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    pub(crate) input: PathBuf,

    /// The cloud that is made, or - for standard output
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,

    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,

    /// Print everything as one JSON object
    #[arg(long)]
    pub(crate) json: bool,

    /// Format of the input, where its extension does not say it
    #[arg(long, value_name = "F")]
    format: Option<Format>,

    /// Format of the output, where its extension does not say it
    #[arg(long, value_name = "F", requires = "output")]
    to: Option<Format>,

    /// Write PLY as text
    #[arg(long)]
    ascii: bool,

    /// Replace files that exist
    #[arg(long)]
    pub(crate) force: bool,
}

impl PointFiles {
    /// Says what cannot work before the work is done.
    ///
    /// - `picture`: another output
    pub(crate) fn check(&self, picture: Option<&Path>) -> Result<(), Failure> {
        let stdout = |path: Option<&Path>| path == Some(Path::new("-"));
        let on_stdout = [self.json, stdout(self.output.as_deref()), stdout(picture)];
        if on_stdout.iter().filter(|uses| **uses).count() > 1 {
            let text = "only one of --json, --output - and --picture - can have standard output";
            return Err(Failure::Usage(text.into()));
        }
        if let Some(path) = picture {
            if !stdout(picture) && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
                return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
            }
            output::check(path, self.force)?;
        }
        let Some(path) = &self.output else { return Ok(()) };
        let to = output::format(path, self.to)?;
        if !to.info().writes_cloud {
            return Err(Failure::Usage(format!("{to} is not written for points; `nearfield formats` lists what is")));
        }
        output::check(path, self.force)
    }

    /// The cloud.
    ///
    /// - `bytes_a_point`: memory that the work takes beside it
    pub(crate) fn read(&self, job: &mut Job<'_>, bytes_a_point: u64) -> Result<PointCloud, Failure> {
        let clock = Instant::now();
        job.progress.step(format!("reading {}", self.input.display()));
        let input = Input::open(&self.input, self.format, job.common)?;
        if let Some(mesh) = input.mesh()? {
            let triangles = grouped(mesh.triangles.len() as u64);
            job.notes.push(format!("{triangles} triangles are left out, the vertices are taken as points"));
        }
        let cloud = searchable(input.cloud()?, &self.input, self.drop_invalid, &mut job.notes)?;
        job.common.allow("the work on the points", bytes_a_point * cloud.len() as u64).map_err(Failure::Search)?;
        job.times.read = milliseconds(clock);
        Ok(cloud)
    }

    /// Writes the cloud, where one is asked for.
    pub(crate) fn write(&self, job: &mut Job<'_>, cloud: &PointCloud) -> Result<(), Failure> {
        let Some(path) = &self.output else { return Ok(()) };
        let clock = Instant::now();
        job.progress.step(format!("writing {}", path.display()));
        let format = Some(output::format(path, self.to)?);
        let options = WriteOptions { format, force: self.force, ascii: self.ascii };
        write_cloud(path, cloud, &options).map_err(Failure::writing)?;
        job.times.write = milliseconds(clock);
        Ok(())
    }
}

/// The work on one cloud, as the user sees it.
pub(crate) struct Job<'a> {
    pub(crate) common: &'a Common,
    pub(crate) progress: Progress,
    pub(crate) notes: Vec<String>,
    pub(crate) times: Times,
    /// What did the work.
    pub(crate) device: String,
}

impl<'a> Job<'a> {
    pub(crate) fn start(common: &'a Common) -> Self {
        interrupt::watch();
        let progress = Progress::start(common, "starting");
        Self { common, progress, notes: vec![], times: Times::default(), device: "cpu".to_owned() }
    }

    /// Runs the work on the CPU.
    pub(crate) fn on_cpu<T>(
        &mut self,
        work: impl FnOnce(&mut Watch<'_>) -> nearfield::Result<T>,
    ) -> Result<T, Failure> {
        let clock = Instant::now();
        let made = watched(&self.progress, work).map_err(failure)?;
        self.times.query = milliseconds(clock);
        Ok(made)
    }

    /// Runs the work on the GPU that was chosen, else on the CPU.
    pub(crate) fn on_device<T>(
        &mut self,
        device: &DeviceChoice,
        on_gpu: impl FnOnce(&nearfield::Gpu, &mut Watch<'_>) -> nearfield::Result<T>,
        on_cpu: impl FnOnce(&mut Watch<'_>) -> nearfield::Result<T>,
    ) -> Result<T, Failure> {
        let (clock, progress) = (Instant::now(), &self.progress);
        let named = |gpu: &nearfield::Gpu| Ok((watched(progress, |watch| on_gpu(gpu, watch))?, gpu.name().to_owned()));
        if let Some((made, name)) = fallback::on_gpu(device, &mut self.notes, named).map_err(failure)? {
            self.times.query = milliseconds(clock);
            self.device = name;
            return Ok(made);
        }
        self.on_cpu(on_cpu)
    }

    /// Tells rows of names and values, or one JSON object.
    ///
    /// - `to_stderr`: another output has standard output
    pub(crate) fn tell(
        self,
        files: &PointFiles,
        to_stderr: bool,
        mut rows: Vec<(&'static str, String)>,
        mut object: Map<String, Value>,
    ) -> Result<(), Failure> {
        drop(self.progress);
        if files.json {
            object.insert("device".into(), self.device.into());
            object.insert("milliseconds".into(), self.times.json());
            object.insert("notes".into(), self.notes.into());
            return print_json(&Value::Object(object));
        }
        if self.common.quiet {
            return Ok(());
        }
        rows.push(("device", self.device));
        rows.push(("time", self.times.line()));
        rows.extend(self.notes.into_iter().map(|note| ("note", note)));
        let text: String = rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect();
        if to_stderr || files.output.as_deref() == Some(Path::new("-")) {
            eprint!("{text}");
            return Ok(());
        }
        print(&text)
    }
}

/// Runs `work` with a watch that shows how far it is and ends it where the user wants that.
fn watched<T>(progress: &Progress, work: impl FnOnce(&mut Watch<'_>) -> nearfield::Result<T>) -> nearfield::Result<T> {
    let mut tell = |at: application::Progress| {
        let percent = (100 * at.done).checked_div(at.total).unwrap_or(100);
        progress.step(format!("{}, {percent} %", at.stage));
        if interrupt::asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    work(&mut Watch::new(&mut tell))
}

fn failure(error: Error) -> Failure {
    match error {
        Error::Interrupted { .. } => Failure::Interrupted(format!("{error}; nothing was written")),
        other => Failure::Search(other),
    }
}

/// The points as the CPU takes them.
pub(crate) fn arrays(points: &[Vec3]) -> Vec<[f32; 3]> {
    points.iter().map(Vec3::to_array).collect()
}

/// A length in the unit of the points; only relative ones look at them.
pub(crate) fn resolved(length: Length, setting: &'static str, points: &[[f32; 3]]) -> Result<f64, Failure> {
    if let Length::Absolute(length) = length
        && length > 0.0
    {
        return Ok(length);
    }
    let tree = AabbTreeN::build(points, &AabbTreeNSettings::default()).map_err(Failure::Search)?;
    length.resolve(setting, &tree).map_err(Failure::Search)
}

/// Adds an attribute to a cloud, in place of one of that name.
pub(crate) fn set_attribute(cloud: &mut PointCloud, name: &str, values: Column) {
    cloud.attributes.retain(|attribute| attribute.name != name);
    cloud.attributes.push(Attribute { name: name.to_owned(), values });
}
