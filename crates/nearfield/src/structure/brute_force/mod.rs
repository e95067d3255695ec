//! No structure at all: every query is tested against every point, every ray against every triangle.
//!
//! The reference that every other structure is compared with, and the fastest choice for a few thousand points.
//! Source: the brute-force baseline of Accel. Cost: 16 bytes a point, no build beyond a copy, O(n) a query.
//!
//! Invariants: 1. the order is the caller's order; 2. packs are runs of at most 64 points.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
mod gpu_mesh;
mod mesh;

pub use cpu::BruteForce;
#[cfg(feature = "gpu")]
pub use gpu::{BruteForceLayout, GpuBruteForce};
#[cfg(feature = "gpu")]
pub use gpu_mesh::{GpuBruteForceMesh, TriangleList};
pub use mesh::BruteForceMesh;

/// Points of a pack: queries that share one set of spans. Here the span is always everything.
const PACK: usize = 64;
