//! The order of the dispatches that build an octree on the device.
//!
//! Two submissions: keys, sort, gather and leaves; then, once the number of nodes is known, the nodes. Where ten levels
//! of keys do not part the points far enough, the first one runs again with all 21.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::gpu::GpuLinearOctree;
use super::layout::OctreeNode;
use super::region::OctreeLayout;
use super::settings::{NARROW_LEVELS, OctreeSettings};
use crate::curve::{Curve, Domain, MAX_LEVEL};
use crate::geometry::Aabb;
use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::compact::GpuCompact;
use crate::parallel::radix_sort::{GpuRadixSort, SortKey};
use crate::parallel::reduce::{GpuBounds, GpuReduce};
use crate::parallel::scan::GpuScan;
use crate::structure::BuildStage;
use crate::structure::on_gpu::{DevicePoint, device_points};
use crate::{Error, Result};

/// Invocations of a workgroup of the build kernels.
const WORKGROUP: u32 = 256;
const LEAVES: &str = "package::structure::linear_octree::leaves";
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

/// Everything that builds of octrees of one size share: pipelines and scratch memory. Keep it to build again as points
/// move.
#[derive(Debug)]
pub struct OctreeBuilder {
    gpu: Gpu,
    n_points: usize,
    settings: OctreeSettings,
    domain: Domain,
    domain_buffer: Buffer<Domain>,
    scan: GpuScan,
    narrow: Sorter<u32>,
    /// Made when points first ask for it.
    wide: Option<Sorter<u64>>,
    order: Buffer<u32>,
    node_counts: Buffer<u32>,
    first_nodes: Buffer<u32>,
}

/// Kernels and memory for keys of one width.
#[derive(Debug)]
struct Sorter<K: SortKey> {
    /// Levels that count, of those that the keys have.
    levels: u32,
    key_levels: u32,
    unused_bits: u32,
    compute_keys: Arc<Pipeline>,
    gather_points: Arc<Pipeline>,
    count_nodes: Arc<Pipeline>,
    summarize: Arc<Pipeline>,
    emit_nodes: Arc<Pipeline>,
    link_nodes: Arc<Pipeline>,
    sort: GpuRadixSort<K>,
    keys: Buffer<K>,
    sorted_keys: Buffer<K>,
}

/// The points along the curve.
struct SortedPoints {
    points: Buffer<DevicePoint>,
    ids: Buffer<u32>,
}

fn kernel<'a>(
    module: &'a str,
    entry: &'a str,
    features: &'a [(&'a str, bool)],
    bindings: &'a [Access],
    workgroup: u32,
) -> Kernel<'a> {
    const CONSTANTS: &[(&str, f64)] = &[("WORKGROUP", WORKGROUP as f64)];
    Kernel { features, constants: CONSTANTS, ..Kernel::new(module, entry, bindings, workgroup) }
}

