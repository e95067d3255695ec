//! `nearfield-bench baselines`: build and query times of every baseline with their recall, on points uniform in the unit
//! cube that ask among themselves.
//!
//! Each method is asked twice: for the k nearest, and for all within a radius, the median distance of the k-th nearest. Recall is
//! that of a sample of the queries by brute force in f64; a method that promises to be exact and misses one stops the run.

use std::path::PathBuf;

use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::query::{Clock, Stage};
use nearfield::{
    FixedRadius, GpuLinearOctree, GpuUniformGrid, GridSettings, Knn, KnnSearch, LinearOctree, NearestNeighbors,
    NeighborSearch, OctreeSettings, UniformGrid, Vec3,
};

use super::kd_tree_cpu::KdTree;
use super::lsh::{GpuLsh, HashFamily, LshSettings, reference::Tables};
use super::points::{Points, Queries, dist2};
use super::rows::{KnnRows, RangeRows};
use super::shifted_sort::{Asking, GpuShiftedSort, ShiftedSortSettings, reference};
use super::{ann, exact, recall, wrong};
use crate::Result;
use crate::measure::{Effort, Measured, repeat};
use crate::provenance::{COMMIT, Device, Machine};

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, cpu, gpu, gpu:N or part of a device name; on the CPU the approximate searches are their plain references
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Number of points
    #[arg(long, default_value_t = 20_000)]
    pub points: usize,
    /// How many nearest, 1 to 128
    #[arg(long, default_value_t = 20)]
    pub k: usize,
    /// Coordinates of a point, 2 to 64; grid, octree and shifted sort take part in 3, kd-trees up to 16
    #[arg(long, default_value_t = 3)]
    pub dimension: usize,
    /// Shifts of the shifted sort
    #[arg(long, default_value_t = 5)]
    pub shifts: usize,
    /// Tables of the hashing
    #[arg(long, default_value_t = 8)]
    pub tables: usize,
    /// Projections of a table
    #[arg(long, default_value_t = 8)]
    pub projections: usize,
    /// Queries that are judged by brute force
    #[arg(long, default_value_t = 1000)]
    pub sample: usize,
    /// Timed runs of an operation
    #[arg(long, default_value_t = 3)]
    pub repeat: usize,
    /// The program that scripts/build_ann_peer.sh makes
    #[arg(long)]
    pub ann: Option<PathBuf>,
}

/// One method and one question.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Method.
    pub method: &'static str,
    /// Whether it promises all neighbours.
    pub is_exact: bool,
    /// "k nearest" or "within r".
    pub question: &'static str,
    /// Milliseconds of the build: of the device where it has a clock, else of the wall.
    pub build_ms: f64,
    /// Milliseconds of the query.
    pub query_ms: f64,
    /// Share of the neighbours that were found.
    pub recall: f64,
    /// Mean ratio of distances; `None` for lists.
    pub distance_ratio: Option<f64>,
    /// Share of rows with all k nearest; `None` for lists.
    pub exact_rows: Option<f64>,
    /// Points found by a query.
    pub mean_found: f64,
}

const SEED: u64 = 7;
const NEAREST: &str = "k nearest";
const WITHIN: &str = "within r";

/// The points, the questions and what judges the answers.
struct Case<'a> {
    points: &'a Points,
    k: usize,
    radius: f32,
    sample: Vec<u32>,
    nearest: KnnRows,
    effort: Effort,
    rows: Vec<Row>,
}

/// Measures every method that the dimension and the device allow, and prints the table.
///
/// # Errors
/// `NoDevice`, `InvalidSetting`; what a method returns; an answer that is wrong.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let (rows, radius) = measure(arguments, &machine)?;
    println!("commit {COMMIT}; {} ({}); host: {}", machine.name, machine.driver, machine.host);
    let Arguments { points, dimension, k, .. } = arguments;
    println!("{points} points uniform in {dimension} dimensions, k = {k}, r = {radius:.5}");
    println!("| method | question | build ms | query ms | recall | distance ratio | exact rows | mean neighbours |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    for row in &rows {
        let share = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.4}"));
        let Row { method, question, build_ms, query_ms, recall, mean_found, .. } = row;
        let (ratio, exact_rows) = (share(row.distance_ratio), share(row.exact_rows));
        println!(
            "| {method} | {question} | {build_ms:.3} | {query_ms:.3} | {recall:.4} | {ratio} | {exact_rows} | {mean_found:.2} |"
        );
    }
    Ok(())
}

