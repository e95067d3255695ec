//! `nearfield-bench wlop`: locally optimal projection, its times, and its samples beside those of CGAL.
//!
//! Without options it times all variants on a noisy torus as large as the Kitten of Xing2017. Every run is checked: its first
//! iteration on a device against that on the CPU, and all samples for numbers.

mod cgal;
mod times;

use std::path::PathBuf;

use nearfield::gpu::DeviceChoice;

use crate::Result;
use crate::provenance::Machine;

/// What is timed and compared.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// auto, cpu, gpu, gpu:N or part of a device name
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// A file of points, instead of the torus
    #[arg(long)]
    points: Option<PathBuf>,
    /// Samples
    #[arg(long, default_value_t = 20_000)]
    count: usize,
    /// Iterations
    #[arg(long, default_value_t = 100)]
    iterations: u32,
    /// The radius of all variants in spacings of the samples, instead of their defaults
    #[arg(long)]
    spacings: Option<f64>,
    /// Only compare with the program that scripts/build_cgal_peer.sh makes: one iteration within 1e-9 of the diagonal, 35 within 1e-6
    #[arg(long, value_name = "PROGRAM")]
    cgal: Option<PathBuf>,
}

/// Runs what was asked for.
///
/// # Errors
/// A wrong answer; files, programs and devices that cannot be used.
pub fn run(arguments: &Arguments) -> Result<()> {
    if let Some(program) = &arguments.cgal {
        return cgal::compare(program);
    }
    let machine = Machine::open(&arguments.device)?;
    times::run(&machine, arguments)
}
