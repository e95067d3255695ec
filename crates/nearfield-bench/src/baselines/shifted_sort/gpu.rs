//! The search on the device: keys, sort, gather and merge for one shift after the other.

use std::sync::Arc;

use nearfield::curve::{GpuCurve, GpuCurveOrder, Key};
use nearfield::geometry::Aabb;
use nearfield::gpu::{Access, Bind, Buffer, Commands, Gpu, Pipeline, Workgroups};
use nearfield::parallel::radix_sort::{GpuRadixSort, SortKey};
use nearfield::parallel::reduce;
use nearfield::query::Stage;
use nearfield::{Curve, Domain, Error, Result, Vec3};

use super::ShiftedSortSettings;
use super::reference::Asking;
use crate::baselines::kernels::{Sizes, pipeline};
use crate::baselines::rows::{KnnRows, Timed};
use crate::baselines::{Points, device_stages};
use crate::device::device_points;

/// A plan for searches among up to `capacity` points, by keys of 63 bits (`u64`) or their first 30 (`u32`, half the
/// passes of the sort and cells 2048 times as large). Holds its scratch memory and pipelines.
#[derive(Debug)]
pub struct GpuShiftedSort<K: Key + SortKey = u64> {
    gpu: Gpu,
    settings: ShiftedSortSettings,
    capacity: usize,
    curve: GpuCurve,
    sort: GpuRadixSort<K>,
    keys: Buffer<K>,
    sorted_keys: Buffer<K>,
    order: Buffer<u32>,
    sorted_points: Buffer<[f32; 4]>,
    gather: Arc<Pipeline>,
    merge_own: Arc<Pipeline>,
    merge_other: Arc<Pipeline>,
}

/// Rows on the device, `[q × k]`: 0xffffffff and the largest f32 where there is no point.
#[derive(Debug)]
pub struct ShiftedRows {
    /// Indices.
    pub ids: Buffer<u32>,
    /// Squared distances.
    pub dist2: Buffer<f32>,
    /// Times of "keys", "sort", "gather" and "merge" of every shift; other queries are put in order first, by "keys" and "sort".
    pub stages: Vec<Stage>,
}

/// Who asks, on the device.
#[derive(Debug, Clone, Copy)]
pub enum Asks<'a> {
    /// Every point; `without_self` leaves itself out.
    Points {
        /// Leave out the query itself.
        without_self: bool,
    },
    /// Other points: xyz, the fourth value is not used.
    Other(&'a Buffer<[f32; 4]>),
}

/// What the kernels take: see the structs of merge.wesl and gather.wesl.
type Parameters = [u32; 8];

impl<K: Key + SortKey> GpuShiftedSort<K> {
    /// A plan for up to `capacity` points.
    ///
    /// # Errors
    /// `InvalidSetting`, `TooMany`, `OutOfDeviceMemory`, `KernelRejected`.
    pub fn new(gpu: &Gpu, capacity: usize, settings: ShiftedSortSettings) -> Result<Self> {
        settings.validate()?;
        let (read, write, uniform) = (Access::Read, Access::ReadWrite, Access::Uniform);
        let merge = |own: bool| {
            let features = [("own", own), ("wide", K::WIDE), ("hilbert", false)];
            let bindings = [uniform, read, write, write, uniform, read, read, read];
            let bindings = if own { &bindings[..4] } else { &bindings[..] };
            let module = ("shifted_sort::merge", "merge_windows");
            pipeline(gpu, module, bindings, &features, Sizes::of_row(settings.k))
        };
        let module = ("shifted_sort::gather", "gather");
        Ok(Self {
            gpu: gpu.clone(),
            settings,
            capacity,
            curve: GpuCurve::new(gpu, Curve::Morton),
            sort: GpuRadixSort::new(gpu, capacity)?,
            keys: gpu.buffer("keys of points", capacity)?,
            sorted_keys: gpu.buffer("sorted keys of points", capacity)?,
            order: gpu.buffer("order of points", capacity)?,
            sorted_points: gpu.buffer("points along a curve", capacity)?,
            gather: pipeline(gpu, module, &[uniform, read, read, write], &[], Sizes::of_row(settings.k))?,
            merge_own: merge(true)?,
            merge_other: merge(false)?,
        })
    }

