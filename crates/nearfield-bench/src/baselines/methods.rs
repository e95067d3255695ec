//! One baseline after the other: built, asked, judged, and a row for each question.

use nearfield::gpu::Gpu;
use nearfield::query::{Clock, Stage};
use nearfield::{
    FixedRadius, GpuLinearOctree, GpuUniformGrid, GridSettings, Knn, KnnSearch, LinearOctree, NearestNeighbors,
    NeighborSearch, OctreeSettings, UniformGrid, Vec3,
};

use super::kd_tree_cpu::KdTree;
use super::lsh::reference::Tables;
use super::lsh::{GpuLsh, HashFamily, LshSettings};
use super::points::{Points, Queries, dist2};
use super::rows::{KnnRows, RangeRows};
use super::shifted_sort::{Asking, GpuShiftedSort, ShiftedSortSettings, reference};
use super::{ann, exact, recall, wrong};
use crate::Result;
use crate::measure::{Effort, Measured, repeat};

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

const NEAREST: &str = "k nearest";
const WITHIN: &str = "within r";

/// The points, the questions and what judges the answers.
pub(super) struct Case<'a> {
    pub(super) points: &'a Points,
    pub(super) k: usize,
    pub(super) radius: f32,
    pub(super) sample: Vec<u32>,
    pub(super) nearest: KnnRows,
    pub(super) effort: Effort,
    pub(super) rows: Vec<Row>,
}

/// Wall clock or, where the device has a clock, its own.
fn milliseconds(measured: &Measured) -> f64 {
    measured.device.unwrap_or(measured.wall).median
}

fn of_stages(measured: &Measured, is_wanted: impl Fn(&str) -> bool) -> f64 {
    measured.stages.iter().filter(|s| s.clock == Clock::Device && is_wanted(s.name)).map(|s| s.milliseconds).sum()
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
    pub(super) fn own_on_gpu(&mut self, gpu: &Gpu, points: &[Vec3]) -> Result<()> {
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

    pub(super) fn own_on_cpu(&mut self, points: &[Vec3]) -> Result<()> {
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

    pub(super) fn shifted_sort(&mut self, gpu: &Gpu, points: &[Vec3], settings: ShiftedSortSettings) -> Result<()> {
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

    pub(super) fn shifted_sort_on_cpu(&mut self, points: &[Vec3], settings: ShiftedSortSettings) -> Result<()> {
        let asking = Asking::Points { without_self: false };
        let (rows, measured) =
            repeat(self.effort, || Ok((reference::knn(points, asking, &settings, 63)?, Vec::new())))?;
        let times = (0.0, measured.wall.median);
        self.add_nearest("shifted sort, plain reference", false, times, &rows)?;
        self.add_within("shifted sort, plain reference", false, times, &rows.within(self.radius))
    }

    pub(super) fn lsh(&mut self, gpu: &Gpu, settings: &LshSettings) -> Result<()> {
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

    pub(super) fn lsh_on_cpu(&mut self, settings: &LshSettings) -> Result<()> {
        let family = HashFamily::draw(self.points, settings)?;
        let (points, radius, k) = (self.points, self.radius, self.k);
        let (tables, built) = repeat(self.effort, || Ok((Tables::build(points, &family)?, Vec::new())))?;
        let (rows, asked) = repeat(self.effort, || Ok((tables.knn(Queries::Points, k, None)?, Vec::new())))?;
        let method = "hashing (LSH), plain reference";
        self.add_nearest(method, false, (milliseconds(&built), milliseconds(&asked)), &rows)?;
        let (lists, asked) = repeat(self.effort, || Ok((tables.list_within(Queries::Points, radius)?, Vec::new())))?;
        self.add_within(method, false, (milliseconds(&built), milliseconds(&asked)), &lists)
    }

    pub(super) fn kd_tree(&mut self) -> Result<()> {
        let points = self.points;
        let (tree, built) = repeat(self.effort, || Ok((KdTree::build(points)?, Vec::new())))?;
        let (rows, asked) = repeat(self.effort, || Ok((tree.knn(Queries::Points, self.k)?, Vec::new())))?;
        self.add_nearest("kiddo, all cores", true, (milliseconds(&built), milliseconds(&asked)), &rows)?;
        let listed = || Ok((tree.list_within(Queries::Points, self.radius)?, Vec::new()));
        let (lists, asked) = repeat(self.effort, listed)?;
        self.add_within("kiddo, all cores", true, (milliseconds(&built), milliseconds(&asked)), &lists)
    }

    pub(super) fn ann(&mut self, program: &std::path::Path) -> Result<()> {
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
