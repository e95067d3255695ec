//! Rays against every triangle, on the GPU.

use std::sync::Arc;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};

use crate::Result;
use crate::geometry::{PreparedTriangle, TriMesh};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::structure::{BruteForceMesh, BuildStage, GpuRayStructure, PreparedTriangles, RayStructure};

/// Triangles that a round tests where long loops are ended.
const TRIANGLES_A_ROUND: u64 = 8;

/// `TriangleList` in trace_all.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct TriangleList {
    /// Smallest corner of the widened bounds.
    pub low: [f32; 3],
    /// Number of triangles.
    pub n_triangles: u32,
    /// Largest corner of the widened bounds.
    pub high: [f32; 3],
    /// 1 where rays that miss the bounds are not tested.
    pub only_within_box: u32,
}

/// All triangles of a mesh as they came, on the GPU.
#[derive(Debug)]
pub struct GpuBruteForceMesh {
    gpu: Gpu,
    triangles: Arc<PreparedTriangles>,
    buffer: Buffer<PreparedTriangle>,
    list: Buffer<TriangleList>,
    only_within_box: bool,
    stages: Vec<BuildStage>,
}

impl GpuBruteForceMesh {
    /// Prepares the triangles and copies them to the device.
    ///
    /// # Errors
    /// As [`PreparedTriangles::new`]; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(gpu: &Gpu, mesh: &TriMesh) -> Result<Self> {
        Self::of(gpu, PreparedTriangles::new(mesh)?)
    }

    /// Copies triangles that were prepared before to the device.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn of(gpu: &Gpu, triangles: Arc<PreparedTriangles>) -> Result<Self> {
        let start = Instant::now();
        let buffer = gpu.upload("triangles", triangles.as_slice())?;
        let list = Self::upload_list(gpu, &triangles, false)?;
        let stages = vec![BuildStage::on_host("upload", start)];
        Ok(Self { gpu: gpu.clone(), triangles, buffer, list, only_within_box: false, stages })
    }

    /// Tests no triangle for rays that miss the bounding box of the mesh.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn within_box(mut self) -> Result<Self> {
        self.list = Self::upload_list(&self.gpu, &self.triangles, true)?;
        self.only_within_box = true;
        Ok(self)
    }

    fn upload_list(gpu: &Gpu, triangles: &PreparedTriangles, only_within_box: bool) -> Result<Buffer<TriangleList>> {
        let bounds = triangles.space().widened_bounds();
        let list = TriangleList {
            low: bounds.min.to_array(),
            n_triangles: triangles.len() as u32,
            high: bounds.max.to_array(),
            only_within_box: u32::from(only_within_box),
        };
        gpu.uniform("triangle list", &list)
    }
}

impl GpuRayStructure for GpuBruteForceMesh {
    const NAME: &'static str = <BruteForceMesh as RayStructure>::NAME;

    fn search(&self) -> &'static str {
        if self.only_within_box { "bounding-box" } else { "all-triangles" }
    }

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn triangles(&self) -> &Arc<PreparedTriangles> {
        &self.triangles
    }

    fn trace_module(&self) -> &'static str {
        "package::structure::brute_force::trace_all"
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        vec![("short_loops", self.gpu.limits().loop_rounds.is_some())]
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![(Access::Uniform, (&self.list).into()), (Access::Read, (&self.buffer).into())]
    }

    fn fewest_rounds(&self) -> u64 {
        (self.triangles.len() as u64).div_ceil(TRIANGLES_A_ROUND) + 1
    }

    fn expected_tests(&self) -> u64 {
        self.triangles.len() as u64
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.buffer.bytes() + self.list.bytes()
    }
}
