//! `nearfield sort`: the points of a cloud in the order of a space-filling curve.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::curve::{mean_jump, order_in, order_in_plane};
use nearfield::io::{Format, WriteOptions, write_atomically, write_cloud};
use nearfield::{Curve, Domain, PointCloud};
use serde_json::json;

use crate::exit::Failure;
use crate::info;
use crate::input::{Input, searchable};
use crate::options::{Common, PictureSize, SummaryOptions};
use crate::output;
use crate::picture::Up;
use crate::progress::Progress;
use crate::report::{grouped, print, print_json, shown_ms};
use crate::sort_picture::{self, Sorted};

/// Put the points of a cloud in the order of a space-filling curve
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nearfield sort scan.laz --curve hilbert -o sorted.ply
  nearfield sort ten.xyz --picture curve.png

Points that follow each other in the file then lie close together in space. The curve runs through a cube at the
smallest corner of the points, with 2^21 cells along each axis; points of one cell keep their order. Points in a plane
across an axis follow the curve in two dimensions. Colours, normals and all attributes move with their points. Pictures of up to 500 points show their numbers.")]
pub(crate) struct SortArgs {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// The curve: morton (z-order) or hilbert
    #[arg(long, value_name = "CURVE", default_value = "morton")]
    curve: Curve,

    /// Write the sorted cloud, or - for standard output
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Draw the path from point to point into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "1600x1000", requires = "picture")]
    picture_size: PictureSize,

    /// The direction that is up in pictures of many points [default: guessed from the shape]
    #[arg(long, value_name = "AXIS", requires = "picture")]
    up: Option<Up>,

    #[command(flatten)]
    files: SummaryOptions,
}

pub(crate) fn run(args: &SortArgs, common: &Common) -> Result<(), Failure> {
    let to = args.check_outputs()?;
    let mut notes = vec![];
    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let input = Input::open(&args.input, args.files.format, common)?;
    if let (Some(_), Some(mesh)) = (to, input.mesh()?) {
        let triangles = grouped(mesh.triangles.len() as u64);
        notes.push(format!("{triangles} triangles are left out, the vertices are sorted"));
    }
    let cloud = searchable(input.cloud()?, &args.input, args.files.drop_invalid, &mut notes)?;
    // Keys, indices and the sort's second copy of both.
    common.allow("the order of the points", 24 * cloud.len() as u64).map_err(Failure::Search)?;

    progress.step("sorting");
    let clock = Instant::now();
    let domain = Domain::of_bounds(&cloud.bounds());
    let plane = sort_picture::plane(&cloud.points);
    let order = match plane {
        Some(axes) => order_in_plane(&cloud.points, args.curve, &domain, axes),
        None => order_in(&cloud.points, args.curve, &domain),
    };
    let order = order.map_err(Failure::Search)?;
    let milliseconds = clock.elapsed().as_secs_f64() * 1e3;
    let sorted = cloud.reordered(&order).map_err(Failure::Search)?;
    let jumps = [mean_jump(&cloud.points), mean_jump(&sorted.points)];

    if let (Some(path), Some(format)) = (&args.output, to) {
        progress.step(format!("writing {}", path.display()));
        let options = WriteOptions { format: Some(format), force: args.files.force, ascii: args.files.ascii };
        write_cloud(path, &sorted, &options).map_err(Failure::writing)?;
    }
    if let Some(path) = &args.picture {
        progress.step(format!("drawing {}", path.display()));
        let name = args.input.file_name().unwrap_or(args.input.as_os_str()).to_string_lossy().into_owned();
        let shown = Sorted { name, curve: args.curve, domain, points: &sorted.points, jumps, up: args.up };
        let image = sort_picture::draw(&shown, args.picture_size);
        write_atomically(path, args.files.force, |w| image.write_png(w)).map_err(Failure::writing)?;
    }
    drop(progress);
    let dimensions = if plane.is_some() { 2 } else { 3 };
    args.tell(&Summary { cloud: &sorted, domain, dimensions, jumps, milliseconds, notes }, common)
}

/// What is worth saying.
struct Summary<'a> {
    cloud: &'a PointCloud,
    domain: Domain,
    dimensions: u32,
    jumps: [f64; 2],
    milliseconds: f64,
    notes: Vec<String>,
}

impl SortArgs {
    /// Says what cannot work before the work is done; the format of the output, where there is one.
    fn check_outputs(&self) -> Result<Option<Format>, Failure> {
        let stdout = |path: &Option<PathBuf>| path.as_deref() == Some(Path::new("-"));
        let to_stdout =
            usize::from(self.files.json) + usize::from(stdout(&self.output)) + usize::from(stdout(&self.picture));
        if to_stdout > 1 {
            return Err(Failure::Usage(
                "only one of --json, --output - and --picture - can have standard output".into(),
            ));
        }
        if let Some(path) = self.picture.as_deref().filter(|p| *p != Path::new("-"))
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
        {
            return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
        }
        let to = self.output.as_deref().map(|path| output::format(path, self.files.to)).transpose()?;
        if let Some(to) = to.filter(|to| !to.info().writes_cloud) {
            return Err(Failure::Usage(format!("{to} is not written for points; `nearfield formats` lists what is")));
        }
        for path in [&self.output, &self.picture].into_iter().flatten() {
            output::check(path, self.files.force)?;
        }
        Ok(to)
    }

    fn tell(&self, summary: &Summary<'_>, common: &Common) -> Result<(), Failure> {
        let origin = summary.cloud.origin + summary.domain.origin().as_dvec3();
        let points = summary.cloud.len() as u64;
        if self.files.json {
            return print_json(&json!({
                "points": points,
                "curve": self.curve.name(),
                "dimensions": summary.dimensions,
                "domain_origin": origin.to_array(),
                "domain_edge": summary.domain.edge(),
                "mean_jump_before": summary.jumps[0],
                "mean_jump_after": summary.jumps[1],
                "milliseconds": { "sort": (summary.milliseconds * 1e3).round() / 1e3 },
                "notes": summary.notes,
            }));
        }
        let [before, after] = summary.jumps.map(|jump| jump as f32);
        let decimals = info::decimals(summary.cloud);
        let corner = origin.to_array().map(|v| info::shortest(v, decimals)).join(" ");
        let mut rows = vec![
            ("points", grouped(points)),
            ("curve", format!("{} in {} dimensions", self.curve, summary.dimensions)),
            ("domain", format!("cube of {} at {corner}", summary.domain.edge())),
            ("mean jump", format!("{before} before, {after} after")),
            ("time", format!("sort {}", shown_ms(summary.milliseconds))),
        ];
        rows.extend(summary.notes.iter().map(|note| ("note", note.clone())));
        let lines: String = rows.iter().map(|(name, value)| format!("{name:<12}{value}\n")).collect();
        if common.quiet {
            return Ok(());
        }
        if [&self.output, &self.picture].iter().any(|path| path.as_deref() == Some(Path::new("-"))) {
            eprint!("{lines}");
            return Ok(());
        }
        print(&lines)
    }
}
