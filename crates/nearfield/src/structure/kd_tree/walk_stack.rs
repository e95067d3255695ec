//! From the root, with a stack of the subtrees that come later. It decides as [`super::walk_ropes`] does, and so meets
//! the same leaves with the same spans.

use super::layout::KdArrays;
use super::settings::DEEPEST;
use super::walk::{Course, offer_all};
use crate::geometry::{Aabb, PreparedRay, PreparedTriangle};
use crate::structure::{CountRayWork, HitVisitor};

/// A subtree that comes later, and the span of the ray in it.
#[derive(Clone, Copy)]
struct Later {
    node: u32,
    enter: f32,
    leave: f32,
}

pub(super) fn walk<V: HitVisitor, W: CountRayWork>(
    arrays: &KdArrays,
    triangles: &[PreparedTriangle],
    root: &Aabb,
    ray: &PreparedRay,
    visitor: &mut V,
    work: &mut W,
) {
    let Some(course) = Course::new(ray, root, visitor.limit()) else { return };
    // A node waits on each level at most.
    let mut stack = [Later { node: 0, enter: 0.0, leave: 0.0 }; DEEPEST as usize];
    let mut waiting = 0;
    let (mut at, mut enter, mut leave) = (0, course.start, course.end);
    let mut from = f32::NEG_INFINITY;
    loop {
        let mut node = arrays.nodes[at as usize];
        while !node.is_leaf() {
            work.node_visits(1);
            let axis = node.axis();
            let plane = course.plane(axis, node.split);
            let [before, beyond] = course.children(&node);
            at = if plane <= enter {
                beyond
            } else {
                if plane < leave {
                    stack[waiting] = Later { node: beyond, enter: plane, leave };
                    waiting += 1;
                    leave = plane;
                }
                before
            };
            node = arrays.nodes[at as usize];
        }
        let leaf = &arrays.leaves[node.index() as usize];
        let is_last = waiting == 0;
        work.leaf_visits(1);
        let references = &arrays.references[leaf.references()];
        let until = if is_last { f32::INFINITY } else { leave };
        if offer_all(triangles, references, ray, from, until, visitor, work).is_break() || is_last {
            return;
        }
        waiting -= 1;
        (at, enter, leave) = (stack[waiting].node, stack[waiting].enter, stack[waiting].leave);
        if enter > visitor.limit() {
            return;
        }
        from = enter;
    }
}
