//! Questions to a structure and their answers: all neighbours within a radius, how many, the nearest one.
//!
//! [`FixedRadius`] is the question, [`NeighborSearch`] what every structure on every device answers, and
//! [`Neighbors`], [`Counts`], [`Nearest`] the answers; each carries a [`Report`] of what really ran.

mod cpu;
mod fixed_radius;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod index;
mod knn;
mod neighbors;
mod report;
mod rows;
mod search;

pub use cpu::{ForEachNeighbor, ListRows};
pub use fixed_radius::{FixedRadius, Queries, Radius, RowOrder};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::Batch;
#[cfg(feature = "gpu")]
pub use gpu::{ForEachOnDevice, GpuNearestNeighbors, GpuNeighborRows, GpuNeighbors, SearchOnDevice, Visitor};
#[cfg(feature = "gpu")]
pub use index::{Index, IndexSettings, StructureChoice};
pub use knn::{Knn, KnnSearch, NearestNeighbors};
pub use neighbors::{Counts, CutRow, Nearest, Neighbor, NeighborRows, Neighbors, Summary};
pub use report::{Clock, Report, Stage};
pub use search::NeighborSearch;
