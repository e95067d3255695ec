//! A kd-tree over triangles for rays: space is cut by planes, and a ray visits the leaves in their order along it.
//!
//! An inner node takes 8 bytes and a leaf 64: its box and a rope for each face, which leads to the deepest node that covers the face
//! from behind. A ray goes from leaf to leaf without a stack, on the CPU and on the GPU over the same arrays
//! ([`KdTree::nodes`], [`KdTree::leaves`], [`KdTree::references`]).
//!
//! Source: Popov2007 for the ropes and the walk, Wald2006 for where nodes are cut; Accel for the cut in the middle. Differs:
//! a triangle is in every leaf that it comes within the margin of, which makes the answers those of brute force to the bit
//! (see `geometry/prepared_ray.rs`); the walk compares t at planes and nothing else (see `walk_ropes.rs`).
//! Cost: 300 to 600 bytes a triangle (cut by cost) beside the 48 of the triangles; build O(n log n), a ray O(leaves that it passes).
//! When to use: all hits in order, rays that end early, meshes with much depth. The tree is built on the CPU; a mesh that
//! changes is built anew.
//!
//! Invariants:
//! 1. every node and every leaf is reached from the root once; leaves stand in depth-first order;
//! 2. a plane lies strictly inside the cell that it cuts, and a leaf's box is its cell: the leaves tile the tree's box;
//! 3. a rope leads to the deepest node that covers the face from behind, to none on the border of the tree;
//! 4. the leaves' ranges tile the references; a leaf names a triangle once, in ascending order;
//! 5. a leaf has every triangle with an area that comes within the margin of its box, and no triangle without;
//! 6. no leaf is deeper than `max_depth`, and the tree takes no more than `max_bytes`.

mod build;
mod clip;
mod cost;
mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
mod layout;
mod ropes;
mod settings;
mod split_binned;
mod split_events;
mod split_exact;
mod split_median;
mod validate;
mod walk;
mod walk_ropes;
mod walk_stack;

pub use cpu::{KdStats, KdTree};
#[cfg(feature = "gpu")]
pub use gpu::{GpuKdTree, KdRoot};
pub use layout::{KdLeaf, KdNode, NO_NODE};
pub use settings::{KdBuild, KdTraversal, KdTreeSettings};
