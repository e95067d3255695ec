//! The phases on the CPU, and their counters. Phase III is the common code of all CPU queries, over the candidates.

use std::borrow::Cow;
use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::counters::{PhaseLanes, SearchCounters};
use super::sweep::swept;
use crate::Result;
use crate::geometry::row_simd::{self, Ball, Simd};
use crate::geometry::{Aabb, OrderedPoints};
use crate::query::visit::OrderedQueries;
use crate::query::{FixedRadius, Queries};
use crate::structure::{AabbTree, CpuStructure};

/// Lanes that count as running in step: a warp.
const IN_STEP: usize = 32;

/// Phase I: the queries in packs of those with the same leaf.
pub(in crate::query) fn pack_by_leaf<'a>(tree: &'a AabbTree, queries: Queries<'_>) -> OrderedQueries<'a> {
    let Queries::Other(others) = queries else {
        let (points, shape) = (CpuStructure::points(tree), tree.shape());
        // Leaves of a tiny bucket may have no point.
        let leaves: Vec<usize> = shape.leaves().filter(|&leaf| !shape.points(leaf).is_empty()).collect();
        let starts = leaves.iter().map(|&leaf| shape.points(leaf).start as u32);
        let packs = starts.chain([points.len() as u32]).collect();
        return OrderedQueries { points: Cow::Borrowed(points), packs: Cow::Owned(packs), leaves };
    };
    let leaf = |(place, &query): (usize, &Vec3)| (tree.nearest_leaf(query).unwrap_or(0), place as u32);
    let mut keyed: Vec<(usize, u32)> = others.par_iter().enumerate().with_min_len(1 << 10).map(leaf).collect();
    keyed.par_sort_unstable();
    let order: Vec<u32> = keyed.iter().map(|&(_, place)| place).collect();
    let (mut packs, mut leaves, mut end) = (vec![0], Vec::new(), 0);
    for pack in keyed.chunk_by(|a, b| a.0 == b.0) {
        end += pack.len() as u32;
        packs.push(end);
        leaves.push(pack[0].0);
    }
    let points = Cow::Owned(OrderedPoints::gather(others, &order));
    OrderedQueries { points, packs: Cow::Owned(packs), leaves }
}

/// Phase II: the candidates of every pack as spans of the tree's order.
pub(in crate::query) fn find_candidates(
    tree: &AabbTree,
    question: &FixedRadius<'_>,
    queries: &OrderedQueries<'_>,
) -> Vec<Vec<Range<usize>>> {
    let spans = |pack| {
        let mut spans: Vec<Range<usize>> = Vec::new();
        traverse(tree, question, queries, pack, |points| match spans.last_mut() {
            Some(last) if last.end == points.start => last.end = points.end,
            _ => spans.push(points),
        });
        spans
    };
    (0..queries.leaves.len()).into_par_iter().with_min_len(16).map(spans).collect()
}

/// The common traversal of a pack; returns the number of nodes looked at.
fn traverse(
    tree: &AabbTree,
    question: &FixedRadius<'_>,
    queries: &OrderedQueries<'_>,
    pack: usize,
    take: impl FnMut(Range<usize>),
) -> usize {
    let Some(leaf_box) = tree.boxes().get(queries.leaves[pack]) else { return 0 };
    let places = queries.pack(pack);
    let (mut bounds, mut radius) = (Aabb::EMPTY, 0f32);
    for place in places {
        bounds = bounds.grown_to(queries.points.position(place));
        radius = radius.max(question.radius_of(queries.points.id(place) as usize));
    }
    let (around, reach) = swept(&leaf_box.to_aabb(), &bounds, radius);
    tree.back_traverse(queries.leaves[pack], &around, reach, take)
}

