//! The linear octree on the GPU.

use std::time::Instant;

use glam::Vec3;

use super::builder::OctreeBuilder;
use super::effort;
use super::layout::OctreeNode;
use super::region::OctreeLayout;
use super::settings::OctreeSettings;
use super::{LinearOctree, build};
use crate::Result;
use crate::curve::{Curve, Domain};
use crate::geometry::{Aabb, OrderedPoints};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::structure::on_gpu::{DevicePoint, Effort, GpuStructure, upload_points};
use crate::structure::{BuildStage, CpuStructure};

/// Points along a curve and the octree over them, on the GPU.
///
/// Nodes, their numbers and the order of the points are those of [`LinearOctree`] to the bit.
#[derive(Debug)]
pub struct GpuLinearOctree {
    pub(super) gpu: Gpu,
    pub(super) settings: OctreeSettings,
    pub(super) layout: OctreeLayout,
    pub(super) layout_buffer: Buffer<OctreeLayout>,
    pub(super) points: Buffer<DevicePoint>,
    pub(super) ids: Buffer<u32>,
    pub(super) sorted_levels: u32,
    pub(super) is_balanced: bool,
    pub(super) nodes: Buffer<OctreeNode>,
    pub(super) level_starts: Vec<u32>,
    pub(super) pre_order_numbers: Buffer<u32>,
    pub(super) pre_order: Buffer<u32>,
    pub(super) post_order_numbers: Buffer<u32>,
    pub(super) post_order: Buffer<u32>,
    pub(super) stages: Vec<BuildStage>,
}

impl GpuLinearOctree {
    /// Copies the points to the device, sorts them along the curve there and cuts the octants.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` (more than 2³¹ points), `OutsideDomain`, `InvalidSetting`,
    /// `OutOfDeviceMemory` (48 bytes a node and 16 bytes a point must each fit one binding), `DeviceLost`.
    pub fn build(gpu: &Gpu, points: &[Vec3], settings: &OctreeSettings) -> Result<Self> {
        settings.validate()?;
        let domain = settings.domain_of(points)?;
        let start = Instant::now();
        let input = upload_points(gpu, "points", points, 0)?;
        let settings = OctreeSettings { domain: Some(domain), ..*settings };
        let mut tree = OctreeBuilder::new(gpu, points.len(), &settings)?.build(&input)?;
        tree.stages.insert(0, BuildStage::on_host("upload", start));
        Ok(tree)
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
    pub fn nodes(&self) -> &Buffer<OctreeNode> {
        &self.nodes
    }

    /// First node of each level, and the number of nodes behind the last.
    pub fn level_starts(&self) -> &[u32] {
        &self.level_starts
    }

    /// `[n_nodes]` number of each node in pre-order.
    pub fn pre_order_numbers(&self) -> &Buffer<u32> {
        &self.pre_order_numbers
    }

    /// `[n_nodes]` the nodes in pre-order.
    pub fn pre_order(&self) -> &Buffer<u32> {
        &self.pre_order
    }

    /// `[n_nodes]` number of each node in post-order.
    pub fn post_order_numbers(&self) -> &Buffer<u32> {
        &self.post_order_numbers
    }

    /// What the kernels know of the tree.
    pub(crate) fn layout(&self) -> &Buffer<OctreeLayout> {
        &self.layout_buffer
    }

    /// The most nodes and candidates that a search of the nearest `places` points looks at, for any of these queries;
    /// `None` for the points themselves; `radius` is that of a query. For devices that end long loops.
    pub(crate) fn most_nearest_steps(
        &self,
        queries: Option<&[Vec3]>,
        places: usize,
        exclude_self: bool,
        radius: impl Fn(usize) -> f32 + Sync,
    ) -> Result<u64> {
        Ok(effort::most_nearest_steps(&self.read()?, queries, places, exclude_self, radius))
    }

    /// The most nodes and points that a search of boxes with these lowest and highest cells looks at for any of them.
    /// For devices that end long loops.
    pub(crate) fn most_box_steps(&self, boxes: &[[[u32; 3]; 2]], writes: bool) -> Result<u64> {
        Ok(effort::most_box_steps(&self.read()?, boxes, writes))
    }

    /// `[n_nodes]` the nodes in post-order: what gathers from the leaves up may take them in this order.
    pub fn post_order(&self) -> &Buffer<u32> {
        &self.post_order
    }

    /// The nodes of a level, along the curve; none below the deepest one.
    pub fn level(&self, level: u32) -> std::ops::Range<usize> {
        super::walk::level_of(&self.level_starts, level)
    }

    /// The same tree on the host: a copy of everything.
    ///
    /// Points that came with indices of the caller's own keep them where they are a permutation of 0 … n − 1.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read(&self) -> Result<LinearOctree> {
        let points: Vec<DevicePoint> = self.gpu.read(&self.points)?;
        let ids: Vec<u32> = self.gpu.read(&self.ids)?;
        let nodes = build::Nodes {
            nodes: self.gpu.read(&self.nodes)?,
            level_starts: self.level_starts.clone(),
            pre_order: self.gpu.read(&self.pre_order_numbers)?,
            post_order: self.gpu.read(&self.post_order_numbers)?,
        };
        let positions: Vec<Vec3> = points.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
        let ordered = OrderedPoints::in_order(&positions, ids);
        let mut tree = LinearOctree::from_parts(self.settings, self.layout, ordered, self.sorted_levels, nodes);
        tree.is_balanced = self.is_balanced;
        Ok(tree)
    }
}

impl GpuStructure for GpuLinearOctree {
    const NAME: &'static str = <LinearOctree as CpuStructure>::NAME;

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

    fn traverse_module(&self) -> &'static str {
        "package::structure::linear_octree::traverse"
    }

    fn most_effort(&self, radius: f32, queries: Option<&Aabb>) -> Result<Effort> {
        let in_step = self.gpu.limits().subgroup.map_or(effort::MOST_IN_STEP, |(_, largest)| largest);
        Ok(effort::most(&self.read()?, radius, queries, in_step))
    }

    fn features(&self) -> Vec<(&'static str, bool)> {
        vec![("periodic", self.settings.period.is_periodic())]
    }

    fn bindings(&self) -> Vec<(Access, Bind)> {
        vec![
            (Access::Uniform, (&self.layout_buffer).into()),
            (Access::Read, (&self.points).into()),
            (Access::Read, (&self.nodes).into()),
        ]
    }

    /// Sorted along the curve, so that neighbouring invocations visit the same leaves.
    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>> {
        super::builder::sorted_queries(&self.gpu, queries, &self.layout.domain, self.settings.curve)
    }

    fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    fn memory_bytes(&self) -> u64 {
        let orders = [&self.pre_order_numbers, &self.pre_order, &self.post_order_numbers, &self.post_order];
        let orders: u64 = orders.iter().map(|order| order.bytes()).sum();
        self.points.bytes() + self.ids.bytes() + self.nodes.bytes() + orders + self.layout_buffer.bytes()
    }
}
