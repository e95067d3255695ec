//! From leaf to leaf along ropes. `ropes.wesl` is the twin of this file. Source: Popov2007.
//!
//! With t(p) = (p − origin) · inverse direction for a plane p, as computed, the ray has *passed* p at t where t(p) ≤ t. The
//! whole walk knows planes by that alone, so all of its decisions agree: rounding is monotone, so t(p) grows along
//! the ray from plane to plane of an axis; t never falls; a plane that is passed stays passed. There is no epsilon.
//!
//! - *Where*: a descent takes at each cut the side that the ray has reached: beyond the plane where it is passed. A cut that the
//!   ray lies on exactly is passed, so the ray is on the side that it moves to.
//! - *Exit*: the face with the least t(p) of the three ahead. The next t is that t(p) itself: the next point is exactly on
//!   the face.
//! - *Span*: within `[enter, leave)` of a leaf, no face ahead is passed and all faces behind are. Along the ray the spans
//!   tile it. So the point of the ray at t is in the leaf, up to the rounding of t(p), and what is hit at t lies within the
//!   margin of the leaf: see `geometry/prepared_ray.rs`.
//! - *Progress*: a face that was left is never left again. Behind it, faces of that axis are farther: a rope's node covers the
//!   whole face that it stands for, so in the other axes it reaches as far back and ahead as the leaf does, and where a descent
//!   meets a cut that was passed it goes beyond. Each step leaves another of finitely many faces. Where the ray leaves
//!   through an edge or a corner, two or three faces have the same t(p): the leaves in between have empty spans
//!   and are not tested.
//!
//! Differs from Popov2007: there the next leaf is found from a point of the ray, whose rounded coordinates may lie beside
//! the face; here from t, by the comparison that also gives the exits.

use super::layout::{KdArrays, NO_NODE};
use super::walk::{Course, offer_all};
use crate::geometry::{Aabb, PreparedRay, PreparedTriangle};
use crate::structure::{CountRayWork, HitVisitor};

pub(super) fn walk<V: HitVisitor, W: CountRayWork>(
    arrays: &KdArrays,
    triangles: &[PreparedTriangle],
    root: &Aabb,
    ray: &PreparedRay,
    visitor: &mut V,
    work: &mut W,
) {
    let Some(course) = Course::new(ray, root, visitor.limit()) else { return };
    let mut t = course.start;
    // Hits before that were offered by earlier leaves.
    let mut from = f32::NEG_INFINITY;
    let mut at = 0;
    loop {
        let mut node = arrays.nodes[at as usize];
        while !node.is_leaf() {
            work.node_visits(1);
            let axis = node.axis();
            let [before, beyond] = course.children(&node);
            // Two branches, not a choice of an index: a processor guesses a branch and fetches the child before t is known.
            node = if course.plane(axis, node.split) <= t {
                *std::hint::black_box(&arrays.nodes[beyond as usize])
            } else {
                arrays.nodes[before as usize]
            };
        }
        let leaf = &arrays.leaves[node.index() as usize];
        let ahead = |axis: usize| if course.is_ascending[axis] { leaf.max[axis] } else { leaf.min[axis] };
        let planes = [0, 1, 2].map(|axis| course.plane(axis, ahead(axis)));
        let mut exit = usize::from(planes[1] < planes[0]);
        if planes[2] < planes[exit] {
            exit = 2;
        }
        let rope = leaf.ropes[2 * exit + usize::from(course.is_ascending[exit])];
        let leave = if rope == NO_NODE { f32::INFINITY } else { planes[exit].max(t) };
        work.leaf_visits(1);
        if leave > t {
            let references = &arrays.references[leaf.references()];
            if offer_all(triangles, references, ray, from, leave, visitor, work).is_break() {
                return;
            }
            from = leave;
        }
        if leave > visitor.limit() || rope == NO_NODE {
            return;
        }
        work.rope_steps(1);
        (t, at) = (leave, rope);
    }
}
