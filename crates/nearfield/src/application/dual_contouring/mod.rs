//! Dual contouring: from values at the nodes of a grid to a triangle mesh that keeps creases and corners.
//!
//! Where the surface crosses edges of the grid, its places and normals (Hermite data) are taken; each cell gets a vertex where
//! the planes of its crossings meet best, and each crossed edge a polygon between the vertices of the four cells around it
//! (Ju2002). A cell that several sheets of the surface pass has a vertex for each, by a table that is derived from the faces
//! (`cell_table.rs`), so the mesh is manifold whatever the signs are. Vertices that would make triangles flip or intersect
//! move into their cells (`untangle.rs`); in feature mode they stay.
//!
//! Differs from the paper: sheets instead of one vertex a cell (Nielson2004, Wenger2013); eigenvalues are cut relative to the
//! largest; normals of a sampled field come from the side of a crease on which its gradient is that of a distance. Cost: some
//! 4 bytes a node and 200 an active cell; time is linear in nodes and in active cells. When to use: fields with creases; where
//! all is smooth, surface nets give the same with fewer steps.
//!
//! Invariants, for every field:
//! 1. an edge of the mesh has one triangle or two, which run along it in opposite directions;
//! 2. the triangles of a vertex are one fan;
//! 3. an edge has one triangle only at a crossed edge of the grid that is not a polygon: at the border of the grid or where
//!    values are undefined;
//! 4. in [`VertexMode::Untangled`] no two triangles meet but in what they share, and none is flipped, as far as
//!    [`ContourReport`] says.

mod cell;
mod cell_table;
mod contour;
#[cfg(feature = "gpu")]
mod gpu;
mod hermite;
mod node_values;
mod qef;
mod quad_rows;
mod quads;
mod settings;
mod surface;
mod untangle;

pub use contour::{contour, contour_with};
#[cfg(feature = "gpu")]
pub use gpu::{ContourCell, ContourParameters, GpuContour, contour_on_gpu};
pub use hermite::{Crossing, FieldHermite, FunctionHermite, GridEdge, HermiteData, PointsHermite};
pub use node_values::NodeValues;
pub use settings::{ContourSettings, VertexMode};
pub use surface::{Contour, ContourReport};
