//! The paper's tree of boxes over moving points, with each search and each rule of when to build it anew.

use nearfield::query::Stage;
use nearfield::{
    AabbTreeSettings, BuildOrder, FixedRadius, GpuMovingPoints, MovingPoints, Nearest, NeighborSearch, RebuildPolicy,
    SearchOnDevice, TreeSearch,
};

use super::{Found, Method, NearestFound, Plug, Positions, Start, Update};
use crate::Result;

/// The paper's method: median splits, built anew on the CPU when a box has grown tenfold; algorithm 2.
pub const COHERENT: Plug = Plug {
    name: "tree coherent, GPU",
    on_gpu: true,
    color: 0,
    make: |start| on_gpu(start, TreeSearch::Coherent, BuildOrder::Median, RebuildPolicy::DEFAULT),
};

/// The same with the paper's algorithm 1.
pub const PRIMARY: Plug = Plug {
    name: "tree primary, GPU",
    on_gpu: true,
    color: 9,
    make: |start| on_gpu(start, TreeSearch::Primary, BuildOrder::Median, RebuildPolicy::DEFAULT),
};

/// The same rule and our search; built along the Hilbert curve on the GPU.
pub const PACKED: Plug = Plug {
    name: "tree packed, GPU",
    on_gpu: true,
    color: 1,
    make: |start| on_gpu(start, TreeSearch::Packed, BuildOrder::Hilbert, RebuildPolicy::DEFAULT),
};

/// Median splits once, then only refitted.
pub const PACKED_NEVER: Plug = Plug {
    name: "tree packed, only refitted, GPU",
    on_gpu: true,
    color: 5,
    make: |start| on_gpu(start, TreeSearch::Packed, BuildOrder::Median, RebuildPolicy::Never),
};

/// Built along the Hilbert curve on the GPU in every step.
pub const PACKED_REBUILT: Plug = Plug {
    name: "tree packed, always rebuilt, GPU",
    on_gpu: true,
    color: 10,
    make: |start| on_gpu(start, TreeSearch::Packed, BuildOrder::Hilbert, RebuildPolicy::Always),
};

/// The paper's rule and our search on the CPU.
pub const ON_CPU: Plug = Plug {
    name: "tree packed, CPU",
    on_gpu: false,
    color: 11,
    make: |start| {
        let settings = AabbTreeSettings::default();
        Ok(Box::new(OnCpu(MovingPoints::new(&start.at.host, start.radius, &settings, RebuildPolicy::DEFAULT)?)))
    },
};

fn on_gpu(start: &Start<'_>, search: TreeSearch, order: BuildOrder, policy: RebuildPolicy) -> Result<Box<dyn Method>> {
    let settings = AabbTreeSettings::default().search(search).order(order);
    Ok(Box::new(OnGpu(GpuMovingPoints::new(start.gpu(), &start.at.host, start.radius, &settings, policy)?)))
}

struct OnGpu(GpuMovingPoints);

impl Method for OnGpu {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        let report = self.0.update_on_device(at.on_device())?;
        Ok(Update { rebuilt: report.is_rebuild(), stages: report.stages.iter().map(Stage::from).collect() })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        Ok(Found::OnDevice(self.0.tree().list_on_device(&FixedRadius::new(radius))?))
    }

    fn nearest(&mut self, radius: f32) -> Result<Nearest> {
        Ok(self.0.tree().nearest(&FixedRadius::new(radius).exclude_self())?)
    }

    fn list_around(&mut self, queries: &Positions, radius: f32) -> Result<Found> {
        Ok(Found::OnDevice(self.0.tree().list_on_device(&FixedRadius::new(radius).queries(&queries.host))?))
    }

    fn nearest_around(&mut self, queries: &Positions, radius: f32) -> Result<NearestFound> {
        Ok(self.0.tree().nearest(&FixedRadius::new(radius).queries(&queries.host))?.into())
    }

    fn memory_bytes(&self) -> u64 {
        NeighborSearch::memory_bytes(self.0.tree())
    }
}

struct OnCpu(MovingPoints);

impl Method for OnCpu {
    fn update(&mut self, at: &Positions) -> Result<Update> {
        let report = self.0.update(&at.host)?;
        Ok(Update { rebuilt: report.is_rebuild(), stages: report.stages.iter().map(Stage::from).collect() })
    }

    fn list(&mut self, radius: f32) -> Result<Found> {
        Ok(Found::OnHost(self.0.tree().list(&FixedRadius::new(radius))?))
    }

    fn nearest(&mut self, radius: f32) -> Result<Nearest> {
        Ok(self.0.tree().nearest(&FixedRadius::new(radius).exclude_self())?)
    }

    fn list_around(&mut self, queries: &Positions, radius: f32) -> Result<Found> {
        Ok(Found::OnHost(self.0.tree().list(&FixedRadius::new(radius).queries(&queries.host))?))
    }

    fn nearest_around(&mut self, queries: &Positions, radius: f32) -> Result<NearestFound> {
        Ok(self.0.tree().nearest(&FixedRadius::new(radius).queries(&queries.host))?.into())
    }

    fn memory_bytes(&self) -> u64 {
        NeighborSearch::memory_bytes(self.0.tree())
    }
}
