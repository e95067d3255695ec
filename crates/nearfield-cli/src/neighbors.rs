//! `nearfield neighbors`: all points within a radius of every point, as a summary, lists, JSON or a picture.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::geometry::Period;
use nearfield::gpu::DeviceChoice;
use nearfield::io::Format;
use nearfield::query::{Index, IndexSettings, StructureChoice, Summary};
use nearfield::{FixedRadius, NeighborSearch, Neighbors, PointCloud, Queries, RowOrder, Vec3};

use crate::exit::Failure;
use crate::input::{Input, searchable};
use crate::lists::{self, ListFormat};
use crate::neighbors_picture;
use crate::options::{Common, Length, PictureSize, period};
use crate::picture::Up;
use crate::progress::Progress;
use crate::report::{self, SearchSummary, Times};

const EXAMPLES: &str = "Examples:
  nearfield neighbors scan.pcd --radius 0.5 --output lists.npz --picture counts.png
  nearfield neighbors scan.las --radius 0.5% --exclude-self --json
  nearfield neighbors scan.ply --radius 2 --queries probes.xyz --sort distance --max-neighbors 8 -o lists.csv

A point at exactly the radius is inside. Indices count from 0 in the order of the file.
lists.npz holds offsets (u64, [q+1]), indices (u32, [nnz]) and distances (f32, [nnz]): the neighbours of query i are
indices[offsets[i]..offsets[i+1]].";

/// Find all points within a radius of every point
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct NeighborsArgs {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// Search radius in the unit of the file, or a part of the bounding-box diagonal such as 0.5%
    #[arg(long, short, value_name = "R|P%", allow_hyphen_values = true)]
    radius: Length,

    /// Ask around the points of this file instead
    #[arg(long, value_name = "FILE", conflicts_with = "exclude_self")]
    queries: Option<PathBuf>,

    /// Where to search: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "D", default_value = "auto")]
    device: DeviceChoice,

    /// What to search in: auto, brute-force, uniform-grid or linear-octree
    #[arg(long, value_name = "S", default_value = "auto")]
    structure: StructureChoice,

    /// Leave out the point itself
    #[arg(long)]
    exclude_self: bool,

    /// Keep the K nearest neighbours of each query and say what was left out
    #[arg(long, value_name = "K")]
    max_neighbors: Option<u32>,

    /// Order of the neighbours of a query
    #[arg(long, value_name = "ORDER", default_value = "none")]
    sort: Sort,

    /// Lengths after which the domain repeats, 0 for an axis that does not
    #[arg(long, value_name = "X,Y,Z", value_parser = period)]
    periodic: Option<Period>,

    /// Drop points with NaN or infinite coordinates instead of refusing the file
    #[arg(long)]
    drop_invalid: bool,

    /// Write the lists: OUT.npz, OUT.csv, or - for CSV on standard output
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Draw the points into a PNG file
    #[arg(long, value_name = "OUT.png")]
    picture: Option<PathBuf>,

    /// What the colours of the picture show: count, cell, or neighbors-of:I
    #[arg(long, value_name = "WHAT", default_value = "count", requires = "picture")]
    color: Color,

    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "1600x1000", requires = "picture")]
    picture_size: PictureSize,

    /// The direction that is up in the picture [default: guessed from the shape]
    #[arg(long, value_name = "AXIS", requires = "picture")]
    up: Option<Up>,

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

/// Order of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Sort {
    None,
    Index,
    Distance,
}

/// What the colours of a picture show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Color {
    /// The number of neighbours.
    Count,
    /// The cell of the grid.
    Cell,
    /// One query and its neighbours.
    NeighborsOf(usize),
}

impl FromStr for Color {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("neighbors-of:").map(str::parse)) {
            ("count", _) => Ok(Self::Count),
            ("cell", _) => Ok(Self::Cell),
            (_, Some(Ok(query))) => Ok(Self::NeighborsOf(query)),
            _ => Err("expected count, cell, or neighbors-of:I with I the index of a query".to_owned()),
        }
    }
}

/// What was asked and found, for the picture.
pub(crate) struct Found<'a> {
    pub(crate) name: String,
    pub(crate) points: &'a [Vec3],
    /// Query points, where they are not the points themselves.
    pub(crate) queries: Option<&'a [Vec3]>,
    pub(crate) radius: f32,
    pub(crate) period: Period,
    /// Neighbours of each query as found, or as kept under a cap.
    pub(crate) counts: &'a [u32],
    pub(crate) summary: Summary,
    /// The neighbours of the query that the picture is about.
    pub(crate) shown_row: Vec<u32>,
}

