//! `nearfield-bench applications`: the experiments of section 5.2 of Xing2017 on surfaces, redone with every search, measured
//! neighbours, checked answers, and the quality of what comes out beside the time it takes.
//!
//! - [`figure_14`]: 30 iterations of smoothing, with lists by every search and without lists;
//! - [`figure_15`]: the searches of 100 iterations of resampling, among samples and from samples to points;
//! - [`table_3`]: distance fields of 257³ nodes by mode, and the nearest sample of each node by every search;
//! - [`figure_17`]: the surface of a field and its offsets, contoured;
//! - [`quality`]: how near noisy surfaces come to the truth by each method of moving least squares.
//!
//! Each writes a CSV file, plots and pictures into the folder; `summary.md` holds all values beside the paper's. Searches are those of
//! [`crate::paper::methods`].

pub mod field;
pub mod figure_14;
pub mod figure_15;
pub mod figure_17;
pub mod nearest;
pub mod original;
pub mod picture;
pub mod plane_fit;
pub mod plotting;
pub mod quality;
pub mod resampling_path;
pub mod scans;
pub mod smoothing;
pub mod surfaces;
pub mod table_3;
pub mod torus;

use std::path::PathBuf;

use nearfield::gpu::DeviceChoice;

use crate::Result;
use crate::paper::lab::{Lab, one_of};
use crate::paper::methods::{self, Plug};
use crate::paper::rows::Row;
use crate::paper::summary::{self, Head};
use crate::rays::meshes::data_folder;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The GPU: auto, gpu, gpu:N or part of a device name; cpu measures the methods of the CPU alone
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Numbers of points are the paper's times this, but no fewer than 2000; the sides of grids go with its root
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Experiments, such as figure-14,table-3; all where none is named
    #[arg(long, value_delimiter = ',', num_args = 1.., value_parser = experiment)]
    pub only: Vec<String>,
    /// Seconds of each experiment after which its remaining rows are noted as missing
    #[arg(long, default_value_t = 600.0)]
    pub budget: f64,
    /// Folder of the meshes [default: the variable NEARFIELD_DATA, else ../shared/data beside the repository]; without a mesh a
    /// ball takes its place
    #[arg(long)]
    pub data: Option<PathBuf>,
    /// Folder of the CSV files, plots, pictures and summary.md
    #[arg(short, long)]
    pub output: PathBuf,
}

/// What the experiments share beside the devices: where meshes are.
pub struct Workshop {
    /// Devices, scale, budget and folder.
    pub lab: Lab,
    /// Folder of the meshes.
    pub data: PathBuf,
}

type Measure = fn(&Workshop) -> Result<Vec<Row>>;

/// A name, and what measures it.
const EXPERIMENTS: [(&str, Measure); 5] = [
    ("figure-14", figure_14::measure),
    ("figure-15", figure_15::measure),
    ("table-3", table_3::measure),
    ("figure-17", figure_17::measure),
    ("quality", quality::measure),
];

const HEAD: Head<'_> = Head {
    title: "The applications of Xing2017, measured again",
    notes: &original::NOTES,
    times: "Times are wall clock with the device having finished. A total begins with points in host memory and ends with the result \
            there: allocation, copies and builds included, the compilation of kernels not. Every answer was checked in the run that timed it. Of \
            a search that may miss neighbours the recall stands behind the time.",
};

fn experiment(text: &str) -> std::result::Result<String, String> {
    one_of(&EXPERIMENTS.map(|(name, _)| name), text)
}

/// Runs the experiments that are named and writes their files.
///
/// # Errors
/// `NoDevice`; a setting outside its range; what a method returns; an answer that is wrong; a file that cannot be read or written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { device, scale, budget, output, .. } = arguments;
    let lab = Lab::new(device, *scale, *budget, output)?;
    let workshop = Workshop { lab, data: data_folder(arguments.data.as_deref()) };
    for line in workshop.lab.caption() {
        println!("{line}");
    }
    let mut parts = Vec::new();
    for (name, measure) in EXPERIMENTS {
        if arguments.only.is_empty() || arguments.only.iter().any(|wanted| wanted == name) {
            parts.push((name, measure(&workshop)?));
            summary::write(&workshop.lab, &HEAD, &command(arguments), &parts)?;
        }
    }
    Ok(())
}

/// The command that gives these files.
fn command(arguments: &Arguments) -> String {
    let Arguments { device, scale, budget, only, .. } = arguments;
    let only = if only.is_empty() { String::new() } else { format!(" --only {}", only.join(",")) };
    format!("nearfield-bench applications --device {device} --scale {scale} --budget {budget}{only} -o DIR")
}

/// The searches of the applications; the paper's own first.
pub const SEARCHES: &[Plug] = &[
    methods::aabb_tree::COHERENT,
    methods::aabb_tree::PRIMARY,
    methods::aabb_tree::PACKED,
    methods::uniform_grid::ON_GPU,
    methods::uniform_grid::FIXED_256,
    methods::uniform_grid::FIXED_128,
    methods::shifted_sort::ON_GPU,
    methods::aabb_tree::ON_CPU,
    methods::uniform_grid::ON_CPU,
    methods::kd_tree::ON_CPU,
];

/// Those that this machine can run.
pub fn searches(lab: &Lab) -> impl Iterator<Item = &'static Plug> {
    let has_gpu = lab.gpu().is_some();
    SEARCHES.iter().filter(move |plug| has_gpu || !plug.on_gpu)
}
