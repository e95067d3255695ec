//! `cargo xtask test`: every test of the workspace, with totals.

use std::io::{BufRead, BufReader, Write};
use std::process::Stdio;
use std::time::Instant;

use crate::process::{cargo, line};
use crate::totals::Totals;
use crate::vulkan;

/// Runs the tests and prints `N passed, N failed, N skipped` as the last line.
pub(crate) fn run(arguments: &[String]) -> Result<(), String> {
    let (mut long, mut filters) = (false, vec![]);
    for argument in arguments {
        match argument.as_str() {
            "--long" => long = true,
            option if option.starts_with('-') => return Err(format!("test: unknown option {option}")),
            filter => filters.push(filter),
        }
    }
    vulkan::prepare();

    let start = Instant::now();
    let (mut totals, mut finished) = (Totals::default(), true);
    // One run a filter: not every test harness here takes more than one.
    let runs = if filters.is_empty() { vec![None] } else { filters.into_iter().map(Some).collect() };
    for filter in runs {
        let (counted, success) = run_cargo_test(filter, long)?;
        finished &= success || counted.failed > 0;
        totals += counted;
    }

    println!();
    totals.failures.iter().for_each(|name| println!("failed: {name}"));
    if !finished {
        println!(
            "cargo test failed without a failed test: a build error, or a test binary that ended early; see above"
        );
    }
    if totals.gpu_skipped > 0 {
        println!("{} GPU tests were skipped: no adapter; NEARFIELD_REQUIRE_GPU=1 makes them fail", totals.gpu_skipped);
    }
    let seconds = start.elapsed().as_secs();
    println!("{} min {} s, building included", seconds / 60, seconds % 60);
    println!("{} passed, {} failed, {} skipped", totals.passed, totals.failed, totals.skipped);
    if totals.failed > 0 || !finished { Err("the tests did not pass".to_owned()) } else { Ok(()) }
}

/// One `cargo test`, its output passed on line by line; the totals and whether cargo succeeded.
fn run_cargo_test(filter: Option<&str>, long: bool) -> Result<(Totals, bool), String> {
    let mut command = cargo(&["test", "--release", "--locked", "--workspace", "--all-features", "--no-fail-fast"]);
    command.args(filter);
    if long {
        command.env("NEARFIELD_LONG", "1");
    }
    println!("{}", line(&command));
    let started = command.stdout(Stdio::piped()).spawn();
    let mut child = started.map_err(|error| format!("{} could not be started: {error}", line(&command)))?;
    let output = child.stdout.take().expect("standard output should be piped");
    let (mut totals, mut screen) = (Totals::default(), std::io::stdout().lock());
    for bytes in BufReader::new(output).split(b'\n') {
        let bytes = bytes.map_err(|error| format!("reading the output of cargo test: {error}"))?;
        totals.read(String::from_utf8_lossy(&bytes).trim_end_matches('\r'));
        // A closed terminal must not end the run.
        let _ = screen.write_all(&bytes).and_then(|()| screen.write_all(b"\n"));
    }
    let status = child.wait().map_err(|error| format!("waiting for cargo test: {error}"))?;
    Ok((totals, status.success()))
}