/// The rows of the table, and the radius.
///
/// # Errors
/// As [`run`].
pub fn measure(arguments: &Arguments, machine: &Machine) -> Result<(Vec<Row>, f32)> {
    super::check_k(arguments.k)?;
    let points = Points::uniform(arguments.points, arguments.dimension, SEED)?;
    let sample = exact::sample(points.len(), arguments.sample);
    let nearest = exact::knn(&points, Queries::Points, &sample, arguments.k);
    let mut farthest: Vec<f32> = (0..nearest.len()).filter_map(|i| nearest.row_dist2(i).last().copied()).collect();
    farthest.sort_by(f32::total_cmp);
    let radius = farthest.get(farthest.len() / 2).map_or(0.0, |dist2| dist2.sqrt());
    let warm_up = if machine.is_hardware_gpu() { 0.3 } else { 0.0 };
    let effort = Effort { warm_up, runs: arguments.repeat.max(1), seconds: 10.0 };
    let mut case = Case { points: &points, k: arguments.k, radius, sample, nearest, effort, rows: Vec::new() };
    let shifts = ShiftedSortSettings::new(arguments.k).shifts(arguments.shifts);
    let hashing = LshSettings::for_k(arguments.k).tables(arguments.tables).projections(arguments.projections);
    let in_space = (points.dimension() == 3).then(|| in_space(&points));
    match (&machine.device, &in_space) {
        (Device::Gpu(gpu), Some(in_space)) => {
            case.own_on_gpu(gpu, in_space)?;
            case.shifted_sort(gpu, in_space, shifts)?;
        }
        (Device::Cpu, Some(in_space)) => {
            case.own_on_cpu(in_space)?;
            case.shifted_sort_on_cpu(in_space, shifts)?;
        }
        _ => {}
    }
    match &machine.device {
        Device::Gpu(gpu) => case.lsh(gpu, &hashing)?,
        Device::Cpu => case.lsh_on_cpu(&hashing)?,
    }
    if points.dimension() <= 16 {
        case.kd_tree()?;
    }
    if let Some(program) = &arguments.ann {
        case.ann(program)?;
    }
    Ok((case.rows, radius))
}

/// Wall clock or, where the device has a clock, its own.
fn milliseconds(measured: &Measured) -> f64 {
    measured.device.unwrap_or(measured.wall).median
}

fn of_stages(measured: &Measured, is_wanted: impl Fn(&str) -> bool) -> f64 {
    measured.stages.iter().filter(|s| s.clock == Clock::Device && is_wanted(s.name)).map(|s| s.milliseconds).sum()
}

fn in_space(points: &Points) -> Vec<Vec3> {
    points.coordinates().chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])).collect()
}

