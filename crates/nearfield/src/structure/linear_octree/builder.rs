//! The order of the dispatches that build an octree on the device.
//!
//! Two submissions: keys, sort, gather and leaves; then, once the number of nodes is known, the nodes. Where ten levels
//! of keys do not part the points far enough, the first one runs again with all 21.

use std::sync::Arc;

use glam::Vec3;

use super::gpu::GpuLinearOctree;
use super::linker::{LEAVES, NodeLinker, OctreeSummary, SortedKeys, SortedPoints, WORKGROUP, features, kernel};
use super::settings::{NARROW_LEVELS, OctreeSettings};
use crate::curve::{Curve, Domain, MAX_LEVEL};
use crate::gpu::{Access, Buffer, Commands, Gpu, Pipeline, StageTime, Workgroups};
use crate::parallel::radix_sort::{GpuRadixSort, SortKey};
use crate::structure::on_gpu::{DevicePoint, upload_points};
use crate::{Error, Result};

/// Everything that builds of octrees of one size share: pipelines and scratch memory. Keep it to build again as points
/// move.
#[derive(Debug)]
pub struct OctreeBuilder {
    linker: NodeLinker,
    narrow: Sorter<u32>,
    /// Made when points first ask for it.
    wide: Option<Sorter<u64>>,
    order: Buffer<u32>,
}

/// What brings points in the order of keys of one width.
#[derive(Debug)]
struct Sorter<K: SortKey> {
    sorted: SortedKeys<K>,
    sort: GpuRadixSort<K>,
    keys: Buffer<K>,
    gather_points: Arc<Pipeline>,
    count_nodes: Arc<Pipeline>,
}

