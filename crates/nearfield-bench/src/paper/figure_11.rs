//! Figure 11: time of the queries over the dimension, 20 k points; k = 20 by hashing, and a radius with 20 points on average for
//! the range searches. All on one device, the GPU where there is one.

use nearfield::{AabbTreeN, AabbTreeNSettings, FixedRadiusN, GpuAabbTreeN, TreeSearch};
use rayon::prelude::*;

use super::lab::{Lab, Spot};
use super::measured::device_milliseconds;
use super::plotting;
use super::rows::{Row, Sheet};
use crate::Result;
use crate::baselines::kd_tree_cpu::KdTree;
use crate::baselines::lsh::{GpuLsh, HashFamily, LshSettings, reference::Tables};
use crate::baselines::points::dist2_in_f64;
use crate::baselines::{KnnRows, Points, Queries, RangeRows, exact, recall};
use crate::measure::{Measured, repeat};
use crate::plots::{Axes, Frame, Panel};
use crate::sets::SEED;

const POINTS: usize = 20_000;
const K: usize = 20;
const DIMENSIONS: std::ops::RangeInclusive<usize> = 3..=12;
/// Queries that are judged by brute force, and that the radius is tuned by.
const SAMPLE: usize = 500;
const QUANTITY: &str = "query";

/// The points of a dimension, and what answers are judged by.
struct Case {
    points: Points,
    radius: f32,
    mean: f64,
    sample: Vec<u32>,
    nearest: KnnRows,
}

/// Measures every dimension with every method.
///
/// # Errors
/// What a method returns; a wrong answer; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "figure-11")?;
    let n = lab.points(POINTS);
    for dimension in DIMENSIONS {
        let mut case = None;
        for method in methods(lab) {
            let on_gpu = method.ends_with("GPU");
            let spot = Spot { paper_points: POINTS, points: Vec::new(), stretch: 1.0 };
            let blank = spot.row(lab.device(on_gpu), "", 0.0, method);
            let mut row = Row { quantity: QUANTITY, points: n, dimension, ..blank };
            sheet.attempt(row.clone(), || {
                let case = match &case {
                    Some(case) => case,
                    None => case.insert(Case::new(n, dimension)?),
                };
                row.radius = f64::from(case.radius);
                row.mean_neighbors = Some(case.mean);
                let (measured, recall) = by_dimension(lab, case, method)?;
                row.runs = measured.runs;
                row.device_milliseconds = device_milliseconds(&measured.stages);
                row.recall = recall;
                row.note = format!("{} queries judged by brute force; rows read back", case.sample.len());
                Ok(vec![row.value(measured.wall.median)])
            })?;
        }
    }
    plot(lab, sheet.rows())?;
    Ok(sheet.into_rows())
}

fn methods(lab: &Lab) -> &'static [&'static str] {
    if lab.gpu().is_some() {
        &["LSH, GPU", "tree coherent, GPU", "tree primary, GPU", "tree packed, CPU", "kd-tree, CPU"]
    } else {
        &["LSH, CPU", "tree coherent, CPU", "tree primary, CPU", "tree packed, CPU", "kd-tree, CPU"]
    }
}

impl Case {
    fn new(n: usize, dimension: usize) -> Result<Self> {
        let points = Points::uniform(n, dimension, SEED)?;
        let sample = exact::sample(n, SAMPLE);
        // The radius within which the queries of the sample have K points on average: their K · sample nearest pairs.
        let distances = |&query: &u32| -> Vec<f64> {
            (0..n).map(|i| dist2_in_f64(points.get(query as usize), points.get(i))).collect()
        };
        let mut all: Vec<f64> = sample.par_iter().flat_map_iter(distances).collect();
        let last = (K * sample.len()).min(all.len()) - 1;
        let radius = all.select_nth_unstable_by(last, f64::total_cmp).1.sqrt() as f32;
        let nearest = exact::knn(&points, Queries::Points, &sample, K);
        let counts = KdTree::build(&points)?.count_within(Queries::Points, radius)?;
        let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / n as f64;
        Ok(Self { points, radius, mean, sample, nearest })
    }

    /// Recall of lists; an exact method that misses any is wrong.
    fn judge_exact(&self, rows: &RangeRows) -> Result<()> {
        let quality = recall::of_range(&self.points, Queries::Points, &self.sample, self.radius, rows)?;
        if quality.recall < 1.0 {
            return Err(format!("wrong answer: an exact search has recall {}", quality.recall).into());
        }
        Ok(())
    }

