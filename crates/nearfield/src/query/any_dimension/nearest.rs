//! The nearest points on the CPU: leaves near the query first, until none can hold anything nearer.

use std::time::Instant;

use rayon::prelude::*;

use super::query_set::QuerySet;
use super::{FixedRadiusN, KnnN, NearestN, QueriesN, SearchWork, cpu};
use crate::Result;
use crate::geometry::Scalar;
use crate::query::rows;
use crate::structure::AabbTreeN;

/// Hits that are gathered before the worst are dropped, beside half of k.
const SPARE: usize = 8;
/// Queries of a task.
const TASK_QUERIES: usize = 128;

/// The best so far of one query.
#[derive(Debug, Clone)]
pub(super) struct Best<T> {
    k: usize,
    /// Squared distance and index, in this order of significance.
    hits: Vec<(T, u32)>,
    /// Number of hits at which all but the best are dropped.
    most: usize,
    /// Squared distance that hits must not pass: that of the k-th, or the radius before there are k.
    reach2: T,
}

impl<T: Scalar> Best<T> {
    pub(super) fn new(k: usize) -> Self {
        Self { k, hits: Vec::new(), most: k, reach2: T::ZERO }
    }

    /// How many are looked for.
    pub(super) fn k(&self) -> usize {
        self.k
    }

    /// Squared distance that hits must not pass.
    pub(super) fn reach2(&self) -> T {
        self.reach2
    }

    /// What was kept; the nearest first once the search has finished.
    pub(super) fn hits(&self) -> &[(T, u32)] {
        &self.hits
    }

    pub(super) fn begin(&mut self, reach2: T) {
        self.hits.clear();
        (self.most, self.reach2) = (self.k, reach2);
    }

    #[inline(always)]
    pub(super) fn add(&mut self, index: u32, dist2: T) {
        if dist2 <= self.reach2 {
            self.hits.push((dist2, index));
            if self.hits.len() >= self.most {
                self.drop_worst();
            }
        }
    }

    fn drop_worst(&mut self) {
        if self.hits.len() >= self.k {
            self.hits.select_nth_unstable_by(self.k - 1, nearer);
            self.hits.truncate(self.k);
            self.reach2 = self.hits[self.k - 1].0;
        }
        self.most = self.k + self.k / 2 + SPARE;
    }

    /// All that were kept, the nearest first.
    pub(super) fn finish(&mut self) -> &[(T, u32)] {
        self.hits.sort_unstable_by(nearer);
        self.hits.truncate(self.k);
        &self.hits
    }
}

fn nearer<T: Scalar>(a: &(T, u32), b: &(T, u32)) -> std::cmp::Ordering {
    a.0.compare(b.0).then(a.1.cmp(&b.1))
}

impl<T: Scalar, const D: usize> AabbTreeN<T, D> {
    /// The nearest points of every query.
    ///
    /// # Errors
    /// See [`KnnN::validate`].
    pub fn knn(&self, question: &KnnN<'_, T, D>) -> Result<NearestN<T>> {
        question.validate(self.len())?;
        let start = Instant::now();
        let (n_queries, k) = (question.queries.len(self.len()), question.k as usize);
        let (mut indices, mut dist2) = (rows::zeroed::<u32>(n_queries * k)?, rows::zeroed::<T>(n_queries * k)?);
        let mut work = SearchWork::default();
        if k > 0 {
            indices.fill(NearestN::<T>::NONE);
            dist2.fill(T::of(f64::INFINITY));
        }
        if k > 0 && !self.is_empty() {
            let others = match question.queries {
                QueriesN::Points => None,
                QueriesN::Other(queries) => Some(QuerySet::by_nearest_leaf(self, queries)),
            };
            let queries = others.as_ref().map_or(self.ordered_points(), |set| &set.points);
            work = others.as_ref().map(QuerySet::work).unwrap_or_default();
            let mut found = vec![(T::of(f64::INFINITY), NearestN::<T>::NONE); n_queries * k];
            work += found
                .par_chunks_mut(k * TASK_QUERIES)
                .enumerate()
                .map(|(task, rows)| {
                    let first = task * TASK_QUERIES;
                    let mut best = Best::new(k);
                    let mut work = SearchWork::default();
                    for (row, place) in rows.chunks_exact_mut(k).zip(first..) {
                        let id = queries.ids()[place];
                        work += find(self, question, &queries.position(place), id, &mut best);
                        let nearest = best.finish();
                        row[..nearest.len()].copy_from_slice(nearest);
                    }
                    work
                })
                .reduce(SearchWork::default, |mut a, b| {
                    a += b;
                    a
                });
            let mut place_of = vec![0u32; n_queries];
            queries.ids().iter().zip(0..).for_each(|(&id, place)| place_of[id as usize] = place);
            let made = indices.par_chunks_exact_mut(k).zip(dist2.par_chunks_exact_mut(k)).zip(&place_of);
            made.with_min_len(TASK_QUERIES).for_each(|((indices, dist2), &place)| {
                let row = &found[place as usize * k..][..k];
                for ((index, dist2), &hit) in indices.iter_mut().zip(dist2).zip(row) {
                    (*dist2, *index) = hit;
                }
            });
        }
        let mut report = cpu::report("nearest-first");
        report.host_stage("query", start);
        Ok(NearestN { k, n_queries, indices, dist2, work, report })
    }

    /// The nearest point within the radius of every query: rows of one place. The question's order does not matter.
    ///
    /// # Errors
    /// See [`KnnN::validate`].
    pub fn nearest(&self, question: &FixedRadiusN<'_, T, D>) -> Result<NearestN<T>> {
        let FixedRadiusN { queries, radius, exclude_self, .. } = *question;
        self.knn(&KnnN { k: 1, queries, within: Some(radius), exclude_self })
    }
}

/// Fills `best` for one query.
fn find<T: Scalar, const D: usize>(
    tree: &AabbTreeN<T, D>,
    question: &KnnN<'_, T, D>,
    query: &[T; D],
    id: u32,
    best: &mut Best<T>,
) -> SearchWork {
    let points = tree.ordered_points();
    let radius2 = question.within.map(|radius| radius.of(id as usize)).map(|radius| radius * radius);
    best.begin(radius2.unwrap_or(T::of(f64::INFINITY)));
    let (reach2, mut tests) = (best.reach2, 0);
    let nodes = tree.nearest_first(query, reach2, |leaf| {
        let places = tree.places(leaf);
        tests += places.len() as u64;
        points.for_each_dist2(places, query, |place, dist2| {
            let index = points.ids()[place];
            if !(question.exclude_self && index == id) {
                best.add(index, dist2);
            }
        });
        best.reach2
    });
    SearchWork { traversals: 1, nodes, candidates: 0, tests }
}
