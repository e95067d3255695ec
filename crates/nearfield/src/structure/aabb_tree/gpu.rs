//! The tree of boxes on the GPU.

use std::time::Instant;

use glam::Vec3;

use super::build::BoxN;
use super::builder::{AabbTreeBuilder, sorted_queries};
use super::fitter::Fitter;
use super::layout::AabbNode;
use super::settings::{AabbTreeSettings, BuildOrder, TreeSearch};
use super::shape::TreeShape;
use super::{AabbTree, effort};
use crate::geometry::{Aabb, OrderedPoints, validate};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu};
use crate::structure::on_gpu::{DevicePoint, Effort, GpuStructure, upload_points};
use crate::structure::{BuildStage, CpuStructure};
use crate::{Error, Result};

/// Most points of a node that one workgroup searches for.
const MOST_TOGETHER: u32 = 256;

/// Points in the order of a complete binary tree, and the tree's boxes, on the GPU.
#[derive(Debug)]
pub struct GpuAabbTree {
    pub(super) gpu: Gpu,
    settings: AabbTreeSettings,
    pub(super) shape: TreeShape,
    pub(super) points: Buffer<DevicePoint>,
    pub(super) ids: Buffer<u32>,
    pub(super) nodes: Buffer<AabbNode>,
    pub(super) fitter: Fitter,
    pub(super) stages: Vec<BuildStage>,
}

impl GpuAabbTree {
    /// Copies the points to the device and builds the tree: along the Hilbert curve there, by median splits on the CPU.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (more than 2³¹ points), `InvalidSetting`, `OutOfDeviceMemory` (16 bytes
    /// a point and 32 a node must each fit one binding), `Unsupported` (leaves too large for a device that ends long loops),
    /// `DeviceLost`.
    pub fn build(gpu: &Gpu, points: &[Vec3], settings: &AabbTreeSettings) -> Result<Self> {
        settings.validate()?;
        validate::points(points)?;
        if settings.order == BuildOrder::Median {
            return Self::upload(gpu, &AabbTree::build(points, settings)?);
        }
        let start = Instant::now();
        let input = upload_points(gpu, "points", points, 0)?;
        let mut tree = AabbTreeBuilder::new(gpu, points.len(), settings)?.build(&input)?;
        tree.stages.insert(0, BuildStage::on_host("upload", start));
        Ok(tree)
    }

    /// A copy on the device of a tree on the host.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `Unsupported`, `DeviceLost`, as [`GpuAabbTree::build`].
    pub fn upload(gpu: &Gpu, tree: &AabbTree) -> Result<Self> {
        let start = Instant::now();
        let (shape, points) = (tree.shape(), tree.ordered_points());
        let point = |place: usize| {
            let position = points.position(place);
            [position.x, position.y, position.z, f32::from_bits(points.id(place))]
        };
        let in_order: Vec<DevicePoint> = (0..points.len()).map(point).collect();
        let nodes: Vec<AabbNode> =
            tree.boxes().iter().enumerate().map(|(i, aabb)| AabbNode::new(&shape, i, aabb)).collect();
        let in_order = gpu.upload("points of a tree", &in_order)?;
        let ids = gpu.upload("indices of a tree", points.ids())?;
        let nodes = gpu.upload("nodes of a tree", &nodes)?;
        let fitter = Fitter::new(gpu, shape, tree.settings().period)?;
        let mut stages = CpuStructure::build_stages(tree).to_vec();
        stages.push(BuildStage::on_host("upload", start));
        Ok(Self::from_parts(gpu, *tree.settings(), shape, in_order, ids, nodes, fitter, stages))
    }

    #[allow(clippy::too_many_arguments, reason = "the fields, once")]
    pub(super) fn from_parts(
        gpu: &Gpu,
        settings: AabbTreeSettings,
        shape: TreeShape,
        points: Buffer<DevicePoint>,
        ids: Buffer<u32>,
        nodes: Buffer<AabbNode>,
        fitter: Fitter,
        stages: Vec<BuildStage>,
    ) -> Self {
        Self { gpu: gpu.clone(), settings, shape, points, ids, nodes, fitter, stages }
    }

