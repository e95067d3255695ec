//! `nearfield demo`: the main job on a synthetic scan, with every structure on every device, checked against each other.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, adapters};
use nearfield::query::{Index, IndexSettings, StructureChoice, Summary};
use nearfield::{FixedRadius, NeighborSearch, Neighbors, RowOrder, Vec3};

use crate::agreement;
use crate::exit::Failure;
use crate::neighbors::{Color, Found};
use crate::options::{Amount, Common, PictureSize};
use crate::output;
use crate::picture::{self, Up};
use crate::progress::Progress;
use crate::report::{grouped, print, shown_ms, size, table};

/// Seed of the scan.
const SEED: u64 = 7;
/// Search radius in metres.
const RADIUS: f32 = 0.25;
/// Queries for brute force, which tests all points for each: more would take minutes on a software renderer.
const BRUTE_FORCE_QUERIES: usize = 2000;

/// Find all neighbours of a synthetic scan with every structure on every device, and check that they agree
#[derive(Debug, Args)]
#[command(after_help = "Example:
  nearfield demo

The scan is that of a car driving along a street: 120,000 points, always the same. demo.png shows it coloured by the
number of neighbours within 0.25 m.")]
pub(crate) struct DemoArgs {
    /// Number of points
    #[arg(short = 'n', long = "number", value_name = "N", default_value = "120000")]
    n: Amount,

    /// The picture to write
    #[arg(long, value_name = "FILE", default_value = "demo.png")]
    picture: PathBuf,

    /// Replace the picture even if it is not one of ours
    #[arg(long)]
    force: bool,
}

/// One line of the table.
struct Run {
    structure: &'static str,
    device: String,
    queries: usize,
    build_ms: f64,
    query_ms: f64,
    memory_bytes: u64,
    rows: Neighbors,
}

pub(crate) fn run(args: &DemoArgs, common: &Common) -> Result<(), Failure> {
    let force = args.force || is_own_picture(&args.picture);
    output::check(&args.picture, force)?;
    common.allow("the scan", 12 * args.n.0 as u64).map_err(Failure::Search)?;
    let progress = Progress::start(common, "making the scan");
    let scan = cloud(CloudKind::Lidar, args.n.0, SEED);
    let points = &scan.points;
    let step = points.len().div_ceil(BRUTE_FORCE_QUERIES).max(1);
    let sample: Vec<Vec3> = points.iter().copied().step_by(step).collect();

    let mut devices = vec![DeviceChoice::Cpu];
    devices.extend((0..adapters().len()).map(DeviceChoice::Number));
    let mut runs: Vec<Run> = Vec::new();
    for device in &devices {
        for structure in StructureChoice::ALL {
            progress.step(format!("{} on {device}", structure.name()));
            let queries = (structure == StructureChoice::BruteForce).then_some(&sample[..]);
            runs.push(search(points, queries, structure, device).map_err(Failure::Search)?);
        }
    }
    let reference = runs.iter().find(|run| run.queries == points.len()).map(|run| &run.rows);
    let reference =
        reference.ok_or_else(|| Failure::Disagreement("no structure was asked around every point".into()))?;
    progress.step("drawing");
    draw(points, reference, &args.picture, force)?;
    drop(progress);

    if !common.quiet {
        tell(args, points, &runs, step, devices.len() == 1)?;
    }
    let compared = agreement::all(runs.iter().map(|run| (name(run), &run.rows)), reference, step, RADIUS)
        .map_err(Failure::Disagreement)?;
    if common.quiet {
        return Ok(());
    }
    let total = grouped(compared.neighbors);
    let boundary = match compared.at_boundary {
        0 => String::new(),
        n => format!(" ({n} within 4 ulp of the radius may differ)"),
    };
    print(&format!("all agree: {total} neighbours compared{boundary}\n{} written\n", args.picture.display()))
}

fn search(
    points: &[Vec3],
    queries: Option<&[Vec3]>,
    structure: StructureChoice,
    device: &DeviceChoice,
) -> nearfield::Result<Run> {
    let mut question = FixedRadius::new(RADIUS).order(RowOrder::Index).distances();
    if let Some(queries) = queries {
        question = question.queries(queries);
    }
    let settings = IndexSettings { structure, device: device.clone(), ..IndexSettings::default() };
    let index = Index::build(points, &question, &settings)?;
    let build_ms = index.build_stages().iter().map(|stage| stage.milliseconds).sum();
    let clock = Instant::now();
    let rows = index.list(&question)?;
    let query_ms = clock.elapsed().as_secs_f64() * 1e3;
    Ok(Run {
        structure: index.structure(),
        device: index.device(),
        queries: rows.len(),
        build_ms,
        query_ms,
        memory_bytes: index.memory_bytes(),
        rows,
    })
}

fn name(run: &Run) -> String {
    format!("{} on {}", run.structure, run.device)
}

fn tell(args: &DemoArgs, points: &[Vec3], runs: &[Run], step: usize, no_gpu: bool) -> Result<(), Failure> {
    let mut text =
        format!("synthetic street scan, {} points, all neighbours within {RADIUS} m\n", grouped(points.len() as u64));
    if no_gpu {
        text += "no GPU found: the CPU does everything\n";
    }
    text.push('\n');
    let heading = ["structure", "device", "queries", "build", "query", "mean", "min", "max", "memory"];
    let mut rows = vec![heading.map(str::to_owned).to_vec()];
    for run in runs {
        let summary = run.rows.summary();
        rows.push(vec![
            run.structure.to_owned(),
            run.device.clone(),
            grouped(run.queries as u64),
            shown_ms(run.build_ms),
            shown_ms(run.query_ms),
            format!("{:.2}", summary.mean),
            summary.min.to_string(),
            summary.max.to_string(),
            size(run.memory_bytes),
        ]);
    }
    text += &table(&rows, &[2, 3, 4, 5, 6, 7, 8]);
    text.push('\n');
    if step > 1 && args.n.0 > 0 {
        text += &format!("brute force tests every pair: it is asked around every {step}th point only\n");
    }
    print(&text)
}

fn draw(points: &[Vec3], rows: &Neighbors, path: &Path, force: bool) -> Result<(), Failure> {
    let counts: Vec<u32> = rows.offsets().windows(2).map(|w| (w[1] - w[0]) as u32).collect();
    let found = Found {
        name: "synthetic street scan".to_owned(),
        points,
        queries: None,
        asked: format!("radius {RADIUS}"),
        cell: RADIUS,
        varied: false,
        period: Default::default(),
        counts: &counts,
        summary: Summary::of(counts.iter().copied()),
        kth: None,
        shown_row: (vec![], 0.0),
    };
    let size = PictureSize { width: 1600, height: 1000 };
    let image = crate::neighbors_picture::draw(&found, Color::Count, Up::Z, size);
    nearfield::io::write_atomically(path, force, |w| image.write_png(w)).map_err(Failure::writing)
}

/// Whether an earlier demo left this picture, which the next one may then replace.
fn is_own_picture(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(512).read_to_end(&mut head));
    read.is_ok() && picture::is_ours(&head)
}