impl Case<'_> {
    fn add_nearest(&mut self, method: &'static str, is_exact: bool, times: (f64, f64), found: &KnnRows) -> Result<()> {
        let quality = recall::of_knn(self.points, Queries::Points, &self.sample, found, &self.nearest)?;
        self.add(Row {
            method,
            is_exact,
            question: NEAREST,
            build_ms: times.0,
            query_ms: times.1,
            recall: quality.recall,
            distance_ratio: Some(quality.distance_ratio),
            exact_rows: Some(quality.exact_rows),
            mean_found: found.mean_found(),
        })
    }

    fn add_within(&mut self, method: &'static str, is_exact: bool, times: (f64, f64), found: &RangeRows) -> Result<()> {
        let quality = recall::of_range(self.points, Queries::Points, &self.sample, self.radius, found)?;
        self.add(Row {
            method,
            is_exact,
            question: WITHIN,
            build_ms: times.0,
            query_ms: times.1,
            recall: quality.recall,
            distance_ratio: None,
            exact_rows: None,
            mean_found: found.mean_found(),
        })
    }

    fn add(&mut self, row: Row) -> Result<()> {
        if row.is_exact && row.recall < 1.0 {
            return Err(wrong(format!("{} ({}) is exact but has recall {}", row.method, row.question, row.recall)));
        }
        self.rows.push(row);
        Ok(())
    }

    /// The library's grid for lists and its octree for the nearest.
    fn own_on_gpu(&mut self, gpu: &Gpu, points: &[Vec3]) -> Result<()> {
        let (octree, built) = repeat(self.effort, || {
            let octree = GpuLinearOctree::build(gpu, points, &OctreeSettings::default())?;
            let stages = NeighborSearch::build_stages(&octree);
            Ok((octree, stages))
        })?;
        let (rows, asked) = repeat(self.effort, || with_report(octree.knn(&Knn::new(self.k as u32))?))?;
        self.add_nearest("linear octree", true, (milliseconds(&built), milliseconds(&asked)), &self.rows_of(&rows))?;
        let settings = GridSettings::for_radius(self.radius.max(f32::MIN_POSITIVE));
        let (grid, built) = repeat(self.effort, || {
            let grid = GpuUniformGrid::build(gpu, points, &settings)?;
            let stages = NeighborSearch::build_stages(&grid);
            Ok((grid, stages))
        })?;
        self.grid(&grid, &built)
    }

    fn own_on_cpu(&mut self, points: &[Vec3]) -> Result<()> {
        let octree = || Ok((LinearOctree::build(points, &OctreeSettings::default())?, Vec::new()));
        let (octree, built) = repeat(self.effort, octree)?;
        let (rows, asked) = repeat(self.effort, || Ok((octree.knn(&Knn::new(self.k as u32))?, Vec::new())))?;
        self.add_nearest("linear octree", true, (milliseconds(&built), milliseconds(&asked)), &self.rows_of(&rows))?;
        let settings = GridSettings::for_radius(self.radius.max(f32::MIN_POSITIVE));
        let (grid, built) = repeat(self.effort, || Ok((UniformGrid::build(points, &settings)?, Vec::new())))?;
        self.grid(&grid, &built)
    }

    fn grid(&mut self, grid: &impl NeighborSearch, built: &Measured) -> Result<()> {
        let (list, asked) = repeat(self.effort, || {
            let list = grid.list(&FixedRadius::new(self.radius))?;
            let stages = list.report.stages.iter().filter(|s| s.clock == Clock::Device).cloned().collect();
            Ok((list, stages))
        })?;
        let (offsets, ids, _) = list.into_parts();
        let found = RangeRows { offsets, ids };
        self.add_within("uniform grid", true, (milliseconds(built), milliseconds(&asked)), &found)
    }

    /// Rows of the library with squared distances by the same formula.
    fn rows_of(&self, rows: &NearestNeighbors) -> KnnRows {
        let candidate = |i: usize, id: &u32| (dist2(self.points.get(i), self.points.get(*id as usize)), *id);
        let row = |i| rows.row(i).iter().map(|id| candidate(i, id)).collect();
        KnnRows::of_candidates(self.k, (0..rows.len()).map(row).collect())
    }

    fn shifted_sort(&mut self, gpu: &Gpu, points: &[Vec3], settings: ShiftedSortSettings) -> Result<()> {
        let plan = GpuShiftedSort::<u64>::new(gpu, points.len(), settings)?;
        let asked = || {
            let rows = plan.knn(points, Asking::Points { without_self: false })?;
            Ok((rows.answer, rows.stages))
        };
        let (rows, measured) = repeat(self.effort, asked)?;
        let query = of_stages(&measured, |name| name == "merge");
        let build = of_stages(&measured, |name| name != "merge");
        let times = if measured.device.is_some() { (build, query) } else { (0.0, measured.wall.median) };
        self.add_nearest("shifted sort", false, times, &rows)?;
        self.add_within("shifted sort", false, times, &rows.within(self.radius))
    }

    fn shifted_sort_on_cpu(&mut self, points: &[Vec3], settings: ShiftedSortSettings) -> Result<()> {
        let asking = Asking::Points { without_self: false };
        let (rows, measured) =
            repeat(self.effort, || Ok((reference::knn(points, asking, &settings, 63)?, Vec::new())))?;
        let times = (0.0, measured.wall.median);
        self.add_nearest("shifted sort, plain reference", false, times, &rows)?;
        self.add_within("shifted sort, plain reference", false, times, &rows.within(self.radius))
    }

    fn lsh(&mut self, gpu: &Gpu, settings: &LshSettings) -> Result<()> {
        let family = HashFamily::draw(self.points, settings)?;
        let (lsh, built) = repeat(self.effort, || {
            let lsh = GpuLsh::build(gpu, self.points, &family)?;
            let stages = lsh.build_stages().to_vec();
            Ok((lsh, stages))
        })?;
        let (rows, asked) = repeat(self.effort, || {
            let rows = lsh.knn(Queries::Points, self.k, None)?;
            Ok((rows.answer, rows.stages))
        })?;
        self.add_nearest("hashing (LSH)", false, (milliseconds(&built), milliseconds(&asked)), &rows)?;
        let (lists, asked) = repeat(self.effort, || {
            let lists = lsh.list_within(Queries::Points, self.radius)?;
            Ok((lists.answer, lists.stages))
        })?;
        self.add_within("hashing (LSH)", false, (milliseconds(&built), milliseconds(&asked)), &lists)
    }

    fn lsh_on_cpu(&mut self, settings: &LshSettings) -> Result<()> {
        let family = HashFamily::draw(self.points, settings)?;
        let (points, radius, k) = (self.points, self.radius, self.k);
        let (tables, built) = repeat(self.effort, || Ok((Tables::build(points, &family)?, Vec::new())))?;
        let (rows, asked) = repeat(self.effort, || Ok((tables.knn(Queries::Points, k, None)?, Vec::new())))?;
        let method = "hashing (LSH), plain reference";
        self.add_nearest(method, false, (milliseconds(&built), milliseconds(&asked)), &rows)?;
        let (lists, asked) = repeat(self.effort, || Ok((tables.list_within(Queries::Points, radius)?, Vec::new())))?;
        self.add_within(method, false, (milliseconds(&built), milliseconds(&asked)), &lists)
    }

    fn kd_tree(&mut self) -> Result<()> {
        let points = self.points;
        let (tree, built) = repeat(self.effort, || Ok((KdTree::build(points)?, Vec::new())))?;
        let (rows, asked) = repeat(self.effort, || Ok((tree.knn(Queries::Points, self.k)?, Vec::new())))?;
        self.add_nearest("kiddo, all cores", true, (milliseconds(&built), milliseconds(&asked)), &rows)?;
        let listed = || Ok((tree.list_within(Queries::Points, self.radius)?, Vec::new()));
        let (lists, asked) = repeat(self.effort, listed)?;
        self.add_within("kiddo, all cores", true, (milliseconds(&built), milliseconds(&asked)), &lists)
    }

    fn ann(&mut self, program: &std::path::Path) -> Result<()> {
        let ran = ann::run(program, self.points, self.k, self.radius)?;
        self.add_nearest("libann, one core", true, (ran.build_ms, ran.knn_ms), &ran.rows)?;
        // Its counts are in f64: pairs at the radius itself may differ from f32 by a few.
        let counted = ran.counts.iter().map(|&c| f64::from(c)).sum::<f64>() / ran.counts.len().max(1) as f64;
        let (low, high) = exact::mean_within(self.points, &self.sample, self.radius);
        let sampled = self.sample.iter().map(|&i| f64::from(ran.counts[i as usize])).sum::<f64>();
        let sampled = sampled / self.sample.len().max(1) as f64;
        if !(low..=high).contains(&sampled) {
            return Err(wrong(format!("libann counts {sampled} neighbours, expected {low} to {high}")));
        }
        self.add(Row {
            method: "libann, one core",
            is_exact: true,
            question: WITHIN,
            build_ms: ran.build_ms,
            query_ms: ran.count_ms,
            recall: 1.0,
            distance_ratio: None,
            exact_rows: None,
            mean_found: counted,
        })
    }
}

/// An answer of the library with the stages that the device timed.
fn with_report(rows: NearestNeighbors) -> Result<(NearestNeighbors, Vec<Stage>)> {
    let stages = rows.report.stages.iter().filter(|s| s.clock == Clock::Device).cloned().collect();
    Ok((rows, stages))
}
