//! `nearfield-bench baselines`: build and query times of every baseline with their recall, on points uniform in the unit
//! cube that ask among themselves.
//!
//! Each method is asked twice: for the k nearest, and for all within a radius, the median distance of the k-th nearest. Recall is
//! that of a sample of the queries by brute force in f64; a method that promises to be exact and misses one stops the run.

use std::path::PathBuf;

use nearfield::Vec3;
use nearfield::gpu::DeviceChoice;

use super::exact;
use super::lsh::LshSettings;
use super::methods::{Case, Row};
use super::points::{Points, Queries};
use super::shifted_sort::ShiftedSortSettings;
use crate::Result;
use crate::measure::Effort;
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

const SEED: u64 = 7;
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

fn in_space(points: &Points) -> Vec<Vec3> {
    points.coordinates().chunks_exact(3).map(|p| Vec3::new(p[0], p[1], p[2])).collect()
}
