//! Moving points on either device, behind one face.

use nearfield::gpu::Gpu;
use nearfield::{
    AabbTree, AabbTreeSettings, GpuMovingPoints, MovingPoints, NeighborSearch, RebuildPolicy, Result, TreeSearch,
    UpdateReport, Vec3,
};

pub(crate) trait Moving {
    fn update(&mut self, positions: &[Vec3]) -> Result<UpdateReport>;
    fn search(&self) -> &dyn NeighborSearch;
    fn set_search(&mut self, search: TreeSearch);
    fn positions(&self) -> Vec<Vec3>;
    fn record_query_time(&mut self, milliseconds: f64) -> Result<()>;
    fn build_milliseconds(&self) -> f64;
    /// The tree, on the host.
    fn tree(&self) -> AabbTree;
}

impl Moving for MovingPoints {
    fn update(&mut self, positions: &[Vec3]) -> Result<UpdateReport> {
        self.update(positions)
    }

    fn search(&self) -> &dyn NeighborSearch {
        self.tree()
    }

    fn set_search(&mut self, search: TreeSearch) {
        self.set_search(search);
    }

    fn positions(&self) -> Vec<Vec3> {
        self.positions()
    }

    fn record_query_time(&mut self, milliseconds: f64) -> Result<()> {
        self.record_query_time(milliseconds)
    }

    fn build_milliseconds(&self) -> f64 {
        self.build_milliseconds()
    }

    fn tree(&self) -> AabbTree {
        self.tree().clone()
    }
}

impl Moving for GpuMovingPoints {
    fn update(&mut self, positions: &[Vec3]) -> Result<UpdateReport> {
        self.update(positions)
    }

    fn search(&self) -> &dyn NeighborSearch {
        self.tree()
    }

    fn set_search(&mut self, search: TreeSearch) {
        self.set_search(search);
    }

    fn positions(&self) -> Vec<Vec3> {
        self.positions().unwrap()
    }

    fn record_query_time(&mut self, milliseconds: f64) -> Result<()> {
        self.record_query_time(milliseconds)
    }

    fn build_milliseconds(&self) -> f64 {
        self.build_milliseconds()
    }

    fn tree(&self) -> AabbTree {
        self.tree().read().unwrap()
    }
}

/// Where moving points live.
#[derive(Clone, Copy)]
pub(crate) enum Device<'a> {
    Cpu,
    Gpu(&'a Gpu),
}

impl Device<'_> {
    pub(crate) fn start(
        self,
        points: &[Vec3],
        radius: f32,
        settings: &AabbTreeSettings,
        policy: RebuildPolicy,
    ) -> Result<Box<dyn Moving>> {
        Ok(match self {
            Self::Cpu => Box::new(MovingPoints::new(points, radius, settings, policy)?),
            Self::Gpu(gpu) => Box::new(GpuMovingPoints::new(gpu, points, radius, settings, policy)?),
        })
    }
}
