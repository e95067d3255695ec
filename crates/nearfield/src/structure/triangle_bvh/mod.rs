//! Triangle BVH: a wide hierarchy of boxes over triangles, the fastest structure for rays.
//!
//! A binary tree is split by the surface area heuristic down to single triangles, then collapsed into nodes of eight
//! children at least expected cost, which also decides what is a leaf. The CPU tests the eight boxes of a node and the
//! eight triangles of a leaf side by side; the GPU walks nodes of 80 bytes with boxes of 8 bits a side.
//!
//! Source: Wald2007 for the binned build, Ylitie2017 for the collapse, the compressed nodes and their walk on the GPU,
//! Woop2013 for the triangle test. Differs: leaves hold blocks of eight triangles on the CPU; boxes are widened by
//! the margin of [`crate::geometry::RaySpace`], so that answers are those of brute force to the bit; splits go by the
//! median below a depth of 48, so that stacks have a bound. Cost: 48 bytes a prepared triangle, on the CPU about 85 more
//! and on the GPU 80 a node; build O(n log n) on the CPU; refit O(n) on both. When to use: whenever rays are cast at a mesh; a kd-tree
//! with ropes meets triangles in the order of the ray, brute force needs no build.
//!
//! Invariants:
//! 1. every triangle with an area stands in exactly one leaf, and none without one does unless a refit left it there;
//! 2. the box of a child holds the widened box of every triangle below it;
//! 3. every node but the root has one parent, which stands before it; the children that are nodes stand side by side;
//! 4. no path has more nodes than [`TriangleBvh::depth`], and that is at most 80;
//! 5. on the GPU, decoded boxes hold those of 2.

mod build;
mod collapse;
#[cfg(feature = "gpu")]
mod compress;
mod cpu;
#[cfg(feature = "gpu")]
mod fitter;
#[cfg(feature = "gpu")]
mod gpu;
mod layout;
mod nearest;
mod refit;
mod settings;
mod split;
mod sweep;
#[cfg(test)]
mod tests;
mod validate;
mod walk;
mod walk_simd;

#[cfg(feature = "gpu")]
pub use compress::CompressedNode;
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use compress::SLACK;
pub use cpu::TriangleBvh;
#[cfg(feature = "gpu")]
pub use gpu::GpuTriangleBvh;
pub use settings::BvhSettings;

/// Levels of the binary tree that are split by surface area; deeper ones are halved.
const MOST_SPLIT_LEVELS: u32 = 48;
/// Levels of any tree: fewer than 2³² triangles are halved into single ones in 32 levels.
const MOST_LEVELS: u32 = MOST_SPLIT_LEVELS + 32;
