//! The tree of boxes in up to 16 dimensions, over `f32` or `f64`: shape, order and refit are those of the tree in three.
//!
//! Source: Xing2017, whose tree has no fixed dimension. On the CPU the dimension is a type's, on the device it is given at run
//! time and a constant of the kernels. It differs from [`super::AabbTree`] in what it leaves out: no
//! periodic axes, no order along the Hilbert curve. Cost: `D + 1` numbers a point and `2 D` a node. When to use: points
//! of any dimension but three, and `f64`; the more dimensions, the larger the part of the tree that a ball meets, and from
//! about a dozen on most searches read most of the points.
//!
//! Invariants:
//! 1. every point stands once in the order;
//! 2. the shape follows from the numbers of points and bucket alone;
//! 3. every point lies in the box of each node above it;
//! 4. boxes are the smallest ones, after a build and after a refit.

mod check;
mod distance;
#[cfg(feature = "gpu")]
mod gpu;
mod points;
mod settings;
mod tree;
mod validate;
mod walk;

pub(crate) use check::{coordinates, radius};
pub use distance::{RADIUS_SLACK, dist2};
pub(crate) use distance::{dist2_of_boxes, dist2_to_box, is_swept_near, reach};
#[cfg(feature = "gpu")]
pub(crate) use gpu::rows_of;
#[cfg(feature = "gpu")]
pub use gpu::{GpuAabbTreeN, row_vectors};
pub use points::PointsN;
pub use settings::AabbTreeNSettings;
pub use tree::{AabbTreeN, MAX_DIMENSION};
