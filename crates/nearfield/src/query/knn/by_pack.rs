//! The nearest points in the tree of boxes on the CPU: the queries of a pack share the leaves near them, and each guesses how far its nearest
//! points reach.
//!
//! Queries that stand side by side have about the same distance to their k-th nearest point. So a query takes all points in a
//! closed ball that is somewhat wider than those of the queries before. Where those are k or more, the k nearest are among
//! them, ties included, and one sort ends the query; most do not need another look. Where they are fewer, a wider ball is tried; then the triangle
//! inequality gives a ball that holds k, and where that would be far too wide, or there is no query before, the tree is
//! searched from the top, the nearest boxes first.

use std::ops::Range;

use glam::Vec3;

use super::cpu::{Best, Found, Question};
use crate::geometry::Aabb;
use crate::geometry::row_simd::{self, Ball, Hits};
use crate::structure::AabbTree;
use crate::structure::aabb_tree::NearLeaves;

/// By what the squared distance to the k-th nearest points of the queries before is multiplied, first and where that was not enough.
const WIDER: [f32; 2] = [1.25, 1.8];
/// The leaves of a pack are collected for squared distances that are larger by this than the query at hand needs.
const SPARE: f32 = 1.3;
/// Queries that share leaves, where the search has packs of single queries.
const PACK: usize = 32;
/// Hits up to which they are ordered by counting, for each, how many are nearer.
const MOST_RANKED: usize = 64;

/// Memory of one task.
#[derive(Default)]
pub(super) struct ByPack {
    leaves: NearLeaves,
    spans: Vec<Range<usize>>,
    hits: Hits,
    best: Best,
    row: Found,
    /// A query whose row was full, and the squared distance of the last in it.
    before: Option<(Vec3, f32)>,
    /// A running mean of these distances.
    mean2: f32,
}

impl ByPack {
    /// Hands the row of every query of the packs to `push`: whose it is, and what was found.
    pub(super) fn find(
        &mut self,
        tree: &AabbTree,
        question: &Question<'_>,
        packs: &[u32],
        mut push: impl FnMut(u32, &Found),
    ) {
        let mut first = 0;
        while first + 1 < packs.len() {
            let start = packs[first] as usize;
            let more = packs[first + 2..].iter().take_while(|&&end| end as usize - start <= PACK).count();
            first += 1 + more;
            self.find_in_pack(tree, question, start..packs[first] as usize, &mut push);
        }
    }

    fn find_in_pack(
        &mut self,
        tree: &AabbTree,
        question: &Question<'_>,
        places: Range<usize>,
        push: &mut impl FnMut(u32, &Found),
    ) {
        let around = question.queries.bounds(places.clone());
        let mut shared = Shared { around, covered2: -1.0, possible: true };
        for place in places {
            let (center, id) = (question.queries.position(place), question.queries.id(place));
            let radius = question.within.radius_of(id as usize);
            let limit2 = radius * radius;
            let found = self.guesses(center, limit2).into_iter().flatten().any(|reach2| {
                self.find_in_ball(tree, question, &mut shared, center, reach2)
                    && (self.hits.ids.len() >= question.wanted || reach2 == limit2)
            });
            if found {
                self.row.take_nearest(&self.hits, question.wanted);
            } else {
                self.best.search(tree, question, center, radius, &mut self.hits);
                self.row.take_keys(self.best.finish());
            }
            if let Some(&reach2) = self.row.dist2.get(question.wanted - 1) {
                self.mean2 = if self.before.is_some() { 0.5 * self.mean2 + 0.5 * reach2 } else { reach2 };
                self.before = Some((center, reach2));
            }
            if question.exclude_self {
                self.row.leave_out(id);
            }
            push(id, &self.row);
        }
    }

    /// Squared radii to try.
    fn guesses(&self, center: Vec3, limit2: f32) -> [Option<f32>; 3] {
        let Some((before, reach2)) = self.before else { return [None; 3] };
        let apart2 = (center - before).length_squared();
        let near = apart2 <= 4.0 * reach2;
        // The ball of the query before holds enough, and this one holds that ball. Should rounding take some away, the search
        // from the top is left.
        let holds = reach2.sqrt() + apart2.sqrt();
        let [first, second] = WIDER.map(|wider| Some((self.mean2 * wider).min(limit2)));
        [first, second, near.then_some((holds * holds * 1.000_01).min(limit2))]
    }

