//! `cargo xtask fuzz`: each target of `fuzz/` for some seconds.

use crate::process::{cargo, output, succeed};

const INSTALL: &str = "cargo install --locked cargo-fuzz";

/// Runs the targets named, or all; an error names those that crashed.
pub(crate) fn run(arguments: &[String]) -> Result<(), String> {
    let (mut seconds, mut named) = (60u64, vec![]);
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--seconds" => {
                let value = rest.next().map_or("nothing", String::as_str);
                seconds =
                    value.parse().map_err(|_| format!("fuzz: --seconds takes a whole number, found {value:?}"))?;
            }
            option if option.starts_with('-') => return Err(format!("fuzz: unknown option {option}")),
            target => named.push(target.to_owned()),
        }
    }
    if output(&mut cargo(&["fuzz", "--version"])).is_none() {
        return Err(format!("cargo-fuzz is not installed; install it with\n    {INSTALL}\nand run this again"));
    }
    let listed = output(&mut cargo(&["fuzz", "list"])).ok_or("`cargo fuzz list` failed: is there a fuzz folder?")?;
    let targets: Vec<&str> = listed.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    if let Some(unknown) = named.iter().find(|name| !targets.contains(&name.as_str())) {
        return Err(format!("fuzz: there is no target {unknown:?}; there are {}", targets.join(", ")));
    }

    let limit = format!("-max_total_time={seconds}");
    let mut crashed = vec![];
    for target in targets.iter().filter(|target| named.is_empty() || named.iter().any(|name| name == *target)) {
        println!("fuzzing {target} for {seconds} s");
        // The sanitizer flags are unstable: the variable lets the stable compiler take them.
        let mut command = cargo(&["fuzz", "run", "--release", target, "--", &limit]);
        if let Err(error) = succeed(command.env("RUSTC_BOOTSTRAP", "1")) {
            println!("{error}");
            crashed.push(*target);
        }
    }
    if crashed.is_empty() {
        Ok(())
    } else {
        Err(format!("fuzz: {} failed; inputs are in fuzz/artifacts", crashed.join(", ")))
    }
}
