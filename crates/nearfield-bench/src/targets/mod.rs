//! `nearfield-bench targets`: every row of the table of targets on one GPU, beside what is asked for, the best peer and the floor.
//!
//! - `table.rs`: the rows, each a name, its target, its peer, its floor and the function that measures it;
//! - `row.rs`: what a row is, and what measuring it gives;
//! - `bench.rs`: what rows share: the device, the sets with the answers they must give, the scans;
//! - `report.rs`: how rows are printed and written;
//! - the others: the functions, by subject. They call what the other subcommands measure with.
//!
//! Every answer is checked in the run that times it. A row that fails says so and the others go on; the command then ends with an
//! error. Nothing is begun once the budget is spent.

mod bench;
mod calls;
mod clusters;
mod lists;
mod memory;
mod nearest;
mod particles;
mod rays;
mod report;
mod row;
mod sorts;
mod surfaces;
mod table;

use std::path::PathBuf;

use nearfield::gpu::DeviceChoice;

use crate::Result;
use crate::device::timed::not_possible;
use crate::paper::lab::one_of;
use crate::provenance::Machine;
use bench::Bench;
use report::Report;
use row::Outcome;
use table::ROWS;

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// Rows, such as uniform-1m-list,sort-u32-1m; all where none is named
    #[arg(long, value_delimiter = ',', num_args = 1.., value_parser = row_name)]
    pub rows: Vec<String>,
    /// The GPU: auto, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "gpu")]
    pub device: DeviceChoice,
    /// Seconds after which no further row is begun
    #[arg(long, default_value_t = 600.0)]
    pub budget: f64,
    /// Numbers of points, rays and particles times this, but no fewer than 2000 points; other than 1, nothing is said about targets
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Folder of the meshes [default: the variable NEARFIELD_DATA, else ../shared/data beside the repository]; without a mesh something
    /// else takes its place, and the row says so
    #[arg(long)]
    pub data: Option<PathBuf>,
    /// Write every figure and stage to this file
    #[arg(long)]
    pub csv: Option<PathBuf>,
    /// Write the printed table to this file
    #[arg(long)]
    pub markdown: Option<PathBuf>,
}

/// The names of all rows, in the order in which they are measured.
pub fn names() -> Vec<&'static str> {
    ROWS.iter().map(|row| row.name).collect()
}

fn row_name(text: &str) -> std::result::Result<String, String> {
    one_of(&names(), text)
}

/// Measures the rows that are named, prints each as it comes, and writes the files.
///
/// # Errors
/// `NoDevice`; a device that is no GPU; a setting outside its range; a file that cannot be written; after all have run, those that
/// failed: an answer that is wrong, what a build or a query returns.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let mut bench = Bench::new(&machine, arguments.scale, arguments.budget, arguments.data.as_deref())?;
    let mut report = Report::new(machine, arguments.scale);
    print!("{}", report.head());
    let mut failures = Vec::new();
    for row in &ROWS {
        if !arguments.rows.is_empty() && !arguments.rows.iter().any(|name| name == row.name) {
            continue;
        }
        let outcome = if bench.left() <= 0.0 {
            Outcome::missing("left out: the budget is spent")
        } else {
            match (row.measure)(&mut bench) {
                Ok(outcome) => outcome,
                Err(error) => match not_possible(error) {
                    Ok(note) => Outcome::missing(note),
                    Err(error) => {
                        failures.push(format!("{}: {error}", row.name));
                        Outcome::missing(format!("failed: {error}"))
                    }
                },
            }
        };
        for figure in outcome.figures {
            println!("{}", report.line(row, outcome.mean_neighbors, &figure));
            report.add(row, outcome.mean_neighbors, figure);
        }
        if let Some(path) = &arguments.csv {
            report.save_csv(path)?;
        }
        if let Some(path) = &arguments.markdown {
            report.save_markdown(path)?;
        }
    }
    println!("\n{:.0} s in all", bench.seconds());
    if failures.is_empty() { Ok(()) } else { Err(failures.join("; ").into()) }
}