impl AabbTree {
    /// Counts what a coherent search does for this question, whatever search is set; lanes as if 32 ran in step.
    ///
    /// The question's order, cap and distances do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`].
    pub fn coherent_counters(&self, question: &FixedRadius<'_>) -> Result<SearchCounters> {
        question.validate(self.shape().n_points())?;
        let queries = pack_by_leaf(self, question.queries);
        let packs = (0..queries.leaves.len()).into_par_iter().map(|pack| {
            let mut spans = Vec::new();
            let visited = traverse(self, question, &queries, pack, |points| spans.push(points));
            let candidates = spans.iter().map(|span| span.len() as u64).sum::<u64>();
            (visited as u32, candidates, neighbors(self, question, &queries, queries.pack(pack), &spans))
        });
        let packs: Vec<(u32, u64, u64)> = packs.collect();
        let visited: Vec<u32> = packs.iter().map(|pack| pack.0).collect();
        let sizes = (0..packs.len()).map(|pack| queries.pack(pack).len() as u32);
        let lanes = sizes.clone().zip(&packs).flat_map(|(size, pack)| std::iter::repeat_n(size, pack.1 as usize));
        let down = match question.queries {
            Queries::Points => Vec::new(),
            Queries::Other(others) => vec![self.shape().depth(); others.len()],
        };
        Ok(SearchCounters {
            queries: question.len(self.shape().n_points()) as u64,
            traversals: packs.len() as u64,
            nodes_visited: visited.iter().map(|&v| u64::from(v)).sum(),
            candidates: packs.iter().map(|pack| pack.1).sum(),
            tests: sizes.zip(&packs).map(|(size, pack)| u64::from(size) * pack.1).sum(),
            neighbors: packs.iter().map(|pack| pack.2).sum(),
            phases: vec![
                PhaseLanes::of_rounds("pack", &down, IN_STEP),
                PhaseLanes::of_rounds("traverse", &visited, IN_STEP),
                PhaseLanes::of_rounds("extract", &lanes.collect::<Vec<u32>>(), IN_STEP),
            ],
        })
    }

    /// Counts what a search by one traversal a query does for this question, whatever search is set; lanes as if 32 ran in
    /// step, a round of which goes down a level, looks at a node or tests eight points.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`].
    pub fn primary_counters(&self, question: &FixedRadius<'_>) -> Result<SearchCounters> {
        question.validate(self.shape().n_points())?;
        let queries = match question.queries {
            Queries::Points => pack_by_leaf(self, question.queries),
            Queries::Other(others) => {
                let packed = self.pack_queries(others)?;
                let points = Cow::Owned(OrderedPoints::gather(others, &packed.order));
                OrderedQueries { points, packs: Cow::Owned(packed.packs), leaves: Vec::new() }
            }
        };
        let points = &*queries.points;
        let one = |place: usize| {
            let (at, radius) = (points.position(place), question.radius_of(points.id(place) as usize));
            let Some(leaf) = self.nearest_leaf(at) else { return [0; 4] };
            let mut spans = Vec::new();
            let visited = self.back_traverse(leaf, &Aabb::new(at, at), radius, |span| spans.push(span)) as u64;
            let tests = spans.iter().map(|span| span.len() as u64).sum::<u64>();
            let groups = spans.iter().map(|span| span.len().div_ceil(8) as u64).sum::<u64>();
            let rounds = u64::from(self.shape().depth()) + visited + groups;
            [rounds, visited, tests, neighbors(self, question, &queries, place..place + 1, &spans)]
        };
        let each: Vec<[u64; 4]> = (0..points.len()).into_par_iter().with_min_len(64).map(one).collect();
        let rounds: Vec<u32> = each.iter().map(|one| one[0] as u32).collect();
        let sum = |which: usize| each.iter().map(|one| one[which]).sum();
        Ok(SearchCounters {
            queries: points.len() as u64,
            traversals: points.len() as u64,
            nodes_visited: sum(1),
            candidates: 0,
            tests: sum(2),
            neighbors: sum(3),
            phases: vec![PhaseLanes::of_rounds("search", &rounds, IN_STEP)],
        })
    }
}

/// Neighbours of the queries at these places among the points of the spans.
fn neighbors(
    tree: &AabbTree,
    question: &FixedRadius<'_>,
    queries: &OrderedQueries<'_>,
    places: Range<usize>,
    spans: &[Range<usize>],
) -> u64 {
    let count = |place: usize| {
        let radius = question.radius_of(queries.points.id(place) as usize);
        let period = CpuStructure::period(tree);
        let ball = Ball { center: queries.points.position(place), radius2: radius * radius, period };
        let found = row_simd::count(Simd::best(), CpuStructure::points(tree), spans, &ball);
        u64::from(found) - u64::from(question.exclude_self)
    };
    places.map(count).sum()
}
