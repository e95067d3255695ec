//! `nearfield-bench particles`: the experiments of sections 5.2 and 7 of Xing2017 on simulations, redone with every search, measured
//! neighbours and checked answers, and the sizes of the CUDA particles sample (Green2010).
//!
//! - [`figure_18`]: steps a second of grains over their number;
//! - [`figure_19`]: the time of every step, and rebuilds;
//! - [`figure_20`]: grains of three radii by every rule for pairs;
//! - [`green`]: the sample's sizes, with the memory's bandwidth;
//! - [`conservation`]: momentum and energy without walls;
//! - [`fluids`]: every model of fluids, and Accel's.
//!
//! Each writes a CSV file and plots into the folder; `summary.md` holds all values beside the paper's.

pub mod case;
pub mod check;
pub mod conservation;
pub mod figure_18;
pub mod figure_19;
pub mod figure_20;
pub mod fluids;
pub mod green;
pub mod original;
pub mod shifted_sort;
pub mod timing;
pub mod ways;

use std::path::PathBuf;

use nearfield::gpu::DeviceChoice;

use crate::Result;
use crate::paper::lab::{Lab, one_of};
use crate::paper::rows::Row;
use crate::paper::summary::{self, Head};

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The GPU: auto, gpu, gpu:N or part of a device name; cpu measures the CPU alone
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Numbers of particles are the paper's times this, but no fewer than 2000; below 1 runs have fewer steps too
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Experiments, such as figure-18,green; all where none is named
    #[arg(long, value_delimiter = ',', num_args = 1.., value_parser = experiment)]
    pub only: Vec<String>,
    /// Seconds of each experiment, shared by its rows: a run is cut where its time is over, and rows without time are noted as missing
    #[arg(long, default_value_t = 600.0)]
    pub budget: f64,
    /// Folder of the CSV files, the plots and summary.md
    #[arg(short, long)]
    pub output: PathBuf,
}

type Measure = fn(&Lab) -> Result<Vec<Row>>;

/// A name, and what measures it.
const EXPERIMENTS: [(&str, Measure); 6] = [
    ("figure-18", figure_18::measure),
    ("figure-19", figure_19::measure),
    ("figure-20", figure_20::measure),
    ("green", green::measure),
    ("conservation", conservation::measure),
    ("fluids", fluids::measure),
];

const HEAD: Head<'_> = Head {
    title: "The simulations of Xing2017, measured again",
    notes: &original::NOTES,
    times: "Steps a second are those of a run from the start of its scene, first builds included, by wall clock with the device having \
            finished; kernels are compiled before. The device is waited for after batches of steps, in figure 19 after each. Before and \
            after each run of grains its search makes some steps in deterministic mode, after which every particle must be to the bit where another \
            search leads it; after it all particles together must be where the others leave them.",
};

fn experiment(text: &str) -> std::result::Result<String, String> {
    one_of(&EXPERIMENTS.map(|(name, _)| name), text)
}

/// Runs the experiments that are named and writes their files. One that fails does not keep the others from running.
///
/// # Errors
/// `NoDevice`; a setting outside its range; after all have run, those that failed: what a simulation fails at, an answer that is wrong, a
/// file that cannot be written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { device, scale, budget, output, .. } = arguments;
    let lab = Lab::new(device, *scale, *budget, output)?;
    for line in lab.caption() {
        println!("{line}");
    }
    let (mut parts, mut failures) = (Vec::new(), Vec::new());
    for (name, measure) in EXPERIMENTS {
        if !arguments.only.is_empty() && !arguments.only.iter().any(|wanted| wanted == name) {
            continue;
        }
        match measure(&lab) {
            Ok(rows) => parts.push((name, rows)),
            Err(error) => {
                eprintln!("{name} failed: {error}");
                failures.push(error.to_string());
            }
        }
        summary::write(&lab, &HEAD, &command(arguments), &parts)?;
    }
    if failures.is_empty() { Ok(()) } else { Err(failures.join("; ").into()) }
}

/// The command that gives these files.
fn command(arguments: &Arguments) -> String {
    let Arguments { device, scale, budget, only, .. } = arguments;
    let only = if only.is_empty() { String::new() } else { format!(" --only {}", only.join(",")) };
    format!("nearfield-bench particles --device {device} --scale {scale} --budget {budget}{only} -o DIR")
}