    /// Moves the points and fits the boxes to them; the shape of the tree and the order of the points stay. Returns the
    /// times of its stages on the device.
    ///
    /// - `moved`: `[n]` new xyz in the caller's order, the fourth value is not used
    ///
    /// # Errors
    /// `LengthMismatch`, `NonFinite`, `CoordinateTooLarge`: the tree is then as it was. `OutOfDeviceMemory`, `DeviceLost`.
    pub fn refit(&mut self, moved: &Buffer<DevicePoint>) -> Result<Vec<BuildStage>> {
        self.refit_and(moved, |_, _| Ok(()))
    }

    /// As [`GpuAabbTree::refit`], with more recorded behind the fit, which sees the nodes; where points are refused it runs
    /// on those as they were.
    pub(in crate::structure) fn refit_and(
        &mut self,
        moved: &Buffer<DevicePoint>,
        record_more: impl FnOnce(&mut Commands, &Buffer<AabbNode>) -> Result<()>,
    ) -> Result<Vec<BuildStage>> {
        self.check_moved(moved)?;
        let mut commands = self.gpu.commands("refit");
        self.fitter.record_move(&self.gpu, &mut commands, moved, &self.ids, &self.points)?;
        commands.stage("fit");
        self.fitter.record(&mut commands, &self.points, &self.nodes);
        record_more(&mut commands, &self.nodes)?;
        let stages = commands.run()?.iter().filter_map(BuildStage::on_device).collect();
        self.fitter.check(&self.gpu, moved)?;
        Ok(stages)
    }

    /// Checks that there is one new position a point.
    ///
    /// # Errors
    /// `LengthMismatch`.
    pub(in crate::structure) fn check_moved(&self, moved: &Buffer<DevicePoint>) -> Result<()> {
        if moved.len() == self.shape.n_points() {
            return Ok(());
        }
        let (found, expected) = (moved.len() as u64, self.shape.n_points() as u64);
        Err(Error::LengthMismatch { what: "new positions of the points", found, expected })
    }

    /// Records fitting the boxes to the points of [`GpuStructure::points`], which a kernel of the caller has moved in
    /// place: xyz, finite and within ±1e18, which is trusted; the index in w must stay.
    pub fn record_fit(&self, commands: &mut Commands) {
        self.fitter.record(commands, &self.points, &self.nodes);
    }

    /// The settings, with the search as it was set last.
    pub fn settings(&self) -> &AabbTreeSettings {
        &self.settings
    }

    /// The shape of the tree.
    pub fn shape(&self) -> TreeShape {
        self.shape
    }

    /// `[n_nodes]` the nodes in breadth-first order.
    pub fn nodes(&self) -> &Buffer<AabbNode> {
        &self.nodes
    }

    /// Chooses how fixed-radius questions are answered; the tree stays.
    pub fn set_search(&mut self, search: TreeSearch) {
        self.settings.search = search;
    }