    /// Finds all points in a ball; false where the leaves near the pack are too many to share.
    fn find_in_ball(
        &mut self,
        tree: &AabbTree,
        question: &Question<'_>,
        shared: &mut Shared,
        center: Vec3,
        reach2: f32,
    ) -> bool {
        if shared.possible && reach2 > shared.covered2 {
            // Leaves are looked for a little farther than is said, for the rounding of the root.
            let radius = (reach2 * (SPARE * 1.01)).sqrt();
            shared.possible = tree.leaves_near(&shared.around, radius, &mut self.leaves);
            shared.covered2 = reach2 * SPARE;
        }
        if !shared.possible {
            return false;
        }
        tree.spans_within(center, reach2, &mut self.leaves, &mut self.spans);
        self.hits.clear();
        let ball = Ball { center, radius2: reach2, period: question.period };
        row_simd::collect::<true>(question.simd, question.points, &self.spans, &ball, &mut self.hits);
        true
    }
}

/// What the queries of a pack share.
struct Shared {
    around: Aabb,
    /// Squared radius up to which the leaves near the pack are known.
    covered2: f32,
    /// Whether there are few enough of them.
    possible: bool,
}

impl Found {
    /// The `most` nearest of the hits in order, ties by lower index.
    fn take_nearest(&mut self, hits: &Hits, most: usize) {
        let n = hits.ids.len();
        if n > MOST_RANKED || !self.take_ranked(hits, most) {
            self.keys.clear();
            self.keys.extend(hits.iter().map(super::cpu::key));
            if most < n {
                self.keys.select_nth_unstable(most);
                self.keys.truncate(most);
            }
            self.keys.sort_unstable();
            let keys = std::mem::take(&mut self.keys);
            self.take_keys(&keys);
            self.keys = keys;
        }
    }

    /// The same for up to [`MOST_RANKED`] hits without a sort, which would be a row of branches that nobody can foresee. False
    /// where two are equally far.
    fn take_ranked(&mut self, hits: &Hits, most: usize) -> bool {
        const LANES: usize = 16;
        let n = hits.ids.len();
        let mut dist2 = [f32::INFINITY; MOST_RANKED];
        dist2[..n].copy_from_slice(&hits.dist2);
        let mut ranks = [0u32; MOST_RANKED];
        for (ranks, own) in ranks.chunks_exact_mut(LANES).zip(dist2.chunks_exact(LANES)).take(n.div_ceil(LANES)) {
            let mut nearer = [0u32; LANES];
            for &other in &hits.dist2 {
                for (nearer, &own) in nearer.iter_mut().zip(own) {
                    *nearer += u32::from(other < own);
                }
            }
            ranks.copy_from_slice(&nearer);
        }
        // Ranks that differ add up to this, and each pair of equals takes one away.
        if ranks[..n].iter().sum::<u32>() as usize != n * n.saturating_sub(1) / 2 {
            return false;
        }
        let (mut ids, mut in_order) = ([0u32; MOST_RANKED], [0f32; MOST_RANKED]);
        for ((&rank, &id), &d2) in ranks.iter().zip(&hits.ids).zip(&hits.dist2) {
            ids[rank as usize] = id;
            in_order[rank as usize] = d2;
        }
        let kept = n.min(most);
        self.ids.clear();
        self.ids.extend_from_slice(&ids[..kept]);
        self.dist2.clear();
        self.dist2.extend_from_slice(&in_order[..kept]);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_and_sorts_give_the_same_rows() {
        for n in 0..100u32 {
            for equal in [false, true] {
                let d2 = |i: u32| (i * 37 % 101) as f32 * if equal && i > 3 { 0.0 } else { 1.0 };
                let hits = Hits { ids: (0..n).rev().collect(), dist2: (0..n).map(d2).collect() };
                let mut expected: Vec<(f32, u32)> = hits.iter().map(|(id, d2)| (d2, id)).collect();
                expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
                for most in [1, 16, 200] {
                    let mut found = Found::default();
                    found.take_nearest(&hits, most);
                    let pairs: Vec<(f32, u32)> = found.dist2.iter().copied().zip(found.ids.iter().copied()).collect();
                    assert_eq!(pairs, expected[..expected.len().min(most)], "{n} hits, {most} nearest");
                }
            }
        }
    }
}
