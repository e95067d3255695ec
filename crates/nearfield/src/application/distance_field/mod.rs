//! Signed distances from a surface at the nodes of a regular grid: from oriented samples, or from triangles.
//!
//! From samples, all starts with the nearest one, x_c with the normal n_c ([`DistanceMode`] says what is made of it):
//! - *nearest* (Xing2017): sgn((q − x_c)·n_c) · |q − x_c|. It never comes near 0 between samples, so a surface taken from it is
//!   off by a tenth of a grid width;
//! - *plane* (Hoppe1992): n_c·(q − x_c), some thirty times as accurate at the same cost;
//! - *imls* (Kolluri2005): the mean of the distances from the planes of the samples around the nearest, by weight;
//! - *apss* (Guennebaud2007): the distance from the sphere fitted to those samples, for noise.
//!
//! Nodes with no sample within the band are undefined: NaN. Where a whole neighbourhood hangs on one plane, beside an edge or beyond
//! a border, planes may be near though all samples are far: of the last three, no value is nearer to 0 than the distance of the
//! nearest sample less two spacings. The sign is that of the formula, or by the winding number where normals mislead: at thin
//! walls and beyond sharp edges.
//!
//! Only the nearest sample is looked for, never a list: bricks of 8³ nodes are left out where their middle is too far from
//! all samples; in the others each node begins with the bound that a neighbour's answer gives (the triangle inequality) and
//! takes the tree's near leaves first. Equal distances go to the smallest index. Narrow and wide bands are one algorithm.
//!
//! Cost: 8 bytes a node, and for each node in the band some two leaves of the tree. In the modes *nearest* and *plane* the
//! device gives the same indices and the same undefined nodes as the CPU in `f32`, bit for bit.

mod bricks;
mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_mesh;
#[cfg(feature = "gpu")]
mod gpu_run;
#[cfg(feature = "gpu")]
mod gpu_spacing;
mod grid;
mod mesh;
mod pseudonormals;
#[cfg(feature = "gpu")]
mod read_field;
mod samples;
mod settings;
#[cfg(test)]
mod tests;
mod value;

use crate::geometry::DistanceGrid;

#[cfg(feature = "gpu")]
pub use gpu::GpuOrientedSamples;
#[cfg(feature = "gpu")]
pub use gpu_mesh::GpuMeshDistance;
#[cfg(feature = "gpu")]
pub use gpu_run::{FieldParameters, GpuDistanceField};
pub use grid::grid_around;
pub use mesh::MeshDistance;
pub use pseudonormals::MeshClosure;
pub use samples::OrientedSamples;
pub use settings::{DistanceMode, DistanceSettings, SignRule};

/// Distances at the nodes of a grid, and what is nearest to each.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceField {
    /// The distances; NaN where there is nothing within the band.
    pub distances: DistanceGrid,
    /// `[nz][ny][nx]` index of the nearest sample or triangle; [`DistanceField::NONE`] where there is none within the band.
    pub nearest: Vec<u32>,
}

impl DistanceField {
    /// The index of nothing.
    pub const NONE: u32 = u32::MAX;

    /// Number of nodes with a distance.
    pub fn n_defined(&self) -> usize {
        self.nearest.iter().filter(|&&index| index != Self::NONE).count()
    }
}