pub(crate) fn run(args: &NeighborsArgs, common: &Common) -> Result<(), Failure> {
    let list_format = args.output.as_deref().map(ListFormat::of).transpose()?;
    args.check_outputs(list_format)?;
    let mut times = Times::default();
    let mut notes = Vec::new();

    let progress = Progress::start(common, format!("reading {}", args.input.display()));
    let clock = Instant::now();
    let cloud = read(&args.input, args.format, args, common, &mut notes)?;
    let queries = match &args.queries {
        Some(path) => Some(read(path, None, args, common, &mut notes)?.points_relative_to(cloud.origin)),
        None => None,
    };
    times.read = milliseconds(clock);

    let radius = args.radius.within(&cloud.bounds());
    let held = 12 * (cloud.len() + queries.as_ref().map_or(0, Vec::len)) as u64;
    let question = args.question(radius, queries.as_deref(), common.memory_left(held));
    question.validate(cloud.len()).map_err(Failure::Search)?;
    let n_queries = question.len(cloud.len());
    if let (Color::NeighborsOf(i), true) = (args.color, args.picture.is_some())
        && i >= n_queries
    {
        return Err(Failure::Usage(format!("--color neighbors-of:{i}: there are {n_queries} queries, counted from 0")));
    }

    progress.step("building the index");
    let clock = Instant::now();
    let settings = IndexSettings {
        structure: args.structure,
        device: args.device.clone(),
        period: args.periodic.unwrap_or(Period::NONE),
    };
    let index = Index::build(&cloud.points, &question, &settings).map_err(Failure::Search)?;
    let build_stages = index.build_stages();
    times.built(milliseconds(clock), &build_stages);
    common.allow("the index", held + index.memory_bytes()).map_err(Failure::Search)?;

    progress.step("searching");
    let clock = Instant::now();
    let answer = Answer::of(&index, &question, args.output.is_some()).map_err(Failure::Search)?;
    times.asked(milliseconds(clock), &answer.report);

    if let (Some(path), Some(format), Some(rows)) = (&args.output, list_format, &answer.rows) {
        progress.step(format!("writing {}", path.display()));
        let clock = Instant::now();
        lists::write(path, format, rows, args.force).map_err(Failure::writing)?;
        times.write = milliseconds(clock);
    }
    if let Some(path) = &args.picture {
        progress.step(format!("drawing {}", path.display()));
        let clock = Instant::now();
        let shown_row = match args.color {
            Color::NeighborsOf(i) => row_of(&index, &question, &cloud.points, i).map_err(Failure::Search)?,
            _ => vec![],
        };
        let found = Found {
            name: file_name(&args.input),
            points: &cloud.points,
            queries: queries.as_deref(),
            radius,
            period: settings.period,
            counts: &answer.counts,
            summary: Summary::of(answer.counts.iter().copied()),
            shown_row,
        };
        let up = args.up.unwrap_or_else(|| neighbors_picture::guess_up(&found, &args.input, args.format));
        let image = neighbors_picture::draw(&found, args.color, up, args.picture_size);
        nearfield::io::write_atomically(path, args.force, |w| image.write_png(w)).map_err(Failure::writing)?;
        times.picture = milliseconds(clock);
    }
    drop(progress);

    notes.extend(answer.report.notes.iter().cloned());
    if args.device == DeviceChoice::Auto && answer.report.notes.is_empty() && index.device().starts_with("cpu") {
        notes.push("no hardware GPU was found; the CPU did the work".to_owned());
    }
    let summary = SearchSummary {
        points: cloud.len() as u64,
        queries: n_queries as u64,
        radius,
        neighbors: Summary::of(answer.counts.iter().copied()),
        memory_bytes: index.memory_bytes(),
        cut_rows: answer.cut_rows,
        cut_neighbors: answer.cut_neighbors,
        report: answer.report,
        build_stages,
        notes,
        times,
    };
    args.tell(&summary, common)
}