    fn judge_nearest(&self, rows: &KnnRows) -> Result<f64> {
        Ok(recall::of_knn(&self.points, Queries::Points, &self.sample, rows, &self.nearest)?.recall)
    }
}

/// Times one method; its recall where it may miss neighbours.
fn by_dimension(lab: &Lab, case: &Case, method: &str) -> Result<(Measured, Option<f64>)> {
    let measure = match case.points.dimension() {
        3 => run::<3>,
        4 => run::<4>,
        5 => run::<5>,
        6 => run::<6>,
        7 => run::<7>,
        8 => run::<8>,
        9 => run::<9>,
        10 => run::<10>,
        11 => run::<11>,
        _ => run::<12>,
    };
    measure(lab, case, method)
}

fn run<const D: usize>(lab: &Lab, case: &Case, method: &str) -> Result<(Measured, Option<f64>)> {
    let effort = lab.effort();
    let positions = || -> Vec<[f32; D]> {
        case.points.coordinates().chunks_exact(D).map(|p| std::array::from_fn(|axis| p[axis])).collect()
    };
    let question = FixedRadiusN::new(case.radius);
    let settings = |search| AabbTreeNSettings::default().search(search);
    let search = if method.contains("primary") { TreeSearch::Primary } else { TreeSearch::Coherent };
    match (method, lab.gpu()) {
        ("LSH, GPU", Some(gpu)) => {
            let family = HashFamily::draw(&case.points, &LshSettings::for_k(K))?;
            let tables = GpuLsh::build(gpu, &case.points, &family)?;
            let (rows, measured) = repeat(effort, || {
                let timed = tables.knn(Queries::Points, K, None)?;
                Ok((timed.answer, timed.stages))
            })?;
            Ok((measured, Some(case.judge_nearest(&rows)?)))
        }
        ("LSH, CPU", _) => {
            let family = HashFamily::draw(&case.points, &LshSettings::for_k(K))?;
            let tables = Tables::build(&case.points, &family)?;
            let (rows, measured) = repeat(effort, || Ok((tables.knn(Queries::Points, K, None)?, Vec::new())))?;
            Ok((measured, Some(case.judge_nearest(&rows)?)))
        }
        ("kd-tree, CPU", _) => {
            let tree = KdTree::build(&case.points)?;
            let list = || Ok((tree.list_within(Queries::Points, case.radius)?, Vec::new()));
            let (rows, measured) = repeat(effort, list)?;
            case.judge_exact(&rows)?;
            Ok((measured, None))
        }
        (name, Some(gpu)) if name.ends_with("GPU") => {
            let tree = GpuAabbTreeN::build(gpu, &positions(), &settings(search))?;
            let (list, measured) = repeat(effort, || {
                let list = tree.list(&question)?;
                let stages = list.report.stages.clone();
                Ok((list, stages))
            })?;
            case.judge_exact(&RangeRows { offsets: list.offsets().to_vec(), ids: list.indices().to_vec() })?;
            Ok((measured, None))
        }
        (name, _) => {
            let search = if name.contains("packed") { TreeSearch::Packed } else { search };
            let tree = AabbTreeN::build(&positions(), &settings(search))?;
            let (list, measured) = repeat(effort, || Ok((tree.list(&question)?, Vec::new())))?;
            case.judge_exact(&RangeRows { offsets: list.offsets().to_vec(), ids: list.indices().to_vec() })?;
            Ok((measured, None))
        }
    }
}

fn plot(lab: &Lab, rows: &[Row]) -> Result<()> {
    let series = plotting::by_method(rows.iter(), |row| row.dimension as f64);
    let points = rows.first().map_or(0, |row| row.points);
    let recalls = rows.iter().filter_map(|row| row.recall);
    let (low, high) = recalls.fold((f64::INFINITY, 0.0), |(low, high), r| (f64::min(low, r), f64::max(high, r)));
    let mut caption = lab.caption();
    if high > 0.0 {
        caption.push(format!("Recall of the hashing: {low:.3} to {high:.3}; the others are exact. The paper: hashing is faster from 12 dimensions."));
    }
    let frame = Frame {
        title: format!("Figure 11: {points} points, 20 neighbours, over the dimension"),
        caption,
        x_label: "dimension".to_owned(),
        y_label: "ms, rows read back".to_owned(),
        axes: Axes::LogarithmicY,
        legend_right: false,
    };
    plotting::save(lab, "figure-11.svg", &frame, &[Panel { title: String::new(), series }])
}
