//! `nearfield-bench paper`: the experiments of section 5.1 of Xing2017 on moving points, redone with every method, measured
//! neighbours and checked answers.
//!
//! - [`figure_7`]: refit with nodes level by level and shuffled;
//! - [`figure_9`]: steps a second as boxes grow;
//! - [`figure_10`]: a step of moving points, all methods;
//! - [`figure_11`]: 3 to 12 dimensions;
//! - [`figure_12`]: active lanes of the searches and, figure 13, by phase;
//! - [`table_1`]: time and memory over the radius;
//! - [`table_2`]: refit against builds;
//! - [`ratios`]: what the paper says beside its figures.
//!
//! Each writes a CSV file and plots into the folder; `summary.md` holds all values beside the paper's. The methods are files in
//! [`methods`].

pub mod figure_10;
pub mod figure_11;
pub mod figure_12;
pub mod figure_7;
pub mod figure_9;
pub mod growth;
pub mod lab;
pub mod measured;
pub mod methods;
pub mod motion;
pub mod original;
pub mod plotting;
pub mod ratios;
pub mod refit;
pub mod rows;
pub mod summary;
pub mod table_1;
pub mod table_2;

use std::path::PathBuf;

use nearfield::gpu::DeviceChoice;

use crate::Result;
use lab::Lab;
use rows::Row;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// all; else name tables and figures
    #[arg(value_parser = ["all"])]
    pub all: Option<String>,
    /// A table of the paper: 1 or 2
    #[arg(long = "table", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub tables: Vec<u8>,
    /// A figure of the paper: 7 or 9 to 13
    #[arg(long = "figure", value_parser = figure)]
    pub figures: Vec<u8>,
    /// The GPU: auto, gpu, gpu:N or part of a device name; cpu measures the methods of the CPU alone
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Numbers of points are the paper's times this, but no fewer than 2000
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Seconds of each experiment after which its remaining rows are noted as missing
    #[arg(long, default_value_t = 300.0)]
    pub budget: f64,
    /// Folder of the CSV files, the plots and summary.md
    #[arg(short, long)]
    pub output: PathBuf,
}

type Measure = fn(&Lab) -> Result<Vec<Row>>;

/// A name, and what measures it.
const EXPERIMENTS: [(&str, Measure); 8] = [
    ("table-1", table_1::measure),
    ("table-2", table_2::measure),
    ("figure-7", figure_7::measure),
    ("figure-9", figure_9::measure),
    ("figure-10", figure_10::measure),
    ("figure-11", figure_11::measure),
    ("figure-12", figure_12::measure),
    ("claims", ratios::measure),
];

fn figure(text: &str) -> std::result::Result<u8, String> {
    let known = |number: &u8| [7, 9, 10, 11, 12, 13].contains(number);
    text.parse().ok().filter(known).ok_or_else(|| format!("{text:?} is no figure of the tests: expected 7 or 9 to 13"))
}

/// Runs the experiments that are named and writes their files.
///
/// # Errors
/// Nothing named; `NoDevice`; a setting outside its range; what a method returns; an answer that is wrong; a file that cannot be
/// written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let tables = arguments.tables.iter().map(|number| format!("table-{number}"));
    // Figure 13 is figure 12 by phase.
    let figures = arguments.figures.iter().map(|&number| format!("figure-{}", if number == 13 { 12 } else { number }));
    let named: Vec<String> = tables.chain(figures).collect();
    if named.is_empty() == arguments.all.is_none() {
        return Err("name what to measure: all, or some of --table 1|2 and --figure 7|9|10|11|12|13".into());
    }
    let lab = Lab::open(arguments)?;
    for line in lab.caption() {
        println!("{line}");
    }
    let mut parts = Vec::new();
    for (name, measure) in EXPERIMENTS {
        if arguments.all.is_some() || named.iter().any(|wanted| wanted == name) {
            parts.push((name, measure(&lab)?));
            summary::write(&lab, &summary::HEAD, &command(arguments), &parts)?;
        }
    }
    Ok(())
}

/// The command that gives these files.
fn command(arguments: &Arguments) -> String {
    let mut words = vec!["nearfield-bench paper".to_owned()];
    words.extend(arguments.all.clone());
    words.extend(arguments.tables.iter().map(|number| format!("--table {number}")));
    words.extend(arguments.figures.iter().map(|number| format!("--figure {number}")));
    let Arguments { device, scale, budget, .. } = arguments;
    words.push(format!("--device {device} --scale {scale} --budget {budget} -o DIR"));
    words.join(" ")
}
