//! A list of neighbours on a device that is used for as long as no particle has moved too far.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::gpu_state::WORKGROUP;
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Gpu, Kernel, Pipeline, Workgroups};
use crate::query::{GpuNeighbors, SearchOnDevice};
use crate::structure::{BuildStage, DevicePoint, Effort, GpuStructure, GpuUniformGrid, GridBuilder, GridSettings};
use crate::{FixedRadius, Result};

/// `ParticleDrift` in list_age.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct ParticleDrift {
    /// Particles.
    pub n_points: u32,
    /// Squared distance that none may have moved.
    pub limit2: f32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
}

/// Rows of all particles within a radius and a skin. As a structure it hands out those of a row, so radii of questions beyond its own
/// find too few.
pub(super) struct GpuList {
    gpu: Gpu,
    builder: GridBuilder,
    grid: GpuUniformGrid,
    reach: f32,
    points: Buffer<DevicePoint>,
    built_at: Buffer<DevicePoint>,
    rows: GpuNeighbors,
    longest_row: u32,
    drift: Buffer<ParticleDrift>,
    is_old: Buffer<u32>,
    age: Arc<Pipeline>,
}

impl GpuList {
    /// The list of points, which are in the order of their indices.
    ///
    /// # Errors
    /// As [`SearchOnDevice::list_on_device`].
    pub(super) fn new(gpu: &Gpu, domain: &Aabb, points: &Buffer<DevicePoint>, radius: f32, skin: f32) -> Result<Self> {
        let reach = radius + skin;
        let mut builder = GridBuilder::new(gpu, points.len(), domain, &GridSettings::for_radius(reach))?;
        let grid = builder.build(points)?;
        let rows = grid.list_on_device(&FixedRadius::new(reach))?;
        let limit2 = 0.25 * skin * skin;
        let drift = ParticleDrift { n_points: points.len() as u32, limit2, padding_0: 0, padding_1: 0 };
        let accesses = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        let kernel = Kernel {
            constants: &[("WORKGROUP", WORKGROUP as f64)],
            ..Kernel::new("package::application::particles::list_age", "compare_places", &accesses, WORKGROUP)
        };
        let mut list = Self {
            gpu: gpu.clone(),
            builder,
            grid,
            reach,
            points: points.clone(),
            built_at: gpu.buffer("particles at the last list", points.len())?,
            rows,
            longest_row: 0,
            drift: gpu.uniform("age of a list", &drift)?,
            is_old: gpu.buffer("whether a list is old", 1)?,
            age: gpu.prepare(&kernel)?,
        };
        list.note_build()?;
        Ok(list)
    }

    /// Makes a new list if a particle has moved by half the skin; returns whether.
    ///
    /// # Errors
    /// As [`GpuList::new`].
    pub(super) fn follow(&mut self, points: &Buffer<DevicePoint>) -> Result<bool> {
        self.points = points.clone();
        let mut commands = self.gpu.commands("age of a list");
        commands.clear(&self.is_old).dispatch(
            &self.age,
            &[(&self.drift).into(), points.into(), (&self.built_at).into(), (&self.is_old).into()],
            Workgroups::Covering(points.len() as u64),
        );
        commands.submit()?;
        if self.gpu.read(&self.is_old)?[0] == 0 {
            return Ok(false);
        }
        let mut commands = self.gpu.commands("grid of a list");
        self.builder.record_rebuild(&mut commands, points, &mut self.grid)?;
        commands.submit()?;
        self.rows = self.grid.list_on_device(&FixedRadius::new(self.reach))?;
        self.note_build()?;
        Ok(true)
    }

    fn note_build(&mut self) -> Result<()> {
        let mut commands = self.gpu.commands("particles at the last list");
        commands.copy(&self.points, &self.built_at);
        commands.submit()?;
        if self.gpu.limits().loop_rounds.is_some() {
            let offsets = self.gpu.read(&self.rows.offsets)?;
            self.longest_row = offsets.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0);
        }
        Ok(())
    }
}

impl GpuStructure for GpuList {
    const NAME: &'static str = "verlet";

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    fn points(&self) -> &Buffer<DevicePoint> {
        &self.points
    }

    fn shares_queries(&self) -> bool {
        true
    }

    fn traverse_module(&self) -> &'static str {
        "package::application::particles::list"
    }

    fn most_effort(&self, _: f32, _: Option<&Aabb>) -> Result<Effort> {
        Ok(Effort { candidates: u64::from(self.longest_row), rounds: 0 })
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        Vec::new()
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![
            (Access::Read, (&self.points).into()),
            (Access::Read, (&self.rows.offsets).into()),
            (Access::Read, (&self.rows.indices).into()),
        ]
    }

    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>> {
        self.grid.upload_queries(queries)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &[]
    }

    fn memory_bytes(&self) -> u64 {
        self.grid.memory_bytes() + self.rows.offsets.bytes() + self.rows.indices.bytes() + self.built_at.bytes()
    }
}
