//! `nearfield neighbors`: all points within a radius of every point, or the nearest ones, as a summary, lists, JSON or a
//! picture.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use clap::{Args, ValueEnum};
use nearfield::geometry::Period;
use nearfield::gpu::DeviceChoice;
use nearfield::io::Format;
use nearfield::query::{Index, IndexSettings, StructureChoice, Summary};
use nearfield::{FixedRadius, Knn, NeighborSearch, PointCloud, Queries, Radius, RowOrder, Vec3};

use crate::exit::Failure;
use crate::input::{self, Input, file_name, searchable};
use crate::lists::{self, ListFormat};
use crate::neighbors_answer::{Answer, Question, row_of};
use crate::neighbors_picture;
use crate::options::{Common, Framing, Length, period};
use crate::progress::Progress;
use crate::report::{self, DIGITS, KnnSummary, SearchSummary, Times, milliseconds, short};

const EXAMPLES: &str = "Examples:
  nearfield neighbors scan.pcd --radius 0.5 --output lists.npz --picture counts.png
  nearfield neighbors scan.las --radius 0.5% --exclude-self --json
  nearfield neighbors scan.ply --radius 2 --queries probes.xyz --sort distance --max-neighbors 8 -o lists.csv
  nearfield neighbors scan.ply --knn 8 --exclude-self --output nearest.csv --picture spacing.png
  nearfield neighbors scan.ply --knn 8 --radius 0.5 --queries probes.xyz --json
  nearfield neighbors scan.ply --queries probes.xyz --radii radii.txt --output lists.npz

A point at exactly the radius is inside. The nearest are found exactly, ties by lower index; the point itself is one of
them without --exclude-self. Indices count from 0 in the order of the file.
lists.npz holds offsets (u64, [q+1]), indices (u32, [nnz]) and distances (f32, [nnz]): the neighbours of query i are
indices[offsets[i]..offsets[i+1]].";

/// Find all points within a radius of every point, or the nearest ones
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct NeighborsArgs {
    /// Points: any file that `nearfield formats` lists, or - for standard input
    input: PathBuf,

    /// Search radius in the unit of the file, or a part of the bounding-box diagonal such as 0.5%
    #[arg(long, short, value_name = "R|P%", allow_hyphen_values = true, required_unless_present_any = ["knn", "radii"])]
    radius: Option<Length>,

    /// A radius for each query: a text file with one a line, a .npy array, or - for standard input
    #[arg(long, value_name = "FILE", conflicts_with = "radius")]
    radii: Option<PathBuf>,

    /// Find the K nearest points of each query: however far they are, or within the radius where one is given
    #[arg(long, value_name = "K", conflicts_with = "max_neighbors", value_parser = clap::value_parser!(u32).range(1..))]
    knn: Option<u32>,

    /// Ask around the points of this file instead
    #[arg(long, value_name = "FILE", conflicts_with = "exclude_self")]
    queries: Option<PathBuf>,

    /// Where to search: auto, cpu, gpu, gpu:N as `nearfield devices` counts, or part of a name
    #[arg(long, value_name = "D", default_value = "auto")]
    device: DeviceChoice,

    /// What to search in: auto, brute-force, uniform-grid, linear-octree or aabb-tree
    #[arg(long, value_name = "S", default_value = "auto")]
    structure: StructureChoice,

    /// Leave out the point itself
    #[arg(long)]
    exclude_self: bool,

    /// Keep the K nearest neighbours of each query and say what was left out
    #[arg(long, value_name = "K")]
    max_neighbors: Option<u32>,

    /// Order of the neighbours of a query; the nearest come by distance
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

    /// What the colours of the picture show: count, cell, distance (of the K-th neighbour), or neighbors-of:I
    /// [default: count, with --knn distance]
    #[arg(long, value_name = "WHAT", requires = "picture", verbatim_doc_comment)]
    color: Option<Color>,

    #[command(flatten)]
    framing: Framing,

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
    /// The distance of the k-th neighbour.
    Distance,
    /// One query and its neighbours.
    NeighborsOf(usize),
}

impl FromStr for Color {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("neighbors-of:").map(str::parse)) {
            ("count", _) => Ok(Self::Count),
            ("cell", _) => Ok(Self::Cell),
            ("distance", _) => Ok(Self::Distance),
            (_, Some(Ok(query))) => Ok(Self::NeighborsOf(query)),
            _ => Err("expected count, cell, distance, or neighbors-of:I with I the index of a query".to_owned()),
        }
    }
}