impl<K: SortKey> Sorter<K> {
    /// As [`SortedKeys::new`].
    fn new(gpu: &Gpu, n: usize, curve: Curve, levels: u32, key_levels: u32) -> Result<Self> {
        use Access::{Read, ReadWrite, Uniform};
        let features = features(curve, key_levels);
        let pipeline = |entry, bindings: &[Access]| gpu.prepare(&kernel(LEAVES, entry, &features, bindings, WORKGROUP));
        Ok(Self {
            sorted: SortedKeys::new(gpu, n, curve, levels, key_levels)?,
            sort: GpuRadixSort::new(gpu, n)?,
            keys: gpu.buffer("keys of points", n)?,
            gather_points: pipeline("gather_points", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            count_nodes: pipeline("count_nodes", &[Uniform, Read, ReadWrite, ReadWrite])?,
        })
    }

    /// Records the sort of the keys by the levels that count; `order` gets the places of the points before.
    fn record_sort(&self, commands: &mut Commands, order: &Buffer<u32>) -> Result<()> {
        let bits = 3 * (self.sorted.key_levels - self.sorted.levels)..3 * self.sorted.key_levels;
        self.sort.record_from(commands, &self.keys, None, &self.sorted.keys, order, order.len(), bits)
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
        Ok(Self {
            linker: NodeLinker::new(gpu, n_points, settings, domain)?,
            narrow: Sorter::new(gpu, n_points, settings.curve, settings.few_levels(), NARROW_LEVELS)?,
            wide: None,
            order: gpu.buffer("order of points", n_points)?,
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
        let NodeLinker { gpu, n_points, settings, .. } = &self.linker;
        if points.len() != *n_points {
            let (found, expected) = (points.len() as u64, *n_points as u64);
            return Err(Error::LengthMismatch { what: "points to build an octree of", found, expected });
        }
        let sorted = SortedPoints {
            points: gpu.buffer("points along the curve", *n_points)?,
            ids: gpu.buffer("indices along the curve", *n_points)?,
        };
        let (summary, mut stages) = self.leaves(&self.narrow, points, &sorted)?;
        if summary.is_overfull == 0 {
            return self.linker.link(&self.narrow.sorted, sorted, summary, stages);
        }
        if self.wide.is_none() {
            self.wide = Some(Sorter::new(gpu, *n_points, settings.curve, settings.max_level, MAX_LEVEL)?);
        }
        let wide = self.wide.as_ref().expect("the wide keys' kernels should have been made above");
        let (summary, more) = self.leaves(wide, points, &sorted)?;
        stages.extend(more);
        self.linker.link(&wide.sorted, sorted, summary, stages)
    }

    /// Sorts the points and counts the nodes that start at each.
    fn leaves<K: SortKey>(
        &self,
        sorter: &Sorter<K>,
        points: &Buffer<DevicePoint>,
        sorted: &SortedPoints,
    ) -> Result<(OctreeSummary, Vec<StageTime>)> {
        let NodeLinker { gpu, n_points, settings, .. } = &self.linker;
        let (n, levels) = (*n_points as u32, sorter.sorted.levels);
        let may_go_deeper = u32::from(levels < settings.max_level);
        let parameters = gpu.uniform("leaf parameters", &[n, settings.leaf_capacity.min(n), levels, may_go_deeper])?;
        let empty = OctreeSummary { n_nodes: 0, n_outside: 0, first_outside: u32::MAX, is_overfull: 0 };
        let summary = gpu.upload("octree summary", &[empty])?;
        let covering = Workgroups::Covering(n.into());
        let mut commands = gpu.commands("octree leaves");
        commands.stage("keys");
        let shared = [(&parameters).into(), (&self.linker.domain_buffer).into(), (&summary).into()];
        sorter.sorted.record_keys(&mut commands, shared, points, &sorter.keys);
        commands.stage("sort");
        sorter.record_sort(&mut commands, &self.order)?;
        commands.stage("gather").dispatch(
            &sorter.gather_points,
            &[(&parameters).into(), points.into(), (&self.order).into(), (&sorted.points).into(), (&sorted.ids).into()],
            covering.clone(),
        );
        commands.stage("leaves").dispatch(
            &sorter.count_nodes,
            &[(&parameters).into(), (&sorter.sorted.keys).into(), (&self.linker.node_counts).into(), (&summary).into()],
            covering,
        );
        self.linker.record_totals(&mut commands, &sorter.sorted, [(&parameters).into(), (&summary).into()])?;
        let stages = commands.run()?;
        let found = gpu.read(&summary)?[0];
        if found.n_outside > 0 {
            let (count, first) = (u64::from(found.n_outside), u64::from(found.first_outside));
            return Err(Error::OutsideDomain { what: "points", count, first });
        }
        Ok((found, stages))
    }
}

/// Query points on the device, sorted along the curve of a tree; points outside its domain count to the border.
pub(super) fn sorted_queries(
    gpu: &Gpu,
    queries: &[Vec3],
    domain: &Domain,
    curve: Curve,
) -> Result<Buffer<DevicePoint>> {
    let n = queries.len();
    let input = upload_points(gpu, "queries", queries, 0)?;
    let sorter = Sorter::<u32>::new(gpu, n, curve, NARROW_LEVELS, NARROW_LEVELS)?;
    let order = gpu.buffer("order of queries", n)?;
    let sorted = gpu.buffer("sorted queries", n)?;
    let ids: Buffer<u32> = gpu.buffer("indices of sorted queries", n)?;
    let parameters = gpu.uniform("query parameters", &[n as u32, 0, NARROW_LEVELS, 0])?;
    let domain = gpu.uniform("domain", domain)?;
    let summary: Buffer<OctreeSummary> = gpu.buffer("summary of queries", 1)?;
    let mut commands = gpu.commands("sort queries");
    let shared = [(&parameters).into(), (&domain).into(), (&summary).into()];
    sorter.sorted.record_keys(&mut commands, shared, &input, &sorter.keys);
    sorter.record_sort(&mut commands, &order)?;
    commands.dispatch(
        &sorter.gather_points,
        &[(&parameters).into(), (&input).into(), (&order).into(), (&sorted).into(), (&ids).into()],
        Workgroups::Covering(n as u64),
    );
    commands.submit()?;
    Ok(sorted)
}
