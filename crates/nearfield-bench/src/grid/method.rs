//! The four ways to find all neighbours that the experiments compare, each measured and checked on one case.
//!
//! The work is the same for all: the full list of neighbours of every particle, the structure built anew, from points
//! that are where the method works (host memory, or device memory for a GPU) to a list in the same place.

use nearfield::gpu::Gpu;
use nearfield::parallel::reduce;
use nearfield::query::{Clock, Stage};
use nearfield::structure::GridBuilder;
use nearfield::{
    BruteForce, FixedRadius, GpuBruteForce, GpuNeighbors, GridSettings, NeighborSearch, SearchOnDevice, UniformGrid,
    Vec3,
};

use super::rows::{Row, TOTAL};
use crate::check::Expected;
use crate::device::device_points;
use crate::measure::{Effort, Measured, repeat};
use crate::{Error, Result};

/// A structure on a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Brute force on the CPU.
    CpuBruteForce,
    /// Uniform grid on the CPU.
    CpuGrid,
    /// Brute force on the GPU.
    GpuBruteForce,
    /// Uniform grid on the GPU.
    GpuGrid,
}

impl Method {
    /// All four.
    pub const ALL: [Self; 4] = [Self::CpuBruteForce, Self::CpuGrid, Self::GpuBruteForce, Self::GpuGrid];

    /// Name in tables and plots.
    pub const fn name(self) -> &'static str {
        match self {
            Self::CpuBruteForce => "cpu brute force",
            Self::CpuGrid => "cpu grid",
            Self::GpuBruteForce => "gpu brute force",
            Self::GpuGrid => "gpu grid",
        }
    }

    /// Whether it runs on the GPU.
    pub const fn on_gpu(self) -> bool {
        matches!(self, Self::GpuBruteForce | Self::GpuGrid)
    }

    /// Whether its time grows with the square of the number of particles.
    pub const fn is_brute_force(self) -> bool {
        matches!(self, Self::CpuBruteForce | Self::GpuBruteForce)
    }

    /// Finds all neighbours, repeatedly; the last answer is checked.
    ///
    /// Returns the times and the bytes of the structure; `None` where the list does not fit a binding of the device.
    ///
    /// # Errors
    /// What a build or query returns; a wrong answer; `NoDevice` for a method of the GPU without one.
    pub fn measure(self, gpu: Option<&Gpu>, case: &Case<'_>, effort: Effort) -> Result<Option<(Measured, u64)>> {
        let gpu = || gpu.ok_or_else(|| Error::from(format!("{} needs a GPU", self.name())));
        let measured = match self {
            Self::CpuBruteForce => Ok(on_cpu(case, effort, &BruteForce::build(case.points)?)?),
            Self::CpuGrid => Ok(with_cpu_grid(case, effort)?),
            Self::GpuBruteForce => with_gpu_brute_force(gpu()?, case, effort),
            Self::GpuGrid => with_gpu_grid(gpu()?, case, effort),
        };
        match measured {
            Ok(measured) => Ok(Some(measured)),
            Err(error) => match error.downcast_ref::<nearfield::Error>() {
                Some(nearfield::Error::OutOfDeviceMemory { .. }) => Ok(None),
                _ => Err(error),
            },
        }
    }
}

/// Points, a radius, and what the answer must be.
#[derive(Debug)]
pub struct Case<'a> {
    /// The particles.
    pub points: &'a [Vec3],
    /// The radius.
    pub radius: f32,
    /// The answer.
    pub expected: Expected,
}

impl<'a> Case<'a> {
    /// Makes the reference answer.
    ///
    /// # Errors
    /// As [`Expected::of`].
    pub fn new(points: &'a [Vec3], radius: f32) -> Result<Self> {
        Ok(Self { points, radius, expected: Expected::of(points, radius)? })
    }

    fn check(&self, gpu: &Gpu, list: &GpuNeighbors) -> Result<()> {
        let offsets: Vec<u64> = gpu.read(&list.offsets)?.into_iter().map(u64::from).collect();
        self.expected.check_list(&offsets, &gpu.read(&list.indices)?)
    }
}

fn on_cpu(case: &Case<'_>, effort: Effort, structure: &dyn NeighborSearch) -> Result<(Measured, u64)> {
    let question = FixedRadius::new(case.radius);
    let (list, measured) = repeat(effort, || {
        let list = structure.list(&question)?;
        let stages = list.report.stages.clone();
        Ok((list, stages))
    })?;
    case.expected.check_list(list.offsets(), list.indices())?;
    Ok((measured, structure.memory_bytes()))
}

fn with_cpu_grid(case: &Case<'_>, effort: Effort) -> Result<(Measured, u64)> {
    let (settings, question) = (GridSettings::for_radius(case.radius), FixedRadius::new(case.radius));
    let ((list, bytes), measured) = repeat(effort, || {
        let grid = UniformGrid::build(case.points, &settings)?;
        let list = grid.list(&question)?;
        let stages = [NeighborSearch::build_stages(&grid), list.report.stages.clone()].concat();
        Ok(((list, NeighborSearch::memory_bytes(&grid)), stages))
    })?;
    case.expected.check_list(list.offsets(), list.indices())?;
    Ok((measured, bytes))
}

fn with_gpu_brute_force(gpu: &Gpu, case: &Case<'_>, effort: Effort) -> Result<(Measured, u64)> {
    let (structure, question) = (GpuBruteForce::build(gpu, case.points)?, FixedRadius::new(case.radius));
    let (list, measured) = repeat(effort, || {
        let list = structure.list_on_device(&question)?;
        let stages = list.report.stages.clone();
        Ok((list, stages))
    })?;
    case.check(gpu, &list)?;
    Ok((measured, NeighborSearch::memory_bytes(&structure)))
}

fn with_gpu_grid(gpu: &Gpu, case: &Case<'_>, effort: Effort) -> Result<(Measured, u64)> {
    let (settings, question) = (GridSettings::for_radius(case.radius), FixedRadius::new(case.radius));
    let input = gpu.upload("points", &device_points(case.points))?;
    let mut builder = GridBuilder::new(gpu, case.points.len(), &reduce::bounds(case.points), &settings)?;
    let ((list, bytes), measured) = repeat(effort, || {
        let grid = builder.build(&input)?;
        let list = grid.list_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&grid), list.report.stages.clone()].concat();
        Ok(((list, NeighborSearch::memory_bytes(&grid)), stages))
    })?;
    case.check(gpu, &list)?;
    Ok((measured, bytes))
}

/// The rows of a measured point: the stages, and the wall clock as total.
///
/// On a GPU the rest of the wall clock, in which the device's clock counts nothing, is the stage "other": recording,
/// submitting, waiting and taking memory.
pub fn rows(point: &Row, measured: &Measured, on_gpu: bool) -> Vec<Row> {
    let mut rows: Vec<Row> = measured.stages.iter().map(|stage| stage_row(point, stage, measured.runs)).collect();
    let wall = measured.wall.median;
    let host = |name, milliseconds| Stage { name, milliseconds, clock: Clock::Host };
    if let (true, Some(device)) = (on_gpu, measured.device) {
        rows.push(stage_row(point, &host("other", (wall - device.median).max(0.0)), measured.runs));
    }
    rows.push(stage_row(point, &host(TOTAL, wall), measured.runs));
    rows
}

fn stage_row(point: &Row, stage: &Stage, runs: usize) -> Row {
    Row {
        stage: stage.name.to_owned(),
        clock: if stage.clock == Clock::Device { "device" } else { "host" }.to_owned(),
        milliseconds: stage.milliseconds,
        runs,
        ..point.clone()
    }
}
