//! Clusters on the device: the passes as visitors over any structure, with the trees of clusters in device memory from the first to the
//! last.
//!
//! The host submits core points, joining and two passes of flattening, and reads three words: whether joining or flattening must go on.
//! Then it submits borders and labels. Rounds are few: trees join within the attempts of one pass but on devices that end long loops.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::{Clusters, DbscanSettings, EuclideanSettings, labels};
use crate::Result;
use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, positive};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::scan::GpuScan;
use crate::query::{DeviceQueries, Stage, VisitorModule, record_module};
use crate::structure::{GpuStructure, GpuUniformGrid, GridSettings};

/// Invocations of a workgroup of the kernels here.
const WORKGROUP: u32 = 256;
/// Attempts to join two trees in one visit. Where loops end after a number of rounds, so few that many points can be visited.
const MOST_ATTEMPTS: u32 = 1024;
const FEW_ATTEMPTS: u32 = 2;
/// Words that say what is unfinished: joining, and each of two passes of flattening.
const FLAGS: usize = 3;
/// Labels that one thread takes apart.
const TASK: usize = 1 << 14;

use Access::{Read, ReadWrite, Uniform};

/// Clusters that stay on the device.
#[derive(Debug)]
pub struct GpuClusters {
    /// `[n]` by index of the point: `(label + 1) · 2`, with label −1 for points in no cluster, and 1 more for core points.
    pub labels: Buffer<u32>,
    /// Number of clusters.
    pub n_clusters: u32,
    /// Times of the passes by the device's clock, where it has one.
    pub stages: Vec<Stage>,
}

/// As [`super::dbscan`] over a uniform grid on the device, in `f32`; the labels are the same but where a distance is within a few ulp of
/// `eps`.
///
/// # Errors
/// `InvalidSetting`; `CoordinateTooLarge`, `TooMany` for the points; `Unsupported` where the device would end the kernel's loops;
/// `OutOfDeviceMemory`, `DeviceLost`; `Interrupted`.
pub fn dbscan_on_gpu(gpu: &Gpu, points: &[Vec3], settings: &DbscanSettings, watch: &mut Watch<'_>) -> Result<Clusters> {
    settings.validate()?;
    of_points(gpu, points, positive("eps", settings.eps)?, settings.min_points, watch)
}

/// As [`super::euclidean_clusters`] over a uniform grid on the device, in `f32`.
///
/// # Errors
/// As [`dbscan_on_gpu`].
pub fn euclidean_clusters_on_gpu(
    gpu: &Gpu,
    points: &[Vec3],
    settings: &EuclideanSettings,
    watch: &mut Watch<'_>,
) -> Result<Clusters> {
    settings.validate()?;
    let mut clusters = of_points(gpu, points, positive("radius", settings.radius)?, 1, watch)?;
    labels::keep_sizes(&mut clusters, settings);
    Ok(clusters)
}

fn of_points(gpu: &Gpu, points: &[Vec3], radius: f32, min_points: u32, watch: &mut Watch<'_>) -> Result<Clusters> {
    let finite = FinitePoints::of(points)?;
    if finite.points().is_empty() {
        let (labels, is_core) = (finite.spread(vec![], Clusters::NONE), finite.spread(vec![], false));
        return Ok(Clusters { labels, is_core, invalid: finite.invalid(), ..Clusters::default() });
    }
    let grid = GpuUniformGrid::build(gpu, finite.points(), &GridSettings::for_radius(radius))?;
    let found = GpuClusters::of(&grid, radius, min_points, watch)?;
    let start = Instant::now();
    let (labels, is_core) = found.read(gpu)?;
    let read = Stage::on_host("read back", start);
    let stages = grid.build_stages().iter().map(Stage::from).chain(found.stages).chain([read]).collect();
    Ok(Clusters {
        labels: finite.spread(labels, Clusters::NONE),
        is_core: finite.spread(is_core, false),
        n_clusters: found.n_clusters,
        invalid: finite.invalid(),
        stages,
        ..Clusters::default()
    })
}

/// What the passes share.
struct Passes<'a, S> {
    structure: &'a S,
    radius: f32,
    min_points: u32,
    attempts: u32,
    /// `[n]` by index of the point: itself where it is a root, `NONE` where it is no core point.
    parents: Buffer<u32>,
    unfinished: Buffer<u32>,
    flatten: Arc<Pipeline>,
}

