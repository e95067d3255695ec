//! The paper's tree of boxes: refitted in every step or built anew, with each search, on the GPU and on the CPU.

use nearfield::gpu::Buffer;
use nearfield::query::Stage;
use nearfield::structure::{AabbTreeBuilder, DevicePoint};
use nearfield::{
    AabbTree, AabbTreeSettings, BuildOrder, FixedRadius, GpuAabbTree, Nearest, NeighborSearch, SearchOnDevice, TreeSearch,
};

use super::on_gpu::{Builds, Rebuilt};
use super::{Found, Method, Plug, Positions, Start, Update};
use crate::Result;

/// Median splits on the CPU once, refitted on the GPU in every step; packed search.
pub const PACKED_REFIT: Plug =
    Plug { name: "tree packed refit, GPU", on_gpu: true, color: 1, make: |start| refit(start, TreeSearch::Packed) };

/// The same tree with the paper's first search.
pub const PRIMARY_REFIT: Plug =
    Plug { name: "tree primary refit, GPU", on_gpu: true, color: 9, make: |start| refit(start, TreeSearch::Primary) };

/// Built along the Hilbert curve on the GPU in every step; packed search.
pub const PACKED_REBUILT: Plug = Plug {
    name: "tree packed rebuilt, GPU",
    on_gpu: true,
    color: 5,
    make: |start| {
        let settings = AabbTreeSettings::default().order(BuildOrder::Hilbert);
        let builder = AabbTreeBuilder::new(start.gpu(), start.at.host.len(), &settings)?;
        Ok(Box::new(Rebuilt::new(builder, start.at)?))
    },
};

/// Median splits once, refitted in every step, on the CPU; packed search.
pub const ON_CPU: Plug = Plug {
    name: "tree packed refit, CPU",
    on_gpu: false,
    color: 6,
    make: |start| {
        let tree = AabbTree::build(&start.at.host, &AabbTreeSettings::default())?;
        Ok(Box::new(RefitOnCpu { tree }))
    },
};

fn refit(start: &Start<'_>, search: TreeSearch) -> Result<Box<dyn Method>> {
    let settings = AabbTreeSettings::default().search(search);
    Ok(Box::new(RefitOnGpu { tree: GpuAabbTree::build(start.gpu(), &start.at.host, &settings)? }))
}

impl Builds for AabbTreeBuilder {
    type Structure = GpuAabbTree;

    fn build(&mut self, points: &Buffer<DevicePoint>) -> nearfield::Result<GpuAabbTree> {
        AabbTreeBuilder::build(self, points)
    }
}

struct RefitOnGpu {
    tree: GpuAabbTree,
}

impl Method for RefitOnGpu {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        let stages = self.tree.refit(at.on_device())?;
        Ok(Update { stages: stages.iter().map(Stage::from).collect(), rebuilt: false })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        Ok(Found::OnDevice(self.tree.list_on_device(&FixedRadius::new(radius))?))
    }

    fn nearest(&mut self, radius: f32) -> Result<Nearest> {
        Ok(self.tree.nearest(&FixedRadius::new(radius).exclude_self())?)
    }

    fn memory_bytes(&self) -> u64 {
        NeighborSearch::memory_bytes(&self.tree)
    }
}

struct RefitOnCpu {
    tree: AabbTree,
}

impl Method for RefitOnCpu {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        self.tree.refit(&at.host)?;
        Ok(Update { stages: Vec::new(), rebuilt: false })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        Ok(Found::OnHost(self.tree.list(&FixedRadius::new(radius))?))
    }

    fn nearest(&mut self, radius: f32) -> Result<Nearest> {
        Ok(self.tree.nearest(&FixedRadius::new(radius).exclude_self())?)
    }

    fn memory_bytes(&self) -> u64 {
        NeighborSearch::memory_bytes(&self.tree)
    }
}
