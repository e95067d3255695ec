//! The command `nearfield-bench`; each subcommand is a module of the library.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use nearfield::gpu::DeviceChoice;
use nearfield_bench::provenance::{Device, Machine};
use nearfield_bench::{
    Result, applications, auto, baselines, batches, curve, device, everyday, first_call, grid, growth, octree, paper,
    particles, primitives, rays, rivals, small, targets, transfers, wlop,
};

/// Measure Nearfield on this machine.
#[derive(Parser)]
#[command(version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// The paper's applications: smoothing, resampling, distance fields and offsets by every search, with their quality
    Applications(applications::Arguments),
    /// What auto builds for each set and question, beside every structure there is, and what its picks lose
    Auto(auto::Arguments),
    /// All lists of a hundred million points on the CPU, some queries at a time, with the memory at its peak
    Batches(batches::Arguments),
    /// Table of build, count and list on one device, beside the figures of other libraries.
    Device(device::Arguments),
    /// Wall clock of opening a device and of the first answer, with and without pipelines that were kept
    FirstCall(first_call::Arguments),
    /// The experiments of Accel on its uniform grid: CSV files, plots and claims
    Grid(grid::Arguments),
    /// Time a point from ten thousand to a hundred million points by every structure: CSV file, table and plot
    Growth(growth::Arguments),
    /// The charts of the poster on curves and octrees: CSV file, plots and a table
    Octree(octree::Arguments),
    /// The experiments of the paper on moving points: CSV files, plots and a summary beside its figures
    Paper(paper::Arguments),
    /// The paper's simulations: steps a second by every search, radii of three sizes, the CUDA sample's numbers of grains
    Particles(particles::Arguments),
    /// The experiments of Accel on its kd-tree, and the speed of rays: a CSV file and plots
    Rays(rays::Arguments),
    /// Lists and nearest points on the CPU beside kiddo's, by one thread and by all
    Rivals(rivals::Arguments),
    /// Every row of the table of targets on one GPU, beside its target, the best peer and the floor
    Targets(targets::Arguments),
    /// Wall clock of lists of few points, by a plan that keeps its memory and by a grid
    Small(small::Arguments),
    /// Bytes a second to the device and back, beside a copy on the host
    Transfers(transfers::Arguments),
    /// Locally optimal projection: times of all variants, and CGAL's samples beside the library's
    Wlop(wlop::Arguments),
    /// Approximate and other libraries' searches, with recall beside their times
    Baselines(baselines::Arguments),
    /// Clusters, outliers and fewer points of generated sets, with copies
    Everyday(everyday::Arguments),
    /// Times of keys along the curves and of relations between octants on one device
    Curve {
        /// auto, cpu, gpu, gpu:N or part of a device name
        #[arg(long, default_value = "auto")]
        device: DeviceChoice,
    },
    /// Times of scan, reduce and sort on one device
    Primitives {
        /// auto, cpu, gpu, gpu:N or part of a device name
        #[arg(long, default_value = "auto")]
        device: DeviceChoice,
    },
}

fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::Applications(arguments) => applications::run(&arguments),
        Command::Auto(arguments) => auto::run(&arguments),
        Command::Batches(arguments) => batches::run(&arguments),
        Command::Device(arguments) => device::run(&arguments),
        Command::FirstCall(arguments) => first_call::run(&arguments),
        Command::Grid(arguments) => grid::run(&arguments),
        Command::Growth(arguments) => growth::run(&arguments),
        Command::Octree(arguments) => octree::run(&arguments),
        Command::Paper(arguments) => paper::run(&arguments),
        Command::Particles(arguments) => particles::run(&arguments),
        Command::Rays(arguments) => rays::run(&arguments),
        Command::Rivals(arguments) => rivals::run(&arguments),
        Command::Targets(arguments) => targets::run(&arguments),
        Command::Small(arguments) => small::run(&arguments),
        Command::Transfers(arguments) => transfers::run(&arguments),
        Command::Wlop(arguments) => wlop::run(&arguments),
        Command::Baselines(arguments) => baselines::run(&arguments),
        Command::Everyday(arguments) => everyday::run(&arguments),
        Command::Curve { device } => match Machine::open(&device)?.device {
            Device::Cpu => Ok(curve::run_on_cpu()?),
            Device::Gpu(gpu) => Ok(curve::run(&gpu)?),
        },
        Command::Primitives { device } => match Machine::open(&device)?.device {
            Device::Cpu => Ok(primitives::run_on_cpu()?),
            Device::Gpu(gpu) => Ok(primitives::run(&gpu)?),
        },
    }
}

fn main() -> ExitCode {
    match run(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("nearfield-bench: {error}");
            ExitCode::FAILURE
        }
    }
}
