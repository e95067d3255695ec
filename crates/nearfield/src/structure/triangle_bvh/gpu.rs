//! The hierarchy on the GPU.

use std::sync::Arc;
use std::time::Instant;

use super::collapse::LeafCost;
use super::compress::{CompressedNode, LEAF, compress};
use super::cpu::{check_number, wide_tree};
use super::fitter::Fitter;
use super::{BvhSettings, TriangleBvh};
use crate::Result;
use crate::geometry::{PreparedTriangle, TriMesh};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::structure::{BuildStage, GpuRayStructure, PreparedTriangles, RayStructure};

/// Time to test a triangle, in units of the time to test the boxes of a node. Source: Ylitie2017.
const TRIANGLE_COST: f32 = 0.3;
/// Trees of at most this many levels are walked with a small stack; `STACK` in trace.wesl and in triangles.wesl of distance fields.
const SHALLOW: u32 = 20;

/// The triangles of a mesh in a hierarchy of compressed boxes, eight children a node, on the GPU.
///
/// It is built on the CPU and fitted to triangles that move on the device ([`GpuTriangleBvh::refit`]).
#[derive(Debug)]
pub struct GpuTriangleBvh {
    gpu: Gpu,
    triangles: Arc<PreparedTriangles>,
    settings: BvhSettings,
    nodes: Buffer<CompressedNode>,
    in_order: Buffer<PreparedTriangle>,
    depth: u32,
    /// Triangles without an area when the tree was built: they have no place in it.
    outside: Vec<u32>,
    /// Made at the first refit.
    fitter: Option<Fitter>,
    stages: Vec<BuildStage>,
}

impl GpuTriangleBvh {
    /// Prepares the triangles, builds the hierarchy on the CPU and copies it to the device.
    ///
    /// # Errors
    /// As [`TriangleBvh::build`]; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(gpu: &Gpu, mesh: &TriMesh, settings: &BvhSettings) -> Result<Self> {
        settings.validate()?;
        let start = Instant::now();
        let triangles = PreparedTriangles::new(mesh)?;
        let prepare = BuildStage::on_host("prepare", start);
        let mut built = Self::of(gpu, triangles, settings)?;
        built.stages.insert(0, prepare);
        Ok(built)
    }

    /// Over triangles that were prepared before.
    ///
    /// # Errors
    /// As [`TriangleBvh::of`]; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn of(gpu: &Gpu, triangles: Arc<PreparedTriangles>, settings: &BvhSettings) -> Result<Self> {
        settings.validate()?;
        check_number(&triangles)?;
        let mut stages = vec![];
        let cost = LeafCost { most: settings.leaf_triangles.min(LEAF), entry: 0.0, triangle: TRIANGLE_COST };
        let wide = wide_tree(&triangles, settings, &cost, &mut stages)?;
        let depth = wide.as_ref().map_or(0, |(_, wide)| wide.depth);
        let start = Instant::now();
        let compressed = compress(wide, &triangles);
        stages.push(BuildStage::on_host("compress", start));
        let start = Instant::now();
        let nodes = gpu.upload("nodes of a BVH", &compressed.nodes)?;
        let in_order = gpu.upload("triangles of a BVH", &compressed.triangles)?;
        stages.push(BuildStage::on_host("upload", start));
        let without_area = triangles.as_slice().iter().filter(|triangle| !triangle.has_area());
        let outside = without_area.map(|triangle| triangle.index).collect();
        let (gpu, settings) = (gpu.clone(), *settings);
        Ok(Self { gpu, triangles, settings, nodes, in_order, depth, outside, fitter: None, stages })
    }

    /// Over the triangles of a hierarchy on the CPU, with its settings. Leaves are smaller on the device, where
    /// triangles are tested one by one, so the tree is split and collapsed again.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn upload(gpu: &Gpu, bvh: &TriangleBvh) -> Result<Self> {
        Self::of(gpu, bvh.triangles.clone(), &bvh.settings)
    }

    /// Takes a mesh of the same triangles with moved vertices, as [`TriangleBvh::refit`] does: the triangles are prepared
    /// on the CPU, which answers name too, and copied; the boxes are fitted on the device, a level after the other. A tree is
    /// built anew where a triangle that had no area, and so no place in it, now has one.
    ///
    /// The first refit reads the nodes back once, and from then on the tree holds 36 bytes more a node.
    ///
    /// # Errors
    /// `LengthMismatch` for another number of triangles; as [`PreparedTriangles::new`]; `OutOfDeviceMemory`. The tree is
    /// then as it was. `DeviceLost`.
    pub fn refit(&mut self, moved: &TriMesh) -> Result<()> {
        self.triangles.check_moved(moved)?;
        let start = Instant::now();
        let triangles = PreparedTriangles::new(moved)?;
        let mut stages = vec![BuildStage::on_host("prepare", start)];
        if self.outside.iter().any(|&index| triangles.as_slice()[index as usize].has_area()) {
            let mut built = Self::of(&self.gpu, triangles, &self.settings)?;
            stages.append(&mut built.stages);
            *self = Self { stages, ..built };
            return Ok(());
        }
        if !self.in_order.is_empty() {
            let start = Instant::now();
            let fitter = match self.fitter.take() {
                Some(fitter) => fitter,
                None => Fitter::new(&self.gpu, &self.nodes, self.in_order.len())?,
            };
            let fitted = fitter.fit(&self.gpu, &triangles, &self.nodes, &self.in_order);
            self.fitter = Some(fitter);
            stages.extend(fitted?.iter().filter_map(BuildStage::on_device));
            stages.push(BuildStage::on_host("copy and fit", start));
        }
        (self.triangles, self.stages) = (triangles, stages);
        Ok(())
    }

    /// The settings it was built with.
    pub fn settings(&self) -> &BvhSettings {
        &self.settings
    }

    /// `[n_nodes]` the nodes, the root first.
    pub fn nodes(&self) -> &Buffer<CompressedNode> {
        &self.nodes
    }

    /// Nodes of the longest path from the root, at most 80; 0 where no triangle has an area.
    pub fn depth(&self) -> u32 {
        self.depth
    }

    /// Whether kernels that walk it need a large stack: the condition `deep` of their modules.
    pub(crate) fn is_deep(&self) -> bool {
        self.depth > SHALLOW
    }

    /// The first broken invariant of what is on the device, in words; `None` for a sound tree. Reads everything back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `OutOfMemory`, `DeviceLost`.
    pub fn broken_invariant(&self) -> Result<Option<String>> {
        let (nodes, triangles) = (self.gpu.read(&self.nodes)?, self.gpu.read(&self.in_order)?);
        let read = super::compress::Compressed { nodes, triangles };
        Ok(read.broken_invariant(&self.triangles))
    }
}

impl GpuRayStructure for GpuTriangleBvh {
    const NAME: &'static str = <TriangleBvh as RayStructure>::NAME;

    fn search(&self) -> &'static str {
        "compressed-wide"
    }

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        &self.triangles
    }

    fn trace_module(&self) -> &'static str {
        "package::structure::triangle_bvh::trace"
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        vec![("short_loops", self.gpu.limits().loop_rounds.is_some()), ("deep", self.is_deep())]
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![(Access::Read, (&self.nodes).into()), (Access::Read, (&self.in_order).into())]
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        let fitter = self.fitter.as_ref().map_or(0, Fitter::memory_bytes);
        self.nodes.bytes() + self.in_order.bytes() + fitter
    }
}
