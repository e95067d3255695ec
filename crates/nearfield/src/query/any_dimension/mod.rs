//! Questions to a tree of any dimension and their answers.
//!
//! [`FixedRadiusN`] and [`KnnN`] are the questions, [`CountsN`], [`NeighborsN`] and [`NearestN`] the answers; every answer
//! carries a [`SearchWork`], by which the searches of a tree can be told apart. Coordinates and distances are of one type
//! throughout, `f32` or `f64`; distances are squared.

mod answers;
mod coherent;
mod cpu;
mod nearest;
mod packed;
mod primary;
mod query_set;
mod question;
mod rows;
mod visit;

pub use answers::{CountsN, NearestN, NeighborsN, SearchWork};
pub use question::{FixedRadiusN, KnnN, QueriesN, RadiusN};
#[cfg(feature = "gpu")]
pub(super) use rows::{entry_limit, order_rows, too_large};
pub use visit::NearestFew;
