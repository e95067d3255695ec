//! Rays into meshes: every structure on every device against double precision, and against each other.
//!
//! What is right is decided by `reference.rs` in f64: triangles that a ray surely hits, surely misses, and those whose
//! outline it passes within a bound that is stated there, which are counted. t is compared to a share of 10⁻⁵ where a ray is
//! steep and long enough for that (`reference.rs`), else to a wider bound, which is counted. `NEARFIELD_LONG=1` casts 10⁷
//! different rays in all on the CPU, and on hardware devices.

mod choices;
mod inside;
mod meshes;
mod queries;
mod rays;
mod reference;
mod subjects;
#[path = "../support/mod.rs"]
mod support;

use libtest_mimic::{Arguments, Trial};

fn main() {
    let mut trials: Vec<Trial> = reference::trials();
    trials.extend(inside::trials());
    trials.extend(subjects::trials());
    trials.extend(choices::trials());
    trials.extend(queries::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
