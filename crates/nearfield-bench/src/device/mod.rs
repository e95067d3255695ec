//! `nearfield-bench device`: build, count and list on one device, beside what other libraries need for the same sets.
//!
//! Sets are those of [`crate::sets`]: every point queries its own set, itself included, the radius goes with the set.
//! Rows are "build" (points on the device, bounds known), "bounds" (finding them there), "count" and "list" (query
//! alone, list as compressed sparse rows in query order), "build + list", and "points in, list out" (all of it from
//! host memory and back, wall clock). For the AABB-tree also "refit", "refit + list" and "kNN 16".

mod on_cpu;
mod on_gpu;
mod peers;
mod table;
pub(crate) mod timed;
mod tree_on_cpu;
mod tree_on_gpu;

use std::path::PathBuf;

use nearfield::gpu::DeviceChoice;

use crate::Result;
use crate::measure::Effort;
use crate::provenance::{Device, Machine};
use crate::sets::Set;
use table::Table;
pub(crate) use timed::device_points;
pub(crate) use tree_on_gpu::{NEAREST, fit};

/// Seconds after which an operation is not repeated again.
const SECONDS: f64 = 20.0;
/// Seconds of untimed runs on a GPU before each measurement.
const WARM_UP: f64 = 0.5;

/// Arguments of the subcommand.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// auto, cpu, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Sets, such as uniform-1m,shell-1m; by default those that suit the device
    #[arg(long, value_delimiter = ',')]
    pub sets: Vec<Set>,
    /// Structures: uniform-grid, aabb-tree
    #[arg(long, value_delimiter = ',', default_value = "uniform-grid,aabb-tree")]
    pub structures: Vec<Structure>,
    /// Most points of a leaf of the tree
    #[arg(long, default_value_t = nearfield::AabbTreeSettings::DEFAULT.bucket_size)]
    pub bucket: u32,
    /// Timed runs of an operation; by default 10, and 3 for answers of hundreds of millions of entries
    #[arg(long)]
    pub repeat: Option<usize>,
    /// Write every row and stage to this file
    #[arg(long)]
    pub csv: Option<PathBuf>,
    /// Write the printed table to this file
    #[arg(long)]
    pub markdown: Option<PathBuf>,
}

/// A structure that is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Structure {
    /// The uniform grid.
    UniformGrid,
    /// The AABB-tree.
    AabbTree,
}

/// Prints the table, set by set; the files are complete after each set.
///
/// # Errors
/// `NoDevice`; what a build or a query returns; an answer that is wrong; a file that cannot be written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let mut table = Table::new(machine.clone());
    print!("{}", table.markdown_head());
    for set in sets(arguments, &machine)? {
        let runs = arguments.repeat.unwrap_or(if set.is_big() { 3 } else { 10 }).max(1);
        let warm_up = if matches!(machine.device, Device::Gpu(_)) { WARM_UP } else { 0.0 };
        let effort = Effort { warm_up, runs, seconds: SECONDS };
        let (points, radius) = (set.points(), set.radius());
        let mut add = |row: table::Row| {
            println!("{}", table::markdown_row(&row, &machine));
            table.rows.push(row);
        };
        for structure in &arguments.structures {
            match (&machine.device, structure) {
                (Device::Cpu, Structure::UniformGrid) => on_cpu::measure(&set, &points, radius, effort, &mut add)?,
                (Device::Cpu, Structure::AabbTree) => {
                    tree_on_cpu::measure(&set, &points, radius, arguments.bucket, effort, &mut add)?
                }
                (Device::Gpu(gpu), Structure::UniformGrid) => {
                    on_gpu::measure(gpu, &set, &points, radius, effort, &mut add)?;
                }
                (Device::Gpu(gpu), Structure::AabbTree) => {
                    tree_on_gpu::measure(gpu, &set, &points, radius, arguments.bucket, effort, &mut add)?;
                }
            }
        }
        if let Some(path) = &arguments.csv {
            table.save_csv(path)?;
        }
        if let Some(path) = &arguments.markdown {
            table.save_markdown(path)?;
        }
    }
    Ok(())
}

fn sets(arguments: &Arguments, machine: &Machine) -> Result<Vec<Set>> {
    if !arguments.sets.is_empty() {
        return Ok(arguments.sets.clone());
    }
    let names: &[&str] = match &machine.device {
        Device::Gpu(_) if machine.is_hardware_gpu() => &["uniform-1m", "shell-1m", "uniform-10m", "clustered-1m"],
        Device::Gpu(_) => &["uniform-10k", "uniform-100k"],
        Device::Cpu => &["uniform-100k", "uniform-1m", "shell-1m"],
    };
    names.iter().map(|name| name.parse()).collect()
}