impl<K: SortKey> Sorter<K> {
    /// - `levels`: those of the keys that count, of the `key_levels` that they have
    fn new(gpu: &Gpu, n: usize, curve: Curve, levels: u32, key_levels: u32) -> Result<Self> {
        use Access::{Read, ReadWrite, Uniform};
        let features = [("wide", key_levels == MAX_LEVEL), ("hilbert", curve == Curve::Hilbert)];
        let pipeline =
            |module, entry, bindings: &[Access]| gpu.pipeline(&kernel(module, entry, &features, bindings, WORKGROUP));
        Ok(Self {
            levels,
            key_levels,
            unused_bits: 3 * (key_levels - levels),
            compute_keys: pipeline(LEAVES, "compute_keys", &[Uniform, Uniform, Read, ReadWrite, ReadWrite])?,
            gather_points: pipeline(LEAVES, "gather_points", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            count_nodes: pipeline(LEAVES, "count_nodes", &[Uniform, Read, ReadWrite, ReadWrite])?,
            summarize: gpu.pipeline(&kernel(LEAVES, "summarize", &features, &[Uniform, Read, ReadWrite], 1))?,
            emit_nodes: pipeline(NODES, "emit_nodes", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            link_nodes: pipeline(NODES, "link_nodes", &[Uniform, Read, Read, Read, Read, Read, Read, ReadWrite, Read])?,
            sort: GpuRadixSort::new(gpu, n)?,
            keys: gpu.buffer("keys of points", n)?,
            sorted_keys: gpu.buffer("sorted keys", n)?,
        })
    }
}

impl OctreeBuilder {
    /// A builder for `n_points` points; the settings must say the domain.
    ///
    /// # Errors
    /// `InvalidSetting` for a depth limit above 21 and for settings without domain; `TooMany` for more than 2³¹ points,
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, n_points: usize, settings: &OctreeSettings) -> Result<Self> {
        settings.validate()?;
        let domain = settings.domain.ok_or_else(|| Error::InvalidSetting {
            setting: "domain",
            found: "none".to_owned(),
            expected: "the cube that holds points on a device: finding it out would read all of them back",
        })?;
        let scan = GpuScan::new(gpu, n_points)?;
        Ok(Self {
            n_points,
            settings: *settings,
            domain,
            domain_buffer: gpu.uniform("domain", &domain)?,
            scan,
            narrow: Sorter::new(gpu, n_points, settings.curve, settings.few_levels(), NARROW_LEVELS)?,
            wide: None,
            order: gpu.buffer("order of points", n_points)?,
            node_counts: gpu.buffer("nodes that start at points", n_points)?,
            first_nodes: gpu.buffer("first nodes of points", n_points + 1)?,
            gpu: gpu.clone(),
        })
    }

    /// Builds the octree of these points, which may have moved since the last build.
    ///
    /// - `points`: `[n]` xyz, and the index that answers use as bits of w, a permutation of 0 … n − 1; finite coordinates
    ///   within ±1e18. Both are trusted, but for NaN, which counts as outside the domain
    ///
    /// # Errors
    /// `LengthMismatch` for another number of points, `OutsideDomain`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn build(&mut self, points: &Buffer<DevicePoint>) -> Result<GpuLinearOctree> {
        if points.len() != self.n_points {
            let (found, expected) = (points.len() as u64, self.n_points as u64);
            return Err(Error::LengthMismatch { what: "points to build an octree of", found, expected });
        }
        let sorted = SortedPoints {
            points: self.gpu.buffer("points along the curve", self.n_points)?,
            ids: self.gpu.buffer("indices along the curve", self.n_points)?,
        };
        let (summary, mut stages) = self.leaves(&self.narrow, points, &sorted)?;
        if summary.is_overfull == 0 {
            return self.nodes(&self.narrow, sorted, summary, stages);
        }
        if self.wide.is_none() {
            let OctreeSettings { curve, max_level, .. } = self.settings;
            self.wide = Some(Sorter::new(&self.gpu, self.n_points, curve, max_level, MAX_LEVEL)?);
        }
        let wide = self.wide.as_ref().expect("the wide keys' kernels should have been made above");
        let (summary, more) = self.leaves(wide, points, &sorted)?;
        stages.extend(more);
        self.nodes(wide, sorted, summary, stages)
    }

