//! Measurements of Nearfield: the table of a device, the array primitives, keys and octants, and the experiments of the papers.
//!
//! Every measurement checks its own answer in the same run and stops with an error where it is wrong, so that no fast
//! but wrong answer is ever reported. Times are medians after a warm-up; device times are the device's timestamps.

pub mod applications;
pub mod auto;
pub mod baselines;
pub mod batches;
pub mod check;
pub mod clocks;
pub mod curve;
pub mod device;
pub mod everyday;
pub mod first_call;
pub mod grid;
pub mod growth;
pub mod measure;
pub mod octree;
pub mod paper;
pub mod particles;
pub mod plots;
pub mod primitives;
pub mod provenance;
pub mod rays;
pub mod rivals;
pub mod sets;
pub mod small;
pub mod targets;
pub mod transfers;
pub mod wlop;

/// Any failure: the library's, a file's, or an answer that [`check`] refuses.
pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// `Result` with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;
