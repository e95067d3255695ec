//! Tables on the device: every table is the points' hashes sorted with their indices; a bucket is found by binary search.

use std::sync::Arc;

use nearfield::gpu::{Access, Bind, Buffer, Commands, Gpu, Pipeline, Workgroups};
use nearfield::parallel::radix_sort::GpuRadixSort;
use nearfield::parallel::reduce::GpuReduce;
use nearfield::parallel::scan::GpuScan;
use nearfield::query::Stage;
use nearfield::{Error, Result};

use super::HashFamily;
use super::reference::check_dimension;
use crate::baselines::kernels::{Sizes, pipeline};
use crate::baselines::points::{Points, Queries};
use crate::baselines::rows::{KnnRows, RangeRows, Timed};
use crate::baselines::{check_k, check_radius, device_stages};

/// Rounds of a probe besides those of its candidates: two rows, a query's coordinates, a binary search.
const OTHER_ROUNDS: usize = 400;
/// Where there is no radius.
const LARGEST: f32 = f32::MAX;

const READ: Access = Access::Read;
const WRITE: Access = Access::ReadWrite;

/// The tables of a hash family over points on the device.
#[derive(Debug)]
pub struct GpuLsh {
    gpu: Gpu,
    family: HashFamily,
    n: usize,
    /// `[n × quads]`.
    points: Buffer<[f32; 4]>,
    directions: Buffer<[f32; 4]>,
    offsets: Buffer<f32>,
    /// `[n × tables]`.
    hashes: Buffer<u32>,
    /// Of each table: sorted hashes and their points.
    tables: Vec<(Buffer<u32>, Buffer<u32>)>,
    build_stages: Vec<Stage>,
}

/// Rows on the device, `[q × k]`: 0xffffffff and the largest f32 where there is no point.
#[derive(Debug)]
pub struct LshRows {
    /// Indices.
    pub ids: Buffer<u32>,
    /// Squared distances.
    pub dist2: Buffer<f32>,
    /// Times of "hash queries" (of other queries) and "probe".
    pub stages: Vec<Stage>,
}

/// Queries on the device.
struct Asking {
    /// Whether the points ask.
    own: bool,
    without_self: bool,
    n: usize,
    positions: Buffer<[f32; 4]>,
    hashes: Buffer<u32>,
}

/// What a probe writes.
#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Nearest { k: usize },
    Counting,
    Listing,
}

impl GpuLsh {
    /// Uploads the points and sorts them into all tables: stages "hash" and "sort".
    ///
    /// # Errors
    /// `LengthMismatch` where the family is for another dimension; `OutOfDeviceMemory`, `KernelRejected`, `DeviceLost`.
    pub fn build(gpu: &Gpu, points: &Points, family: &HashFamily) -> Result<Self> {
        check_dimension(points, family)?;
        let n = points.len();
        let sort = GpuRadixSort::<u32>::new(gpu, n)?;
        let column: Buffer<u32> = gpu.buffer("hashes of a table", n)?;
        let table = || Ok((gpu.buffer("sorted hashes of a table", n)?, gpu.buffer("points of a table", n)?));
        let mut lsh = Self {
            gpu: gpu.clone(),
            family: family.clone(),
            n,
            points: gpu.upload("points", &points.quads())?,
            directions: gpu.upload("directions of projections", &family.direction_quads()?)?,
            offsets: gpu.upload("offsets of projections", family.offsets())?,
            hashes: gpu.buffer("hashes of points", n.saturating_mul(family.tables()))?,
            tables: (0..family.tables()).map(|_| table()).collect::<Result<_>>()?,
            build_stages: Vec::new(),
        };
        let take_column = lsh.pipeline(("lsh::column", "take_column"), &[Access::Uniform, READ, WRITE], &[], 1)?;
        let mut commands = gpu.commands("build hash tables");
        commands.stage("hash");
        lsh.record_hashes(&mut commands, &lsh.points, &lsh.hashes, n)?;
        commands.stage("sort");
        for (number, (keys, ids)) in lsh.tables.iter().enumerate() {
            let parameters = gpu.uniform("parameters of a column", &[n as u32, number as u32, 0, 0])?;
            let bindings = [(&parameters).into(), (&lsh.hashes).into(), (&column).into()];
            commands.dispatch(&take_column, &bindings, Workgroups::Covering(n as u64));
            sort.record_from(&mut commands, &column, None, keys, ids, n, 0..32)?;
        }
        lsh.build_stages = device_stages(&commands.run()?);
        Ok(lsh)
    }

    /// Times of the build.
    pub fn build_stages(&self) -> &[Stage] {
        &self.build_stages
    }

    /// The hash functions.
    pub fn family(&self) -> &HashFamily {
        &self.family
    }

