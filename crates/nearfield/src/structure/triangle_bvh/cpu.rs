//! The hierarchy on the CPU.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::build::{PARALLEL, Primitive, binary_tree, primitives};
use super::collapse::{LeafCost, WideTree, collapse};
use super::layout::{Block, Node, lay_out};
use super::walk::{LARGE_STACK, SHALLOW, SMALL_STACK};
use super::walk_simd::walk_best;
use super::{BvhSettings, MOST_LEVELS};
use crate::geometry::row_simd::Simd;
use crate::geometry::{PreparedRay, TriMesh};
use crate::structure::{BuildStage, CountRayWork, HitVisitor, PreparedTriangles, RayStructure};
use crate::{Error, Result};

/// Most triangles: children of nodes are named by 31 bits.
const MOST_TRIANGLES: u64 = (1 << 31) - 1;

/// The triangles of a mesh in a hierarchy of boxes, eight children a node.
#[derive(Debug, Clone)]
pub struct TriangleBvh {
    pub(super) triangles: Arc<PreparedTriangles>,
    pub(super) settings: BvhSettings,
    /// The root first; none where no triangle has an area.
    pub(super) nodes: Vec<Node>,
    pub(super) blocks: Vec<Block>,
    pub(super) depth: u32,
    pub(super) simd: Simd,
    pub(super) stages: Vec<BuildStage>,
}

/// The triangles in the order of the leaves, and the wide tree over them; `None` where no triangle has an area.
///
/// # Errors
/// `OutOfMemory`.
pub(super) fn wide_tree(
    triangles: &PreparedTriangles,
    settings: &BvhSettings,
    cost: &LeafCost,
    stages: &mut Vec<BuildStage>,
) -> Result<Option<(Vec<u32>, WideTree)>> {
    let start = Instant::now();
    let primitives = primitives(triangles)?;
    if primitives.is_empty() {
        return Ok(None);
    }
    let reach = triangles.space().widened_bounds().extent().max_element();
    let binary = binary_tree(primitives, reach, settings, cost)?;
    stages.push(BuildStage::on_host("split", start));
    let start = Instant::now();
    let wide = collapse(&binary);
    assert!(wide.depth <= MOST_LEVELS, "a tree should have at most {MOST_LEVELS} levels, not {}", wide.depth);
    let order = binary.primitives.par_iter().with_min_len(PARALLEL).map(Primitive::index).collect();
    stages.push(BuildStage::on_host("collapse", start));
    Ok(Some((order, wide)))
}

/// Checks that there are not more triangles than children can be named.
///
/// # Errors
/// `TooMany`.
pub(super) fn check_number(triangles: &PreparedTriangles) -> Result<()> {
    let found = triangles.len() as u64;
    if found <= MOST_TRIANGLES {
        return Ok(());
    }
    Err(Error::TooMany {
        what: "triangles of a BVH",
        found,
        limit: MOST_TRIANGLES,
        advice: "split the mesh and build a BVH over each part",
    })
}

impl TriangleBvh {
    /// Prepares the triangles and builds the hierarchy.
    ///
    /// # Errors
    /// `InvalidSetting`; `TooMany` (2³¹ triangles or more); `OutOfMemory`, and as [`PreparedTriangles::new`].
    pub fn build(mesh: &TriMesh, settings: &BvhSettings) -> Result<Self> {
        settings.validate()?;
        let start = Instant::now();
        let triangles = PreparedTriangles::new(mesh)?;
        let prepare = BuildStage::on_host("prepare", start);
        let mut built = Self::of(triangles, settings)?;
        built.stages.insert(0, prepare);
        Ok(built)
    }

    /// Over triangles that were prepared before.
    ///
    /// # Errors
    /// `InvalidSetting`; `TooMany` (2³¹ triangles or more); `OutOfMemory`.
    pub fn of(triangles: Arc<PreparedTriangles>, settings: &BvhSettings) -> Result<Self> {
        settings.validate()?;
        check_number(&triangles)?;
        let mut stages = vec![];
        let cost = LeafCost { most: settings.leaf_triangles, entry: settings.leaf_cost, triangle: 0.0 };
        let (mut nodes, mut blocks, mut depth) = (vec![], vec![], 0);
        if let Some((order, wide)) = wide_tree(&triangles, settings, &cost, &mut stages)? {
            let start = Instant::now();
            let triangle = |place: u32| triangles.as_slice()[order[place as usize] as usize];
            (nodes, blocks) = lay_out(&wide, triangle)?;
            depth = wide.depth;
            stages.push(BuildStage::on_host("lay out", start));
        }
        Ok(Self { triangles, settings: *settings, nodes, blocks, depth, simd: Simd::best(), stages })
    }

    /// The settings it was built with.
    pub fn settings(&self) -> &BvhSettings {
        &self.settings
    }

    /// Nodes of eight children; leaves are not among them.
    pub fn n_nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Leaves.
    pub fn n_leaves(&self) -> usize {
        self.blocks.len()
    }

    /// Nodes of the longest path from the root, at most 80; 0 where no triangle has an area.
    pub fn depth(&self) -> u32 {
        self.depth
    }
}

impl RayStructure for TriangleBvh {
    const NAME: &'static str = "triangle-bvh";

    fn search(&self) -> &'static str {
        if self.simd == Simd::Portable { "wide-portable" } else { "wide-avx2" }
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        &self.triangles
    }

    fn walk<V: HitVisitor, W: CountRayWork>(&self, ray: &PreparedRay, visitor: &mut V, work: &mut W) {
        if self.nodes.is_empty() || ray.t_min > visitor.limit() {
            return;
        }
        if self.depth <= SHALLOW {
            walk_best::<SMALL_STACK, V, W>(self.simd, &self.nodes, &self.blocks, ray, visitor, work);
        } else {
            walk_best::<LARGE_STACK, V, W>(self.simd, &self.nodes, &self.blocks, ray, visitor, work);
        }
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        let tree = size_of_val(self.nodes.as_slice()) + size_of_val(self.blocks.as_slice());
        self.triangles.memory_bytes() + tree as u64
    }
}
