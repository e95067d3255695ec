//! Points sorted by the cell of a uniform grid, with a table that says where each run of cells begins.
//!
//! Cells are numbered along x within a row (y, z), so the cells that a ball touches in one row are one run of points.
//! Where the cells of the bounding box are not many more than the points, the table is dense: cell (x, y, z) is number
//! (z·ny + y)·nx + x. Otherwise rows are hashed: the row (y, z) begins at a hash of itself and its cells follow, modulo
//! the table size, so that the table is at most twice the points however far an outlier lies. Runs of different rows
//! may then overlap; they hold points of both, and searches meet each point once.
//!
//! Source: the uniform grid of Accel (Newlin & Rerucha), Green2010, and the hash of Teschner2003. Differs: rows are
//! hashed instead of cells; any domain, negative coordinates and periodic axes; no cap on neighbours; cells need not
//! be as large as the radius.
//!
//! Cost: 16 bytes a point and 4 bytes a table entry (at most 8 entries a point); the build sorts n keys.
//! Use it for one radius, or radii of one order of magnitude. A radius far above the cell size makes many rows a query;
//! strongly clustered points make long runs.
//!
//! Invariants, checked by `validate.rs`:
//! 1. the order is a permutation, sorted by table entry, ties by the caller's index;
//! 2. `starts` is monotone from 0 to n, and entry e holds the points `starts[e]..starts[e + 1]`;
//! 3. packs are ascending from 0 to n, and each holds points of one row.

mod cpu;
#[cfg(feature = "gpu")]
mod effort;
#[cfg(feature = "gpu")]
mod gpu;
mod layout;
mod nearest_radius;
mod settings;
mod validate;

pub use cpu::UniformGrid;
#[cfg(feature = "gpu")]
pub(in crate::structure) use effort::most_effort;
#[cfg(feature = "gpu")]
pub use gpu::{GpuUniformGrid, GridBuilder};
pub use layout::GridLayout;
#[doc(hidden)]
pub use settings::GridSettings;
