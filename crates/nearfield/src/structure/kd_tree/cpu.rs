//! The tree on the CPU: build, walk, figures.

use std::sync::Arc;
use std::time::Instant;

use super::build::build;
use super::cost::surface;
use super::layout::{KdArrays, KdLeaf, KdNode};
use super::settings::{KdTraversal, KdTreeSettings};
use super::{ropes, walk_ropes, walk_stack};
use crate::Result;
use crate::geometry::{Aabb, PreparedRay, TriMesh};
use crate::structure::{BuildStage, CountRayWork, HitVisitor, PreparedTriangles, RayStructure};

/// A kd-tree with ropes over the triangles of a mesh.
#[derive(Debug, Clone)]
pub struct KdTree {
    triangles: Arc<PreparedTriangles>,
    arrays: KdArrays,
    root: Aabb,
    settings: KdTreeSettings,
    traversal: KdTraversal,
    stages: Vec<BuildStage>,
}

/// Figures of a kd-tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KdStats {
    /// Inner nodes and leaves.
    pub nodes: u64,
    /// Leaves.
    pub leaves: u64,
    /// Leaves without triangles.
    pub empty_leaves: u64,
    /// Triangles of all leaves together.
    pub references: u64,
    /// Cuts above the deepest leaf.
    pub depth: u32,
    /// Expected cost of a ray that meets the tree's box and hits nothing, in the unit of the settings' `test_cost`.
    pub sah_cost: f64,
    /// Bytes of the tree, the prepared triangles not counted.
    pub bytes: u64,
}

impl KdTree {
    /// Prepares the triangles of a mesh and builds a tree over them. It is walked by its ropes.
    ///
    /// # Errors
    /// As [`PreparedTriangles::new`] and [`KdTree::of`].
    pub fn build(mesh: &TriMesh, settings: &KdTreeSettings) -> Result<Self> {
        settings.validate()?;
        let start = Instant::now();
        let triangles = PreparedTriangles::new(mesh)?;
        let prepare = BuildStage::on_host("prepare", start);
        let mut tree = Self::of(triangles, settings)?;
        tree.stages.insert(0, prepare);
        Ok(tree)
    }

    /// Builds a tree over triangles that were prepared before.
    ///
    /// # Errors
    /// `InvalidSetting`; `OutOfMemory` where `max_bytes` has no room for one leaf with all triangles, or the host has not
    /// enough.
    pub fn of(triangles: Arc<PreparedTriangles>, settings: &KdTreeSettings) -> Result<Self> {
        settings.validate()?;
        let root = triangles.space().widened_bounds();
        let start = Instant::now();
        let mut arrays = build(triangles.as_slice(), triangles.space(), settings)?;
        let cut = BuildStage::on_host("cut", start);
        let start = Instant::now();
        ropes::link(&mut arrays, root);
        let stages = vec![cut, BuildStage::on_host("ropes", start)];
        Ok(Self { triangles, arrays, root, settings: *settings, traversal: KdTraversal::default(), stages })
    }

    /// The same tree, walked in another way.
    pub fn with_traversal(mut self, traversal: KdTraversal) -> Self {
        self.traversal = traversal;
        self
    }

    /// Sets how it is walked.
    pub fn set_traversal(&mut self, traversal: KdTraversal) {
        self.traversal = traversal;
    }

    /// How it is walked.
    pub fn traversal(&self) -> KdTraversal {
        self.traversal
    }

    /// What it was built with.
    pub fn settings(&self) -> &KdTreeSettings {
        &self.settings
    }

    /// Its box: the bounds of the mesh, wider by the margin.
    pub fn root_cell(&self) -> Aabb {
        self.root
    }

    /// `[nodes]` as they lie on the device too; the first is the root.
    pub fn nodes(&self) -> &[KdNode] {
        &self.arrays.nodes
    }

    /// `[leaves]` as they lie on the device too.
    pub fn leaves(&self) -> &[KdLeaf] {
        &self.arrays.leaves
    }

    /// `[references]` triangles of the leaves, as they lie on the device too.
    pub fn references(&self) -> &[u32] {
        &self.arrays.references
    }

    /// Counts what the tree is made of.
    pub fn stats(&self) -> KdStats {
        let whole = surface(&self.root);
        let [pass, test] = [self.settings.traversal_cost, self.settings.test_cost].map(f64::from);
        let (mut depth, mut cost) = (0, 0.0);
        self.for_each_node(|node, cell, level| {
            depth = depth.max(level);
            let chance = surface(cell) / whole;
            cost += chance
                * if node.is_leaf() { test * f64::from(self.arrays.leaves[node.index() as usize].count) } else { pass };
        });
        KdStats {
            nodes: self.arrays.nodes.len() as u64,
            leaves: self.arrays.leaves.len() as u64,
            empty_leaves: self.arrays.leaves.iter().filter(|leaf| leaf.count == 0).count() as u64,
            references: self.arrays.references.len() as u64,
            depth,
            sah_cost: cost,
            bytes: self.arrays.bytes(),
        }
    }

    /// Every node with its cell and the number of cuts above it, from the root on.
    fn for_each_node(&self, mut each: impl FnMut(&KdNode, &Aabb, u32)) {
        let mut stack = vec![(0u32, self.root, 0)];
        while let Some((at, cell, level)) = stack.pop() {
            let node = self.arrays.nodes[at as usize];
            each(&node, &cell, level);
            if !node.is_leaf() {
                let [left, right] = super::layout::halves(&cell, node.axis(), node.split);
                stack.push((node.index() + 1, right, level + 1));
                stack.push((node.index(), left, level + 1));
            }
        }
    }
}

impl RayStructure for KdTree {
    const NAME: &'static str = "kd-tree";

    fn search(&self) -> &'static str {
        self.traversal.name()
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        &self.triangles
    }

    fn walk<V: HitVisitor, W: CountRayWork>(&self, ray: &PreparedRay, visitor: &mut V, work: &mut W) {
        let triangles = self.triangles.as_slice();
        match self.traversal {
            KdTraversal::Stack => walk_stack::walk(&self.arrays, triangles, &self.root, ray, visitor, work),
            KdTraversal::Ropes => walk_ropes::walk(&self.arrays, triangles, &self.root, ray, visitor, work),
        }
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.triangles.memory_bytes() + self.arrays.bytes()
    }
}
