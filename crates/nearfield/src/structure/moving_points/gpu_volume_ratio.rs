//! The largest ratio of volumes on the device.

use std::sync::Arc;

use super::volume_ratio::INFINITE_BEYOND;
use crate::Result;
use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::reduce::GpuReduce;
use crate::structure::aabb_tree::AabbNode;

/// Invocations of a workgroup.
const WORKGROUP: u32 = 256;

/// The boxes of a tree on the device as they were at its build, and the kernels that compare them.
#[derive(Debug)]
pub(super) struct GpuVolumesAtBuild {
    n_nodes: usize,
    parameters: Buffer<[u32; 4]>,
    /// `[n_nodes]`.
    sides: Buffer<[f32; 4]>,
    /// `[n_nodes]`.
    ratios: Buffer<f32>,
    largest: Buffer<f32>,
    keep_sides: Arc<Pipeline>,
    compare_volumes: Arc<Pipeline>,
    reduce: GpuReduce,
}

impl GpuVolumesAtBuild {
    /// Memory for a tree of so many nodes.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `KernelRejected`.
    pub(super) fn new(gpu: &Gpu, n_nodes: usize, radius: f32) -> Result<Self> {
        use Access::{Read, ReadWrite, Uniform};
        let kernel = |entry, accesses: &[Access]| {
            gpu.prepare(&Kernel {
                constants: &[("WORKGROUP", f64::from(WORKGROUP))],
                ..Kernel::new("package::structure::moving_points::volume_ratio", entry, accesses, WORKGROUP)
            })
        };
        Ok(Self {
            n_nodes,
            parameters: gpu.uniform("volume parameters", &[n_nodes as u32, radius.to_bits(), 0, 0])?,
            sides: gpu.buffer("sides of boxes at the build", n_nodes)?,
            ratios: gpu.buffer("volume ratios", n_nodes)?,
            largest: gpu.buffer("largest volume ratio", 1)?,
            keep_sides: kernel("keep_sides", &[Uniform, Read, ReadWrite])?,
            compare_volumes: kernel("compare_volumes", &[Uniform, Read, Read, ReadWrite])?,
            reduce: GpuReduce::new(gpu)?,
        })
    }

    /// Records taking the boxes of a tree that was just built.
    pub(super) fn record_keep(&self, commands: &mut Commands, nodes: &Buffer<AabbNode>) {
        let binds = [(&self.parameters).into(), nodes.into(), (&self.sides).into()];
        commands.dispatch(&self.keep_sides, &binds, Workgroups::Covering(self.n_nodes as u64));
    }

    /// Records the largest ratio of a box of the same tree.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `KernelRejected`.
    pub(super) fn record_largest(&self, commands: &mut Commands, nodes: &Buffer<AabbNode>) -> Result<()> {
        let binds = [(&self.parameters).into(), nodes.into(), (&self.sides).into(), (&self.ratios).into()];
        commands.dispatch(&self.compare_volumes, &binds, Workgroups::Covering(self.n_nodes as u64));
        self.reduce.record_largest_f32(commands, &self.ratios, self.n_nodes, &self.largest)
    }

    /// The ratio that was recorded last, four bytes read back; 1 for no box.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `DeviceLost`.
    pub(super) fn largest_ratio(&self, gpu: &Gpu) -> Result<f32> {
        if self.n_nodes == 0 {
            return Ok(1.0);
        }
        let largest = gpu.read(&self.largest)?[0];
        Ok(if f64::from(largest) > INFINITE_BEYOND { f32::INFINITY } else { largest })
    }
}
