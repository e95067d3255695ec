//! Conformance: every structure on every device gives every answer that brute force, written out again in
//! `reference.rs`, gives on every named case.
//!
//! A case is added in `cases.rs`, a structure in `subjects/builds.rs`, a question in `questions.rs`, a single claim in
//! `claims.rs`; the trials and their names are made from those tables. `planted.rs` checks the comparison itself.
//!
//! - `NEARFIELD_TEST_DEVICE`, `NEARFIELD_REQUIRE_GPU`: see `support`
//! - `NEARFIELD_DATA`: the folder of real scans, else `../shared/data` beside the repository
//! - `NEARFIELD_LONG=1`: clouds of a million points, and on software devices all builds and all questions of every case,
//!   which there take turns (hardware has all of these always)
//! - `NEARFIELD_SEED=N`: only that random case

#![allow(clippy::neg_cmp_op_on_partial_ord, reason = "a comparison with NaN must fail the check")]
#![allow(clippy::type_complexity, reason = "tables of cases are read where they stand")]

mod boxes;
mod cases;
mod claims;
mod compare;
mod images;
mod knn;
mod large;
mod planted;
mod property;
mod questions;
mod random;
mod reference;
mod subjects;
#[cfg(feature = "gpu")]
#[path = "../support/mod.rs"]
mod support;
#[cfg(feature = "gpu")]
mod visitors;

use std::process::ExitCode;
use std::sync::{LazyLock, OnceLock};

use libtest_mimic::{Arguments, Failed, Trial};

use crate::compare::Verdict;
use crate::subjects::{Device, SUBJECTS, Subject};

fn main() -> ExitCode {
    let mut trials = planted::trials();
    trials.extend(case_trials());
    trials.extend(claims::trials());
    trials.extend(property::trials());
    trials.extend(images::trials());
    trials.extend(large::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// A trial from its name and check.
fn trial(name: String, check: impl FnOnce() -> Verdict + Send + 'static) -> Trial {
    Trial::test(name, move || check().map_err(Failed::from))
}

/// A trial that needs the GPU.
#[cfg(feature = "gpu")]
fn gpu_trial(name: String, check: impl FnOnce() -> Verdict + Send + 'static) -> Trial {
    support::gpu_trial(name, move |_| check().unwrap_or_else(|difference| panic!("{difference}")))
}

/// A trial on the subject's device.
fn trial_on(subject: &Subject, name: String, check: impl FnOnce() -> Verdict + Send + 'static) -> Trial {
    match subject.device {
        Device::Cpu => trial(name, check),
        #[cfg(feature = "gpu")]
        Device::Gpu => gpu_trial(name, check),
    }
}

/// Every subject over every case.
fn case_trials() -> Vec<Trial> {
    let mut trials = vec![];
    for (number, named) in cases::all().enumerate() {
        let missing = named.file.is_some_and(|file| !support::data_folder().join(file).exists());
        if missing {
            eprintln!("{} is skipped: no {}", named.name, named.file.unwrap_or_default());
        }
        let name = format!("known-total/{}", named.name);
        trials.push(trial(name, move || check_known_total(number)).with_ignored_flag(missing));
        for subject in SUBJECTS.iter().filter(|s| s.is_tried_here()) {
            let name = format!("{}/{}", subject.name(), named.name);
            let trial = trial_on(subject, name, move || check_case(subject, number));
            trials.push(if missing { trial.with_ignored_flag(true) } else { trial });
        }
    }
    // What software devices leave out of the cases above is counted as skipped, and passes nowhere else.
    for subject in SUBJECTS.iter().filter(|s| s.is_tried_here() && !s.asks_everything()) {
        let long = || Err("asked with NEARFIELD_LONG=1, or on hardware".into());
        let name = format!("{}/questions-for-hardware", subject.name());
        trials.push(trial(name, long).with_ignored_flag(true));
    }
    trials
}

/// A case with its truth, made at its first use and shared by all trials.
fn solved(number: usize) -> &'static questions::Solved<'static> {
    static MADE: LazyLock<Vec<OnceLock<cases::Case>>> = LazyLock::new(none_yet);
    static SOLVED: LazyLock<Vec<OnceLock<questions::Solved<'static>>>> = LazyLock::new(none_yet);
    let make = || cases::all().nth(number).map(|named| (named.make)()).expect("a number should be that of a case");
    SOLVED[number].get_or_init(|| questions::Solved::new(MADE[number].get_or_init(make), number))
}

fn none_yet<T>() -> Vec<OnceLock<T>> {
    cases::all().map(|_| OnceLock::new()).collect()
}

fn check_case(subject: &Subject, number: usize) -> Verdict {
    let solved = solved(number);
    let built = subject.build(&subjects::Plan::of(solved.case)).map_err(|error| error.to_string())?;
    if let Some(broken) = built.broken_invariant() {
        return Err(format!("broken invariant {broken}"));
    }
    let (n, bytes) = (solved.case.points.len() as u64, built.memory_bytes());
    // Points, eight table entries a point and packs; a table over the bounding box would take far more. An octree of
    // small leaves has up to two nodes a point.
    let most = if subject.structure == "linear-octree" { 160 * n } else { 64 * n };
    if built.len() as u64 != n || bytes > most + 40_000 {
        return Err(format!("{} points of {n}, {bytes} bytes", built.len()));
    }
    #[cfg(feature = "gpu")]
    if subject.device == Device::Gpu {
        visitors::check(built.as_ref(), solved).map_err(|difference| format!("the caller's kernel: {difference}"))?;
    }
    questions::ask_everything(subject, built.as_ref(), solved)
}

/// The reference itself against totals known by hand.
fn check_known_total(number: usize) -> Verdict {
    let problem = solved(number).own();
    let total: u64 = problem.truth.iter().map(|row| row.hits.len() as u64).sum();
    match solved(number).case.total {
        Some(known) if known != total => Err(format!("{total} neighbours, known are {known}")),
        _ if problem.is_complete() => Ok(()),
        _ => Err("only a sample of the rows was solved".into()),
    }
}