impl NeighborsArgs {
    /// Says what cannot work before the work is done.
    fn check_outputs(&self, list_format: Option<ListFormat>) -> Result<(), Failure> {
        let stdout = |path: &Option<PathBuf>| path.as_deref() == Some(Path::new("-"));
        let to_stdout = usize::from(self.json) + usize::from(stdout(&self.output)) + usize::from(stdout(&self.picture));
        if to_stdout > 1 {
            return Err(Failure::Usage(
                "only one of --json, --output - and --picture - can have standard output".into(),
            ));
        }
        if self.input == Path::new("-") && self.queries.as_deref() == Some(Path::new("-")) {
            return Err(Failure::Usage("points and queries cannot both come from standard input".into()));
        }
        if let Some(path) = self.picture.as_deref().filter(|p| *p != Path::new("-"))
            && !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))
        {
            return Err(Failure::Usage(format!("--picture {}: pictures are written as .png", path.display())));
        }
        for path in [list_format.and(self.output.as_deref()), self.picture.as_deref()].into_iter().flatten() {
            crate::output::check(path, self.force)?;
        }
        Ok(())
    }

    fn question<'a>(&self, radius: f32, queries: Option<&'a [Vec3]>, max_bytes: Option<u64>) -> FixedRadius<'a> {
        let mut question = FixedRadius::new(radius).order(match self.sort {
            Sort::None => RowOrder::Unspecified,
            Sort::Index => RowOrder::Index,
            Sort::Distance => RowOrder::Distance,
        });
        if let Some(queries) = queries {
            question = question.queries(queries);
        }
        if self.exclude_self {
            question = question.exclude_self();
        }
        if self.output.is_some() {
            question = question.distances();
        }
        question.max_neighbors = self.max_neighbors;
        question.max_bytes = max_bytes;
        question
    }

    fn tell(&self, summary: &SearchSummary, common: &Common) -> Result<(), Failure> {
        if self.json {
            return report::print_json(&summary.json());
        }
        if common.quiet {
            // A cut is never silent, whatever else is.
            if let Some(note) = summary.cut_note() {
                eprintln!("nearfield: {note}");
            }
            return Ok(());
        }
        let stdout_taken = [&self.output, &self.picture].iter().any(|p| p.as_deref() == Some(Path::new("-")));
        if stdout_taken {
            eprint!("{}", summary.lines());
            return Ok(());
        }
        report::print(&summary.lines())
    }
}

fn read(
    path: &Path,
    format: Option<Format>,
    args: &NeighborsArgs,
    common: &Common,
    notes: &mut Vec<String>,
) -> Result<PointCloud, Failure> {
    let cloud = Input::open(path, format, common)?.cloud()?;
    searchable(cloud, path, args.drop_invalid, notes)
}

/// Counts, and lists where they are needed.
struct Answer {
    counts: Vec<u32>,
    rows: Option<Neighbors>,
    report: nearfield::Report,
    cut_rows: u64,
    cut_neighbors: u64,
}

impl Answer {
    fn of(index: &Index, question: &FixedRadius<'_>, lists: bool) -> nearfield::Result<Self> {
        if lists {
            let rows = index.list(question)?;
            let counts = rows.offsets().windows(2).map(|w| (w[1] - w[0]) as u32).collect();
            let cut_rows = rows.cut().len() as u64;
            let cut_neighbors = rows.cut().iter().map(|cut| u64::from(cut.missing)).sum();
            return Ok(Self { counts, report: rows.report.clone(), rows: Some(rows), cut_rows, cut_neighbors });
        }
        let found = index.count(question)?;
        let report = found.report.clone();
        let mut counts = found.into_vec();
        let (mut cut_rows, mut cut_neighbors) = (0, 0);
        if let Some(cap) = question.max_neighbors {
            for count in counts.iter_mut().filter(|count| **count > cap) {
                cut_rows += 1;
                cut_neighbors += u64::from(*count - cap);
                *count = cap;
            }
        }
        Ok(Self { counts, rows: None, report, cut_rows, cut_neighbors })
    }
}

/// The neighbours of one query without itself, the nearest first.
fn row_of(index: &Index, question: &FixedRadius<'_>, points: &[Vec3], i: usize) -> nearfield::Result<Vec<u32>> {
    let (at, is_point) = match question.queries {
        Queries::Points => (points[i], true),
        Queries::Other(queries) => (queries[i], false),
    };
    let at = [at];
    let alone = FixedRadius { exclude_self: false, max_neighbors: None, order: RowOrder::Distance, ..*question };
    let mut row = index.list(&alone.queries(&at))?.row(0).to_vec();
    row.retain(|&j| !(is_point && j as usize == i));
    if let Some(cap) = question.max_neighbors {
        row.truncate(cap as usize);
    }
    Ok(row)
}

fn file_name(path: &Path) -> String {
    match path.file_name() {
        Some(name) if path != Path::new("-") => name.to_string_lossy().into_owned(),
        _ => "standard input".to_owned(),
    }
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}
