//! The command `nearfield-bench`; each subcommand is a module of the library.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use nearfield_bench::{Result, device, grid};

/// Measure Nearfield on this machine.
#[derive(Parser)]
#[command(version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Table of build, count and list on one device, beside the figures of other libraries.
    Device(device::Arguments),
    /// The experiments of Accel on its uniform grid: CSV files, plots and claims
    Grid(grid::Arguments),
}

fn run(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::Device(arguments) => device::run(&arguments),
        Command::Grid(arguments) => grid::run(&arguments),
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
