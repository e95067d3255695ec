//! Fixed-radius queries over any GPU structure: one kernel, filled with the structure's traversal and a visitor.
//!
//! `visit` runs a visitor; `answers` are count and nearest; `list` is the list with its batches, `capped_list` that of
//! the nearest, `list_plan` that of few points again and again; `on_device` leaves answers there; `row_masks` is the fast way to write rows; `pairs` searches two points at a time; `visitor` takes a caller's
//! own WGSL, `device_queries` takes queries that are there already; `knn` finds the nearest of a tree or a grid and `boxes` what
//! lies in boxes, `knn_visit` runs visitors on the nearest; `loops` keeps answers exact on devices that end long loops.

mod answers;
mod any_dimension;
pub(super) mod batch;
mod boxes;
mod capped_list;
mod device_queries;
mod knn;
mod knn_boxes;
mod knn_cells;
mod knn_octants;
mod knn_packs;
mod knn_pairs;
mod knn_visit;
mod list;
mod list_plan;
mod loops;
mod on_device;
mod pairs;
mod row_masks;
mod visit;
mod visitor;

pub(super) use answers::add_stages;
#[doc(hidden)]
pub use any_dimension::{Asked, HitN, SearchN};
pub use device_queries::DeviceQueries;
pub(crate) use device_queries::{VisitorModule, record_module};
pub use knn::GpuNearestNeighbors;
#[doc(hidden)]
pub use knn_boxes::KnnRun;
#[doc(hidden)]
pub use knn_cells::CellsRun;
#[doc(hidden)]
pub use knn_octants::KnnBatch;
#[doc(hidden)]
pub use knn_packs::KNN_SPAN_POINTS;
pub(crate) use knn_visit::visit_nearest;
pub use list_plan::GpuListPlan;
#[doc(hidden)]
pub use list_plan::SmallList;
pub use on_device::{GpuNeighborRows, GpuNeighbors, SearchOnDevice};
#[doc(hidden)]
pub use pairs::PairSearch;
#[doc(hidden)]
pub use visit::Batch;
pub use visitor::{ForEachOnDevice, Visitor};
