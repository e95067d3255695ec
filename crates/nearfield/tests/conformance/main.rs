//! Conformance: every structure on every device gives every answer that brute force, written out again in
//! `reference.rs`, gives on every named case.
//!
//! `NEARFIELD_LONG=1` adds large clouds. A case is added in `cases.rs`, a structure in `subjects.rs`, a question in
//! `questions.rs`; the trials and their names are made from those tables.

mod cases;
mod compare;
mod planted;
mod questions;
mod random;
mod reference;
mod subjects;

use std::process::ExitCode;
use std::sync::{LazyLock, OnceLock};

use libtest_mimic::{Arguments, Failed, Trial};

use crate::compare::Verdict;

fn main() -> ExitCode {
    let mut trials = planted::trials();
    trials.extend(case_trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}

/// A trial from its name and check.
fn trial(name: String, check: impl FnOnce() -> Verdict + Send + 'static) -> Trial {
    Trial::test(name, move || check().map_err(Failed::from))
}

/// Every subject over every case.
fn case_trials() -> Vec<Trial> {
    let mut trials = vec![];
    for (number, named) in cases::CASES.iter().enumerate() {
        trials.push(trial(format!("known-total/{}", named.name), move || check_known_total(number)));
        for subject in subjects::SUBJECTS {
            let name = format!("{}/{}", subject.name(), named.name);
            trials.push(trial(name, move || check_case(subject, number)));
        }
    }
    trials
}

/// A case with its truth, made at its first use and shared by all trials.
fn solved(number: usize) -> &'static questions::Solved<'static> {
    static MADE: LazyLock<Vec<OnceLock<cases::Case>>> = LazyLock::new(|| none_yet(cases::CASES.len()));
    static SOLVED: LazyLock<Vec<OnceLock<questions::Solved<'static>>>> = LazyLock::new(|| none_yet(cases::CASES.len()));
    SOLVED[number].get_or_init(|| questions::Solved::new(MADE[number].get_or_init(cases::CASES[number].make)))
}

fn none_yet<T>(n: usize) -> Vec<OnceLock<T>> {
    (0..n).map(|_| OnceLock::new()).collect()
}

fn check_case(subject: &subjects::Subject, number: usize) -> Verdict {
    let solved = solved(number);
    let built = subject.build(&subjects::Plan::of(solved.case)).map_err(|error| error.to_string())?;
    if let Some(broken) = built.broken_invariant() {
        return Err(format!("broken invariant {broken}"));
    }
    let (n, bytes) = (solved.case.points.len() as u64, built.memory_bytes());
    // Points, four table entries a point and packs; a table over the bounding box would take far more.
    if built.len() as u64 != n || bytes > 48 * n + 40_000 {
        return Err(format!("{} points of {n}, {bytes} bytes", built.len()));
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
