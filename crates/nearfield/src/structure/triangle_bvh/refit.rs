//! Boxes that follow triangles whose corners have moved.

use std::time::Instant;

use rayon::prelude::*;

use super::TriangleBvh;
use super::layout::{Block, Node};
use crate::Result;
use crate::geometry::{Aabb, RaySpace, TriMesh};
use crate::structure::{BuildStage, PreparedTriangles};

/// Leaves that a thread takes at once.
const CHUNK: usize = 1 << 10;

impl TriangleBvh {
    /// Takes a mesh of the same triangles with moved vertices: prepares them and fits the boxes from the leaves up, while
    /// the shape of the tree stays. Answers are exact; the farther triangles have moved from where they were when the
    /// tree was built, the more of it each ray meets, until it is built anew. That happens here where a triangle that had
    /// no area, and so no place in the tree, now has one.
    ///
    /// # Errors
    /// `LengthMismatch` for another number of triangles, and as [`PreparedTriangles::new`]; the tree is then as it was.
    pub fn refit(&mut self, moved: &TriMesh) -> Result<()> {
        self.triangles.check_moved(moved)?;
        let start = Instant::now();
        let triangles = PreparedTriangles::new(moved)?;
        let mut stages = vec![];
        stages.push(BuildStage::on_host("prepare", start));
        let in_tree: usize = self.blocks.iter().map(Block::len).sum();
        if in_tree < triangles.len() && self.has_newcomers(&triangles) {
            let mut built = Self::of(triangles, &self.settings)?;
            stages.append(&mut built.stages);
            *self = Self { stages, simd: self.simd, ..built };
            return Ok(());
        }
        let start = Instant::now();
        let bounds: Vec<Aabb> =
            self.blocks.par_iter_mut().with_min_len(CHUNK).map(|block| follow(block, &triangles)).collect();
        // Children stand behind their parents.
        for place in (0..self.nodes.len()).rev() {
            let (nodes, below) = self.nodes.split_at_mut(place + 1);
            let node: &mut Node = &mut nodes[place];
            for slot in 0..node.children.len() {
                let child = node.children[slot];
                if child == super::layout::Child::NONE {
                    continue;
                }
                let fitted =
                    if child.is_leaf() { bounds[child.index()] } else { below[child.index() - place - 1].all_bounds() };
                node.set_bounds(slot, &fitted);
            }
        }
        self.triangles = triangles;
        stages.push(BuildStage::on_host("fit", start));
        self.stages = stages;
        Ok(())
    }

    /// Whether a triangle outside the tree has an area.
    fn has_newcomers(&self, triangles: &PreparedTriangles) -> bool {
        let mut is_inside = vec![false; triangles.len()];
        for block in &self.blocks {
            block.indices[..block.len()].iter().for_each(|&index| is_inside[index as usize] = true);
        }
        triangles.as_slice().iter().zip(is_inside).any(|(triangle, is_inside)| !is_inside && triangle.has_area())
    }
}

/// Takes the corners of the moved triangles into a leaf; its new box.
fn follow(block: &mut Block, triangles: &PreparedTriangles) -> Aabb {
    for lane in 0..block.len() {
        block.set(lane, &triangles.as_slice()[block.indices[lane] as usize]);
    }
    bounds_of(block, triangles.space())
}

/// The union of the widened boxes of a leaf's triangles.
pub(super) fn bounds_of(block: &Block, space: &RaySpace) -> Aabb {
    (0..block.len()).fold(Aabb::EMPTY, |all, lane| all.union(space.widened(&block.triangle(lane).bounds())))
}
