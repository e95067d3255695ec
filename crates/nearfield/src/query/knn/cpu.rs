//! The nearest points on the CPU: queries in packs along the curve, spans near them from the tree, SIMD over each span.

use std::ops::Range;
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;

use super::by_pack::ByPack;
use super::{Knn, KnnSearch, NearestNeighbors};
use crate::Result;
use crate::geometry::OrderedPoints;
use crate::geometry::distance::Period;
use crate::geometry::row_simd::{self, Ball, Hits, Simd};
use crate::query::{FixedRadius, NeighborSearch, Neighbors, cpu, rows, visit};
use crate::structure::{AabbTree, BruteForce, CpuStructure, LinearOctree};

/// The best so far of one query.
#[derive(Debug, Default)]
pub(super) struct Best {
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

    /// Finds the nearest of a query; `hits` is memory to work in.
    pub(super) fn search<S: NearestFirst>(
        &mut self,
        tree: &S,
        question: &Question<'_>,
        center: Vec3,
        radius: f32,
        hits: &mut Hits,
    ) {
        self.begin(question.wanted, radius);
        tree.nearest_first(center, question.wanted, radius, |span| {
            hits.clear();
            let ball = Ball { center, radius2: self.reach2, period: question.period };
            row_simd::collect::<true>(question.simd, question.points, std::slice::from_ref(&span), &ball, hits);
            self.add(hits);
            self.reach2
        });
    }

    #[inline]
    fn add(&mut self, hits: &Hits) {
        self.keys.extend(hits.iter().map(key));
        if self.keys.len() >= self.most {
            self.keys.select_nth_unstable(self.k - 1);
            self.keys.truncate(self.k);
            self.reach2 = f32::from_bits((self.keys[self.k - 1] >> 32) as u32);
            self.most = self.k + self.k / 2 + SPARE;
        }
    }

    /// All that were kept, the nearest first.
    pub(super) fn finish(&mut self) -> &[u64] {
        self.keys.sort_unstable();
        self.keys.truncate(self.k);
        &self.keys
    }
}

/// A hit as a number that orders by distance, then by index.
#[inline(always)]
pub(super) fn key((id, dist2): (u32, f32)) -> u64 {
    u64::from(dist2.to_bits()) << 32 | u64::from(id)
}

/// What was found for one query, the nearest first.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub(super) ids: Vec<u32>,
    pub(super) dist2: Vec<f32>,
    /// Memory to work in.
    pub(super) keys: Vec<u64>,
}

impl Found {
    pub(super) fn take_keys(&mut self, keys: &[u64]) {
        self.ids.clear();
        self.ids.extend(keys.iter().map(|&key| key as u32));
        self.dist2.clear();
        self.dist2.extend(keys.iter().map(|&key| f32::from_bits((key >> 32) as u32)));
    }

    /// Leaves out the query itself; where as many duplicates of lower index stand before it, it is not there, and the last goes
    /// when the row is cut.
    pub(super) fn leave_out(&mut self, id: u32) {
        if let Some(own) = self.ids.iter().position(|&found| found == id) {
            self.ids.remove(own);
            self.dist2.remove(own);
        }
    }
}

/// A question as the search of one query sees it.
pub(super) struct Question<'a> {
    pub(super) simd: Simd,
    pub(super) points: &'a OrderedPoints,
    pub(super) period: Period,
    pub(super) queries: &'a OrderedPoints,
    /// Radii.
    pub(super) within: FixedRadius<'a>,
    /// Neighbours to find, the query itself included where it is left out in the end; 1 or more.
    pub(super) wanted: usize,
    pub(super) exclude_self: bool,
}

/// Hits that are gathered before the worst are dropped, beside half of k.
const SPARE: usize = 8;

/// All rows in query order, `k` places each. Threads write rows of different queries: plain stores on every processor, and safe.
struct Rows {
    k: usize,
    indices: Vec<AtomicU32>,
    distances: Vec<AtomicU32>,
}

/// A tree that hands out its points the nearest first.
pub(super) trait NearestFirst: CpuStructure + Sized {
    /// Name of that search.
    const NEAREST: &'static str;

    /// Hands spans of points to `test`, each point at most once and near ones first, until nothing that is left can lie
    /// within `radius` and the squared distance that `test` returned last. At least `wanted` points are of interest.
    fn nearest_first(&self, query: Vec3, wanted: usize, radius: f32, test: impl FnMut(Range<usize>) -> f32);

