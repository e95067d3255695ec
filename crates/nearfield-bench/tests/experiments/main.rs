//! The experiments at a small scale: every method, column and reference value is there, plots and claims are made,
//! a second run resumes, and a wrong answer stops a measurement. The charts of the poster have every method too, the table of targets
//! every row.

mod applications;
mod auto;
mod baselines;
mod device_table;
mod folder;
mod grid;
mod growth;
mod host_side;
mod octree;
mod paper;
#[path = "../../../nearfield/tests/support/mod.rs"]
mod support;
mod targets;

use libtest_mimic::Arguments;

fn main() {
    let by_subject = [
        grid::trials(),
        growth::trials(),
        device_table::trials(),
        octree::trials(),
        baselines::trials(),
        paper::trials(),
        applications::trials(),
        auto::trials(),
        targets::trials(),
        host_side::trials(),
    ];
    libtest_mimic::run(&Arguments::from_args(), by_subject.into_iter().flatten().collect()).exit();
}
