//! What the kernels know of the tree: the same bytes on both sides. `layout.wesl` is the twin of this file.

use bytemuck::{Pod, Zeroable};

use super::region::NodeBox;
#[cfg(feature = "gpu")]
use super::shape::TreeShape;
#[cfg(feature = "gpu")]
use crate::geometry::Period;

/// A node on a device.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct AabbNode {
    /// Smallest corner.
    pub low: [f32; 3],
    /// First of its points in the tree's order.
    pub first_point: u32,
    /// Largest corner.
    pub high: [f32; 3],
    /// End of its points.
    pub end_point: u32,
}

impl AabbNode {
    /// Node `node` of the shape with this box.
    #[cfg(feature = "gpu")]
    pub(super) fn new(shape: &TreeShape, node: usize, aabb: &NodeBox) -> Self {
        let points = shape.points(node);
        Self { low: aabb.min, first_point: points.start as u32, high: aabb.max, end_point: points.end as u32 }
    }

    /// Its box.
    pub fn aabb(&self) -> NodeBox {
        NodeBox { min: self.low, max: self.high }
    }
}

/// What is the same for all nodes, in the bytes of a uniform.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct TreeLayout {
    /// Length of the period by axis; 0 where not periodic.
    pub period: [f32; 3],
    /// Number of points.
    pub n_points: u32,
    /// One over the period; 0 where not periodic.
    pub inverse_period: [f32; 3],
    /// Level of the leaves.
    pub depth: u32,
}

#[cfg(feature = "gpu")]
impl TreeLayout {
    pub(super) fn new(shape: &TreeShape, period: Period) -> Self {
        Self {
            period: period.lengths().to_array(),
            n_points: shape.n_points() as u32,
            inverse_period: period.inverse().to_array(),
            depth: shape.depth(),
        }
    }
}