    /// Sorts the points and counts the nodes that start at each.
    fn leaves<K: SortKey>(
        &self,
        sorter: &Sorter<K>,
        points: &Buffer<DevicePoint>,
        sorted: &SortedPoints,
    ) -> Result<(OctreeSummary, Vec<StageTime>)> {
        let n = self.n_points;
        let may_go_deeper = u32::from(sorter.levels < self.settings.max_level);
        let capacity = self.settings.leaf_capacity.min(n as u32);
        let parameters = self.gpu.uniform("leaf parameters", &[n as u32, capacity, sorter.levels, may_go_deeper])?;
        let empty = OctreeSummary { n_nodes: 0, n_outside: 0, first_outside: u32::MAX, is_overfull: 0 };
        let summary = self.gpu.upload("octree summary", &[empty])?;
        let covering = Workgroups::Covering(n as u64);
        let mut commands = self.gpu.commands("octree leaves");
        commands.stage("keys").dispatch(
            &sorter.compute_keys,
            &[
                (&parameters).into(),
                (&self.domain_buffer).into(),
                points.into(),
                (&summary).into(),
                (&sorter.keys).into(),
            ],
            covering.clone(),
        );
        commands.stage("sort");
        let key_bits = sorter.unused_bits..sorter.unused_bits + 3 * sorter.levels;
        sorter.sort.record_from(&mut commands, &sorter.keys, None, &sorter.sorted_keys, &self.order, n, key_bits)?;
        commands.stage("gather").dispatch(
            &sorter.gather_points,
            &[(&parameters).into(), points.into(), (&self.order).into(), (&sorted.points).into(), (&sorted.ids).into()],
            covering.clone(),
        );
        commands.stage("leaves").dispatch(
            &sorter.count_nodes,
            &[(&parameters).into(), (&sorter.sorted_keys).into(), (&self.node_counts).into(), (&summary).into()],
            covering,
        );
        self.scan.record(&mut commands, &self.node_counts, &self.first_nodes, n)?;
        commands.dispatch(
            &sorter.summarize,
            &[(&parameters).into(), (&self.first_nodes).into(), (&summary).into()],
            Workgroups::Count(1),
        );
        let stages = commands.run()?;
        let found = self.gpu.read(&summary)?[0];
        if found.n_outside > 0 {
            let (count, first) = (u64::from(found.n_outside), u64::from(found.first_outside));
            return Err(Error::OutsideDomain { what: "points", count, first });
        }
        Ok((found, stages))
    }

