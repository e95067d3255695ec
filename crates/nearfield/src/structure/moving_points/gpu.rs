//! Moving points on the GPU.

use std::time::Instant;

use glam::Vec3;

use super::cost::Costs;
use super::cpu::milliseconds_since;
use super::gpu_volume_ratio::GpuVolumesAtBuild;
use super::policy::{Decision, RebuildPolicy};
use super::report::{UpdateAction, UpdateReport};
use crate::geometry::validate;
use crate::gpu::{Buffer, Gpu};
use crate::structure::on_gpu::{DevicePoint, GpuStructure, device_point, upload_points};
use crate::structure::{AabbTree, AabbTreeBuilder, AabbTreeSettings, BuildOrder, BuildStage, GpuAabbTree, TreeSearch};
use crate::{Error, Result};

/// Points that move and the tree that answers questions about them, on the GPU.
///
/// With [`BuildOrder::Hilbert`] builds stay on the device and use the memory that is there. With [`BuildOrder::Median`] the
/// points are read back, put in order on the CPU and copied to the device, as in Xing2017.
///
/// ```no_run
/// use nearfield::{AabbTreeSettings, BuildOrder, FixedRadius, Gpu, GpuMovingPoints, NeighborSearch, RebuildPolicy, Vec3};
///
/// # fn simulate(gpu: &Gpu, points: &[Vec3], moved: &nearfield::gpu::Buffer<[f32; 4]>) -> nearfield::Result<()> {
/// let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert);
/// let mut particles = GpuMovingPoints::new(gpu, points, 0.1, &settings, RebuildPolicy::DEFAULT)?;
/// // `moved`: [n] positions in the order of `points`, written by a kernel.
/// println!("{}", particles.update_on_device(moved)?);
/// let neighbors = particles.tree().list(&FixedRadius::new(0.1))?;
/// # let _ = neighbors;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct GpuMovingPoints {
    gpu: Gpu,
    tree: GpuAabbTree,
    radius: f32,
    policy: RebuildPolicy,
    volumes: Option<GpuVolumesAtBuild>,
    /// Where trees are built on the device, and may be built again.
    builder: Option<AabbTreeBuilder>,
    /// Positions that come from the host; made when they do.
    input: Option<Buffer<DevicePoint>>,
    costs: Costs,
}

impl GpuMovingPoints {
    /// Copies the points to the device and builds the tree.
    ///
    /// - `radius`: the one that most questions ask with; boxes are grown by it before their volumes are compared
    ///
    /// # Errors
    /// `InvalidRadius`; `InvalidSetting` for the policy; as [`GpuAabbTree::build`].
    pub fn new(
        gpu: &Gpu,
        points: &[Vec3],
        radius: f32,
        settings: &AabbTreeSettings,
        policy: RebuildPolicy,
    ) -> Result<Self> {
        policy.validate()?;
        validate::radius(radius, None)?;
        validate::points(points)?;
        let start = Instant::now();
        let (tree, builder, input) = match settings.order {
            BuildOrder::Median => (GpuAabbTree::build(gpu, points, settings)?, None, None),
            BuildOrder::Hilbert => {
                let input = upload_points(gpu, "moved points", points, 0)?;
                let mut builder = AabbTreeBuilder::new(gpu, points.len(), settings)?;
                let tree = builder.build(&input)?;
                (tree, (policy != RebuildPolicy::Never).then_some(builder), Some(input))
            }
        };
        let costs = Costs::built(milliseconds_since(start));
        let volumes = match policy {
            RebuildPolicy::VolumeRatio { .. } => Some(GpuVolumesAtBuild::new(gpu, tree.shape().n_nodes(), radius)?),
            _ => None,
        };
        let moving = Self { gpu: gpu.clone(), tree, radius, policy, volumes, builder, input, costs };
        moving.keep_volumes(&mut Vec::new())?;
        Ok(moving)
    }

    /// Moves the points to positions of the host; the tree follows, by a fit or a build as the policy says.
    ///
    /// - `positions`: `[n]` new positions in the caller's order
    ///
    /// # Errors
    /// As [`GpuMovingPoints::update_on_device`].
    pub fn update(&mut self, positions: &[Vec3]) -> Result<UpdateReport> {
        let n = self.tree.shape().n_points();
        if positions.len() != n {
            let (found, expected) = (positions.len() as u64, n as u64);
            return Err(Error::LengthMismatch { what: "new positions of the points", found, expected });
        }
        let start = Instant::now();
        let input = match self.input.take() {
            Some(input) => input,
            None => self.gpu.buffer("moved points", n)?,
        };
        let updated = self.gpu.write_with(&input, device_point(positions, 0)).and_then(|()| {
            let upload = BuildStage::on_host("upload", start);
            let mut report = self.update_on_device(&input)?;
            report.stages.insert(0, upload);
            report.milliseconds = milliseconds_since(start);
            Ok(report)
        });
        self.input = Some(input);
        updated
    }

