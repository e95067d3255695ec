//! AABB-tree: a complete binary tree of boxes over points that move.
//!
//! Which node has which points is arithmetic: the tree is balanced, and a level is split as a whole while any of its nodes
//! holds more than `bucket_size` points. Only the boxes depend on where the points are, so the tree follows moving points
//! by fitting its boxes anew, from the leaves up, and is built again only when they have grown too large.
//!
//! Source: Xing2017 for the tree, its refit and the searches `Primary` and `Coherent`; the searches `Packed` and by
//! nearness, and the build along the Hilbert curve, are ours. Cost: 16 bytes a point, and 24 a node on the CPU or 32 on the
//! GPU, about 0.13 nodes a point, on the CPU and by `Primary` also 4 for the pack of each point; build by median splits O(n log n), along the curve one sort; refit O(n). When to use:
//! points that move, density that varies strongly, radii that differ, nearest neighbours; for one radius and even density
//! that is built anew in every step the uniform grid is faster.
//!
//! Invariants:
//! 1. every point stands once in the order;
//! 2. the shape is complete and follows from the numbers of points and bucket alone ([`TreeShape`]): no leaf holds more
//!    than the bucket, halves of a node differ by at most one point;
//! 3. every point lies in the box of each node above it;
//! 4. boxes are the smallest ones, after a build and after a refit; in 3 and 4 a device may take coordinates below 1.2e-38 for 0;
//! 5. packs tile the order.

pub mod any_dimension;
mod build;
#[cfg(feature = "gpu")]
mod builder;
mod cpu;
#[cfg(feature = "gpu")]
mod effort;
#[cfg(feature = "gpu")]
mod fitter;
#[cfg(feature = "gpu")]
mod gpu;
mod layout;
mod near_leaves;
mod region;
mod settings;
mod shape;
mod update;
mod validate;
mod walk;

#[cfg(feature = "gpu")]
pub use any_dimension::GpuAabbTreeN;
pub use any_dimension::{AabbTreeN, AabbTreeNSettings};
pub use build::BoxN;
#[cfg(feature = "gpu")]
pub use builder::AabbTreeBuilder;
pub use cpu::AabbTree;
#[cfg(feature = "gpu")]
pub use gpu::GpuAabbTree;
pub use layout::{AabbNode, TreeLayout};
pub(crate) use near_leaves::NearLeaves;
pub use region::NodeBox;
pub use settings::{AabbTreeSettings, BuildOrder, TreeSearch};
pub use shape::TreeShape;
pub(super) use update::check_moved;