    /// Makes the nodes of the leaves that were counted last.
    fn nodes<K: SortKey>(
        &self,
        sorter: &Sorter<K>,
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
                sorter,
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
            sorted_levels: sorter.levels,
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

    /// The nodes of `tree` once these octants are cut.
    fn cut<K: SortKey>(
        &self,
        sorter: &Sorter<K>,
        tree: &GpuLinearOctree,
        octants: &Buffer<u64>,
    ) -> Result<GpuLinearOctree> {
        use Access::{Read, ReadWrite, Uniform};
        let (gpu, n) = (&self.gpu, self.n_points);
        let features = [("wide", sorter.key_levels == MAX_LEVEL), ("hilbert", self.settings.curve == Curve::Hilbert)];
        let accesses = [Uniform, Read, Read, Read, ReadWrite];
        let module = "package::structure::linear_octree::balance";
        let count_cut_nodes = gpu.pipeline(&kernel(module, "count_cut_nodes", &features, &accesses, WORKGROUP))?;
        let parameters = gpu.uniform("leaf parameters", &[n as u32, 0, sorter.levels, 0])?;
        let cut_parameters = gpu.uniform("cut parameters", &[n as u32, 0, octants.len() as u32, 0])?;
        let summary: Buffer<OctreeSummary> = gpu.buffer("octree summary", 1)?;
        let covering = Workgroups::Covering(n as u64);
        let mut commands = gpu.commands("cut leaves");
        // The points stand in order: so do their keys.
        commands.stage("cut leaves").dispatch(
            &sorter.compute_keys,
            &[
                (&parameters).into(),
                (&self.domain_buffer).into(),
                (&tree.points).into(),
                (&summary).into(),
                (&sorter.sorted_keys).into(),
            ],
            covering.clone(),
        );
        commands.dispatch(
            &count_cut_nodes,
            &[
                (&cut_parameters).into(),
                (&tree.nodes).into(),
                octants.into(),
                (&sorter.sorted_keys).into(),
                (&self.node_counts).into(),
            ],
            covering,
        );
        self.scan.record(&mut commands, &self.node_counts, &self.first_nodes, n)?;
        commands.dispatch(
            &sorter.summarize,
            &[(&parameters).into(), (&self.first_nodes).into(), (&summary).into()],
            Workgroups::Count(1),
        );
        let stages = commands.run()?;
        let sorted = SortedPoints { points: tree.points.clone(), ids: tree.ids.clone() };
        let tree = self.nodes(sorter, sorted, gpu.read(&summary)?[0], stages)?;
        Ok(GpuLinearOctree { is_balanced: true, ..tree })
    }

    fn record_nodes<K: SortKey>(
        &self,
        commands: &mut Commands,
        sorter: &Sorter<K>,
        n_nodes: usize,
        nodes: &Buffer<OctreeNode>,
        [pre_order, in_pre_order, post_order, in_post_order]: [&Buffer<u32>; 4],
        level_starts: &Buffer<u32>,
    ) -> Result<()> {
        use Access::{Read, ReadWrite, Uniform};
        let gpu = &self.gpu;
        let pipeline = |entry, bindings: &[Access]| {
            gpu.pipeline(&kernel(NODES, entry, &[("wide", false), ("hilbert", false)], bindings, WORKGROUP))
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
            &sorter.emit_nodes,
            &[
                (&parameters).into(),
                (&self.first_nodes).into(),
                (&sorter.sorted_keys).into(),
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
            &sorter.link_nodes,
            &[
                (&parameters).into(),
                pre_order.into(),
                (&sorter.sorted_keys).into(),
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

/// As [`super::LinearOctree::balanced`].
pub(super) fn balanced(tree: &GpuLinearOctree) -> Result<GpuLinearOctree> {
    let settings = OctreeSettings { domain: Some(tree.layout.domain), ..tree.settings };
    let builder = OctreeBuilder::new(&tree.gpu, tree.points.len(), &settings)?;
    let octants = tree.octants_to_cut()?;
    if tree.sorted_levels <= NARROW_LEVELS {
        return builder.cut(&builder.narrow, tree, &octants);
    }
    let wide = Sorter::<u64>::new(&tree.gpu, tree.points.len(), settings.curve, settings.max_level, MAX_LEVEL)?;
    builder.cut(&wide, tree, &octants)
}

/// Query points on the device, sorted along the curve of a tree; points outside its domain count to the border.
pub(super) fn sorted_queries(
    gpu: &Gpu,
    queries: &[Vec3],
    domain: &Domain,
    curve: Curve,
) -> Result<Buffer<DevicePoint>> {
    let n = queries.len();
    let input = gpu.upload("queries", &device_points(queries, 0))?;
    let sorter = Sorter::<u32>::new(gpu, n, curve, NARROW_LEVELS, NARROW_LEVELS)?;
    let order = gpu.buffer("order of queries", n)?;
    let sorted = gpu.buffer("sorted queries", n)?;
    let ids: Buffer<u32> = gpu.buffer("indices of sorted queries", n)?;
    let parameters = gpu.uniform("query parameters", &[n as u32, 0, NARROW_LEVELS, 0])?;
    let domain = gpu.uniform("domain", domain)?;
    let summary: Buffer<OctreeSummary> = gpu.buffer("summary of queries", 1)?;
    let covering = Workgroups::Covering(n as u64);
    let mut commands = gpu.commands("sort queries");
    commands.dispatch(
        &sorter.compute_keys,
        &[(&parameters).into(), (&domain).into(), (&input).into(), (&summary).into(), (&sorter.keys).into()],
        covering.clone(),
    );
    let bits = 0..3 * NARROW_LEVELS;
    sorter.sort.record_from(&mut commands, &sorter.keys, None, &sorter.sorted_keys, &order, n, bits)?;
    commands.dispatch(
        &sorter.gather_points,
        &[(&parameters).into(), (&input).into(), (&order).into(), (&sorted).into(), (&ids).into()],
        covering,
    );
    commands.submit()?;
    Ok(sorted)
}
