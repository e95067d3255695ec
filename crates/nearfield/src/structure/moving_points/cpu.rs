//! Moving points on the CPU.

use std::time::Instant;

use glam::Vec3;

use super::cost::Costs;
use super::policy::RebuildPolicy;
use super::report::{UpdateAction, UpdateReport};
use super::volume_ratio::VolumesAtBuild;
use crate::Result;
use crate::geometry::validate;
use crate::structure::aabb_tree::check_moved;
use crate::structure::{AabbTree, AabbTreeSettings, BuildStage, CpuStructure, TreeSearch};

/// Points that move and the tree that answers questions about them, on the CPU.
///
/// ```
/// use nearfield::{AabbTreeSettings, FixedRadius, MovingPoints, NeighborSearch, RebuildPolicy, Vec3};
///
/// // Particles on a lattice, half a unit apart.
/// let mut positions: Vec<Vec3> = (0..1000u16)
///     .map(|i| 0.5 * Vec3::new(f32::from(i % 10), f32::from(i / 10 % 10), f32::from(i / 100)))
///     .collect();
/// let radius = 0.5;
/// let policy = RebuildPolicy::VolumeRatio { limit: 2.0 };
/// let mut particles = MovingPoints::new(&positions, radius, &AabbTreeSettings::DEFAULT, policy)?;
///
/// let mut n_rebuilds = 0;
/// for _ in 0..60 {
///     // They drift around the axis, the outer ones as fast as the inner ones.
///     for position in &mut positions {
///         *position += 0.1 * Vec3::new(-position.y, position.x, 0.0).normalize_or_zero();
///     }
///     let report = particles.update(&positions)?;
///     n_rebuilds += u32::from(report.is_rebuild());
///     println!("{report}");
///     let counts = particles.tree().count(&FixedRadius::new(radius).exclude_self())?;
///     assert_eq!(counts.as_slice().len(), 1000);
/// }
/// assert!(0 < n_rebuilds && n_rebuilds < 30, "{n_rebuilds}");
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MovingPoints {
    tree: AabbTree,
    radius: f32,
    policy: RebuildPolicy,
    volumes: VolumesAtBuild,
    costs: Costs,
}

impl MovingPoints {
    /// Builds the tree of the points.
    ///
    /// - `radius`: the one that most questions ask with; boxes are grown by it before their volumes are compared
    ///
    /// # Errors
    /// `InvalidRadius`; `InvalidSetting` for the tree or the policy; `NonFinite`, `CoordinateTooLarge`, `TooMany`.
    pub fn new(points: &[Vec3], radius: f32, settings: &AabbTreeSettings, policy: RebuildPolicy) -> Result<Self> {
        policy.validate()?;
        validate::radius(radius, None)?;
        let start = Instant::now();
        let tree = AabbTree::build(points, settings)?;
        let costs = Costs::built(milliseconds_since(start));
        let mut moving = Self { tree, radius, policy, volumes: VolumesAtBuild::default(), costs };
        moving.keep_volumes();
        Ok(moving)
    }

    /// Moves the points; the tree follows, by a fit or a build as the policy says.
    ///
    /// - `positions`: `[n]` new positions in the caller's order
    ///
    /// # Errors
    /// `LengthMismatch`, `NonFinite`, `CoordinateTooLarge`: points and tree are then as they were.
    pub fn update(&mut self, positions: &[Vec3]) -> Result<UpdateReport> {
        let start = Instant::now();
        let costs = self.costs.after_step();
        let mut stages = Vec::new();
        let decision = match self.policy.before_fit(&costs) {
            Ok(decision) => {
                if decision.action == UpdateAction::Refit {
                    self.refit(positions, &mut stages)?;
                }
                decision
            }
            Err(limit) => {
                self.refit(positions, &mut stages)?;
                let compare = Instant::now();
                let measured = self.volumes.largest_ratio(self.tree.boxes(), self.radius);
                stages.push(BuildStage::on_host("volume ratio", compare));
                RebuildPolicy::after_fit(measured, limit)
            }
        };
        self.costs = match decision.action {
            UpdateAction::Rebuild => self.rebuild(positions, &mut stages)?,
            UpdateAction::Refit => costs,
        };
        let milliseconds = milliseconds_since(start);
        Ok(UpdateReport { action: decision.action, reason: decision.reason, stages, milliseconds })
    }

    fn refit(&mut self, positions: &[Vec3], stages: &mut Vec<BuildStage>) -> Result<()> {
        let start = Instant::now();
        self.tree.refit(positions)?;
        stages.push(BuildStage::on_host("refit", start));
        Ok(())
    }

    fn rebuild(&mut self, positions: &[Vec3], stages: &mut Vec<BuildStage>) -> Result<Costs> {
        let start = Instant::now();
        check_moved(positions, self.tree.shape().n_points())?;
        self.tree = AabbTree::build(positions, self.tree.settings())?;
        let costs = Costs::built(milliseconds_since(start));
        stages.extend_from_slice(self.tree.build_stages());
        self.keep_volumes();
        Ok(costs)
    }

    fn keep_volumes(&mut self) {
        if matches!(self.policy, RebuildPolicy::VolumeRatio { .. }) {
            self.volumes.keep(self.tree.boxes());
        }
    }

    /// The tree over the points as they are now. It answers all questions.
    pub fn tree(&self) -> &AabbTree {
        &self.tree
    }

    /// `[n]` the points as they are now, in the caller's order.
    pub fn positions(&self) -> Vec<Vec3> {
        let points = self.tree.ordered_points();
        let mut positions = vec![Vec3::ZERO; points.len()];
        for (place, &id) in points.ids().iter().enumerate() {
            positions[id as usize] = points.position(place);
        }
        positions
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

    /// Asks the tree and records the time of that, as [`MovingPoints::record_query_time`] does.
    pub fn ask<A>(&mut self, question: impl FnOnce(&AabbTree) -> A) -> A {
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

pub(super) fn milliseconds_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}