    /// Bytes on the device that the tables take, the points included.
    pub fn memory_bytes(&self) -> u64 {
        let tables: u64 = self.tables.iter().map(|(keys, ids)| keys.bytes() + ids.bytes()).sum();
        tables + self.points.bytes() + self.hashes.bytes() + self.directions.bytes() + self.offsets.bytes()
    }

    /// The k nearest candidates of every query, of those within `radius` where one is given; left on the device.
    ///
    /// # Errors
    /// `InvalidSetting` for k, `LengthMismatch` for queries of another dimension, `OutOfDeviceMemory`, `KernelRejected`,
    /// `DeviceLost`.
    pub fn knn_on_device(&self, queries: Queries<'_>, k: usize, radius: Option<f32>) -> Result<LshRows> {
        check_k(k)?;
        let mut commands = self.gpu.commands("probe hash tables");
        let asking = self.asking(&mut commands, queries)?;
        let places = asking.n.saturating_mul(k);
        let (ids, dist2) = (self.gpu.buffer("row ids", places)?, self.gpu.buffer("row distances", places)?);
        let output = [(&ids).into(), (&dist2).into()];
        self.record_probes(&mut commands, &asking, Mode::Nearest { k }, radius, &output)?;
        let stages = device_stages(&commands.run()?);
        Ok(LshRows { ids, dist2, stages })
    }

    /// As [`GpuLsh::knn_on_device`], read back.
    ///
    /// # Errors
    /// As [`GpuLsh::knn_on_device`].
    pub fn knn(&self, queries: Queries<'_>, k: usize, radius: Option<f32>) -> Result<Timed<KnnRows>> {
        let rows = self.knn_on_device(queries, k, radius)?;
        let answer = KnnRows::of_device(k, self.gpu.read(&rows.ids)?, self.gpu.read(&rows.dist2)?);
        Ok(Timed { answer, stages: rows.stages })
    }

    /// How many candidates of every query lie within the radius; left on the device.
    ///
    /// # Errors
    /// As [`GpuLsh::knn_on_device`].
    pub fn count_within_on_device(&self, queries: Queries<'_>, radius: f32) -> Result<Timed<Buffer<u32>>> {
        let mut commands = self.gpu.commands("probe hash tables");
        let asking = self.asking(&mut commands, queries)?;
        let answer = self.record_counts(&mut commands, &asking, radius)?;
        Ok(Timed { answer, stages: device_stages(&commands.run()?) })
    }

    /// How many candidates of every query lie within the radius.
    ///
    /// # Errors
    /// As [`GpuLsh::knn_on_device`].
    pub fn count_within(&self, queries: Queries<'_>, radius: f32) -> Result<Timed<Vec<u32>>> {
        let Timed { answer, stages } = self.count_within_on_device(queries, radius)?;
        Ok(Timed { answer: self.gpu.read(&answer)?, stages })
    }

    /// The candidates of every query within the radius, by two passes: count, scan, and probe again to fill.
    ///
    /// # Errors
    /// As [`GpuLsh::knn_on_device`]; `TooMany` for 2³² candidates or more.
    pub fn list_within(&self, queries: Queries<'_>, radius: f32) -> Result<Timed<RangeRows>> {
        let gpu = &self.gpu;
        let mut commands = gpu.commands("probe hash tables");
        let asking = self.asking(&mut commands, queries)?;
        let counts = self.record_counts(&mut commands, &asking, radius)?;
        let (offsets, ends) = (gpu.buffer("offsets", asking.n + 1)?, gpu.buffer("ends of rows", asking.n + 1)?);
        let (scan, reduce) = (GpuScan::new(gpu, asking.n)?, GpuReduce::new(gpu)?);
        let total: Buffer<u64> = gpu.buffer("candidates in all", 1)?;
        commands.stage("scan");
        scan.record(&mut commands, &counts, &offsets, asking.n)?;
        reduce.record_sum(&mut commands, &counts, asking.n, &total)?;
        commands.copy(&offsets, &ends);
        let mut stages = device_stages(&commands.run()?);
        let total = gpu.read(&total)?[0];
        if total > u64::from(u32::MAX) {
            let (limit, advice) = (u64::from(u32::MAX), "count, or use a smaller radius");
            return Err(Error::TooMany { what: "candidates", found: total, limit, advice });
        }
        let ids = gpu.buffer("indices", total as usize)?;
        let mut commands = gpu.commands("fill lists");
        let output = [(&ends).into(), (&ids).into()];
        self.record_probes(&mut commands, &asking, Mode::Listing, Some(radius), &output)?;
        stages.extend(device_stages(&commands.run()?));
        let offsets = gpu.read(&offsets)?.into_iter().map(u64::from).collect();
        Ok(Timed { answer: RangeRows { offsets, ids: gpu.read(&ids)? }, stages })
    }

    fn record_counts(&self, commands: &mut Commands, asking: &Asking, radius: f32) -> Result<Buffer<u32>> {
        let counts = self.gpu.buffer("counts", asking.n)?;
        self.record_probes(commands, asking, Mode::Counting, Some(radius), &[(&counts).into()])?;
        Ok(counts)
    }

