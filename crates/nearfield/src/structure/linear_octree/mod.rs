//! Linear octree: points sorted along a space-filling curve, and the octants that hold them as a sorted list.
//!
//! An octant with more than `leaf_capacity` points is cut into eight, down to `max_level`; octants without points are
//! left out. Nothing is built from the top: with points sorted by key, the leaf of each point follows from the keys
//! around it, and parents, children, ropes and the numbers of the nodes in pre-, post- and breadth-first order follow
//! from the levels that neighbouring points share.
//!
//! Source: Ajmera2008 for the octree on sorted keys, its octant relations and orders; the closed form of the leaves is
//! ours. Differs: no arrays of 8^k cells (see `dense_octree` for those), empty octants are left out, any depth to 21.
//! Cost: 16 bytes a point and 56 a node on the CPU, 20 and 64 on the GPU; about 0.15 nodes a point at capacity 32; build O(n) beside the sort; a
//! ball O(nodes it touches). When to use: points whose density varies, queries of very different radii, nearest
//! neighbours, domain decomposition; for one radius and even density the uniform grid is faster. Equal points end in one leaf, however many:
//! each of them asks all others.
//!
//! Invariants:
//! 1. points are sorted by the first `3 · sorted_levels` bits of their key, ties by index; every point stands once;
//! 2. the leaves' ranges of points tile the order, and a point's cell lies in its leaf;
//! 3. a leaf holds at most `leaf_capacity` points, or is at the depth limit; an inner node holds more than that, but for
//!    trees that were balanced;
//! 4. nodes stand in breadth-first order, each level along the curve; children of a node stand side by side;
//! 5. parent, first child, child mask, ranges and ropes agree with each other;
//! 6. pre- and post-order are permutations: in one a node comes before its descendants, in the other behind them.

mod adjacency;
mod balance;
mod build;
#[cfg(feature = "gpu")]
mod builder;
mod cpu;
#[cfg(feature = "gpu")]
mod effort;
#[cfg(feature = "gpu")]
mod gpu;
mod layout;
#[cfg(feature = "gpu")]
mod linker;
mod locate;
mod nearest;
mod region;
mod settings;
#[cfg(test)]
mod tests;
mod validate;
mod walk;

#[cfg(feature = "gpu")]
pub use adjacency::GpuLeafNeighbors;
pub use adjacency::{Contact, LeafNeighbors};
#[cfg(feature = "gpu")]
pub use builder::OctreeBuilder;
pub use cpu::LinearOctree;
#[cfg(feature = "gpu")]
pub use gpu::GpuLinearOctree;
pub use layout::{NONE, OctreeNode};
#[cfg(feature = "gpu")]
pub use linker::OctreeSummary;
pub use region::OctreeLayout;
pub use settings::OctreeSettings;
pub(crate) use walk::Step;
