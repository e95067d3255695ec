//! Rows of neighbours while they are found.
//!
//! A list is made in two looks. The first marks what is inside each ball, a bit a candidate, and knows how long every row is;
//! the second writes rows to their places, with no rows in between whose memory would have to be touched for the first
//! time. Marks take at most as much as the rows, on a grid a fifth. Rows with a cap are kept as they are: at most as many
//! neighbours as the cap lets through.

use std::ops::Range;

use super::FixedRadius;
use super::rows::RowMaker;
use super::visit::{Query, Visits};
use crate::geometry::OrderedPoints;
use crate::geometry::row_simd::{self, Hits, Simd};
use crate::structure::CpuStructure;

/// Bytes of a place where it is kept instead of marks.
const PLACE_BYTES: usize = size_of::<u32>();

/// What one task found, in searching order.
#[derive(Debug, Default)]
pub(super) struct FoundRows {
    parts: Vec<FoundPart>,
    /// Begin and end of the spans of all parts, one part after the other.
    spans: Vec<[u32; 2]>,
    /// Neighbours of each query, however many of them go into its row.
    found: Vec<u32>,
    /// Without a cap, one record a query: a bit a candidate, or the places of what was found where that takes less.
    records: Vec<u8>,
    /// With a cap, the rows.
    kept: Hits,
    entries: u64,
    /// Entries and bytes that others know of.
    reported: (u64, u64),
    scratch: Scratch,
}

/// Queries at consecutive places that have the same candidates.
#[derive(Debug)]
struct FoundPart {
    places: Range<usize>,
    n_spans: usize,
}

/// Memory that is used for one query after the other.
#[derive(Debug, Default)]
struct Scratch {
    hits: Hits,
    maker: RowMaker,
    places: Vec<u32>,
    spans: Vec<Range<usize>>,
}

/// Entries, or bytes, that a task adds between two looks at what all tasks have.
const REPORT_STEP: u64 = 1 << 14;

impl FoundRows {
    /// Room for so many queries.
    pub(super) fn new(n_queries: usize) -> Self {
        Self { found: Vec::with_capacity(n_queries), ..Self::default() }
    }

    /// Finds the neighbours of the queries at `places` among the candidates in `spans`; `visits` has the queries, `points` the
    /// candidates. Now and then `tell` is called with the entries and the bytes added since; once it returns false, so does this,
    /// and what was found is not to be used.
    pub(super) fn find<S: CpuStructure>(
        &mut self,
        visits: &Visits<'_, S>,
        points: &OrderedPoints,
        places: Range<usize>,
        spans: &[Range<usize>],
        tell: impl Fn(u64, u64) -> bool,
    ) -> bool {
        let n_bytes = row_simd::mark_bytes(spans);
        for place in places.clone() {
            let query = visits.query(place, spans);
            let found = match visits.question.max_neighbors {
                None => self.mark(points, &query, n_bytes, visits.own_place(place)),
                Some(_) => self.keep(points, &query, visits.question),
            };
            self.found.push(found);
            self.entries += u64::from(row_len(found, visits.question));
            let held = (self.records.len() + 8 * self.kept.ids.len()) as u64;
            let (entries, bytes) = self.reported;
            if self.entries >= entries + REPORT_STEP || held >= bytes + REPORT_STEP {
                let sizes = self.sizes();
                self.reported = sizes;
                if !tell(sizes.0 - entries, sizes.1 - bytes) {
                    return false;
                }
            }
        }
        self.parts.push(FoundPart { places, n_spans: spans.len() });
        self.spans.extend(spans.iter().map(|span| [span.start as u32, span.end as u32]));
        true
    }

