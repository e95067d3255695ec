//! Fewer points for many: one a cell ([`voxel_downsample`]), evenly spread and of an exact number ([`poisson_disk`]), or each as far as can
//! be from those before ([`farthest_points`]).
//!
//! All work in `f32` and `f64`, give the same bits for any number of threads, and say which points they took: attributes can follow.
//! Points with a NaN or infinite coordinate are never taken, and are told.

mod farthest;
#[cfg(feature = "gpu")]
mod farthest_gpu;
mod heap;
mod poisson;
mod voxel;
#[cfg(feature = "gpu")]
mod voxel_gpu;

pub use farthest::{FarthestPoints, FarthestStart, farthest_points};
#[cfg(feature = "gpu")]
pub use farthest_gpu::farthest_points_on_gpu;
pub use poisson::{Extent, PoissonDisk, PoissonDiskSettings, poisson_disk};
pub use voxel::{VoxelOrigin, VoxelPoint, VoxelSettings, Voxels, voxel_downsample};
#[cfg(feature = "gpu")]
pub use voxel_gpu::voxel_downsample_on_gpu;