    /// Moves the points to positions on the device; the tree follows, by a fit or a build as the policy says.
    ///
    /// - `positions`: `[n]` new xyz in the caller's order, the fourth value is not used
    ///
    /// # Errors
    /// `LengthMismatch`, `NonFinite`, `CoordinateTooLarge`: points and tree are then as they were. `OutOfDeviceMemory`,
    /// `OutOfMemory`: the tree is as it was, or fitted to the new positions. `DeviceLost`.
    pub fn update_on_device(&mut self, positions: &Buffer<DevicePoint>) -> Result<UpdateReport> {
        let start = Instant::now();
        let costs = self.costs.after_step();
        let mut stages = Vec::new();
        let decision = match self.policy.before_fit(&costs) {
            Ok(decision) => {
                if decision.action == UpdateAction::Refit {
                    stages = self.tree.refit(positions)?;
                }
                decision
            }
            Err(limit) => self.refit_and_compare(positions, limit, &mut stages)?,
        };
        self.costs = match decision.action {
            UpdateAction::Rebuild => self.rebuild(positions, &mut stages)?,
            UpdateAction::Refit => costs,
        };
        let milliseconds = milliseconds_since(start);
        Ok(UpdateReport { action: decision.action, reason: decision.reason, stages, milliseconds })
    }

    /// Fits the boxes and decides by the volumes that they have then.
    fn refit_and_compare(
        &mut self,
        positions: &Buffer<DevicePoint>,
        limit: f32,
        stages: &mut Vec<BuildStage>,
    ) -> Result<Decision> {
        let volumes = self.volumes.as_ref().expect("the policy by volumes should keep those of the build");
        *stages = self.tree.refit_and(positions, |commands, nodes| {
            commands.stage("volume ratio");
            volumes.record_largest(commands, nodes)
        })?;
        Ok(RebuildPolicy::after_fit(volumes.largest_ratio(&self.gpu)?, limit))
    }

    fn rebuild(&mut self, positions: &Buffer<DevicePoint>, stages: &mut Vec<BuildStage>) -> Result<Costs> {
        let start = Instant::now();
        match &mut self.builder {
            Some(builder) => builder.rebuild(positions, &mut self.tree)?,
            None => {
                self.tree.check_moved(positions)?;
                let points: Vec<Vec3> = self.gpu.read(positions)?.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
                stages.push(BuildStage::on_host("read back", start));
                self.tree = GpuAabbTree::upload(&self.gpu, &AabbTree::build(&points, self.tree.settings())?)?;
            }
        }
        let costs = Costs::built(milliseconds_since(start));
        stages.extend_from_slice(self.tree.build_stages());
        self.keep_volumes(stages)?;
        Ok(costs)
    }

    fn keep_volumes(&self, stages: &mut Vec<BuildStage>) -> Result<()> {
        if let Some(volumes) = &self.volumes {
            let mut commands = self.gpu.commands("volumes at the build");
            volumes.record_keep(&mut commands, self.tree.nodes());
            stages.extend(commands.run()?.iter().filter_map(BuildStage::on_device));
        }
        Ok(())
    }

    /// The tree over the points as they are now. It answers all questions.
    pub fn tree(&self) -> &GpuAabbTree {
        &self.tree
    }

    /// `[n]` the points as they are now, in the caller's order, read back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn positions(&self) -> Result<Vec<Vec3>> {
        let points: Vec<DevicePoint> = self.gpu.read(self.tree.points())?;
        let mut positions = vec![Vec3::ZERO; points.len()];
        for [x, y, z, id] in points {
            positions[id.to_bits() as usize] = Vec3::new(x, y, z);
        }
        Ok(positions)
    }

    /// The policy.
    pub fn policy(&self) -> RebuildPolicy {
        self.policy
    }

    /// The radius that boxes are grown by.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Chooses how fixed-radius questions are answered; the tree stays.
    pub fn set_search(&mut self, search: TreeSearch) {
        self.tree.set_search(search);
    }

    /// Asks the tree and records the time of that by the host's clock, as [`GpuMovingPoints::record_query_time`] does. The
    /// question should wait for its answer.
    pub fn ask<A>(&mut self, question: impl FnOnce(&GpuAabbTree) -> A) -> A {
        let start = Instant::now();
        let answer = question(&self.tree);
        let recorded = self.costs.record(milliseconds_since(start));
        recorded.expect("a time that has passed should be a number");
        answer
    }

    /// Tells [`RebuildPolicy::Cost`] the time of a query, by the host's clock as builds are timed. Times between two updates
    /// add up to those of a step, and steps are compared: they should ask alike.
    ///
    /// # Errors
    /// `InvalidSetting` for a time that is not a finite number, 0 or more.
    pub fn record_query_time(&mut self, milliseconds: f64) -> Result<()> {
        self.costs.record(milliseconds)
    }

    /// Time of the last build by the host's clock: what the extra time of queries is compared with.
    pub fn build_milliseconds(&self) -> f64 {
        self.costs.build_milliseconds()
    }
}
