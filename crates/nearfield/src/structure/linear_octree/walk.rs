//! Walks over the nodes: by level, in pre-order, in post-order, and over those that a region touches.

use std::ops::Range;

use super::LinearOctree;
use super::layout::{NONE, OctreeNode};
use super::region::CellRegion;

impl LinearOctree {
    /// Number of levels: one more than the depth; 0 without points.
    pub fn n_levels(&self) -> usize {
        self.nodes.level_starts.len() - 1
    }

    /// The nodes of a level, along the curve; none below the deepest one.
    pub fn level(&self, level: u32) -> Range<usize> {
        let starts = &self.nodes.level_starts;
        match (starts.get(level as usize), starts.get(level as usize + 1)) {
            (Some(&first), Some(&end)) => first as usize..end as usize,
            _ => self.nodes().len()..self.nodes().len(),
        }
    }

    /// `[n_nodes]` number of each node in pre-order: parents before children.
    pub fn pre_order(&self) -> &[u32] {
        &self.nodes.pre_order
    }

    /// `[n_nodes]` number of each node in post-order: children before parents.
    pub fn post_order(&self) -> &[u32] {
        &self.nodes.post_order
    }

    /// The nodes in pre-order `[n_nodes]`.
    pub fn in_pre_order(&self) -> Vec<u32> {
        inverse(&self.nodes.pre_order)
    }

    /// The nodes in post-order `[n_nodes]`: what gathers from the leaves up may take them in this order.
    pub fn in_post_order(&self) -> Vec<u32> {
        inverse(&self.nodes.post_order)
    }

    /// The leaves along the curve.
    pub fn leaves(&self) -> impl Iterator<Item = u32> + '_ {
        let nodes = self.nodes();
        let mut node = if nodes.is_empty() { NONE } else { 0 };
        std::iter::from_fn(move || {
            while !nodes.get(node as usize)?.is_leaf() {
                node = nodes[node as usize].first_child;
            }
            let leaf = node;
            node = nodes[leaf as usize].rope;
            Some(leaf)
        })
    }

    /// Appends the spans of points in the nodes that the region touches; touching spans become one.
    pub(super) fn spans_in(&self, region: &CellRegion, spans: &mut Vec<Range<usize>>) {
        self.nodes_in(region, |node| {
            let points = node.points();
            match spans.last_mut() {
                Some(last) if last.end == points.start => last.end = points.end,
                _ => spans.push(points),
            }
        });
    }

    /// Calls `visit` with nodes that together hold all points in the cells of the region, along the curve: the largest
    /// ones that lie inside, and the leaves that lie partly inside.
    pub(super) fn nodes_in(&self, region: &CellRegion, mut visit: impl FnMut(&OctreeNode)) {
        let nodes = self.nodes();
        let mut next = if nodes.is_empty() { NONE } else { 0 };
        while let Some(node) = nodes.get(next as usize) {
            next = node.rope;
            if region.overlaps(node) {
                if node.is_leaf() || region.contains(node) {
                    visit(node);
                } else {
                    next = node.first_child;
                }
            }
        }
    }
}

/// The inverse of a permutation.
fn inverse(numbers: &[u32]) -> Vec<u32> {
    let mut inverse = vec![0; numbers.len()];
    for (i, &number) in numbers.iter().enumerate() {
        inverse[number as usize] = i as u32;
    }
    inverse
}