    /// Other queries are uploaded, and hashed in the stage "hash queries".
    fn asking(&self, commands: &mut Commands, queries: Queries<'_>) -> Result<Asking> {
        let without_self = matches!(queries, Queries::PointsWithoutSelf);
        let Queries::Other(points) = queries else {
            let (positions, hashes) = (self.points.clone(), self.hashes.clone());
            return Ok(Asking { own: true, without_self, n: self.n, positions, hashes });
        };
        check_dimension(points, &self.family)?;
        let n = points.len();
        let positions = self.gpu.upload("queries", &points.quads())?;
        let hashes = self.gpu.buffer("hashes of queries", n.saturating_mul(self.family.tables()))?;
        commands.stage("hash queries");
        self.record_hashes(commands, &positions, &hashes, n)?;
        Ok(Asking { own: false, without_self, n, positions, hashes })
    }

    fn record_hashes(
        &self,
        commands: &mut Commands,
        points: &Buffer<[f32; 4]>,
        hashes: &Buffer<u32>,
        n: usize,
    ) -> Result<()> {
        let bindings = [Access::Uniform, READ, READ, READ, WRITE];
        let compute_hashes = self.pipeline(("lsh::hash", "compute_hashes"), &bindings, &[], 1)?;
        let parameters = [n as u32, 0, 0, self.family.inverse_width().to_bits()];
        let parameters = self.gpu.uniform("parameters of hashes", &parameters)?;
        let bindings =
            [(&parameters).into(), points.into(), (&self.directions).into(), (&self.offsets).into(), hashes.into()];
        commands.dispatch(&compute_hashes, &bindings, Workgroups::Covering(n as u64));
        Ok(())
    }

    /// Probes one table after the other, and long buckets in parts where the device ends long loops.
    fn record_probes(
        &self,
        commands: &mut Commands,
        asking: &Asking,
        mode: Mode,
        radius: Option<f32>,
        output: &[Bind],
    ) -> Result<()> {
        let (counting, listing) = (mode == Mode::Counting, mode == Mode::Listing);
        let features = [("own", asking.own), ("counting", counting), ("listing", listing)];
        let k = if let Mode::Nearest { k } = mode { k } else { 1 };
        let inputs = [Access::Uniform, READ, READ, READ, READ, READ, READ];
        let access = [&inputs[..], &[WRITE; 2][..output.len()]].concat();
        let probe = self.pipeline(("lsh::probe", "probe"), &access, &features, k)?;
        radius.map_or(Ok(()), check_radius)?;
        let radius2 = radius.map_or(LARGEST, |r| r * r);
        let part = self.part(k);
        commands.stage("probe");
        for (table, (keys, ids)) in self.tables.iter().enumerate() {
            // One dispatch of the first table at least makes the rows.
            for begin in (0..self.family.bucket_limit().min(self.n.max(1))).step_by(part) {
                let end = (begin + part).min(self.family.bucket_limit());
                let is_first = u32::from(table == 0 && begin == 0);
                let parameters: [u32; 8] = [
                    self.n as u32,
                    asking.n as u32,
                    table as u32,
                    begin as u32,
                    end as u32,
                    is_first,
                    u32::from(asking.without_self),
                    radius2.to_bits(),
                ];
                let parameters = self.gpu.uniform("parameters of a probe", &parameters)?;
                let (points, point_hashes) = ((&self.points).into(), (&self.hashes).into());
                let (positions, hashes) = ((&asking.positions).into(), (&asking.hashes).into());
                let inputs = [(&parameters).into(), keys.into(), ids.into(), points, point_hashes, positions, hashes];
                let bindings = [&inputs[..], output].concat();
                commands.dispatch(&probe, &bindings, Workgroups::Covering(asking.n as u64));
            }
        }
        Ok(())
    }

    /// Points of a bucket that one dispatch may look at: a candidate takes rounds for its coordinates, for the tables
    /// before, and for its way into a row.
    fn part(&self, k: usize) -> usize {
        let rounds = 10 + self.quads() + self.family.tables() + k;
        let limit = self.gpu.limits().loop_rounds.map(|limit| (limit as usize - OTHER_ROUNDS) / rounds);
        limit.unwrap_or(self.family.bucket_limit()).max(1)
    }

    fn quads(&self) -> usize {
        self.family.dimension().div_ceil(4)
    }

    fn pipeline(
        &self,
        entry: (&str, &str),
        bindings: &[Access],
        features: &[(&str, bool)],
        row: usize,
    ) -> Result<Arc<Pipeline>> {
        let (tables, projections) = (self.family.tables(), self.family.projections());
        pipeline(&self.gpu, entry, bindings, features, Sizes { row, quads: self.quads(), tables, projections })
    }
}
