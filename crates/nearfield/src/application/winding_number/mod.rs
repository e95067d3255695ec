//! How often a surface winds around a place: 1 inside, 0 outside, in between where the surface has holes or is only sampled.
//!
//! The winding number of a surface is its solid angle as seen from the place over 4π: ∫ n·(p − q) / (4π|p − q|³) dA. Of a
//! triangle it is known in closed form (VanOosterom1983); a sample with a normal and an area is a dipole,
//! a n·(p − q) / (4π|p − q|³). A place is inside where the number passes ½, whatever the gaps, the overlaps and the noise.
//!
//! Source: Barill2018. A tree is laid over the elements; a node whose centre is farther than β times its radius is replaced
//! by the Taylor expansion of its dipoles about its centre up to the second order, all others are opened. The error falls
//! with β³; at β = 2 it is a few 1e-3. Differs: of each order only the symmetric part is kept (23 numbers a node), all
//! that counts in a harmonic field; expansions of inner nodes are moved up from their children.
//!
//! Cost: 24 numbers a node, a node for every 3 to 4 elements, and the elements; the build is that of an AABB-tree and one
//! pass over the nodes, in f64; a place opens some hundred nodes.

mod areas;
mod cpu;
mod expansion;
#[cfg(feature = "gpu")]
mod gpu;
mod solid_angle;
#[cfg(test)]
mod tests;
mod tree;

pub use areas::disk_areas;
pub use cpu::WindingNumber;
#[cfg(feature = "gpu")]
pub use gpu::{GpuWindingNumber, WindingLayout};
