//! The linear octree on the GPU, built anew in every step; not in the paper.

use nearfield::gpu::Buffer;
use nearfield::structure::{DevicePoint, OctreeBuilder};
use nearfield::{Domain, GpuLinearOctree, OctreeSettings};

use super::Plug;
use super::on_gpu::{Builds, Rebuilt};
use crate::paper::lab::cube;

/// Built and asked on the GPU.
pub const ON_GPU: Plug = Plug {
    name: "octree, GPU",
    on_gpu: true,
    color: 4,
    make: |start| {
        let settings = OctreeSettings::default().domain(Domain::of_bounds(&cube()));
        let builder = OctreeBuilder::new(start.gpu(), start.at.host.len(), &settings)?;
        Ok(Box::new(Rebuilt::new(builder, start.at)?))
    },
};

impl Builds for OctreeBuilder {
    type Structure = GpuLinearOctree;

    fn build(&mut self, points: &Buffer<DevicePoint>) -> nearfield::Result<GpuLinearOctree> {
        OctreeBuilder::build(self, points)
    }
}
