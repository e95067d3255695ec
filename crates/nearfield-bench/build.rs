//! Gives the program the commit it was built from: `git rev-parse`, else the variable `NEARFIELD_COMMIT`, else
//! "unknown". Uncommitted changes of the sources add "-dirty".

use std::env;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-env-changed=NEARFIELD_COMMIT");
    for path in ["build.rs", "src", "../nearfield/src", "../../Cargo.lock"] {
        println!("cargo::rerun-if-changed={path}");
    }
    // The log of HEAD changes with every commit and checkout, in a work tree of its own too.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo::rerun-if-changed={log}");
    }
    let commit = git(&["rev-parse", "--short=12", "HEAD"]).map(|commit| {
        let changed = git(&["status", "--porcelain", "--untracked-files=no", "--", "src", "../nearfield/src"]);
        if changed.is_some() { format!("{commit}-dirty") } else { commit }
    });
    let commit = commit.or_else(|| env::var("NEARFIELD_COMMIT").ok()).unwrap_or_else(|| "unknown".to_owned());
    println!("cargo::rustc-env=NEARFIELD_BENCH_COMMIT={commit}");
}

/// Output of a git command; `None` where it fails or says nothing.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?.trim().to_owned();
    (output.status.success() && !text.is_empty()).then_some(text)
}
