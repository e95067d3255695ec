//! `nearfield-bench rays`: Accel's experiments on its kd-tree, and how fast rays are cast here.
//!
//! - [`counts`]: triangle tests a ray as in its heat maps, over all of its mesh and over the three corners of each quad that
//!   it read;
//! - [`growth`]: 750 × 750 primary rays against the number of triangles, all structures, with Accel's figures;
//! - [`shares`]: build, copy to the device and traversal, for Accel's trees and ours;
//! - [`speed`]: primary rays, diffuse bounces, shadow rays and all hits on the Stanford bunny, and the build of a tree
//!   over a million triangles, with this library's targets;
//! - [`paths`]: iterations of a path tracer on Accel's bunny in a room;
//! - [`embree`]: hits and times beside Embree's, where its program is given.
//!
//! Every ray of every row is compared with the answer of the CPU, and that with brute force on a sample of the rays
//! ([`check`]). Source: the README of Accel (Newlin and Rerucha). Differs: its times are of one run and on the GPU with
//! allocation and upload; its rays pass triangles that its test takes for degenerate.

pub mod check;
pub mod counts;
pub mod embree;
pub mod growth;
pub mod meshes;
pub mod method;
pub mod paths;
pub mod published;
pub mod rows;
pub mod shares;
pub mod shots;
pub mod speed;

use std::path::PathBuf;
use std::time::Instant;

use nearfield::KdTreeSettings;
use nearfield::gpu::{DeviceChoice, Gpu};

use crate::measure::Effort;
use crate::provenance::{COMMIT, Device, Machine};
use crate::{Error, Result};
use meshes::Source;
use method::Method;
use rows::Row;

/// A part of the experiments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// Time against the number of triangles.
    Triangles,
    /// Triangle tests a ray, on the mesh and on Accel's three corners of its quads.
    Counts,
    /// Shares of build, copy and traversal.
    Shares,
    /// The speed table and the build of a large tree.
    Speed,
    /// Iterations of the path tracer.
    Paths,
}

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The GPU: auto, gpu, gpu:N or part of a device name; cpu leaves those rows out
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Numbers of rays and triangles times this; other than 1, meshes are icospheres
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Seconds: a cast of brute force that would take more than a sixth of them is estimated from some rows of the picture,
    /// the path tracer is stopped after a sixth of what is left, and no cast is begun after them
    #[arg(long, default_value_t = 480.0)]
    pub budget: f64,
    /// Folder of the meshes [default: the variable NEARFIELD_DATA, else ../shared/data beside the repository]
    #[arg(long)]
    pub data: Option<PathBuf>,
    /// Parts, such as speed,shares
    #[arg(long, value_delimiter = ',', default_value = "counts,speed,shares,paths,triangles")]
    pub parts: Vec<Part>,
    /// Timed runs of a row at most, and iterations of the path tracer; with it the GPU is not warmed up
    #[arg(long)]
    pub repeat: Option<usize>,
    /// Take the time it takes, whatever the budget: the path tracer runs its two minutes by every structure, and brute force
    /// casts all rays; about 20 minutes without a GPU, 30 with one, longer with a software renderer
    #[arg(long, conflicts_with = "repeat")]
    pub full: bool,
    /// The program that scripts/build_embree_peer.sh makes: its hits and times are compared too
    #[arg(long)]
    pub embree: Option<PathBuf>,
    /// Folder of rays.csv, triangles.svg, shares-cpu.svg and shares-gpu.svg
    #[arg(short, long)]
    pub output: PathBuf,
}

/// What all parts share: the machine, the meshes, the clock and the rows.
pub struct Lab {
    /// The machine.
    pub machine: Machine,
    /// Where meshes come from.
    pub source: Source,
    /// The kd-tree that is measured.
    pub tree: KdTreeSettings,
    /// Seconds in all.
    pub budget: f64,
    /// Rows so far.
    pub rows: Vec<Row>,
    /// Whether nothing is estimated or cut short.
    pub full: bool,
    begin: Instant,
    scale: f64,
    repeat: Option<usize>,
}