    /// Marks the neighbours of a query, which itself is at the place `own` if it is to be left out; returns how many there are.
    fn mark(&mut self, points: &OrderedPoints, query: &Query<'_>, n_bytes: usize, own: Option<usize>) -> u32 {
        let (begin, spans) = (self.records.len(), query.spans);
        self.make_room(n_bytes);
        let mut found = row_simd::mark(Simd::best(), points, spans, &query.ball, &mut self.records);
        if let Some(own) = own {
            found -= u32::from(row_simd::unmark(spans, own, &mut self.records[begin..]));
        }
        if are_places(found, n_bytes) {
            let places = &mut self.scratch.places;
            places.clear();
            places.extend(row_simd::marked(spans, &self.records[begin..]).map(|place| place as u32));
            self.records.truncate(begin);
            self.records.extend(places.iter().flat_map(|place| place.to_le_bytes()));
        }
        found
    }

    /// Makes room for the marks of a query, and for the records of those that follow if they take as much on average, but for no more
    /// than eight times what is held.
    fn make_room(&mut self, n_bytes: usize) {
        let (held, needed) = (self.records.len(), n_bytes + size_of::<u16>());
        if self.records.capacity() - held < needed {
            let (done, all) = (self.found.len(), self.found.capacity());
            let expected = held.div_ceil(done.max(1)).saturating_mul(all.saturating_sub(done));
            // Where there is no memory for all that, marks take what they need by themselves.
            let _ = self.records.try_reserve_exact(needed + expected.clamp(held / 8, 8 * held));
        }
    }

    /// Keeps the row of a query with a cap; returns how many neighbours there are.
    fn keep(&mut self, points: &OrderedPoints, query: &Query<'_>, question: &FixedRadius<'_>) -> u32 {
        let Scratch { hits, maker, .. } = &mut self.scratch;
        hits.clear();
        row_simd::collect::<true>(Simd::best(), points, query.spans, &query.ball, hits);
        if question.exclude_self {
            hits.leave_out(query.id);
        }
        let found = hits.ids.len() as u32;
        maker.make_row::<true>(hits, question);
        self.kept.ids.extend_from_slice(&hits.ids);
        self.kept.dist2.extend_from_slice(&hits.dist2);
        found
    }

    /// Entries of the rows, and bytes that hold them.
    pub(super) fn sizes(&self) -> (u64, u64) {
        let bytes = self.records.len()
            + self.kept.ids.len() * size_of::<u32>()
            + self.kept.dist2.len() * size_of::<f32>()
            + self.found.capacity() * size_of::<u32>()
            + self.spans.capacity() * size_of::<[u32; 2]>()
            + self.parts.capacity() * size_of::<FoundPart>();
        (self.entries, bytes as u64)
    }

    /// The queries in searching order, each with the length of its row.
    pub(super) fn lengths<'a, S: CpuStructure>(
        &'a self,
        visits: &'a Visits<'_, S>,
    ) -> impl Iterator<Item = (u32, u32)> + 'a {
        let places = self.parts.iter().flat_map(|part| part.places.clone());
        let length = |(place, &found)| (visits.queries.points.id(place), row_len(found, visits.question));
        places.zip(&self.found).map(length)
    }

    /// Calls `visit` with every query in searching order, its row, and how many neighbours the cap left out. Squared distances are
    /// there under `DIST2`.
    pub(super) fn each_row<S: CpuStructure, const DIST2: bool>(
        &mut self,
        visits: &Visits<'_, S>,
        points: &OrderedPoints,
        mut visit: impl FnMut(&Query<'_>, &Hits, u32),
    ) {
        let (simd, question) = (Simd::best(), visits.question);
        let Scratch { hits, maker, spans: own, .. } = &mut self.scratch;
        let (mut spans, mut records, mut found) = (&self.spans[..], &self.records[..], self.found.iter());
        let mut first_kept = 0;
        for part in &self.parts {
            let (of_part, others) = spans.split_at(part.n_spans);
            spans = others;
            own.clear();
            own.extend(of_part.iter().map(|&[begin, end]| begin as usize..end as usize));
            let own = &own[..];
            let n_bytes = row_simd::mark_bytes(own);
            for (place, &found) in part.places.clone().zip(found.by_ref()) {
                hits.clear();
                let query = visits.query(place, own);
                if question.max_neighbors.is_some() {
                    let kept = first_kept..first_kept + row_len(found, question) as usize;
                    first_kept = kept.end;
                    hits.ids.extend_from_slice(&self.kept.ids[kept.clone()]);
                    hits.dist2.extend_from_slice(&self.kept.dist2[kept]);
                    visit(&query, hits, found - hits.ids.len() as u32);
                    continue;
                }
                let are_places = are_places(found, n_bytes);
                let (record, rest) = records.split_at(if are_places { found as usize * PLACE_BYTES } else { n_bytes });
                records = rest;
                if are_places {
                    let (places, _) = record.as_chunks();
                    let places = places.iter().map(|&bytes| u32::from_le_bytes(bytes) as usize);
                    row_simd::collect_places::<DIST2>(points, places, &query.ball, hits);
                } else {
                    row_simd::collect_marked::<DIST2>(simd, points, own, &query.ball, record, hits);
                }
                maker.make_row::<DIST2>(hits, question);
                visit(&query, hits, 0);
            }
        }
    }
}

