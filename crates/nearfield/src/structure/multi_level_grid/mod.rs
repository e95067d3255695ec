//! A uniform grid for each class of radii, in one table: for points with radii of their own that act on each other within a reach that
//! depends on both.
//!
//! A grid with cells for the largest reach makes small points meet all that lie in large cells; one with small cells makes large points walk many.
//! Here every class has cells for itself, and a question visits the cells of each class that its reach into that class touches. Points
//! stand in blocks by class, each sorted by cell; rows of cells are hashed as in [`super::uniform_grid`], into a table of its own for each
//! class, and all tables are one array, so one sort builds them all.
//!
//! Source: hierarchical grids (Ericson2005 §7.2) with the hashed rows of the uniform grid. Differs: a level is a class of equal radii, not a
//! power of two; points enter one cell, and questions visit all levels.
//!
//! Cost: 16 bytes a point and 8 to 16 bytes of table; the build sorts n keys. A question visits 3 × 3 rows of each level whose radius is not
//! above its own, and more rows of finer ones.
//!
//! It lives on the GPU. On the CPU a `UniformGrid` for each class, asked one after the other, is the same.
//!
//! Invariants:
//! 1. level l has the points `first_point..first_point + n_points` of the order, sorted by table entry, ties by place in the input;
//! 2. entry e of level l holds the points `starts[first_entry + e]..starts[first_entry + e + 1]`.

mod gpu;
mod layout;

pub use gpu::{GpuMultiLevelGrid, MultiLevelGridBuilder};
pub use layout::{GridLevel, LevelRule, MultiLevelLayout};