    /// The same tree on the host: a copy of everything.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read(&self) -> Result<AabbTree> {
        let points: Vec<DevicePoint> = self.gpu.read(&self.points)?;
        let positions: Vec<Vec3> = points.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
        let ordered = OrderedPoints::in_order(&positions, self.gpu.read(&self.ids)?);
        let boxes = self.gpu.read(&self.nodes)?.iter().map(AabbNode::aabb).collect();
        Ok(AabbTree::from_parts(self.settings, self.shape, ordered, boxes))
    }

    /// Bounds of all points.
    fn bounds(&self) -> Result<Aabb> {
        if self.shape.n_points() == 0 {
            return Ok(Aabb::EMPTY);
        }
        let root: AabbNode = self.gpu.read_range(&self.nodes, 0..1)?[0];
        Ok(BoxN::to_aabb(&root.aabb()))
    }

    /// How many invocations, each on a way of its own to its nearest points, share the loop rounds of a device that limits
    /// them; 1 where they go together, which bounds what each does by the size of the tree.
    pub(crate) fn rounds_in_step(&self) -> u64 {
        let limits = self.gpu.limits();
        match limits.subgroup {
            Some(_) if limits.loop_rounds.is_some() => 1,
            Some((_, largest)) => u64::from(largest),
            None => u64::from(effort::MOST_IN_STEP),
        }
    }

    /// Whether invocations of a subgroup go through the tree together.
    fn is_packed(&self) -> bool {
        self.settings.search == TreeSearch::Packed && self.gpu.limits().subgroup.is_some()
    }

    /// Whether invocations may leave their pack. On devices that end long loops only where that surely takes no more
    /// rounds than there are, with one for each point: else every point would have to be tested instead.
    fn splits_packs(&self) -> bool {
        let fits = |limit: u32| {
            let most = effort::most_packed(&self.shape, self.len(), true);
            most.candidates + most.rounds <= u64::from(limit)
        };
        self.is_packed() && self.gpu.limits().loop_rounds.is_none_or(fits)
    }
}

impl GpuStructure for GpuAabbTree {
    const NAME: &'static str = <AabbTree as CpuStructure>::NAME;

    fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    fn points(&self) -> &Buffer<DevicePoint> {
        &self.points
    }

    fn ids(&self) -> Option<&Buffer<u32>> {
        Some(&self.ids)
    }

    /// Points in median order jump where a large node ends: a subgroup must not take points from both sides.
    fn query_parts(&self) -> Option<u32> {
        let n = self.shape.n_points() as u32;
        let level = TreeShape::new(n, MOST_TOGETHER.min(self.gpu.limits().workgroup_invocations)).depth();
        let is_cut = self.settings.order == BuildOrder::Median && self.is_packed() && level <= self.shape.depth();
        is_cut.then_some(level)
    }

    fn counts_by_masks(&self) -> bool {
        true
    }

    /// A ball meets more leaves than it meets rows of a grid; with more, the masks of 10 M points would not fit a binding.
    fn mask_words(&self) -> u32 {
        24
    }

    fn shares_queries(&self) -> bool {
        true
    }

    fn traverse_module(&self) -> &'static str {
        "package::structure::aabb_tree::traverse"
    }

    fn most_effort(&self, radius: f32, queries: Option<&Aabb>) -> Result<Effort> {
        if self.is_packed() {
            return Ok(effort::most_packed(&self.shape, self.len(), self.splits_packs()));
        }
        let in_step = self.gpu.limits().subgroup.map_or(effort::MOST_IN_STEP, |(_, largest)| largest);
        let tree = self.read()?;
        if self.settings.search == TreeSearch::Coherent {
            return Ok(effort::most_candidates(&tree, radius, queries));
        }
        Ok(effort::most(&tree, radius, queries, in_step))
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        let periodic = self.settings.period.is_periodic();
        vec![("periodic", periodic), ("packed", self.is_packed()), ("splits", self.splits_packs())]
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![
            (Access::Uniform, (&self.fitter.layout).into()),
            (Access::Read, (&self.points).into()),
            (Access::Read, (&self.nodes).into()),
        ]
    }

    /// Sorted along the Hilbert curve, so that neighbouring invocations visit the same leaves.
    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>> {
        sorted_queries(&self.gpu, queries, &self.bounds()?, &self.fitter)
    }

    fn coherent_tree(&self) -> Option<&GpuAabbTree> {
        (self.settings.search == TreeSearch::Coherent).then_some(self)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        self.points.bytes() + self.ids.bytes() + self.nodes.bytes() + self.fitter.layout.bytes()
    }
}
