//! What a policy should do, by plain computations of its definition.

use nearfield::structure::TreeShape;
use nearfield::structure::aabb_tree::NodeBox;
use nearfield::{RebuildPolicy, UpdateReason, UpdateReport, Vec3};

use crate::subject::Moving;

/// What ratios may differ by: two roundings in f32 for each side and each quotient, and one for the products.
const RATIO_SLACK: f64 = 2e-6;

/// The state of a policy as its definition has it.
pub(crate) struct Model {
    policy: RebuildPolicy,
    radius: f32,
    boxes_at_build: Vec<NodeBox>,
    shape: TreeShape,
    /// Places of the order that the boxes are of.
    ids: Vec<u32>,
    /// Query times since the build, one a step.
    times: Vec<f64>,
    build: f64,
    pub(crate) n_rebuilds: u32,
}

impl Model {
    pub(crate) fn new(moving: &dyn Moving, radius: f32, policy: RebuildPolicy) -> Self {
        let mut model = Self {
            policy,
            radius,
            boxes_at_build: vec![],
            shape: moving.tree().shape(),
            ids: vec![],
            times: vec![],
            build: 0.0,
            n_rebuilds: 0,
        };
        model.begin(moving);
        model
    }

    /// Takes the tree that was just built.
    fn begin(&mut self, moving: &dyn Moving) {
        let tree = moving.tree();
        self.boxes_at_build = tree.boxes().to_vec();
        self.ids = tree.ordered_points().ids().to_vec();
        self.build = moving.build_milliseconds();
        self.times.clear();
    }

    /// Records a query that takes this share of a build.
    pub(crate) fn record(&mut self, moving: &mut dyn Moving, share: f64) {
        let time = share * self.build;
        moving.record_query_time(time).unwrap();
        self.times.push(time);
    }

    /// Checks what an update to these positions reported, and follows it.
    pub(crate) fn check(&mut self, moving: &dyn Moving, positions: &[Vec3], report: &UpdateReport, case: &str) {
        let expected = match (self.policy, report.reason) {
            (RebuildPolicy::Always, UpdateReason::Policy { policy: RebuildPolicy::Always }) => true,
            (RebuildPolicy::Never, UpdateReason::Policy { policy: RebuildPolicy::Never }) => false,
            (RebuildPolicy::VolumeRatio { limit }, UpdateReason::VolumeRatio { measured, limit: said }) => {
                assert_eq!(said, limit, "{case}");
                let ratio = self.largest_ratio(positions);
                let (least, most) = (ratio * (1.0 - RATIO_SLACK), ratio * (1.0 + RATIO_SLACK));
                let is_right = (least..=most).contains(&f64::from(measured));
                // Ratios beyond 2^100 are infinite.
                let is_infinite = ratio > 1e30 && measured == f32::INFINITY;
                assert!(is_right || is_infinite, "{case}: measured {measured}, by the definition {ratio}");
                let at_limit = least <= f64::from(limit) && f64::from(limit) <= most;
                if at_limit { report.is_rebuild() } else { ratio > f64::from(limit) }
            }
            (RebuildPolicy::Cost, UpdateReason::QueryTime { extra_milliseconds, build_milliseconds }) => {
                assert_eq!(build_milliseconds, self.build, "{case}");
                let extra = self.extra_time();
                assert!((extra_milliseconds - extra).abs() <= 1e-9 * extra, "{case}: {report:?}, expected {extra}");
                extra > 0.0 && extra >= self.build
            }
            (policy, reason) => panic!("{case}: {policy:?} gave the reason {reason:?}"),
        };
        assert_eq!(report.is_rebuild(), expected, "{case}: {report}");
        if expected {
            self.n_rebuilds += 1;
            self.begin(moving);
        }
    }

    /// Time beyond the fastest step so far, from step to step.
    fn extra_time(&self) -> f64 {
        let fastest = |step: usize| self.times[..=step].iter().copied().fold(f64::INFINITY, f64::min);
        (0..self.times.len()).map(|step| self.times[step] - fastest(step)).sum()
    }

    /// The largest ratio of volumes that boxes fitted to these positions have, grown by the radius.
    fn largest_ratio(&self, positions: &[Vec3]) -> f64 {
        let volume = |low: Vec3, high: Vec3| {
            let side = |axis: usize| f64::from(high[axis]) - f64::from(low[axis]) + 2.0 * f64::from(self.radius);
            side(0) * side(1) * side(2)
        };
        let of_node = |node: usize| {
            let ids = &self.ids[self.shape.points(node)];
            if ids.is_empty() {
                return 1.0;
            }
            let points = || ids.iter().map(|&id| positions[id as usize]);
            let (low, high) = (points().fold(Vec3::MAX, Vec3::min), points().fold(Vec3::MIN, Vec3::max));
            let at_build = &self.boxes_at_build[node];
            volume(low, high) / volume(Vec3::from_array(at_build.min), Vec3::from_array(at_build.max))
        };
        let nodes = 0..self.boxes_at_build.len();
        if nodes.is_empty() { 1.0 } else { nodes.map(of_node).fold(f64::NEG_INFINITY, f64::max) }
    }
}
