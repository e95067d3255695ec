//! Everyday tasks: clusters, outliers and fewer points, against references written from their definitions, and on the device against the
//! CPU.

mod clouds;
mod clusters;
mod downsampling;
mod on_gpu;
mod outliers;
#[path = "../support/mod.rs"]
mod support;

use libtest_mimic::{Arguments, Trial};

fn main() {
    let mut trials: Vec<Trial> = clusters::trials();
    trials.extend(outliers::trials());
    trials.extend(downsampling::trials());
    trials.extend(on_gpu::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
