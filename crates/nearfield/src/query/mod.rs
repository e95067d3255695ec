//! Questions to a structure and their answers: all neighbours within a radius, how many, the nearest one; the k nearest,
//! however far or within a radius; the points in a box; what rays hit.
//!
//! [`FixedRadius`] is the first question, [`NeighborSearch`] what every structure on every device answers, and
//! [`Neighbors`], [`Counts`], [`Nearest`] the answers. [`Knn`] and [`Boxes`] are asked of structures with [`KnnSearch`]
//! and [`BoxSearch`], rays of meshes with [`RaySearch`]. Each answer carries a [`Report`] of what really ran.

mod any_dimension;
mod boxes;
#[cfg(feature = "gpu")]
mod choose;
mod closest_point;
mod coherent;
mod cpu;
mod cpu_list;
mod fixed_radius;
mod found_rows;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod index;
mod knn;
mod map_rows;
mod neighbors;
#[cfg(feature = "gpu")]
mod occupancy;
mod packs;
mod ray_cast;
#[cfg(feature = "gpu")]
mod ray_choice;
#[cfg(feature = "gpu")]
mod ray_index;
mod report;
mod rows;
mod search;
mod visit;

pub use any_dimension::{CountsN, FixedRadiusN, KnnN, NearestFew, NearestN, NeighborsN, QueriesN, RadiusN, SearchWork};
pub use boxes::{BoxSearch, Boxes};
#[cfg(feature = "gpu")]
pub use choose::{Purpose, StructureChoice};
pub use closest_point::{ClosestPoint, ClosestPointSearch};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use coherent::Sweep;
pub use coherent::{PhaseLanes, SearchCounters};
pub use cpu::ForEachNeighbor;
pub use cpu_list::ListRows;
pub use fixed_radius::{FixedRadius, Queries, Radius, RowOrder};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::{Asked, Batch, CellsRun, HitN, KNN_SPAN_POINTS, KnnBatch, KnnRun, PairSearch, SearchN, SmallList};
#[cfg(feature = "gpu")]
pub use gpu::{
    DeviceQueries, ForEachOnDevice, GpuListPlan, GpuNearestNeighbors, GpuNeighborRows, GpuNeighbors, SearchOnDevice,
    Visitor,
};
#[cfg(feature = "gpu")]
pub(crate) use gpu::{VisitorModule, record_module, visit_nearest};
#[cfg(feature = "gpu")]
pub use index::{Index, IndexSettings};
pub use knn::{Knn, KnnSearch, NearestNeighbors};
pub use map_rows::MapRows;
pub use neighbors::{Counts, CutRow, Nearest, Neighbor, NeighborRows, Neighbors, Summary};
#[cfg(feature = "gpu")]
pub use ray_cast::{DeviceRays, RaysOnDevice};
pub use ray_cast::{HitCounts, HitLists, HitRecord, Hits, Occlusion, RayHit, RaySearch};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use ray_cast::{RayBatch, SortBatch};
#[cfg(feature = "gpu")]
pub use ray_choice::{RayQuery, RayStructureChoice, RayTask};
#[cfg(feature = "gpu")]
pub use ray_index::{RayIndex, RayIndexSettings};
pub use report::{Clock, Report, Stage};
pub(crate) use rows::available_memory;
pub use search::NeighborSearch;