impl GpuClusters {
    /// Clusters the points of a structure, which must have the indices 0 to n − 1.
    ///
    /// - `min_points`: 1 for Euclidean clusters
    ///
    /// # Errors
    /// `InvalidRadius`; `Unsupported` where the device would end the kernel's loops; `OutOfDeviceMemory`, `DeviceLost`; `Interrupted`.
    pub fn of<S: GpuStructure>(structure: &S, radius: f32, min_points: u32, watch: &mut Watch<'_>) -> Result<Self> {
        let (gpu, n) = (structure.gpu(), structure.len());
        let mut stages = Vec::new();
        let passes = Passes {
            structure,
            radius,
            min_points,
            attempts: if gpu.limits().loop_rounds.is_some() { FEW_ATTEMPTS } else { MOST_ATTEMPTS },
            parents: gpu.buffer("parents of core points", n)?,
            unfinished: gpu.buffer("what is unfinished", FLAGS)?,
            flatten: pipeline(gpu, "flatten", &[Uniform, ReadWrite, ReadWrite])?,
        };
        watch.report("join", 0, 2)?;
        let mut commands = gpu.commands("clusters");
        passes.record_core_points(&mut commands)?;
        passes.record_join(&mut commands)?;
        passes.record_flatten(&mut commands)?;
        add(&mut stages, &commands.run()?);
        while let Some(again) = Again::of(&gpu.read(&passes.unfinished)?) {
            watch.report("join", 0, 2)?;
            let mut commands = gpu.commands("clusters");
            match again {
                Again::Join => passes.record_join(&mut commands)?,
                Again::Flatten => {
                    commands.stage("flatten").clear(&passes.unfinished);
                }
            }
            passes.record_flatten(&mut commands)?;
            add(&mut stages, &commands.run()?);
        }
        watch.report("labels", 1, 2)?;
        let clusters = gpu.buffer("clusters of points", n)?;
        let labels = gpu.buffer("roots and labels", n)?;
        let ranks = gpu.buffer("ranks of roots", n + 1)?;
        let mut commands = gpu.commands("labels of clusters");
        passes.record_borders(&mut commands, &clusters, &labels)?;
        commands.stage("labels");
        GpuScan::new(gpu, n)?.record(&mut commands, &labels, &ranks, n)?;
        let asked = gpu.uniform("what is labelled", &[n as u32, 0, 0, 0])?;
        let write_labels = pipeline(gpu, "write_labels", &[Uniform, Read, Read, Read, ReadWrite])?;
        let binds = [(&asked).into(), (&passes.parents).into(), (&clusters).into(), (&ranks).into(), (&labels).into()];
        commands.dispatch(&write_labels, &binds, Workgroups::Covering(n as u64));
        add(&mut stages, &commands.run()?);
        let n_clusters = if n == 0 { 0 } else { gpu.read_range(&ranks, n..n + 1)?[0] };
        if n_clusters > 0 {
            labels::check_count(n_clusters - 1)?;
        }
        watch.report("labels", 2, 2)?;
        Ok(Self { labels, n_clusters, stages })
    }

    /// Reads labels back, and who is a core point.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read(&self, gpu: &Gpu) -> Result<(Vec<i32>, Vec<bool>)> {
        let words = gpu.read(&self.labels)?;
        let apart = |&word: &u32| ((word >> 1) as i32 - 1, word & 1 == 1);
        Ok(words.par_iter().with_min_len(TASK).map(apart).unzip())
    }
}

/// What has to run again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Again {
    Join,
    Flatten,
}

impl Again {
    /// From the words of the last passes; what the first pass of flattening left the second has finished, or said.
    fn of(unfinished: &[u32]) -> Option<Self> {
        match unfinished {
            [0, _, 0] => None,
            [0, ..] => Some(Self::Flatten),
            _ => Some(Self::Join),
        }
    }
}

fn pipeline(gpu: &Gpu, entry: &'static str, bindings: &[Access]) -> Result<Arc<Pipeline>> {
    let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
    gpu.prepare(&Kernel {
        constants,
        ..Kernel::new("package::application::cluster::flatten", entry, bindings, WORKGROUP)
    })
}

/// Adds stages that the device has timed.
fn add(stages: &mut Vec<Stage>, times: &[StageTime]) {
    stages.extend(times.iter().filter_map(Stage::on_device));
}

impl<S: GpuStructure> Passes<'_, S> {
    fn record(
        &self,
        commands: &mut Commands,
        module: &'static str,
        bindings: &[(Access, Bind)],
        each: u64,
    ) -> Result<()> {
        let queries = DeviceQueries::new(self.structure.points(), self.radius);
        let visitor = VisitorModule { module, features: &[], bindings, rounds: [each, 0], combines: false };
        record_module(commands, self.structure, &queries, &visitor)
    }

    fn record_core_points(&self, commands: &mut Commands) -> Result<()> {
        let asked = self.structure.gpu().uniform("core points asked for", &[self.min_points, 0, 0, 0])?;
        let bindings = [(Uniform, (&asked).into()), (ReadWrite, (&self.parents).into())];
        commands.stage("core points");
        self.record(commands, "package::application::cluster::core_points", &bindings, 0)
    }

    fn record_join(&self, commands: &mut Commands) -> Result<()> {
        let asked = self.structure.gpu().uniform("attempts to join", &[0, self.attempts, 0, 0])?;
        let bindings =
            [(Uniform, (&asked).into()), (ReadWrite, (&self.parents).into()), (ReadWrite, (&self.unfinished).into())];
        commands.stage("join").clear(&self.unfinished);
        // A look ends the loop.
        self.record(commands, "package::application::cluster::join", &bindings, u64::from(self.attempts) + 1)
    }

    fn record_flatten(&self, commands: &mut Commands) -> Result<()> {
        let (gpu, n) = (self.structure.gpu(), self.structure.len());
        commands.stage("flatten");
        for pass in 1..FLAGS as u32 {
            let asked = gpu.uniform("what is flattened", &[n as u32, pass, 0, 0])?;
            let binds = [(&asked).into(), (&self.parents).into(), (&self.unfinished).into()];
            commands.dispatch(&self.flatten, &binds, Workgroups::Covering(n as u64));
        }
        Ok(())
    }

    fn record_borders(&self, commands: &mut Commands, clusters: &Buffer<u32>, roots: &Buffer<u32>) -> Result<()> {
        let bindings = [(Read, (&self.parents).into()), (ReadWrite, clusters.into()), (ReadWrite, roots.into())];
        commands.stage("borders");
        self.record(commands, "package::application::cluster::borders", &bindings, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unfinished_runs_again() {
        assert_eq!(Again::of(&[0, 0, 0]), None);
        assert_eq!(Again::of(&[0, 1, 0]), None);
        assert_eq!(Again::of(&[0, 1, 1]), Some(Again::Flatten));
        assert_eq!(Again::of(&[1, 0, 0]), Some(Again::Join));
        assert_eq!(Again::of(&[1, 1, 1]), Some(Again::Join));
    }
}
