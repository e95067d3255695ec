//! The uniform grid, the paper's voxels: built anew in every step. Source of the idea in the paper: Green2012.

use nearfield::gpu::Buffer;
use nearfield::structure::{DevicePoint, GridBuilder};
use nearfield::{GpuUniformGrid, GridSettings, UniformGrid};

use super::on_gpu::Builds;
use super::{Plug, on_cpu, on_gpu};
use crate::paper::lab::cube;

/// Built and asked on the GPU.
pub const ON_GPU: Plug = Plug {
    name: "grid, GPU",
    on_gpu: true,
    color: 3,
    make: |start| {
        let settings = GridSettings::for_radius(start.radius);
        let builder = GridBuilder::new(start.gpu(), start.at.host.len(), &cube(), &settings)?;
        Ok(Box::new(on_gpu::Rebuilt::new(builder, start.at)?))
    },
};

/// Built and asked on the CPU.
pub const ON_CPU: Plug = Plug {
    name: "grid, CPU",
    on_gpu: false,
    color: 8,
    make: |start| {
        let settings = GridSettings::for_radius(start.radius);
        Ok(Box::new(on_cpu::Rebuilt::new(move |points| UniformGrid::build(points, &settings), start.at)?))
    },
};

impl Builds for GridBuilder {
    type Structure = GpuUniformGrid;

    fn build(&mut self, points: &Buffer<DevicePoint>) -> nearfield::Result<GpuUniformGrid> {
        GridBuilder::build(self, points)
    }
}
