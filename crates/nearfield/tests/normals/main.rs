//! Normals and their orientation: on surfaces whose normals are known, on a scan, on points without a surface, and on the device
//! against the CPU.

mod on_cpu;
mod on_gpu;
mod orientation;
#[path = "../support/mod.rs"]
mod support;
mod surfaces;

use libtest_mimic::{Arguments, Trial};

fn main() {
    let mut trials: Vec<Trial> = on_cpu::trials();
    trials.extend(orientation::trials());
    trials.extend(on_gpu::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