impl Lab {
    /// Opens the device.
    ///
    /// # Errors
    /// `NoDevice`; a scale or a budget that is not a positive number.
    pub fn open(arguments: &Arguments) -> Result<Self> {
        for (name, value) in [("--scale", arguments.scale), ("--budget", arguments.budget)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{name} {value}: expected a number above 0").into());
            }
        }
        Ok(Self {
            machine: Machine::open(&arguments.device)?,
            source: Source::new(arguments.data.as_deref(), arguments.scale),
            tree: KdTreeSettings::default(),
            budget: if arguments.full { f64::INFINITY } else { arguments.budget },
            full: arguments.full,
            rows: Vec::new(),
            begin: Instant::now(),
            scale: arguments.scale,
            repeat: arguments.repeat,
        })
    }

    /// The GPU, if there is one.
    pub fn gpu(&self) -> Option<&Gpu> {
        match &self.machine.device {
            Device::Gpu(gpu) => Some(gpu),
            Device::Cpu => None,
        }
    }

    /// Seconds of the budget that are left.
    pub fn left(&self) -> f64 {
        self.budget - self.begin.elapsed().as_secs_f64()
    }

    /// Side of a picture with that side at full scale.
    pub fn side(&self, side: usize) -> usize {
        ((side as f64 * self.scale.sqrt()).round() as usize).max(16)
    }

    /// A number of rays at this scale.
    pub fn rays(&self, n: usize) -> usize {
        ((n as f64 * self.scale) as usize).max(256)
    }

    /// Name of the device of a method.
    pub fn device(&self, method: Method) -> String {
        if method.on_gpu() { self.machine.name.clone() } else { self.machine.host.clone() }
    }

    /// How often a cast is repeated.
    pub fn effort(&self, method: Method) -> Effort {
        let is_quiet = self.repeat.is_some() || !method.on_gpu() || !self.machine.is_hardware_gpu();
        Effort { warm_up: if is_quiet { 0.0 } else { 0.5 }, runs: self.repeat.unwrap_or(9).max(1), seconds: 2.0 }
    }

    /// Prints a row and keeps it.
    pub fn add(&mut self, row: Row) {
        println!("{}", row.markdown());
        self.rows.push(row);
    }
}

/// The note for what a device does not do; other errors stay errors.
///
/// # Errors
/// Any error but `Unsupported` and `OutOfDeviceMemory`.
pub fn unsupported(error: Error) -> Result<String> {
    use nearfield::Error::{OutOfDeviceMemory, Unsupported};
    match error.downcast_ref::<nearfield::Error>() {
        Some(known @ (Unsupported { .. } | OutOfDeviceMemory { .. })) => Ok(format!("not possible: {known}")),
        _ => Err(error),
    }
}

/// Measures, prints a line a row, and writes the files.
///
/// # Errors
/// `NoDevice`; a setting outside its range; what a build or a cast returns; an answer that is wrong; a file that cannot
/// be read or written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let mut lab = Lab::open(arguments)?;
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let machine = &lab.machine;
    println!("commit {COMMIT}; GPU: {} ({}); host: {}\n\n{}", machine.name, machine.driver, machine.host, Row::head());
    for part in [Part::Counts, Part::Speed, Part::Shares, Part::Paths, Part::Triangles] {
        if arguments.parts.contains(&part) {
            match part {
                Part::Counts => counts::measure(&mut lab),
                Part::Triangles => growth::measure(&mut lab),
                Part::Shares => shares::measure(&mut lab),
                Part::Speed => speed::measure(&mut lab),
                Part::Paths => paths::measure(&mut lab),
            }?;
            rows::save(&folder.join("rays.csv"), &lab.rows, &lab.machine.driver)?;
        }
    }
    if let Some(program) = &arguments.embree {
        embree::measure(&mut lab, program)?;
        rows::save(&folder.join("rays.csv"), &lab.rows, &lab.machine.driver)?;
    }
    if arguments.parts.contains(&Part::Triangles) {
        growth::plot(&lab, &folder.join("triangles.svg"))?;
    }
    if arguments.parts.contains(&Part::Shares) {
        shares::plot(&lab, &folder.join("shares-cpu.svg"), false)?;
        shares::plot(&lab, &folder.join("shares-gpu.svg"), true)?;
    }
    println!("\n{:.0} s in all; files in {}", lab.begin.elapsed().as_secs_f64(), folder.display());
    Ok(())
}
