//! `cargo xtask test`: every test of the workspace, with totals.
//!
//! A test that finds no GPU is either marked as ignored by its harness, or, where the harness decides that too early,
//! passes after appending its name as a line to the file that `NEARFIELD_SKIPPED` names; both count as skipped.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{ExitCode, Stdio};
use std::time::Instant;

use crate::process::{cargo, line};
use crate::totals::Totals;
use crate::vulkan;

/// Runs the tests and prints `N passed, N failed, N skipped` as the last line.
pub(crate) fn run(arguments: &[String]) -> Result<ExitCode, String> {
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
    let filtered = !filters.is_empty();
    let runs = if filtered { filters.into_iter().map(Some).collect() } else { vec![None] };
    let skipped_file = std::env::temp_dir().join(format!("nearfield-skipped-{}", std::process::id()));
    for filter in runs {
        let (counted, success) = run_cargo_test(filter, long, &skipped_file)?;
        finished &= success || counted.failed > 0;
        totals += counted;
    }

    // Absent unless a test wrote it.
    if let Ok(names) = fs::read_to_string(&skipped_file) {
        names.lines().for_each(|name| totals.skip_passed(name));
        let _ = fs::remove_file(&skipped_file);
    }

    println!();
    let none = filtered && totals.passed + totals.failed + totals.skipped == 0;
    if none {
        println!("no test has one of these words in its name");
    }
    totals.failures.iter().for_each(|name| println!("failed: {name}"));
    if !finished {
        println!(
            "cargo test failed without a failed test: a build error, or a test binary that ended early; see above"
        );
    }
    if !totals.gpu_skipped.is_empty() {
        let count = totals.gpu_skipped.len();
        totals.gpu_skipped.iter().for_each(|name| println!("skipped: {name}"));
        println!("{count} GPU tests were skipped: no adapter; NEARFIELD_REQUIRE_GPU=1 makes them fail");
    }
    let seconds = start.elapsed().as_secs();
    println!("{} min {} s, building included", seconds / 60, seconds % 60);
    println!("{} passed, {} failed, {} skipped", totals.passed, totals.failed, totals.skipped);
    Ok(if totals.failed > 0 || !finished || none { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// One `cargo test`, its output passed on line by line; the totals and whether cargo succeeded.
fn run_cargo_test(filter: Option<&str>, long: bool, skipped_file: &Path) -> Result<(Totals, bool), String> {
    let mut command = cargo(&["test", "--release", "--locked", "--workspace", "--all-features", "--no-fail-fast"]);
    command.args(filter).env("NEARFIELD_SKIPPED", skipped_file);
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
