//! The walk towards what is nearest to a place: boxes near it first, until none can hold anything nearer.

use super::TriangleBvh;
use super::collapse::WIDTH;
use super::layout::{Child, Node};
use super::walk::LARGE_STACK;
use crate::geometry::PreparedTriangle;

/// Part of a squared distance that boxes may be off by rounding: more than that of six operations.
const SLACK: f32 = 1.0 - 1.0 / (1 << 20) as f32;

impl TriangleBvh {
    /// Hands triangles to `test`, those in near boxes first, until none that is left can lie within the squared distance that
    /// `test` returned last, or the one given.
    pub(crate) fn nearest_first(&self, place: [f32; 3], reach2: f64, mut test: impl FnMut(&PreparedTriangle) -> f64) {
        if self.nodes.is_empty() {
            return;
        }
        let mut stack = [(0.0f32, Child::ROOT); LARGE_STACK + 1];
        let (mut waiting, mut reach2) = (1, reach2);
        while waiting > 0 {
            waiting -= 1;
            let (below, child) = stack[waiting];
            if f64::from(below) > reach2 {
                continue;
            }
            if child.is_leaf() {
                let block = &self.blocks[child.index()];
                for lane in 0..block.len() {
                    reach2 = test(&block.triangle(lane)).min(reach2);
                }
                continue;
            }
            let node = &self.nodes[child.index()];
            let below = dist2_to_boxes(node, place);
            let first = waiting;
            for (slot, child) in node.children().filter(|(slot, _)| f64::from(below[*slot]) <= reach2) {
                // The nearest last: it is taken next.
                let mut at = waiting;
                while at > first && stack[at - 1].0 < below[slot] {
                    stack[at] = stack[at - 1];
                    at -= 1;
                }
                stack[at] = (below[slot], child);
                waiting += 1;
            }
        }
    }
}

/// Squared distances that nothing in each box falls below.
#[inline(always)]
fn dist2_to_boxes(node: &Node, place: [f32; 3]) -> [f32; WIDTH] {
    let mut sums = [0.0; WIDTH];
    for (axis, &own) in place.iter().enumerate() {
        for (slot, sum) in sums.iter_mut().enumerate() {
            let gap = (node.planes[axis][slot] - own).max(own - node.planes[axis + 3][slot]).max(0.0);
            *sum += gap * gap;
        }
    }
    sums.map(|sum| sum * SLACK)
}
