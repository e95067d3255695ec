//! The nearest points on the CPU: queries in packs along the curve, spans near them from the tree, SIMD over each span.

use std::time::Instant;

use rayon::prelude::*;

use super::{Knn, KnnSearch, NearestNeighbors};
use crate::Result;
use crate::geometry::row_simd::{self, Ball, Hits, Simd};
use crate::query::{NeighborSearch, Neighbors, cpu, rows};
use crate::structure::{BruteForce, CpuStructure, LinearOctree};

/// The best so far of one query.
#[derive(Debug, Default)]
struct Best {
    k: usize,
    /// Squared distance and index, in this order of significance: squared distances are not negative, so their bits
    /// order like numbers, and ties fall to the lower index.
    keys: Vec<u64>,
    /// Number of keys at which all but the best are dropped.
    most: usize,
    /// Squared distance of the k-th; before there are k, the square of the question's radius.
    reach2: f32,
}

impl Best {
    fn begin(&mut self, k: usize, radius: f32) {
        self.keys.clear();
        (self.k, self.most, self.reach2) = (k, k, radius * radius);
    }

    #[inline]
    fn add(&mut self, hits: &Hits, left_out: Option<u32>) {
        let kept = hits.iter().filter(|hit| Some(hit.0) != left_out);
        self.keys.extend(kept.map(|(id, dist2)| u64::from(dist2.to_bits()) << 32 | u64::from(id)));
        if self.keys.len() >= self.most {
            self.keys.select_nth_unstable(self.k - 1);
            self.keys.truncate(self.k);
            self.reach2 = f32::from_bits((self.keys[self.k - 1] >> 32) as u32);
            self.most = self.k + self.k / 2 + SPARE;
        }
    }

    /// All that were kept, the nearest first.
    fn finish(&mut self) -> &[u64] {
        self.keys.sort_unstable();
        self.keys.truncate(self.k);
        &self.keys
    }
}

/// Hits that are gathered before the worst are dropped, beside half of k.
const SPARE: usize = 8;

/// Rows of one task: whose they are, and their entries side by side.
#[derive(Debug, Default)]
struct TaskRows {
    queries: Vec<u32>,
    indices: Vec<u32>,
    distances: Vec<f32>,
}

impl KnnSearch for LinearOctree {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        let points = CpuStructure::points(self);
        question.validate(points.len())?;
        let start = Instant::now();
        let (simd, period, places) = (Simd::best(), CpuStructure::period(self), question.places(points.len()));
        let within = question.as_fixed_radius();
        let wanted = places + usize::from(question.exclude_self);
        let queries = cpu::ordered(self, question.queries)?;
        let packs = &queries.packs[..];
        let find = |task: std::ops::Range<usize>| {
            let range = packs[task.start] as usize..packs[task.end] as usize;
            let mut made = TaskRows::with_capacity(range.len(), places);
            let (mut best, mut hits) = (Best::default(), Hits::default());
            for place in range {
                let (center, id) = (queries.points.position(place), queries.points.id(place));
                let left_out = question.exclude_self.then_some(id);
                let radius = within.radius_of(id as usize);
                best.begin(places, radius);
                if places > 0 {
                    self.nearest_first(center, wanted, radius, |span| {
                        hits.clear();
                        let ball = Ball { center, radius2: best.reach2, period };
                        row_simd::collect::<true>(simd, points, std::slice::from_ref(&span), &ball, &mut hits);
                        best.add(&hits, left_out);
                        best.reach2
                    });
                }
                made.push(id, best.finish(), places);
            }
            made
        };
        let made: Vec<TaskRows> = cpu::tasks(packs).into_par_iter().map(find).collect();
        let mut report = cpu::report(self, "row_simd::collect");
        report.search = "nearest-octants";
        report.host_stage("query", start);
        let start = Instant::now();
        let n_queries = within.len(points.len());
        let mut nearest = assemble(&made, n_queries, places, question.k as usize)?;
        report.host_stage("assemble", start);
        nearest.report = report;
        Ok(nearest)
    }
}

impl TaskRows {
    fn with_capacity(n_queries: usize, places: usize) -> Self {
        let entries = n_queries * places;
        Self {
            queries: Vec::with_capacity(n_queries),
            indices: Vec::with_capacity(entries),
            distances: Vec::with_capacity(entries),
        }
    }

    /// Adds a row, filled up to `places`.
    fn push(&mut self, query: u32, keys: &[u64], places: usize) {
        self.queries.push(query);
        let end = self.indices.len() + places;
        self.indices.extend(keys.iter().map(|&key| key as u32));
        self.distances.extend(keys.iter().map(|&key| f32::from_bits((key >> 32) as u32).sqrt()));
        self.indices.resize(end, NearestNeighbors::NONE);
        self.distances.resize(end, f32::INFINITY);
    }
}

/// Queries whose rows one thread copies.
const GATHER_QUERIES: usize = 1 << 12;

/// Brings rows of `places` entries into query order, and fills them up to `k`.
fn assemble(tasks: &[TaskRows], n_queries: usize, places: usize, k: usize) -> Result<NearestNeighbors> {
    let mut indices = rows::zeroed(n_queries * k)?;
    let mut distances = rows::zeroed(n_queries * k)?;
    if k > 0 {
        let mut row_of = vec![(0u32, 0u32); n_queries];
        for (number, task) in tasks.iter().enumerate() {
            for (row, &query) in task.queries.iter().enumerate() {
                row_of[query as usize] = (number as u32, row as u32);
            }
        }
        let parts = indices.par_chunks_mut(k * GATHER_QUERIES).zip(distances.par_chunks_mut(k * GATHER_QUERIES));
        parts.zip(row_of.par_chunks(GATHER_QUERIES)).for_each(|((indices, distances), row_of)| {
            let rows = indices.chunks_exact_mut(k).zip(distances.chunks_exact_mut(k)).zip(row_of);
            for ((indices, distances), &(task, row)) in rows {
                let (task, from) = (&tasks[task as usize], row as usize * places);
                indices[..places].copy_from_slice(&task.indices[from..from + places]);
                distances[..places].copy_from_slice(&task.distances[from..from + places]);
                indices[places..].fill(NearestNeighbors::NONE);
                distances[places..].fill(f32::INFINITY);
            }
        });
    }
    Ok(NearestNeighbors { k, n_queries, indices, distances, ..NearestNeighbors::default() })
}

impl KnnSearch for BruteForce {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        question.validate(CpuStructure::points(self).len())?;
        let list = self.list(&question.as_fixed_radius())?;
        Ok(NearestNeighbors::of_list(list, question.k as usize))
    }
}

impl NearestNeighbors {
    /// Rows of a list, which are in order and no longer than `k`, filled up to `k`.
    pub(in crate::query) fn of_list(list: Neighbors, k: usize) -> Self {
        let n_queries = list.len();
        let mut made = Self { k, n_queries, report: list.report.clone(), ..Self::default() };
        made.indices = Vec::with_capacity(n_queries * k);
        made.distances = Vec::with_capacity(n_queries * k);
        for i in 0..n_queries {
            made.indices.extend_from_slice(list.row(i));
            made.distances.extend_from_slice(list.row_distances(i).unwrap_or_default());
            made.indices.resize((i + 1) * k, Self::NONE);
            made.distances.resize((i + 1) * k, f32::INFINITY);
        }
        made
    }
}
