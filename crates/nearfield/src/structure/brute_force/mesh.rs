//! Rays against every triangle, on the CPU.

use std::sync::Arc;
use std::time::Instant;

use crate::Result;
use crate::geometry::{PreparedRay, TriMesh};
use crate::structure::{BuildStage, CountRayWork, HitVisitor, PreparedTriangles, RayStructure};

/// All triangles of a mesh as they came: every ray is tested against each of them.
///
/// The reference that the other ray structures are compared with. [`BruteForceMesh::within_box`] is Accel's second
/// picture: rays that miss the mesh's bounding box are not tested at all.
#[derive(Debug, Clone)]
pub struct BruteForceMesh {
    triangles: Arc<PreparedTriangles>,
    only_within_box: bool,
    stages: Vec<BuildStage>,
}

impl BruteForceMesh {
    /// Prepares the triangles.
    ///
    /// # Errors
    /// As [`PreparedTriangles::new`].
    pub fn build(mesh: &TriMesh) -> Result<Self> {
        let start = Instant::now();
        let mut built = Self::of(PreparedTriangles::new(mesh)?);
        built.stages[0].milliseconds = start.elapsed().as_secs_f64() * 1e3;
        Ok(built)
    }

    /// Over triangles that were prepared before.
    pub fn of(triangles: Arc<PreparedTriangles>) -> Self {
        let stages = vec![BuildStage { name: "prepare", milliseconds: 0.0, on_device: false }];
        Self { triangles, only_within_box: false, stages }
    }

    /// Tests no triangle for rays that miss the bounding box of the mesh.
    pub fn within_box(mut self) -> Self {
        self.only_within_box = true;
        self
    }
}

impl RayStructure for BruteForceMesh {
    const NAME: &'static str = "brute-force";

    fn search(&self) -> &'static str {
        if self.only_within_box { "bounding-box" } else { "all-triangles" }
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        &self.triangles
    }

    fn walk<V: HitVisitor, W: CountRayWork>(&self, ray: &PreparedRay, visitor: &mut V, work: &mut W) {
        if self.only_within_box {
            work.node_visits(1);
            let bounds = self.triangles.space().widened_bounds();
            let (near, far) = ray.slabs(bounds.min, bounds.max);
            if near.max(ray.t_min) > far.min(visitor.limit()) {
                return;
            }
        }
        work.leaf_visits(1);
        for triangle in self.triangles.as_slice() {
            work.triangle_tests(1);
            if let Some(hit) = triangle.hit(ray)
                && visitor.offer(&hit, f32::INFINITY).is_break()
            {
                return;
            }
        }
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.triangles.memory_bytes()
    }
}
