//! `nearfield-bench growth`: time a point of build and count by every structure, from ten thousand points to a hundred million.
//!
//! Sets are uniform, shell and clustered, with radii for about as many neighbours at every number of points, which are measured.
//! Where a structure's time a point stays the same, its line in the plot is flat.
//!
//! - `clouds.rs`: the points, and radii for as many neighbours;
//! - `on_gpu.rs`, `on_cpu.rs`: build and count by each structure;
//! - `rows.rs`: what comes of it, as a table, a CSV file and a plot.
//!
//! Up to 300,000 points every count is compared with that of the reference, beyond some queries with a plain loop over all points; and
//! the totals of all structures with each other. Whatever does not fit the device, or would take too long, is a row that says so.

mod clouds;
mod on_cpu;
mod on_gpu;
mod rows;

use std::path::PathBuf;
use std::time::Instant;

use nearfield::geometry::generate::CloudKind;
use nearfield::gpu::DeviceChoice;

use crate::provenance::{Device, Machine};
use crate::{Error, Result};
use clouds::Cloud;
use rows::{Row, Table};

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, cpu, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Fewest points
    #[arg(long, default_value_t = 10_000)]
    pub least: usize,
    /// Most points; 100,000,000 by default, 100,000 on a software device
    #[arg(long)]
    pub most: Option<usize>,
    /// Seconds after which nothing further is begun
    #[arg(long, default_value_t = 600.0)]
    pub budget: f64,
    /// Folder of growth.csv, growth.svg and growth.md
    #[arg(short, long)]
    pub output: PathBuf,
}

/// The sets.
const KINDS: [CloudKind; 3] = [CloudKind::Uniform, CloudKind::Shell, CloudKind::Clustered];
/// Most points on hardware, and on a software device.
const MOST: [usize; 2] = [100_000_000, 100_000];

/// Numbers of points by factors of about three: 10 k, 30 k, 100 k …
fn numbers(least: usize, most: usize) -> Vec<usize> {
    let decades = (0..=9).map(|exponent| 10usize.pow(exponent));
    decades.flat_map(|decade| [decade, 3 * decade]).filter(|n| (least..=most).contains(n)).collect()
}

/// What a structure is measured by, and until when.
struct Task<'a> {
    cloud: &'a Cloud,
    begin: Instant,
    budget: f64,
}

impl Task<'_> {
    fn is_over(&self) -> bool {
        self.begin.elapsed().as_secs_f64() >= self.budget
    }
}

/// Measures every structure at every number of points and writes the files after each.
///
/// # Errors
/// `NoDevice`; no number between `least` and `most`; a wrong answer; what a build or a query fails at but for memory; a file that
/// cannot be written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let machine = Machine::open(&arguments.device)?;
    let is_software = matches!(machine.device, Device::Gpu(_)) && !machine.is_hardware_gpu();
    let most = arguments.most.unwrap_or(MOST[usize::from(is_software)]);
    let numbers = numbers(arguments.least.max(1), most);
    if numbers.is_empty() {
        let least = arguments.least;
        return Err(
            format!("no number of points such as 10000 or 30000 is between --least {least} and --most {most}").into()
        );
    }
    if !(arguments.budget >= 0.0) {
        return Err(format!("--budget {} is not usable: expected seconds, 0 or more", arguments.budget).into());
    }
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).map_err(|error| Error::from(format!("{}: {error}", folder.display())))?;
    let begin = Instant::now();
    let mut table = Table::new(machine.clone());
    print!("{}", table.head());
    // Small numbers of all sets first: a budget that is spent then cuts the ends of all lines alike.
    for &n in &numbers {
        for kind in KINDS {
            if begin.elapsed().as_secs_f64() >= arguments.budget {
                table.add(Row::missing(kind, n, "all", "left out: the budget is spent"));
                continue;
            }
            let cloud = Cloud::new(kind, n)?;
            let task = Task { cloud: &cloud, begin, budget: arguments.budget };
            match &machine.device {
                Device::Gpu(gpu) => on_gpu::measure(gpu, &task, &mut table)?,
                Device::Cpu => on_cpu::measure(&task, &mut table)?,
            }
        }
        table.save(folder)?;
    }
    println!("\n{:.0} s in all; files in {}", begin.elapsed().as_secs_f64(), folder.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_rise_by_about_three_between_the_ends() {
        let all = numbers(10_000, 100_000_000);
        assert_eq!(all, [1, 3, 10, 30, 100, 300, 1000, 3000, 10_000].map(|k| 10_000 * k));
        assert_eq!(numbers(2000, 12_000), [3000, 10_000]);
        assert!(numbers(40, 50).is_empty());
    }
}