    /// Rows of the queries, left on the device; waits for it.
    ///
    /// - `points`: xyz, the fourth value is not used; finite
    /// - `bounds`: a box that holds the points
    ///
    /// # Errors
    /// `TooMany` for more points than the capacity, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn run(&self, points: &Buffer<[f32; 4]>, bounds: &Aabb, asks: Asks<'_>) -> Result<ShiftedRows> {
        let n = points.len();
        if n > self.capacity {
            let (found, limit, advice) = (n as u64, self.capacity as u64, "make the plan for that many");
            return Err(Error::TooMany { what: "points of a shifted sort", found, limit, advice });
        }
        let n_queries = if let Asks::Other(queries) = asks { queries.len() } else { n };
        let places = n_queries.saturating_mul(self.settings.k);
        let (ids, dist2) = (self.gpu.buffer("row ids", places)?, self.gpu.buffer("row distances", places)?);
        let mut commands = self.gpu.commands("shifted sort");
        let query_order = match asks {
            Asks::Points { .. } => None,
            Asks::Other(queries) => Some(self.order_queries(&mut commands, queries, bounds)?),
        };
        for (shift, domain) in self.settings.domains(bounds)?.iter().enumerate() {
            self.sort_points(&mut commands, points, domain)?;
            commands.stage("merge");
            let (window, is_first) = (self.settings.window as u32, u32::from(shift == 0));
            let without_self = matches!(asks, Asks::Points { without_self: true });
            let parameters: Parameters =
                [n as u32, n_queries as u32, window, is_first, u32::from(without_self), 0, 0, 0];
            let parameters = self.gpu.uniform("parameters of a merge", &parameters)?;
            let mut bindings: Vec<Bind> =
                vec![(&parameters).into(), (&self.sorted_points).into(), (&ids).into(), (&dist2).into()];
            let mut merge = &self.merge_own;
            if let (Asks::Other(queries), Some((_, order))) = (asks, &query_order) {
                let domain = self.gpu.uniform("domain of a shift", domain)?;
                bindings.extend([(&domain).into(), (&self.sorted_keys).into(), queries.into(), order.into()]);
                merge = &self.merge_other;
            }
            commands.dispatch(merge, &bindings, Workgroups::Covering(n_queries as u64));
        }
        let stages = device_stages(&commands.run()?);
        Ok(ShiftedRows { ids, dist2, stages })
    }

    /// Rows of the queries from host memory and back; the times are those of the device alone.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, and those of [`GpuShiftedSort::run`].
    pub fn knn(&self, points: &[Vec3], asking: Asking<'_>) -> Result<Timed<KnnRows>> {
        Points::in_space(points)?;
        let on_device = self.gpu.upload("points", &device_points(points))?;
        let bounds = reduce::bounds(points);
        let rows = match asking {
            Asking::Points { without_self } => self.run(&on_device, &bounds, Asks::Points { without_self })?,
            Asking::Other(queries) => {
                Points::in_space(queries)?;
                let queries = self.gpu.upload("queries", &device_points(queries))?;
                self.run(&on_device, &bounds, Asks::Other(&queries))?
            }
        };
        let answer = KnnRows::of_device(self.settings.k, self.gpu.read(&rows.ids)?, self.gpu.read(&rows.dist2)?);
        Ok(Timed { answer, stages: rows.stages })
    }

    /// Queries that stand side by side along the curve look at the same points. The plan must live until the commands
    /// are submitted.
    fn order_queries(
        &self,
        commands: &mut Commands,
        queries: &Buffer<[f32; 4]>,
        bounds: &Aabb,
    ) -> Result<(GpuCurveOrder, Buffer<u32>)> {
        let plan = GpuCurveOrder::new(&self.gpu, Curve::Morton, queries.len())?;
        let order = self.gpu.buffer("order of queries", queries.len())?;
        plan.record(commands, &Domain::of_bounds(bounds), queries, &order, queries.len())?;
        Ok((plan, order))
    }

    /// Keys, their sort, and the points in that order.
    fn sort_points(&self, commands: &mut Commands, points: &Buffer<[f32; 4]>, domain: &Domain) -> Result<()> {
        let n = points.len();
        commands.stage("keys");
        self.curve.record_point_keys(commands, domain, points, &self.keys, n)?;
        commands.stage("sort");
        let bits = if K::WIDE { 0..63 } else { 0..30 };
        self.sort.record_from(commands, &self.keys, None, &self.sorted_keys, &self.order, n, bits)?;
        commands.stage("gather");
        let parameters = self.gpu.uniform("parameters of a gather", &[n as u32, 0, 0, 0])?;
        let bindings = [(&parameters).into(), points.into(), (&self.order).into(), (&self.sorted_points).into()];
        commands.dispatch(&self.gather, &bindings, Workgroups::Covering(n as u64));
        Ok(())
    }
}
