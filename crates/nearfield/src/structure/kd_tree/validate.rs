//! The invariants of `mod.rs` as code, by their numbers.

use glam::DVec3;

use super::layout::{KdLeaf, NO_NODE, halves};
use super::{KdNode, KdTree};
use crate::geometry::{Aabb, PreparedTriangle};
use crate::structure::RayStructure;

impl KdTree {
    /// The first broken invariant, in words; `None` for a sound tree. Takes time in leaves × triangles: for tests and for
    /// debugging.
    pub fn broken_invariant(&self) -> Option<String> {
        self.check_invariants().err()
    }

    fn check_invariants(&self) -> Result<(), String> {
        let cells = self.check_nodes()?;
        self.check_ropes(&cells)?;
        self.check_references()?;
        let triangles = self.triangles().as_slice();
        let margin = f64::from(self.triangles().space().margin);
        self.leaves().iter().enumerate().try_for_each(|(i, leaf)| self.check_leaf(i, leaf, triangles, margin))?;
        let (stats, settings) = (self.stats(), self.settings());
        if stats.depth > settings.max_depth {
            return Err(format!("6: depth {} is beyond {}", stats.depth, settings.max_depth));
        }
        let bound = settings.byte_bound(triangles.len());
        if stats.bytes > bound {
            return Err(format!("6: {} bytes are more than {bound}", stats.bytes));
        }
        Ok(())
    }

    /// Invariants 1 and 2; gives the cells of all nodes.
    fn check_nodes(&self) -> Result<Vec<Aabb>, String> {
        let mut cells = vec![Aabb::EMPTY; self.nodes().len()];
        let (mut reached, mut leaves) = (0, 0);
        let mut stack = vec![(0, self.root_cell())];
        while let Some((at, cell)) = stack.pop() {
            let node = *self.nodes().get(at).ok_or_else(|| format!("1: node {at} is not there"))?;
            if !cells[at].is_empty() {
                return Err(format!("1: node {at} is reached twice"));
            }
            cells[at] = cell;
            reached += 1;
            let first = node.index() as usize;
            if node.is_leaf() {
                if first != leaves {
                    return Err(format!("1: leaf {first} comes as number {leaves}"));
                }
                let leaf = self.leaves().get(first).ok_or_else(|| format!("1: leaf {first} is not there"))?;
                if leaf.cell() != cell {
                    return Err(format!("2: the box of leaf {first} is {:?}, its cell {cell:?}", leaf.cell()));
                }
                leaves += 1;
                continue;
            }
            if !(cell.min[node.axis()] < node.split && node.split < cell.max[node.axis()]) {
                return Err(format!("2: node {at} is cut at {} outside {cell:?}", node.split));
            }
            let [left, right] = halves(&cell, node.axis(), node.split);
            stack.push((first + 1, right));
            stack.push((first, left));
        }
        if (reached, leaves) != (self.nodes().len(), self.leaves().len()) {
            return Err(format!("1: {reached} nodes and {leaves} leaves are reached"));
        }
        Ok(cells)
    }

    /// Invariant 3.
    fn check_ropes(&self, cells: &[Aabb]) -> Result<(), String> {
        for (i, leaf) in self.leaves().iter().enumerate() {
            for (face, &rope) in leaf.ropes.iter().enumerate() {
                let at = face_plane(&leaf.cell(), face);
                if rope == NO_NODE {
                    if at != face_plane(&self.root_cell(), face) {
                        return Err(format!("3: face {face} of leaf {i} has no rope and is not on the border"));
                    }
                    continue;
                }
                if !covers(&cells[rope as usize], &leaf.cell(), face) {
                    return Err(format!("3: rope {face} of leaf {i} leads to a node that does not cover the face"));
                }
                let node: KdNode = self.nodes()[rope as usize];
                let children = if node.is_leaf() { 0..0 } else { node.index()..node.index() + 2 };
                if children.into_iter().any(|child| covers(&cells[child as usize], &leaf.cell(), face)) {
                    return Err(format!("3: rope {face} of leaf {i} could lead deeper"));
                }
            }
        }
        Ok(())
    }

    /// Invariant 4.
    fn check_references(&self) -> Result<(), String> {
        let mut end = 0;
        for (i, leaf) in self.leaves().iter().enumerate() {
            if leaf.first != end {
                return Err(format!("4: the references of leaf {i} begin at {}, not at {end}", leaf.first));
            }
            end += leaf.count;
            let here =
                self.references().get(leaf.references()).ok_or_else(|| format!("4: leaf {i} reaches too far"))?;
            if !here.is_sorted_by(|a, b| a < b) {
                return Err(format!("4: the references of leaf {i} do not ascend"));
            }
        }
        let n = self.references().len();
        if end as usize == n { Ok(()) } else { Err(format!("4: {end} of {n} references belong to leaves")) }
    }

    /// Invariant 5.
    fn check_leaf(&self, i: usize, leaf: &KdLeaf, triangles: &[PreparedTriangle], margin: f64) -> Result<(), String> {
        let references = &self.references()[leaf.references()];
        for (index, triangle) in triangles.iter().enumerate() {
            let is_there = references.binary_search(&(index as u32)).is_ok();
            if !triangle.has_area() {
                if is_there {
                    return Err(format!("5: leaf {i} has triangle {index}, which has no area"));
                }
            } else if !is_there && touches(triangle, &leaf.cell(), margin) {
                return Err(format!("5: leaf {i} lacks triangle {index}"));
            }
        }
        Ok(())
    }
}

/// Coordinate of a face.
fn face_plane(cell: &Aabb, face: usize) -> f32 {
    if face.is_multiple_of(2) { cell.min[face / 2] } else { cell.max[face / 2] }
}

/// Whether a node's cell lies behind a face of a leaf and reaches as far in the other axes.
fn covers(node: &Aabb, leaf: &Aabb, face: usize) -> bool {
    let axis = face / 2;
    face_plane(node, face ^ 1) == face_plane(leaf, face)
        && (0..3)
            .filter(|&other| other != axis)
            .all(|other| node.min[other] <= leaf.min[other] && leaf.max[other] <= node.max[other])
}

/// Whether a triangle comes within the margin of a cell, by separating axes: another way than the builders take. Up to
/// the rounding of an f64 in the margin's last millionth, where the answer is no.
fn touches(triangle: &PreparedTriangle, cell: &Aabb, margin: f64) -> bool {
    let (min, max) = (cell.min.as_dvec3(), cell.max.as_dvec3());
    let center = 0.5 * (min + max);
    let half = 0.5 * (max - min) + margin * (1.0 - 1e-6);
    let [a, b, c] = [triangle.low, triangle.middle, triangle.high].map(|corner| corner.as_dvec3() - center);
    let apart = |axis: DVec3| {
        let along = [a.dot(axis), b.dot(axis), c.dot(axis)];
        let (low, high) = along.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
        let reach = half.dot(axis.abs());
        low > reach || high < -reach
    };
    let edges = [b - a, c - b, a - c];
    let units = [DVec3::X, DVec3::Y, DVec3::Z];
    let crossed = edges.iter().flat_map(|edge| units.iter().map(|unit| edge.cross(*unit)));
    !units.into_iter().chain([edges[0].cross(edges[1])]).chain(crossed).any(apart)
}
