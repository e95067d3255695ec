//! Locally optimal projection: every variant is the formula written down plainly, samples come near the surface and lie evenly, what
//! cannot be done is said, and the device agrees with the CPU.

mod edges;
mod formula;
mod on_gpu;
mod quality;
#[path = "../support/mod.rs"]
mod support;
#[path = "../support/surfaces.rs"]
mod surfaces;

use libtest_mimic::{Arguments, Trial};
use nearfield::application::{Length, WlopSettings, WlopVariant};
use nearfield::geometry::vector;
use nearfield::{AabbTreeN, AabbTreeNSettings, Scalar};

fn tree<T: Scalar>(points: &[[T; 3]]) -> AabbTreeN<T, 3> {
    AabbTreeN::build(points, &AabbTreeNSettings::default()).unwrap()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    vector::norm(vector::subtract(a, b))
}

/// Settings without an early end.
fn settings(variant: WlopVariant, radius: f64) -> WlopSettings {
    WlopSettings { tolerance: 0.0, ..WlopSettings::new(variant).radius(Length::Absolute(radius)) }
}

fn main() {
    let mut trials: Vec<Trial> = formula::trials();
    trials.extend(quality::trials());
    trials.extend(edges::trials());
    trials.extend(on_gpu::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
