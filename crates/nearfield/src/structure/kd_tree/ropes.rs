//! The boxes of the leaves, and what lies behind their faces. Source: Popov2007 §3.
//!
//! The rope of a face is the deepest node that covers it: on the way down from the root each cut gives both sides the other as
//! neighbour, and neighbours are replaced by their children for as long as one of those covers the whole face.

use super::layout::{KdArrays, KdLeaf, KdNode, NO_NODE, halves};
use crate::geometry::Aabb;

/// Depth down to which the two halves of a node are linked side by side.
const FORK_DEPTH: u32 = 8;

/// Fills in the boxes and the ropes of all leaves.
pub(super) fn link(arrays: &mut KdArrays, root: Aabb) {
    link_below(&arrays.nodes, &mut arrays.leaves, 0, 0, root, [NO_NODE; 6], 0);
}

/// Links the leaves of a subtree, which are all of `leaves`; the first of them has index `base`.
fn link_below(
    nodes: &[KdNode],
    leaves: &mut [KdLeaf],
    base: u32,
    node: u32,
    cell: Aabb,
    mut ropes: [u32; 6],
    depth: u32,
) {
    for (face, rope) in ropes.iter_mut().enumerate() {
        *rope = pushed(nodes, *rope, face, &cell);
    }
    let here = nodes[node as usize];
    if here.is_leaf() {
        let leaf = &mut leaves[(here.index() - base) as usize];
        *leaf = KdLeaf { min: cell.min, max: cell.max, ropes, ..*leaf };
        return;
    }
    let (axis, left, right) = (here.axis(), here.index(), here.index() + 1);
    let [left_cell, right_cell] = halves(&cell, axis, here.split);
    let (mut left_ropes, mut right_ropes) = (ropes, ropes);
    left_ropes[2 * axis + 1] = right;
    right_ropes[2 * axis] = left;
    let right_base = first_leaf(nodes, right);
    let (left_leaves, right_leaves) = leaves.split_at_mut((right_base - base) as usize);
    let depth = depth + 1;
    let mut link_left = || link_below(nodes, left_leaves, base, left, left_cell, left_ropes, depth);
    let mut link_right = || link_below(nodes, right_leaves, right_base, right, right_cell, right_ropes, depth);
    if depth <= FORK_DEPTH {
        rayon::join(link_left, link_right);
    } else {
        link_left();
        link_right();
    }
}

/// The first leaf of a subtree.
fn first_leaf(nodes: &[KdNode], mut node: u32) -> u32 {
    loop {
        let here = nodes[node as usize];
        if here.is_leaf() {
            return here.index();
        }
        node = here.index();
    }
}

/// The deepest node at or below `rope` that covers a face of the cell.
fn pushed(nodes: &[KdNode], mut rope: u32, face: usize, cell: &Aabb) -> u32 {
    while rope != NO_NODE {
        let node = nodes[rope as usize];
        if node.is_leaf() {
            break;
        }
        let axis = node.axis();
        let is_right = if axis == face / 2 {
            // Behind the largest face lies the child with the smaller coordinates.
            face.is_multiple_of(2)
        } else if node.split >= cell.max[axis] {
            false
        } else if node.split <= cell.min[axis] {
            true
        } else {
            break;
        };
        rope = node.index() + u32::from(is_right);
    }
    rope
}
