//! The linear octree on the CPU.

use std::ops::Range;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::build::{self, CurveKey, Nodes};
use super::layout::{NONE, OctreeNode};
use super::region::OctreeLayout;
use super::settings::{NARROW_LEVELS, OctreeSettings};
use super::walk::{Step, walk_nodes};
use crate::Result;
use crate::curve::{Curve, Domain, MAX_LEVEL};
use crate::geometry::{Aabb, OrderedPoints, Period};
use crate::parallel::{radix_sort, reduce};
use crate::structure::{BuildStage, CpuStructure, Packed, packing};

/// Most points of a pack: enough to share the look-up of spans, few enough to keep the pack's box small.
const PACK: usize = 64;

/// Points along a curve and the octree over them, on the CPU.
#[derive(Debug, Clone)]
pub struct LinearOctree {
    pub(super) settings: OctreeSettings,
    pub(super) layout: OctreeLayout,
    pub(super) points: OrderedPoints,
    pub(super) sorted_levels: u32,
    pub(super) is_balanced: bool,
    pub(super) nodes: Nodes,
    pub(super) packs: Vec<u32>,
    stages: Vec<BuildStage>,
}

impl LinearOctree {
    /// Sorts the points along the curve and cuts the octants.
    ///
    /// Without points there are no nodes.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more), `OutsideDomain`, `InvalidSetting`.
    pub fn build(points: &[Vec3], settings: &OctreeSettings) -> Result<Self> {
        let mut stages = Vec::new();
        let mut clock = Instant::now();
        let mut stage = |name| {
            stages.push(BuildStage::on_host(name, clock));
            clock = Instant::now();
        };
        settings.validate()?;
        let domain = settings.domain_of(points)?;
        stage("bounds");
        let sorted = Sorted::new(points, &domain, settings)?;
        stage("sort");
        let (nodes, sorted_levels) = match &sorted.keys {
            Keys::Narrow(keys) => (linked(keys, settings, sorted.levels)?, sorted.levels),
            Keys::Wide(keys) => (linked(keys, settings, sorted.levels)?, sorted.levels),
        };
        stage("nodes");
        let ordered = OrderedPoints::gather(points, &sorted.order);
        stage("gather");
        let bounds = if settings.period.is_periodic() { reduce::bounds(points) } else { Aabb::EMPTY };
        let layout = OctreeLayout::new(domain, settings.period, &bounds, [points.len(), nodes.nodes.len()]);
        let packs = packs(&nodes.nodes, points.len());
        stage("packs");
        Ok(Self {
            settings: *settings,
            layout,
            points: ordered,
            sorted_levels,
            is_balanced: false,
            nodes,
            packs,
            stages,
        })
    }

    /// The tree of parts that were made elsewhere.
    #[cfg(feature = "gpu")]
    pub(super) fn from_parts(
        settings: OctreeSettings,
        layout: OctreeLayout,
        points: OrderedPoints,
        sorted_levels: u32,
        nodes: Nodes,
    ) -> Self {
        let packs = packs(&nodes.nodes, points.len());
        Self { settings, layout, points, sorted_levels, is_balanced: false, nodes, packs, stages: Vec::new() }
    }

    /// The same points with other nodes.
    pub(super) fn with_nodes(self, nodes: Nodes) -> Self {
        let packs = packs(&nodes.nodes, self.points.len());
        let layout = OctreeLayout { n_nodes: nodes.nodes.len() as u32, ..self.layout };
        Self { nodes, layout, packs, ..self }
    }

    /// The 63-bit key of the point at a place, zero behind the levels that points are sorted by.
    pub(super) fn key_at(&self, place: usize) -> u64 {
        let unused = 3 * (MAX_LEVEL - self.sorted_levels);
        self.domain().key_of(self.curve(), self.points.position(place)) >> unused << unused
    }

    /// The settings it was built with.
    pub fn settings(&self) -> &OctreeSettings {
        &self.settings
    }

    /// The curve of points and octants.
    pub fn curve(&self) -> Curve {
        self.settings.curve
    }

    /// The cube that was cut.
    pub fn domain(&self) -> &Domain {
        &self.layout.domain
    }

