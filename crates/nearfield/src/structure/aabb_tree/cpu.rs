//! The tree of boxes on the CPU.

use std::ops::Range;
use std::time::Instant;

use glam::Vec3;

use super::build::{self, Item};
use super::region::NodeBox;
use super::settings::{AabbTreeSettings, BuildOrder, TreeSearch};
use super::shape::TreeShape;
use crate::Result;
use crate::curve::{self, Curve, Domain};
use crate::geometry::{Aabb, OrderedPoints, Period, validate};
use crate::structure::{BuildStage, CpuStructure, Packed, packing};

/// Most points of a pack: enough to share the look-up of spans, few enough to keep the pack's box small.
const PACK: u32 = 64;

/// Points in the order of a complete binary tree, and the tree's boxes, on the CPU.
#[derive(Debug, Clone)]
pub struct AabbTree {
    pub(super) settings: AabbTreeSettings,
    pub(super) shape: TreeShape,
    pub(super) points: OrderedPoints,
    /// `[n_nodes]` in breadth-first order.
    pub(super) boxes: Vec<NodeBox>,
    /// Largest distance of a point from zero by axis.
    pub(super) extent: Vec3,
    packs: Vec<u32>,
    stages: Vec<BuildStage>,
}

impl AabbTree {
    /// Brings the points into the tree's order and fits the boxes.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (2³² − 1 points or more), `InvalidSetting`.
    pub fn build(points: &[Vec3], settings: &AabbTreeSettings) -> Result<Self> {
        let mut stages = Vec::new();
        let mut clock = Instant::now();
        let mut stage = |name| {
            stages.push(BuildStage::on_host(name, clock));
            clock = Instant::now();
        };
        settings.validate()?;
        validate::points(points)?;
        let shape = TreeShape::new(points.len() as u32, settings.bucket_size);
        let order = match settings.order {
            BuildOrder::Median => {
                let item = |(point, id): (&Vec3, u32)| Item { position: point.to_array(), id };
                let mut items: Vec<Item<f32, 3>> = points.iter().zip(0..).map(item).collect();
                build::median_order(&mut items, &shape);
                items.iter().map(|item| item.id).collect()
            }
            BuildOrder::Hilbert => curve::order(points, Curve::Hilbert)?,
        };
        stage("order");
        let points = OrderedPoints::gather(points, &order);
        stage("gather");
        let mut tree = Self::from_parts(*settings, shape, points, vec![NodeBox::EMPTY; shape.n_nodes()]);
        tree.fit();
        stage("fit");
        tree.stages = stages;
        Ok(tree)
    }

    /// The tree of parts that were made elsewhere.
    pub(super) fn from_parts(
        settings: AabbTreeSettings,
        shape: TreeShape,
        points: OrderedPoints,
        boxes: Vec<NodeBox>,
    ) -> Self {
        let packs = packs(&shape, settings.search);
        let extent = boxes.first().map_or(Vec3::ZERO, extent);
        Self { settings, shape, points, boxes, extent, packs, stages: Vec::new() }
    }

    /// Moves the points and fits the boxes to them; the shape of the tree and the order of the points stay.
    ///
    /// - `points`: `[n]` new positions in the caller's order
    ///
    /// # Errors
    /// `LengthMismatch`, `NonFinite`, `CoordinateTooLarge`: the tree is then as it was.
    pub fn refit(&mut self, points: &[Vec3]) -> Result<()> {
        super::update::check_moved(points, self.points.len())?;
        self.points.move_to(points);
        self.fit();
        Ok(())
    }

    /// Fits all boxes to the points, from the leaves up.
    fn fit(&mut self) {
        let points = &self.points;
        build::fit(&self.shape, &mut self.boxes, |places| {
            places.fold(NodeBox::EMPTY, |aabb, place| aabb.grown_to(&points.position(place).to_array()))
        });
        self.extent = self.boxes.first().map_or(Vec3::ZERO, extent);
    }

    /// The settings, with the search as it was set last.
    pub fn settings(&self) -> &AabbTreeSettings {
        &self.settings
    }

    /// The shape of the tree.
    pub fn shape(&self) -> TreeShape {
        self.shape
    }

    /// `[n_nodes]` the boxes in breadth-first order.
    pub fn boxes(&self) -> &[NodeBox] {
        &self.boxes
    }

    /// `[n]` the points in the tree's order.
    pub fn ordered_points(&self) -> &OrderedPoints {
        &self.points
    }

    /// Chooses how fixed-radius questions are answered; the tree stays.
    pub fn set_search(&mut self, search: TreeSearch) {
        self.settings.search = search;
        self.packs = packs(&self.shape, search);
    }
}

/// Largest absolute coordinates of a box.
fn extent(aabb: &NodeBox) -> Vec3 {
    aabb.low().abs().max(aabb.high().abs())
}

/// The packs of a search: single points, leaves, or nodes of at most [`PACK`] points.
fn packs(shape: &TreeShape, search: TreeSearch) -> Vec<u32> {
    let n = shape.n_points();
    let level = match search {
        TreeSearch::Primary => return (0..=n as u32).collect(),
        TreeSearch::Coherent => shape.depth(),
        TreeSearch::Packed => TreeShape::new(n as u32, PACK).depth().min(shape.depth()),
    };
    let starts = shape.level(level).map(|node| shape.points(node).start as u32);
    starts.chain([n as u32]).collect()
}

impl CpuStructure for AabbTree {
    const NAME: &'static str = "aabb-tree";

    fn search(&self) -> &'static str {
        self.settings.search.name()
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

    /// Along the Hilbert curve, cut where packs of the points would be.
    fn pack_queries(&self, queries: &[Vec3]) -> Result<Packed> {
        let bounds = self.boxes.first().map_or(Aabb::EMPTY, NodeBox::to_aabb);
        let most = if self.settings.search == TreeSearch::Primary { 1 } else { PACK as usize };
        packing::along_curve(queries, &Domain::of_bounds(&bounds), Curve::Hilbert, self.packs.len(), most)
    }

    fn spans_near(&self, region: &Aabb, radius: f32, spans: &mut Vec<Range<usize>>) {
        self.spans_in(&self.region_near(region, radius), spans);
    }

    fn coherent_tree(&self) -> Option<&AabbTree> {
        (self.settings.search == TreeSearch::Coherent).then_some(self)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.points.memory_bytes() + size_of_val(&self.boxes[..]) as u64 + 4 * self.packs.len() as u64
    }
}
