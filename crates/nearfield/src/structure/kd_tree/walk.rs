//! What both walks share: planes along a ray, and the test of a leaf.

use std::ops::ControlFlow;

use super::layout::KdNode;
use crate::geometry::{Aabb, PreparedRay, PreparedTriangle};
use crate::structure::{CountRayWork, HitVisitor};

/// A ray as it passes planes.
pub(super) struct Course {
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Whether coordinates grow along the ray.
    pub(super) is_ascending: [bool; 3],
    /// Where it enters the tree, or its first t inside.
    pub(super) start: f32,
    /// Where it leaves the tree.
    pub(super) end: f32,
}

impl Course {
    /// `None` where the ray has nothing to look for in the tree.
    #[inline(always)]
    pub(super) fn new(ray: &PreparedRay, root: &Aabb, limit: f32) -> Option<Self> {
        let (near, end) = ray.slabs(root.min, root.max);
        let start = near.max(ray.t_min);
        let inverse = ray.inverse.to_array();
        let is_ascending = inverse.map(|slope| slope > 0.0);
        (start <= end && start <= limit).then(|| Self {
            origin: ray.origin.to_array(),
            inverse,
            is_ascending,
            start,
            end,
        })
    }

    /// The children of a node: the one before its plane, and the one beyond.
    #[inline(always)]
    pub(super) fn children(&self, node: &KdNode) -> [u32; 2] {
        let is_right = u32::from(self.is_ascending[node.axis()]);
        [node.index() + 1 - is_right, node.index() + is_right]
    }

    /// t at a plane, by the formula of [`PreparedRay::slabs`].
    #[inline(always)]
    pub(super) fn plane(&self, axis: usize, at: f32) -> f32 {
        (at - self.origin[axis]) * self.inverse[axis]
    }
}

/// Tests the triangles of a leaf, and offers what is hit at `from` or later.
#[inline(always)]
pub(super) fn offer_all<V: HitVisitor, W: CountRayWork>(
    triangles: &[PreparedTriangle],
    references: &[u32],
    ray: &PreparedRay,
    from: f32,
    leave: f32,
    visitor: &mut V,
    work: &mut W,
) -> ControlFlow<()> {
    for &reference in references {
        work.triangle_tests(1);
        if let Some(hit) = triangles[reference as usize].hit(ray)
            && hit.t >= from
        {
            visitor.offer(&hit, leave)?;
        }
    }
    ControlFlow::Continue(())
}
