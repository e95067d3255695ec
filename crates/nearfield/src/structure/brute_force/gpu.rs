//! Brute force on the GPU.

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use crate::geometry::{Aabb, Period, validate};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::structure::on_gpu::{DevicePoint, Effort, GpuStructure, upload_points};
use crate::structure::{BruteForce, BuildStage, CpuStructure};
use crate::{Error, Result};

/// `Layout` in traverse.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct BruteForceLayout {
    /// Length of the period by axis; 0 where not periodic.
    pub period: [f32; 3],
    /// Number of points.
    pub n_points: u32,
    /// One over the period; 0 where not periodic.
    pub inverse_period: [f32; 3],
    /// Unused.
    pub padding: u32,
}

/// All points as they came, on the GPU.
#[derive(Debug)]
pub struct GpuBruteForce {
    gpu: Gpu,
    points: Buffer<DevicePoint>,
    layout: Buffer<BruteForceLayout>,
    period: Period,
    stages: Vec<BuildStage>,
}

impl GpuBruteForce {
    /// Copies the points to the device.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more; a million on a software device),
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(gpu: &Gpu, points: &[Vec3]) -> Result<Self> {
        Self::build_periodic(gpu, points, Period::NONE)
    }

    /// Copies the points of a periodic domain to the device.
    ///
    /// # Errors
    /// As [`GpuBruteForce::build`].
    pub fn build_periodic(gpu: &Gpu, points: &[Vec3], period: Period) -> Result<Self> {
        validate::points(points)?;
        let start = Instant::now();
        let points = upload_points(gpu, "points", points, 0)?;
        let mut all = Self::of_points(gpu, &points, period)?;
        all.stages.push(BuildStage::on_host("upload", start));
        Ok(all)
    }

    /// Takes points that are on the device already; the memory is shared, so that they may move.
    ///
    /// - `points`: `[n]` xyz, and the index that answers use as bits of w; trusted to be finite and within ±1e18
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build_on_device(gpu: &Gpu, points: &Buffer<DevicePoint>) -> Result<Self> {
        Self::of_points(gpu, points, Period::NONE)
    }

    /// Takes the memory of as many other points.
    ///
    /// # Errors
    /// `LengthMismatch` for another number.
    pub fn replace_points(&mut self, points: &Buffer<DevicePoint>) -> Result<()> {
        if points.len() != self.points.len() {
            let (found, expected) = (points.len() as u64, self.points.len() as u64);
            return Err(Error::LengthMismatch { what: "points to replace others", found, expected });
        }
        self.points = points.clone();
        Ok(())
    }

    fn of_points(gpu: &Gpu, points: &Buffer<DevicePoint>, period: Period) -> Result<Self> {
        let layout = BruteForceLayout {
            period: period.lengths().to_array(),
            n_points: points.len() as u32,
            inverse_period: period.inverse().to_array(),
            padding: 0,
        };
        let layout = gpu.uniform("brute-force layout", &layout)?;
        Ok(Self { gpu: gpu.clone(), points: points.clone(), layout, period, stages: Vec::new() })
    }
}

impl GpuStructure for GpuBruteForce {
    const NAME: &'static str = <BruteForce as CpuStructure>::NAME;

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
        "package::structure::brute_force::traverse"
    }

    fn most_effort(&self, _: f32, _: Option<&Aabb>) -> Result<Effort> {
        Ok(Effort { candidates: self.len() as u64, rounds: 0 })
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        vec![("periodic", self.period.is_periodic())]
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![(Access::Uniform, (&self.layout).into()), (Access::Read, (&self.points).into())]
    }

    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>> {
        upload_points(&self.gpu, "queries", queries, 0)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.points.bytes() + self.layout.bytes()
    }
}
