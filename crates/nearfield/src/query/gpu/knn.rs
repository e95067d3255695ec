//! The nearest points on the device: one kernel over a tree, or the list with a cap where there is none.

use std::time::Instant;

use super::answers::{add_stages, in_batches};
use super::visit::QueryBuffers;
use super::{list, loops};
use crate::gpu::{Access, Bind, Buffer, Kernel, StageTime, Workgroups};
use crate::query::{FixedRadius, Knn, KnnSearch, NearestNeighbors, Queries, Report};
use crate::structure::{GpuBruteForce, GpuLinearOctree, GpuStructure};
use crate::{Error, Result};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;

/// The nearest points of every query, on the device.
#[derive(Debug)]
pub struct GpuNearestNeighbors {
    /// Places of a row: `k`, or the number of points where there are fewer.
    pub places: usize,
    /// `[q × places]` indices into the points as the caller gave them, nearest first, in query order.
    pub indices: Buffer<u32>,
    /// `[q × places]` squared distances.
    pub dist2: Buffer<f32>,
    /// What ran.
    pub report: Report,
}

/// Rows of so many queries on the device.
struct Rows {
    ids: Buffer<u32>,
    dist2: Buffer<f32>,
    times: Vec<StageTime>,
}

impl GpuLinearOctree {
    /// The nearest points of every query, left on the device.
    ///
    /// The limit on the bytes of the answer does not matter.
    ///
    /// # Errors
    /// As [`KnnSearch::knn`]; `OutOfDeviceMemory` with the size where the rows do not fit one binding.
    pub fn knn_on_device(&self, question: &Knn<'_>) -> Result<GpuNearestNeighbors> {
        let within = question.within_everywhere();
        within.validate(self.len())?;
        let places = question.places(self.len());
        check_loops(self, question, places)?;
        let mut report = report(self);
        let rows = find(self, &within, &QueryBuffers::unpacked(self, &within)?, places)?;
        add_stages(&mut report, &rows.times);
        Ok(GpuNearestNeighbors { places, indices: rows.ids, dist2: rows.dist2, report })
    }
}

impl KnnSearch for GpuLinearOctree {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        question.validate(self.len())?;
        let start = Instant::now();
        let (within, places, k) = (question.within_everywhere(), question.places(self.len()), question.k as usize);
        check_loops(self, question, places)?;
        let n_queries = within.len(self.len());
        let mut report = report(self);
        let mut made = NearestNeighbors { k, n_queries, ..NearestNeighbors::default() };
        in_batches(self, &within, 1, &mut report, |queries, report| {
            let rows = find(self, &within, queries, places)?;
            add_stages(report, &rows.times);
            let read = Instant::now();
            let (ids, dist2) = (self.gpu().read(&rows.ids)?, self.gpu().read(&rows.dist2)?);
            made.append(ids, list::square_roots(dist2), queries.len());
            report.host_stage("read back", read);
            Ok(())
        })?;
        report.host_stage("total", start);
        Ok(NearestNeighbors { report, ..made })
    }
}

impl KnnSearch for GpuBruteForce {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        question.validate(self.len())?;
        let list = list::list(self, &question.within_everywhere())?;
        Ok(NearestNeighbors::of_list(list, question.k as usize))
    }
}

fn report(tree: &GpuLinearOctree) -> Report {
    Report {
        structure: <GpuLinearOctree as GpuStructure>::NAME,
        search: "nearest-octants",
        device: tree.gpu().name().to_owned(),
        kernels: vec!["package::query::knn".to_owned()],
        batches: 1,
        ..Report::default()
    }
}

/// Rows of `places` neighbours of these queries.
fn find(tree: &GpuLinearOctree, within: &FixedRadius<'_>, queries: &QueryBuffers, places: usize) -> Result<Rows> {
    use Access::{Read, ReadWrite, Uniform};
    let (gpu, n) = (tree.gpu(), queries.len());
    let ids = gpu.buffer("nearest indices", n * places)?;
    let dist2 = gpu.buffer("nearest distances", n * places)?;
    let mut times = Vec::new();
    if n * places > 0 {
        let parameters = [n as u32, queries.first_id(), u32::from(within.exclude_self), places as u32];
        let parameters = gpu.uniform("nearest parameters", &parameters)?;
        let mut features = tree.features();
        features.push(("by_index", false));
        let kernel = Kernel {
            visitor_bindings: &[ReadWrite, ReadWrite],
            features: &features,
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new("package::query::knn", "find_nearest", &[Uniform, Read, Uniform, Read, Read], WORKGROUP)
        };
        let binds: [Bind; 5] = [
            (&parameters).into(),
            queries.points().into(),
            tree.layout().into(),
            tree.points().into(),
            tree.nodes().into(),
        ];
        let mut commands = gpu.commands("nearest neighbours");
        let rows: [Bind; 2] = [(&ids).into(), (&dist2).into()];
        let covering = Workgroups::Covering(n as u64);
        commands.stage("query").dispatch_with_visitor(&gpu.pipeline(&kernel)?, &binds, &rows, covering);
        times = commands.run()?;
    }
    Ok(Rows { ids, dist2, times })
}

/// Checks that the device does not end the kernel's loops before their work is done.
fn check_loops(tree: &GpuLinearOctree, question: &Knn<'_>, places: usize) -> Result<()> {
    let Some(limit) = tree.gpu().limits().loop_rounds else { return Ok(()) };
    if places == 0 {
        return Ok(());
    }
    let queries = match question.queries {
        Queries::Points => None,
        Queries::Other(queries) => Some(queries),
    };
    let steps = tree.most_nearest_steps(queries, places, question.exclude_self)?;
    if loops::of_knn(steps, places as u32) <= u64::from(limit) {
        return Ok(());
    }
    let (n, gpu) = (tree.len(), tree.gpu().name());
    Err(Error::Unsupported {
        what: format!(
            "finding the nearest {places} of {n} points on {gpu}, which ends the loops of a kernel after {limit} rounds,"
        ),
        advice: "use the CPU, fewer neighbours or fewer points",
    })
}

impl NearestNeighbors {
    /// Appends rows of equal length, filled up to `k`.
    fn append(&mut self, ids: Vec<u32>, distances: Vec<f32>, n_rows: usize) {
        let places = ids.len() / n_rows.max(1);
        if places == self.k && self.indices.is_empty() {
            (self.indices, self.distances) = (ids, distances);
            return;
        }
        for row in (0..n_rows).map(|i| i * places..(i + 1) * places) {
            let end = self.indices.len() + self.k;
            self.indices.extend_from_slice(&ids[row.clone()]);
            self.distances.extend_from_slice(&distances[row]);
            self.indices.resize(end, Self::NONE);
            self.distances.resize(end, f32::INFINITY);
        }
    }
}
