//! The nearest points on the device: kernels over trees and grids, or the list with a cap where there is none.

use std::time::Instant;

use super::answers::{add_stages, in_batches};
use super::list;
use super::visit::QueryBuffers;
use crate::Result;
use crate::gpu::{Buffer, Commands};
use crate::query::{FixedRadius, Knn, KnnSearch, NearestNeighbors, Report};
use crate::structure::{GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuStructure, GpuUniformGrid};

/// The nearest points of every query, on the device.
#[derive(Debug)]
pub struct GpuNearestNeighbors {
    /// Places of a row: `k`, or the number of points where there are fewer.
    pub places: usize,
    /// `[q × places]` indices into the points as the caller gave them, nearest first, in query order;
    /// [`NearestNeighbors::NONE`] where fewer points are within the radius.
    pub indices: Buffer<u32>,
    /// `[q × places]` squared distances; the largest f32 where there is no point.
    pub dist2: Buffer<f32>,
    /// What ran.
    pub report: Report,
}

/// Rows of so many queries on the device.
pub(super) struct Rows {
    pub(super) ids: Buffer<u32>,
    pub(super) dist2: Buffer<f32>,
}

/// A structure with a kernel that finds the nearest points.
pub(super) trait NearestOnDevice: GpuStructure {
    /// Name of that search.
    const NEAREST: &'static str;
    /// Module of the kernel.
    const KERNEL: &'static str;

    /// Records finding the nearest `places` points of these queries, at least one, into rows. Returns the modules of kernels
    /// that go before.
    fn record_nearest(
        &self,
        commands: &mut Commands,
        within: &FixedRadius<'_>,
        queries: &QueryBuffers,
        places: u32,
        rows: &Rows,
    ) -> Result<&'static [&'static str]>;

    /// Checks that the device does not end the kernel's loops before their work is done.
    fn check_loops(&self, question: &Knn<'_>, places: usize) -> Result<()>;
}

/// The nearest points of every query, read back; and left on the device. (A blanket implementation would overlap with that
/// for brute force.)
macro_rules! nearest_on_gpu {
    ($($structure:ty),*) => {$(
        impl $structure {
            /// The nearest points of every query, left on the device.
            ///
            /// The limit on the bytes of the answer does not matter.
            ///
            /// # Errors
            /// As [`KnnSearch::knn`]; `OutOfDeviceMemory` with the size where the rows do not fit one binding.
            pub fn knn_on_device(&self, question: &Knn<'_>) -> Result<GpuNearestNeighbors> {
                knn_on_device(self, question)
            }
        }

        impl KnnSearch for $structure {
            fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
                knn(self, question)
            }
        }
    )*};
}

nearest_on_gpu!(GpuLinearOctree, GpuAabbTree, GpuUniformGrid);

fn knn_on_device<S: NearestOnDevice>(tree: &S, question: &Knn<'_>) -> Result<GpuNearestNeighbors> {
    let within = question.as_fixed_radius();
    within.validate(tree.len())?;
    let places = question.places(tree.len());
    tree.check_loops(question, places)?;
    let mut report = report(tree);
    let rows = find(tree, &within, &QueryBuffers::unpacked(tree, &within)?, places, &mut report)?;
    Ok(GpuNearestNeighbors { places, indices: rows.ids, dist2: rows.dist2, report })
}

fn knn<S: NearestOnDevice>(tree: &S, question: &Knn<'_>) -> Result<NearestNeighbors> {
    question.validate(tree.len())?;
    let start = Instant::now();
    let (within, places, k) = (question.as_fixed_radius(), question.places(tree.len()), question.k as usize);
    tree.check_loops(question, places)?;
    let n_queries = within.len(tree.len());
    let mut report = report(tree);
    let mut made = NearestNeighbors { k, n_queries, ..NearestNeighbors::default() };
    in_batches(tree, &within, 1, &mut report, |queries, report| {
        let rows = find(tree, &within, queries, places, report)?;
        let read = Instant::now();
        let (ids, dist2) = (tree.gpu().read(&rows.ids)?, tree.gpu().read(&rows.dist2)?);
        let distances = distances(&ids, dist2);
        made.append(ids, distances, queries.len());
        report.host_stage("read back", read);
        Ok(())
    })?;
    report.host_stage("total", start);
    Ok(NearestNeighbors { report, ..made })
}

impl KnnSearch for GpuBruteForce {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        question.validate(self.len())?;
        let list = list::list(self, &question.as_fixed_radius())?;
        Ok(NearestNeighbors::of_list(list, question.k as usize))
    }
}

pub(super) fn report<S: NearestOnDevice>(tree: &S) -> Report {
    Report {
        structure: S::NAME,
        search: S::NEAREST,
        device: tree.gpu().name().to_owned(),
        kernels: vec![S::KERNEL.to_owned()],
        batches: 1,
        ..Report::default()
    }
}

/// Rows of `places` neighbours of these queries; the report gets the times of finding them, and kernels that went before.
pub(super) fn find<S: NearestOnDevice>(
    tree: &S,
    within: &FixedRadius<'_>,
    queries: &QueryBuffers,
    places: usize,
    report: &mut Report,
) -> Result<Rows> {
    let (gpu, n) = (tree.gpu(), queries.len());
    let ids = gpu.buffer("nearest indices", n * places)?;
    let dist2 = gpu.buffer("nearest distances", n * places)?;
    let rows = Rows { ids, dist2 };
    if n * places == 0 {
        return Ok(rows);
    }
    let mut commands = gpu.commands("nearest neighbours");
    commands.stage("query");
    let before = tree.record_nearest(&mut commands, within, queries, places as u32, &rows)?;
    add_stages(report, &commands.run()?);
    if !report.kernels.iter().any(|kernel| before.contains(&kernel.as_str())) {
        report.kernels.splice(0..0, before.iter().map(|&kernel| kernel.to_owned()));
    }
    Ok(rows)
}

/// Distances from their squares, infinite in places without a point.
fn distances(ids: &[u32], dist2: Vec<f32>) -> Vec<f32> {
    let mut distances = list::square_roots(dist2);
    for (distance, _) in distances.iter_mut().zip(ids).filter(|(_, id)| **id == NearestNeighbors::NONE) {
        *distance = f32::INFINITY;
    }
    distances
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