    /// `[n_nodes]` the nodes in breadth-first order, each level along the curve.
    pub fn nodes(&self) -> &[OctreeNode] {
        &self.nodes.nodes
    }

    /// `[n]` the points along the curve.
    pub fn ordered_points(&self) -> &OrderedPoints {
        &self.points
    }

    /// Levels of the keys that points are sorted by; ties by index.
    pub fn sorted_levels(&self) -> u32 {
        self.sorted_levels
    }
}

fn linked<K: CurveKey>(keys: &[K], settings: &OctreeSettings, depth: u32) -> Result<Nodes> {
    let heads = build::leaf_heads(keys, settings.leaf_capacity as usize, depth.min(settings.max_level));
    build::link(keys, &heads, settings.curve)
}

/// Keys in ascending order.
enum Keys {
    Narrow(Vec<u32>),
    Wide(Vec<u64>),
}

/// Points sorted along a curve, as deep as the tree needs.
struct Sorted {
    keys: Keys,
    /// The points' indices in that order, ties by index.
    order: Vec<u32>,
    /// Levels of the keys that count.
    levels: u32,
}

impl Sorted {
    /// By 30 bits where the leaves end within ten levels, which costs half the sort; else by all that are needed.
    fn new(points: &[Vec3], domain: &Domain, settings: &OctreeSettings) -> Result<Self> {
        let levels = settings.few_levels();
        let unused = 3 * (NARROW_LEVELS - levels);
        let mut keys: Vec<u32> = keys_of(points, domain, settings.curve, |key| (key >> 33) as u32 >> unused << unused);
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        radix_sort::sort_pairs(&mut keys, &mut order, unused..3 * NARROW_LEVELS)?;
        let enough =
            levels == settings.max_level || !build::is_overfull(&keys, settings.leaf_capacity as usize, NARROW_LEVELS);
        if enough {
            return Ok(Self { keys: Keys::Narrow(keys), order, levels });
        }
        let levels = settings.max_level;
        let unused = 3 * (MAX_LEVEL - levels);
        let mut keys: Vec<u64> = keys_of(points, domain, settings.curve, |key| key >> unused << unused);
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        radix_sort::sort_pairs(&mut keys, &mut order, unused..3 * MAX_LEVEL)?;
        Ok(Self { keys: Keys::Wide(keys), order, levels })
    }
}

fn keys_of<K: Send>(points: &[Vec3], domain: &Domain, curve: Curve, cut: impl Fn(u64) -> K + Sync) -> Vec<K> {
    points.par_iter().with_min_len(1 << 12).map(|&point| cut(domain.key_of(curve, point))).collect()
}

/// Packs of at most [`PACK`] points: the largest octants that are small enough, large leaves in parts.
fn packs(nodes: &[OctreeNode], n: usize) -> Vec<u32> {
    let mut packs = Vec::with_capacity(n / (PACK / 4) + 1);
    walk_nodes(nodes, 0, NONE, |_, node| {
        if !node.is_leaf() && node.n_points() as usize > PACK {
            return Step::Into;
        }
        packs.extend(node.points().step_by(PACK).map(|place| place as u32));
        Step::Over
    });
    packs.push(n as u32);
    packs
}

impl CpuStructure for LinearOctree {
    const NAME: &'static str = "linear-octree";

    fn search(&self) -> &'static str {
        "octants"
    }

    fn points(&self) -> &OrderedPoints {
        &self.points
    }

    fn period(&self) -> Period {
        self.settings.period
    }

    fn packs(&self) -> &[u32] {
        &self.packs
    }

    /// Along the same curve, cut where the octants of the points' packs would be.
    fn pack_queries(&self, queries: &[Vec3]) -> Result<Packed> {
        packing::along_curve(queries, self.domain(), self.curve(), self.packs.len(), PACK)
    }

    fn spans_near(&self, region: &Aabb, radius: f32, spans: &mut Vec<Range<usize>>) {
        let region = self.layout.region_near(region, radius);
        self.spans_in(&region, spans);
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        let words = self.nodes.pre_order.len() + self.nodes.post_order.len() + self.nodes.level_starts.len();
        let nodes = size_of_val(&self.nodes.nodes[..]) + 4 * (words + self.packs.len());
        self.points.memory_bytes() + nodes as u64
    }
}
