//! What the library's structures are measured against: approximate searches on the GPU, with their recall beside their
//! time, and exact kd-trees on the CPU.
//!
//! - [`shifted_sort`]: the nearest along several shifted Morton curves (Li2012), in space;
//! - [`lsh`]: locality-sensitive hashing with several tables (Datar2004, Pan2011), 2 to 64 dimensions;
//! - [`kd_tree_cpu`]: kiddo, and Debian's libann through a program of its own ([`ann`]);
//! - [`recall`]: how good an answer is, judged by brute force in f64 ([`exact`]).
//!
//! Each approximate search stands beside a plain CPU implementation of the same definition, its `reference`, and gives
//! the same rows. `nearfield-bench baselines` prints a table of them all.

pub mod ann;
mod command;
pub mod exact;
pub mod kd_tree_cpu;
mod kernels;
pub mod lsh;
mod methods;
pub mod points;
pub mod recall;
pub mod rows;
pub mod shifted_sort;

pub use command::{Arguments, measure, run};
pub use methods::Row;
pub use points::{Points, Queries};
pub use rows::{KnnRows, RangeRows, Timed};

use nearfield::gpu::StageTime;
use nearfield::query::{Clock, Stage};

use crate::Error;

/// Most places of a row: rows are held in the private memory of an invocation.
pub const MOST_K: usize = 128;

pub(crate) fn check_k(k: usize) -> nearfield::Result<()> {
    if (1..=MOST_K).contains(&k) {
        return Ok(());
    }
    Err(nearfield::Error::InvalidSetting { setting: "k", found: k.to_string(), expected: "1 to 128" })
}

pub(crate) fn check_radius(radius: f32) -> nearfield::Result<()> {
    if radius >= 0.0 && (radius * radius).is_finite() {
        return Ok(());
    }
    let reason = "must not be negative, and its square must be a finite f32";
    Err(nearfield::Error::InvalidRadius { radius, index: None, reason })
}

/// The stages that the device timed.
pub(crate) fn device_stages(times: &[StageTime]) -> Vec<Stage> {
    let stage = |t: &StageTime| Some(Stage { name: t.name, milliseconds: t.milliseconds?, clock: Clock::Device });
    times.iter().filter_map(stage).collect()
}

fn wrong(what: String) -> Error {
    format!("wrong answer: {what}").into()
}
