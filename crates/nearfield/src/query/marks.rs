//! Rows of neighbours while they are found: of every query a bit a candidate, a fifth of the memory of the row itself.
//!
//! A list is made in two looks. The first marks what is inside each ball and knows how long every row is; the second writes
//! rows to their places, with no rows in between whose memory would have to be touched for the first time.

use std::ops::Range;

use super::FixedRadius;
use super::visit::{Query, Visits};
use crate::geometry::OrderedPoints;
use crate::geometry::row_simd::{self, Hits, Simd};
use crate::structure::CpuStructure;

/// Bytes of a place where it is kept instead of marks.
const PLACE_BYTES: usize = size_of::<u32>();

/// What one task found, in searching order.
#[derive(Debug, Default)]
pub(super) struct TaskMarks {
    parts: Vec<MarkedPart>,
    /// Spans of all parts, one part after the other.
    spans: Vec<Range<usize>>,
    /// Neighbours of each query, however many of them go into its row.
    found: Vec<u32>,
    /// One record a query: a bit a candidate, or the places of what was found where that takes less.
    records: Vec<u8>,
    /// Entries and bytes that others know of.
    reported: (u64, u64),
    entries: u64,
}

/// Queries at consecutive places that have the same candidates.
#[derive(Debug)]
struct MarkedPart {
    places: Range<usize>,
    n_spans: usize,
}

/// Entries a task adds between two looks at what all tasks have.
const REPORT_STEP: u64 = 1 << 18;

impl TaskMarks {
    /// Room for the records of so many queries.
    pub(super) fn new(n_queries: usize) -> Self {
        Self { found: Vec::with_capacity(n_queries), ..Self::default() }
    }

    /// Marks the candidates in `spans` of the queries at `places`; `visits` has the queries, `points` the candidates. Now and
    /// then `tell` is called with the entries and the bytes added since; returns false once it does, and is not to be used then.
    pub(super) fn mark<S: CpuStructure>(
        &mut self,
        visits: &Visits<'_, S>,
        points: &OrderedPoints,
        places: Range<usize>,
        spans: &[Range<usize>],
        tell: impl Fn(u64, u64) -> bool,
    ) -> bool {
        let simd = Simd::best();
        let n_bytes = row_simd::mark_bytes(spans);
        for place in places.clone() {
            let begin = self.records.len();
            let query = visits.query(place, spans);
            let mut found = row_simd::mark(simd, points, spans, &query.ball, &mut self.records);
            if visits.question.exclude_self {
                // The queries are the points, in the structure's order: what stands at this place is the query itself.
                found -= u32::from(row_simd::unmark(spans, place, &mut self.records[begin..]));
            }
            if are_places(found, n_bytes) {
                let inside: Vec<u32> = row_simd::marked(spans, &self.records[begin..]).map(|i| i as u32).collect();
                self.records.truncate(begin);
                self.records.extend(inside.into_iter().flat_map(u32::to_le_bytes));
            }
            self.found.push(found);
            self.entries += u64::from(row_len(found, visits.question));
            if self.entries - self.reported.0 >= REPORT_STEP && !self.report(&tell) {
                return false;
            }
        }
        self.parts.push(MarkedPart { places, n_spans: spans.len() });
        self.spans.extend_from_slice(spans);
        true
    }

    fn report(&mut self, tell: impl Fn(u64, u64) -> bool) -> bool {
        let sizes = self.sizes();
        let added = (sizes.0 - self.reported.0, sizes.1 - self.reported.1);
        self.reported = sizes;
        tell(added.0, added.1)
    }

    /// Number of queries.
    pub(super) fn len(&self) -> usize {
        self.found.len()
    }

    /// Entries of the rows, and bytes that this holds.
    pub(super) fn sizes(&self) -> (u64, u64) {
        let bytes = self.records.capacity()
            + self.found.capacity() * size_of::<u32>()
            + self.spans.capacity() * size_of::<Range<usize>>()
            + self.parts.capacity() * size_of::<MarkedPart>();
        (self.entries, bytes as u64)
    }

    /// Calls `visit` with every query and the length of its row, in searching order.
    pub(super) fn each_length<S: CpuStructure>(&self, visits: &Visits<'_, S>, mut visit: impl FnMut(u32, u32)) {
        let places = self.parts.iter().flat_map(|part| part.places.clone());
        for (place, &found) in places.zip(&self.found) {
            visit(visits.queries.points.id(place), row_len(found, visits.question));
        }
    }

    /// Calls `visit` with every query and its neighbours, in searching order.
    pub(super) fn each_row<S: CpuStructure, const DIST2: bool>(
        &self,
        visits: &Visits<'_, S>,
        points: &OrderedPoints,
        hits: &mut Hits,
        mut visit: impl FnMut(&Query<'_>, &mut Hits),
    ) {
        let simd = Simd::best();
        let (mut spans, mut records, mut found) = (&self.spans[..], &self.records[..], self.found.iter());
        for part in &self.parts {
            let (own, others) = spans.split_at(part.n_spans);
            spans = others;
            let n_bytes = row_simd::mark_bytes(own);
            for (place, &found) in part.places.clone().zip(found.by_ref()) {
                hits.clear();
                let query = visits.query(place, own);
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
                visit(&query, hits);
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