/// Whether a record holds places: they take less than marks where few of many candidates are inside.
fn are_places(found: u32, n_mark_bytes: usize) -> bool {
    (found as usize) < n_mark_bytes / PLACE_BYTES
}

/// Length of the row of a query with so many neighbours.
fn row_len(found: u32, question: &FixedRadius<'_>) -> u32 {
    found.min(question.max_neighbors.unwrap_or(u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generate::{CloudKind, cloud};
    use crate::structure::{BruteForce, GridSettings, UniformGrid};

    /// Entries of all rows, and the bytes that hold them.
    fn sizes<S: CpuStructure>(structure: &S, question: &FixedRadius<'_>) -> (u64, u64) {
        let mut visits = Visits::prepare(structure, question).unwrap();
        let points = structure.points();
        let tasks = visits.each_part(FoundRows::new, |visits, rows, places, spans| {
            rows.find(visits, points, places, spans, |_, _| true)
        });
        tasks.iter().map(FoundRows::sizes).fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    }

    #[test]
    fn rows_take_less_while_they_are_found_than_in_the_list() {
        let points = cloud(CloudKind::Uniform, 20_000, 7).points;
        let radius = 0.08;
        let grid = UniformGrid::build(&points, &GridSettings::for_radius(radius)).unwrap();
        let (entries, bytes) = sizes(&grid, &FixedRadius::new(radius));
        assert!(entries > 30 * 20_000 && 5 * bytes < 2 * 4 * entries, "{bytes} bytes for {entries} entries");
        // Few of many candidates: places, whose vectors grow by doubling, and 12 bytes a query beside them.
        let all = BruteForce::build(&points).unwrap();
        let (entries, bytes) = sizes(&all, &FixedRadius::new(radius));
        assert!(bytes < 8 * entries + 12 * 20_000, "{bytes} bytes for {entries} entries");
    }

    #[test]
    fn a_cap_bounds_what_is_held() {
        let points = cloud(CloudKind::Uniform, 3000, 7).points;
        let all = BruteForce::build(&points).unwrap();
        for cap in [0, 1, 8] {
            let (entries, bytes) = sizes(&all, &FixedRadius::new(2.0).max_neighbors(cap));
            assert_eq!(entries, 3000 * u64::from(cap));
            assert!(bytes <= 3000 * (24 + 16 * u64::from(cap)), "{bytes} bytes for a cap of {cap}");
        }
    }

    #[test]
    fn what_is_found_is_told_before_it_is_much() {
        let points = cloud(CloudKind::Uniform, 20_000, 7).points;
        let grid = UniformGrid::build(&points, &GridSettings::for_radius(0.1)).unwrap();
        let question = FixedRadius::new(0.1);
        let mut visits = Visits::prepare(&grid, &question).unwrap();
        let points = grid.points();
        let tasks = visits.each_part(FoundRows::new, |visits, rows, places, spans| {
            rows.find(visits, points, places, spans, |_, _| false)
        });
        let entries: u64 = tasks.iter().map(|task| task.sizes().0).sum();
        // A task ends a row after the step, and each thread may be at one.
        let most = (REPORT_STEP + 20_000) * rayon::current_num_threads() as u64;
        assert!(entries <= most, "{entries} entries, at most {most}");
    }
}
