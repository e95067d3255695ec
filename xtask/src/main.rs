//! Maintenance tasks of the workspace, run as `cargo xtask TASK`; no dependencies, so that it builds in seconds.

mod check;
mod doc_paths;
mod fuzz;
mod process;
mod test;
mod totals;
mod vulkan;

use std::process::ExitCode;

const USAGE: &str = "\
Usage: cargo xtask <task>

  test [--long] [FILTER…]       run every test, or those whose name contains a filter; with no GPU driver, as root and
                                with apt-get, first installs the software one (mesa-vulkan-drivers)
                                --long adds the tests that take minutes (NEARFIELD_LONG=1)
  check [--before-tests]        format, lints on every feature set, documentation, paths, layering, shaders
                                --before-tests leaves out layering and shaders, which `test` has too
  fuzz [--seconds N] [TARGET…]  fuzz every file reader, or those named, for N seconds each (default 60)

NEARFIELD_REQUIRE_GPU=1 makes GPU tests fail where they would be skipped.";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result = match arguments.split_first() {
        Some((task, rest)) => match task.as_str() {
            "test" => test::run(rest),
            "check" => check::run(rest).map(|()| ExitCode::SUCCESS),
            "fuzz" => fuzz::run(rest).map(|()| ExitCode::SUCCESS),
            "help" | "--help" | "-h" => {
                println!("{USAGE}");
                Ok(ExitCode::SUCCESS)
            }
            other => Err(format!("there is no task {other:?}\n\n{USAGE}")),
        },
        None => Err(format!("name a task\n\n{USAGE}")),
    };
    result.unwrap_or_else(|message| {
        eprintln!("xtask: {message}");
        ExitCode::FAILURE
    })
}