    /// Finds the rows of the queries of packs and hands them to `push`.
    fn find(&self, question: &Question<'_>, packs: &[u32], mut push: impl FnMut(u32, &Found)) {
        let (mut best, mut hits, mut row) = (Best::default(), Hits::default(), Found::default());
        for place in packs[0] as usize..packs[packs.len() - 1] as usize {
            let (center, id) = (question.queries.position(place), question.queries.id(place));
            best.search(self, question, center, question.within.radius_of(id as usize), &mut hits);
            row.take_keys(best.finish());
            if question.exclude_self {
                row.leave_out(id);
            }
            push(id, &row);
        }
    }
}

impl NearestFirst for LinearOctree {
    const NEAREST: &'static str = "nearest-octants";

    fn nearest_first(&self, query: Vec3, wanted: usize, radius: f32, test: impl FnMut(Range<usize>) -> f32) {
        self.octants_nearest_first(query, wanted, radius, test);
    }
}

impl NearestFirst for AabbTree {
    const NEAREST: &'static str = "nearest-boxes";

    fn nearest_first(&self, query: Vec3, _: usize, radius: f32, test: impl FnMut(Range<usize>) -> f32) {
        self.boxes_nearest_first(query, radius * radius, test);
    }

    fn find(&self, question: &Question<'_>, packs: &[u32], push: impl FnMut(u32, &Found)) {
        ByPack::default().find(self, question, packs, push);
    }
}

impl KnnSearch for LinearOctree {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        knn(self, question)
    }
}

impl KnnSearch for AabbTree {
    fn knn(&self, question: &Knn<'_>) -> Result<NearestNeighbors> {
        knn(self, question)
    }
}

fn knn<S: NearestFirst>(tree: &S, question: &Knn<'_>) -> Result<NearestNeighbors> {
    let points = tree.points();
    question.validate(points.len())?;
    let start = Instant::now();
    let places = question.places(points.len());
    let within = question.as_fixed_radius();
    let queries = visit::ordered(tree, question.queries)?;
    let packs = &queries.packs[..];
    let asked = Question {
        simd: Simd::best(),
        points,
        period: tree.period(),
        queries: &queries.points,
        within,
        wanted: places + usize::from(question.exclude_self),
        exclude_self: question.exclude_self,
    };
    let n_queries = within.len(points.len());
    let rows = Rows::new(n_queries, question.k as usize)?;
    visit::tasks(packs).into_par_iter().filter(|_| places > 0).for_each(|task| {
        tree.find(&asked, &packs[task.start..=task.end], |id, row| rows.put(id as usize, row, places));
    });
    let mut report = cpu::report(tree, "row_simd::collect");
    report.search = S::NEAREST;
    report.host_stage("query", start);
    let (indices, distances) = rows.into_parts();
    Ok(NearestNeighbors { k: question.k as usize, n_queries, indices, distances, report })
}

impl Rows {
    /// Rows without a neighbour.
    ///
    /// # Errors
    /// `OutOfMemory`.
    fn new(n_queries: usize, k: usize) -> Result<Self> {
        let filled = |word: u32| -> Result<Vec<AtomicU32>> {
            let n = n_queries * k;
            let mut words = Vec::new();
            words.try_reserve_exact(n).map_err(|_| rows::no_memory::<u32>(n))?;
            // All threads share the first touch of the pages.
            (0..n).into_par_iter().with_min_len(1 << 14).map(|_| AtomicU32::new(word)).collect_into_vec(&mut words);
            Ok(words)
        };
        Ok(Self { k, indices: filled(NearestNeighbors::NONE)?, distances: filled(f32::INFINITY.to_bits())? })
    }

    /// Writes a row, cut to `places`.
    fn put(&self, query: usize, row: &Found, places: usize) {
        let (start, n) = (query * self.k, row.ids.len().min(places));
        for (to, &id) in self.indices[start..start + n].iter().zip(&row.ids) {
            to.store(id, Relaxed);
        }
        for (to, &d2) in self.distances[start..start + n].iter().zip(&row.dist2) {
            to.store(d2.sqrt().to_bits(), Relaxed);
        }
    }

    fn into_parts(self) -> (Vec<u32>, Vec<f32>) {
        let indices = self.indices.into_iter().map(AtomicU32::into_inner).collect();
        (indices, self.distances.into_iter().map(|bits| f32::from_bits(bits.into_inner())).collect())
    }
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
