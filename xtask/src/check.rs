//! `cargo xtask check`: everything short of the tests, each step timed; the first failure stops.

use std::process::Command;
use std::time::Instant;

use crate::doc_paths;
use crate::process::{cargo, repository_root, succeed};

/// Feature sets of the library that must build without warnings by themselves; the workspace has both.
const FEATURE_SETS: [&str; 3] = ["", "io", "gpu"];

const EVERYTHING: [&str; 4] = ["--release", "--locked", "--workspace", "--all-features"];

/// Runs all steps in the order cheapest first.
pub(crate) fn run(arguments: &[String]) -> Result<(), String> {
    let are_tests_next = match arguments {
        [] => false,
        [option] if option == "--before-tests" => true,
        other => return Err(format!("check takes --before-tests or nothing, found {other:?}")),
    };
    let start = Instant::now();
    step("format", || succeed(&mut cargo(&["fmt", "--all", "--check"])))?;
    step("paths named in documents", || doc_paths::check(&repository_root()))?;
    step("clippy, workspace", || succeed(&mut clippy(&EVERYTHING, &["--all-targets"])))?;
    for features in FEATURE_SETS {
        let name = if features.is_empty() { "none" } else { features };
        let select = ["--release", "--locked", "-p", "nearfield", "--no-default-features", "--features", features];
        step(&format!("clippy, library with features: {name}"), || succeed(&mut clippy(&select, &[])))?;
    }
    step("documentation", || {
        let mut doc = cargo(&["doc", "--no-deps", "--lib"]);
        succeed(doc.args(EVERYTHING).env("RUSTDOCFLAGS", "-D warnings"))
    })?;
    if !are_tests_next {
        step("layering and shaders", || {
            let mut test = cargo(&["test", "--quiet", "--test", "layering", "--test", "shaders"]);
            succeed(test.args(EVERYTHING))
        })?;
    }
    println!("check passed in {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn clippy(select: &[&str], targets: &[&str]) -> Command {
    let mut command = cargo(&["clippy", "--quiet"]);
    command.args(select).args(targets).args(["--", "-D", "warnings"]);
    command
}

fn step(name: &str, run: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
    let start = Instant::now();
    println!("{name} …");
    run().map_err(|error| format!("check stopped at \"{name}\": {error}"))?;
    println!("{name}: ok, {:.1} s", start.elapsed().as_secs_f64());
    Ok(())
}
