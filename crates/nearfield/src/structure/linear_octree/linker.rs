//! From sorted keys to linked nodes on the device: what a build and a balance share. `nodes.wesl` holds the kernels.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::gpu::GpuLinearOctree;
use super::layout::OctreeNode;
use super::region::OctreeLayout;
use super::settings::OctreeSettings;
use crate::Result;
use crate::curve::{Curve, Domain, MAX_LEVEL};
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Commands, DeviceElement, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::compact::GpuCompact;
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::reduce::{GpuBounds, GpuReduce};
use crate::parallel::scan::GpuScan;
use crate::structure::BuildStage;
use crate::structure::on_gpu::DevicePoint;

/// Invocations of a workgroup of the build kernels.
pub(super) const WORKGROUP: u32 = 256;
pub(super) const LEAVES: &str = "package::structure::linear_octree::leaves";
const NODES: &str = "package::structure::linear_octree::nodes";
/// Bits of a level.
const LEVEL_BITS: u32 = 5;

/// `Summary` in leaves.wesl, byte for byte.
#[doc(hidden)]
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct OctreeSummary {
    /// Number of nodes.
    pub n_nodes: u32,
    /// Points outside the domain.
    pub n_outside: u32,
    /// The first place of one.
    pub first_outside: u32,
    /// 1 where the keys end before the leaves do.
    pub is_overfull: u32,
}

/// Keys of points in order, and the kernels for keys of that width.
#[derive(Debug)]
pub(super) struct SortedKeys<K> {
    /// Levels that count, of those that the keys have.
    pub(super) levels: u32,
    pub(super) key_levels: u32,
    pub(super) keys: Buffer<K>,
    compute_keys: Arc<Pipeline>,
    summarize: Arc<Pipeline>,
    emit_nodes: Arc<Pipeline>,
    link_nodes: Arc<Pipeline>,
}

/// The points along the curve.
#[derive(Debug, Clone)]
pub(super) struct SortedPoints {
    pub(super) points: Buffer<DevicePoint>,
    pub(super) ids: Buffer<u32>,
}

pub(super) fn kernel<'a>(
    module: &'a str,
    entry: &'a str,
    features: &'a [(&'a str, bool)],
    bindings: &'a [Access],
    workgroup: u32,
) -> Kernel<'a> {
    const CONSTANTS: &[(&str, f64)] = &[("WORKGROUP", WORKGROUP as f64)];
    Kernel { features, constants: CONSTANTS, ..Kernel::new(module, entry, bindings, workgroup) }
}