/// What was asked and found, for the picture.
pub(crate) struct Found<'a> {
    pub(crate) name: String,
    pub(crate) points: &'a [Vec3],
    /// Query points, where they are not the points themselves.
    pub(crate) queries: Option<&'a [Vec3]>,
    /// What was asked, for the title: "radius 0.5".
    pub(crate) asked: String,
    /// Edge of the cells that are shown, the radius.
    pub(crate) cell: f32,
    /// Whether that is the largest of several radii.
    pub(crate) varied: bool,
    pub(crate) period: Period,
    /// Neighbours of each query as found, or as kept under a cap.
    pub(crate) counts: &'a [u32],
    pub(crate) summary: Summary,
    /// K and the distance of the K-th neighbour of each query, infinite where there is none.
    pub(crate) kth: Option<(u32, &'a [f32])>,
    /// The neighbours of the query that the picture is about, and how far they reach.
    pub(crate) shown_row: (Vec<u32>, f32),
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

    let n_queries = queries.as_ref().map_or(cloud.len(), Vec::len);
    let radii = args.radii.as_deref().map(|path| input::radii(path, n_queries, common)).transpose()?;
    let radius = match (&radii, args.radius) {
        (Some(radii), _) => Some(Radius::Each(radii)),
        (None, radius) => radius.map(|radius| Radius::One(radius.within(&cloud.bounds()))),
    };
    let held = 12 * (cloud.len() + queries.as_ref().map_or(0, Vec::len)) as u64
        + 4 * radii.as_ref().map_or(0, Vec::len) as u64;
    let question = args.question(radius, queries.as_deref(), cloud.len(), common.memory_left(held), &mut notes);
    question.validate(cloud.len()).map_err(Failure::Search)?;
    let color = args.color.unwrap_or(if args.knn.is_some() { Color::Distance } else { Color::Count });
    if let (Color::NeighborsOf(i), true) = (color, args.picture.is_some())
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
    let index = Index::build(&cloud.points, question.purpose(), &settings).map_err(Failure::Search)?;
    let build_stages = index.build_stages();
    times.built(milliseconds(clock), &build_stages);
    common.allow("the index", held + index.memory_bytes()).map_err(Failure::Search)?;

    progress.step("searching");
    let clock = Instant::now();
    let answer =
        Answer::of(&index, &question, args.knn.unwrap_or(0), args.output.is_some()).map_err(Failure::Search)?;
    times.asked(milliseconds(clock), &answer.report);

    if let (Some(path), Some(format), Some(rows)) = (&args.output, list_format, answer.rows()) {
        progress.step(format!("writing {}", path.display()));
        let clock = Instant::now();
        lists::write(path, format, &rows, args.force).map_err(Failure::writing)?;
        times.write = milliseconds(clock);
    }
    if let Some(path) = &args.picture {
        progress.step(format!("drawing {}", path.display()));
        let clock = Instant::now();
        let shown_row = match color {
            Color::NeighborsOf(i) => row_of(&index, &question, &answer, &cloud.points, i).map_err(Failure::Search)?,
            _ => (vec![], 0.0),
        };
        let found = Found {
            name: file_name(&args.input),
            points: &cloud.points,
            queries: queries.as_deref(),
            asked: args.asked(question.radii()),
            cell: question.radii().map_or(0.0, |radii| radii[1]),
            varied: question.radii().is_some_and(|[low, high]| low < high),
            period: settings.period,
            counts: &answer.counts,
            summary: answer.summary(),
            kth: args.knn.zip(answer.kth.as_deref()),
            shown_row,
        };
        let up = args.framing.up.unwrap_or_else(|| neighbors_picture::guess_up(&found, &args.input, args.format));
        let image = neighbors_picture::draw(&found, color, up, args.framing.size());
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
        radii: question.radii(),
        knn: args.knn.zip(answer.kth.as_deref()).map(|(k, kth)| KnnSummary::of(k, kth)),
        neighbors: answer.summary(),
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
        let from_stdin = [Some(&self.input), self.queries.as_ref(), self.radii.as_ref()];
        if from_stdin.into_iter().flatten().filter(|path| path.as_os_str() == "-").count() > 1 {
            return Err(Failure::Usage("only one of points, queries and radii can come from standard input".into()));
        }
        match self.color {
            Some(Color::Distance) if self.knn.is_none() => {
                return Err(Failure::Usage(
                    "--color distance shows the distance of the K-th neighbour of --knn K".into(),
                ));
            }
            Some(Color::Cell) if self.radius.is_none() && self.radii.is_none() => {
                return Err(Failure::Usage("--color cell shows cells as wide as the radius: give --radius".into()));
            }
            _ => {}
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

    fn question<'a>(
        &self,
        radius: Option<Radius<'a>>,
        queries: Option<&'a [Vec3]>,
        points: usize,
        max_bytes: Option<u64>,
        notes: &mut Vec<String>,
    ) -> Question<'a> {
        let queries = queries.map_or(Queries::Points, Queries::Other);
        let Some(k) = self.knn else {
            return Question::Within(FixedRadius {
                queries,
                radius: radius.unwrap_or(Radius::One(0.0)),
                exclude_self: self.exclude_self,
                max_neighbors: self.max_neighbors,
                order: match self.sort {
                    Sort::None => RowOrder::Unspecified,
                    Sort::Index => RowOrder::Index,
                    Sort::Distance => RowOrder::Distance,
                },
                distances: self.output.is_some(),
                max_bytes,
            });
        };
        let others = points.saturating_sub(usize::from(self.exclude_self));
        if (others as u64) < u64::from(k) {
            notes.push(format!("no query can have {k} neighbours: there are {others} points to choose from"));
        }
        // Places for more neighbours than there are points would only take memory.
        let knn = Knn { k: k.min(others as u32), queries, radius, exclude_self: self.exclude_self, max_bytes };
        Question::Nearest { knn, by_index: self.sort == Sort::Index }
    }

    /// The question for the title of a picture.
    fn asked(&self, radii: Option<[f32; 2]>) -> String {
        let radius = radii.map(|[low, high]| {
            if low == high { short(low, DIGITS) } else { format!("{} to {}", short(low, DIGITS), short(high, DIGITS)) }
        });
        match (self.knn, radius) {
            (Some(k), Some(radius)) => format!("{k} nearest within {radius}"),
            (Some(k), None) => format!("{k} nearest"),
            (None, Some(radius)) => format!("radius {radius}"),
            (None, None) => String::new(),
        }
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
