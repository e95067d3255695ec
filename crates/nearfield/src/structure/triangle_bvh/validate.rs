//! The invariants of the hierarchy as code; the numbers are those of the module's page.

use super::refit::bounds_of;
use super::settings::BLOCK;
use super::{MOST_LEVELS, TriangleBvh};
use crate::geometry::Aabb;

impl TriangleBvh {
    /// The first broken invariant, in words; `None` for a sound tree. For tests and for debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        self.broken_leaves().or_else(|| self.broken_boxes()).or_else(|| self.broken_shape())
    }

    fn broken_leaves(&self) -> Option<String> {
        let triangles = self.triangles.as_slice();
        let mut seen = vec![false; triangles.len()];
        for (place, block) in self.blocks.iter().enumerate() {
            let n = block.len();
            if n == 0 || n > BLOCK || block.lanes != (1 << n) - 1 {
                return Some(format!("1: leaf {place} has the lanes {:b}", block.lanes));
            }
            for lane in 0..n {
                let index = block.indices[lane] as usize;
                if index >= triangles.len() || std::mem::replace(&mut seen[index], true) {
                    return Some(format!("1: triangle {index} of leaf {place} is out of range or stands twice"));
                }
                if block.triangle(lane) != triangles[index] {
                    return Some(format!("1: leaf {place} has another triangle {index} than was prepared"));
                }
            }
        }
        let mut missing = triangles.iter().zip(&seen).filter(|(triangle, seen)| triangle.has_area() && !**seen);
        missing.next().map(|(triangle, _)| format!("1: triangle {} is in no leaf", triangle.index))
    }

    fn broken_boxes(&self) -> Option<String> {
        let holds = |outer: &Aabb, inner: &Aabb| outer.union(*inner) == *outer;
        let space = self.triangles.space();
        for (place, node) in self.nodes.iter().enumerate() {
            for (slot, child) in node.children() {
                let held = match (child.is_leaf(), self.blocks.get(child.index()), self.nodes.get(child.index())) {
                    (true, Some(block), _) => bounds_of(block, space),
                    (false, _, Some(below)) => below.all_bounds(),
                    _ => return Some(format!("3: child {slot} of node {place} is {child:?}, which is not there")),
                };
                if !holds(&node.bounds(slot), &held) {
                    return Some(format!("2: the box of child {slot} of node {place} does not hold what is below it"));
                }
            }
        }
        None
    }

    fn broken_shape(&self) -> Option<String> {
        let mut levels = vec![0u32; self.nodes.len()];
        let mut leaves = vec![false; self.blocks.len()];
        if let Some(root) = levels.first_mut() {
            *root = 1;
        }
        for (place, node) in self.nodes.iter().enumerate() {
            let mut last: Option<usize> = None;
            for (slot, child) in node.children() {
                if child.is_leaf() {
                    if std::mem::replace(&mut leaves[child.index()], true) {
                        return Some(format!("3: leaf {} has two parents", child.index()));
                    }
                    continue;
                }
                let is_beside = last.is_none_or(|last| child.index() == last + 1);
                if child.index() <= place || levels[child.index()] != 0 || !is_beside {
                    return Some(format!("3: child {slot} of node {place} is {child:?}"));
                }
                levels[child.index()] = levels[place] + 1;
                last = Some(child.index());
            }
        }
        if levels.contains(&0) || leaves.contains(&false) {
            return Some("3: a node or a leaf has no parent".to_owned());
        }
        let depth = levels.iter().copied().max().unwrap_or(0);
        (depth > self.depth || depth > MOST_LEVELS)
            .then(|| format!("4: a path has {depth} nodes, the tree says {}", self.depth))
    }
}
