//! The tree on the GPU: the arrays of the CPU's tree, as they are.

use std::sync::Arc;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};

use super::layout::{KdLeaf, KdNode};
use super::settings::KdTraversal;
use super::{KdTree, KdTreeSettings};
use crate::Result;
use crate::geometry::{PreparedTriangle, TriMesh};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::structure::{BuildStage, GpuRayStructure, PreparedTriangles, RayStructure};

/// `KdRoot` in ropes.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct KdRoot {
    /// Smallest corner of the tree's box.
    pub low: [f32; 3],
    /// Unused.
    pub padding_0: u32,
    /// Largest corner of the tree's box.
    pub high: [f32; 3],
    /// Unused.
    pub padding_1: u32,
}

/// A kd-tree on the GPU, walked by its ropes, one invocation a ray. It is built on the CPU.
#[derive(Debug)]
pub struct GpuKdTree {
    gpu: Gpu,
    triangles: Arc<PreparedTriangles>,
    root: Buffer<KdRoot>,
    triangle_buffer: Buffer<PreparedTriangle>,
    nodes: Buffer<KdNode>,
    leaves: Buffer<KdLeaf>,
    references: Buffer<u32>,
    expected_tests: u64,
    stages: Vec<BuildStage>,
}

/// Leaves whose triangles a ray is tested against, about: into Accel's bunny rays meet at most 3.4, 8.8 and 33 times the
/// limit of leaves of 2000, 200 and 20 triangles, and a fraction of that on average.
const LEAVES_MET: u64 = 4;
/// Fewest tests that are reckoned with.
const FEWEST_TESTS: u64 = 64;

/// Triangles that a ray is tested against, about.
fn expected_tests(tree: &KdTree) -> u64 {
    // A tree that ran into its bounds has leaves beyond the limit.
    let mean = tree.references().len().div_ceil(tree.leaves().len().max(1)) as u64;
    let leaf = mean.max(tree.settings().leaf_limit.into());
    (LEAVES_MET * leaf).min(tree.triangles().len() as u64).max(FEWEST_TESTS)
}

impl GpuKdTree {
    /// Builds a tree on the CPU and copies it to the device.
    ///
    /// # Errors
    /// As [`KdTree::build`]; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(gpu: &Gpu, mesh: &TriMesh, settings: &KdTreeSettings) -> Result<Self> {
        Self::upload(gpu, &KdTree::build(mesh, settings)?)
    }

    /// Copies a tree to the device.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn upload(gpu: &Gpu, tree: &KdTree) -> Result<Self> {
        let start = Instant::now();
        let cell = tree.root_cell();
        let root = KdRoot { low: cell.min.to_array(), padding_0: 0, high: cell.max.to_array(), padding_1: 0 };
        let triangles = Arc::clone(tree.triangles());
        let mut uploaded = Self {
            gpu: gpu.clone(),
            root: gpu.uniform("root of the kd-tree", &root)?,
            triangle_buffer: gpu.upload("triangles", triangles.as_slice())?,
            nodes: gpu.upload("nodes of the kd-tree", tree.nodes())?,
            leaves: gpu.upload("leaves of the kd-tree", tree.leaves())?,
            references: gpu.upload("references of the kd-tree", tree.references())?,
            triangles,
            expected_tests: expected_tests(tree),
            stages: tree.build_stages().to_vec(),
        };
        uploaded.stages.push(BuildStage::on_host("upload", start));
        Ok(uploaded)
    }
}

impl GpuRayStructure for GpuKdTree {
    const NAME: &'static str = <KdTree as RayStructure>::NAME;

    fn search(&self) -> &'static str {
        KdTraversal::Ropes.name()
    }

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        &self.triangles
    }

    fn trace_module(&self) -> &'static str {
        "package::structure::kd_tree::ropes"
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        vec![("short_loops", self.gpu.limits().loop_rounds.is_some())]
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![
            (Access::Uniform, (&self.root).into()),
            (Access::Read, (&self.triangle_buffer).into()),
            (Access::Read, (&self.nodes).into()),
            (Access::Read, (&self.leaves).into()),
            (Access::Read, (&self.references).into()),
        ]
    }

    fn expected_tests(&self) -> u64 {
        self.expected_tests
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        let tree = self.nodes.bytes() + self.leaves.bytes() + self.references.bytes();
        self.root.bytes() + self.triangle_buffer.bytes() + tree
    }
}