/// Conditions of the kernels for keys of so many levels.
pub(super) fn features(curve: Curve, key_levels: u32) -> [(&'static str, bool); 2] {
    [("wide", key_levels == MAX_LEVEL), ("hilbert", curve == Curve::Hilbert)]
}

impl<K: DeviceElement> SortedKeys<K> {
    /// - `levels`: those of the keys that count, of the `key_levels` that they have
    pub(super) fn new(gpu: &Gpu, n: usize, curve: Curve, levels: u32, key_levels: u32) -> Result<Self> {
        use Access::{Read, ReadWrite, Uniform};
        let features = features(curve, key_levels);
        let pipeline =
            |module, entry, bindings: &[Access]| gpu.prepare(&kernel(module, entry, &features, bindings, WORKGROUP));
        Ok(Self {
            levels,
            key_levels,
            keys: gpu.buffer("sorted keys", n)?,
            compute_keys: pipeline(LEAVES, "compute_keys", &[Uniform, Uniform, Read, ReadWrite, ReadWrite])?,
            summarize: gpu.prepare(&kernel(LEAVES, "summarize", &features, &[Uniform, Read, ReadWrite], 1))?,
            emit_nodes: pipeline(NODES, "emit_nodes", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            link_nodes: pipeline(NODES, "link_nodes", &[Uniform, Read, Read, Read, Read, Read, Read, ReadWrite, Read])?,
        })
    }

    /// Records the keys of points into `keys`.
    pub(super) fn record_keys(
        &self,
        commands: &mut Commands,
        [parameters, domain, summary]: [Bind; 3],
        points: &Buffer<DevicePoint>,
        keys: &Buffer<K>,
    ) {
        let bindings = [parameters, domain, points.into(), summary, keys.into()];
        commands.dispatch(&self.compute_keys, &bindings, Workgroups::Covering(points.len() as u64));
    }
}

/// What makes nodes of points in order, once it is known how many nodes start at each.
#[derive(Debug)]
pub(super) struct NodeLinker {
    pub(super) gpu: Gpu,
    pub(super) n_points: usize,
    pub(super) settings: OctreeSettings,
    pub(super) domain: Domain,
    pub(super) domain_buffer: Buffer<Domain>,
    /// `[n]` nodes that start at each point.
    pub(super) node_counts: Buffer<u32>,
    first_nodes: Buffer<u32>,
    scan: GpuScan,
}

impl NodeLinker {
    pub(super) fn new(gpu: &Gpu, n_points: usize, settings: &OctreeSettings, domain: Domain) -> Result<Self> {
        Ok(Self {
            gpu: gpu.clone(),
            n_points,
            settings: *settings,
            domain,
            domain_buffer: gpu.uniform("domain", &domain)?,
            node_counts: gpu.buffer("nodes that start at points", n_points)?,
            first_nodes: gpu.buffer("first nodes of points", n_points + 1)?,
            scan: GpuScan::new(gpu, n_points)?,
        })
    }

    /// Records the numbers of the first nodes of points, and that of all nodes into the summary.
    pub(super) fn record_totals<K>(
        &self,
        commands: &mut Commands,
        sorted_keys: &SortedKeys<K>,
        [parameters, summary]: [Bind; 2],
    ) -> Result<()> {
        self.scan.record(commands, &self.node_counts, &self.first_nodes, self.n_points)?;
        let bindings = [parameters, (&self.first_nodes).into(), summary];
        commands.dispatch(&sorted_keys.summarize, &bindings, Workgroups::Count(1));
        Ok(())
    }

    /// Makes the nodes of the leaves that were counted last.
    pub(super) fn link<K: DeviceElement>(
        &self,
        sorted_keys: &SortedKeys<K>,
        sorted: SortedPoints,
        summary: OctreeSummary,
        mut stages: Vec<StageTime>,
    ) -> Result<GpuLinearOctree> {
        let (gpu, n_nodes) = (&self.gpu, summary.n_nodes as usize);
        let nodes: Buffer<OctreeNode> = gpu.buffer("octree nodes", n_nodes)?;
        let pre_order = gpu.buffer("pre-order of nodes", n_nodes)?;
        let in_pre_order = gpu.buffer("nodes in pre-order", n_nodes)?;
        let post_order = gpu.buffer("post-order of nodes", n_nodes)?;
        let in_post_order = gpu.buffer("nodes in post-order", n_nodes)?;
        let level_starts = gpu.upload("first nodes of levels", &[summary.n_nodes; MAX_LEVEL as usize + 2])?;
        let bounds: Option<Buffer<GpuBounds>> =
            self.settings.period.is_periodic().then(|| gpu.buffer("bounds of points", 1)).transpose()?;
        if n_nodes > 0 {
            let mut commands = gpu.commands("octree nodes");
            self.record_nodes(
                &mut commands,
                sorted_keys,
                n_nodes,
                &nodes,
                [&pre_order, &in_pre_order, &post_order, &in_post_order],
                &level_starts,
            )?;
            if let Some(bounds) = &bounds {
                GpuReduce::new(gpu)?.record_bounds(&mut commands, &sorted.points, self.n_points, bounds)?;
            }
            stages.extend(commands.run()?);
        }
        let bounds = match bounds.filter(|_| n_nodes > 0) {
            Some(bounds) => {
                let GpuBounds { min, max, .. } = gpu.read(&bounds)?[0];
                Aabb::new(Vec3::new(min[0], min[1], min[2]), Vec3::new(max[0], max[1], max[2]))
            }
            None => Aabb::EMPTY,
        };
        let mut starts = gpu.read(&level_starts)?;
        starts.dedup();
        let layout = OctreeLayout::new(self.domain, self.settings.period, &bounds, [self.n_points, n_nodes]);
        Ok(GpuLinearOctree {
            layout_buffer: gpu.uniform("octree layout", &layout)?,
            gpu: gpu.clone(),
            settings: self.settings,
            layout,
            points: sorted.points,
            ids: sorted.ids,
            sorted_levels: sorted_keys.levels,
            is_balanced: false,
            nodes,
            level_starts: starts,
            pre_order_numbers: pre_order,
            pre_order: in_pre_order,
            post_order_numbers: post_order,
            post_order: in_post_order,
            stages: stages.iter().filter_map(BuildStage::on_device).collect(),
        })
    }

    fn record_nodes<K: DeviceElement>(
        &self,
        commands: &mut Commands,
        sorted_keys: &SortedKeys<K>,
        n_nodes: usize,
        nodes: &Buffer<OctreeNode>,
        [pre_order, in_pre_order, post_order, in_post_order]: [&Buffer<u32>; 4],
        level_starts: &Buffer<u32>,
    ) -> Result<()> {
        use Access::{Read, ReadWrite, Uniform};
        let gpu = &self.gpu;
        let pipeline = |entry, bindings: &[Access]| {
            gpu.prepare(&kernel(NODES, entry, &[("wide", false), ("hilbert", false)], bindings, WORKGROUP))
        };
        let number_nodes =
            pipeline("number_nodes", &[Uniform, Read, Read, Read, ReadWrite, ReadWrite, ReadWrite, ReadWrite])?;
        let close_nodes = pipeline("close_nodes", &[Uniform, Read, Read, Read, ReadWrite, ReadWrite, ReadWrite])?;
        let levels: Buffer<u32> = gpu.buffer("levels in pre-order", n_nodes)?;
        let sorted_levels: Buffer<u32> = gpu.buffer("levels of nodes", n_nodes)?;
        let start_points: Buffer<u32> = gpu.buffer("first points in pre-order", n_nodes)?;
        let first_children: Buffer<u32> = gpu.buffer("whether nodes are first children", n_nodes)?;
        let inner: Buffer<u32> = gpu.buffer("whether nodes have children", n_nodes)?;
        let ranks: Buffer<u32> = gpu.buffer("first children before nodes", n_nodes + 1)?;
        let inner_nodes: Buffer<u32> = gpu.buffer("nodes with children", n_nodes)?;
        let n_inner: Buffer<u32> = gpu.buffer("number of nodes with children", 1)?;
        let sort = GpuRadixSort::<u32>::new(gpu, n_nodes)?;
        let parameters = gpu.uniform("node parameters", &[self.n_points as u32, n_nodes as u32, 0, 0])?;
        let covering = Workgroups::Covering(n_nodes as u64);

        commands.stage("order").dispatch(
            &sorted_keys.emit_nodes,
            &[
                (&parameters).into(),
                (&self.first_nodes).into(),
                (&sorted_keys.keys).into(),
                (&levels).into(),
                (&start_points).into(),
            ],
            Workgroups::Covering(self.n_points as u64),
        );
        sort.record_from(commands, &levels, None, &sorted_levels, pre_order, n_nodes, 0..LEVEL_BITS)?;
        commands.dispatch(
            &number_nodes,
            &[
                (&parameters).into(),
                (&sorted_levels).into(),
                pre_order.into(),
                (&start_points).into(),
                in_pre_order.into(),
                (&first_children).into(),
                (&inner).into(),
                level_starts.into(),
            ],
            covering.clone(),
        );
        commands.stage("link");
        GpuScan::new(gpu, n_nodes)?.record(commands, &first_children, &ranks, n_nodes)?;
        GpuCompact::new(gpu, n_nodes)?.record(commands, &inner, &inner_nodes, &n_inner, n_nodes)?;
        commands.dispatch(
            &sorted_keys.link_nodes,
            &[
                (&parameters).into(),
                pre_order.into(),
                (&sorted_keys.keys).into(),
                (&start_points).into(),
                in_pre_order.into(),
                (&ranks).into(),
                (&inner_nodes).into(),
                nodes.into(),
                (&sorted_levels).into(),
            ],
            covering.clone(),
        );
        commands.stage("post-order").dispatch(
            &close_nodes,
            &[
                (&parameters).into(),
                pre_order.into(),
                (&start_points).into(),
                in_pre_order.into(),
                nodes.into(),
                post_order.into(),
                in_post_order.into(),
            ],
            covering,
        );
        Ok(())
    }
}
