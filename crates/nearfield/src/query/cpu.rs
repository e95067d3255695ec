//! Fixed-radius queries over any CPU structure: packs of queries in parallel, each pack with one set of spans.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::coherent;
use super::packs::{look_up, visit_in_parts, visit_pack};
use super::rows::{self, TaskRows};
use super::{
    Clock, Counts, FixedRadius, Nearest, Neighbor, NeighborRows, NeighborSearch, Neighbors, Queries, Report, RowOrder,
    Stage,
};
use crate::geometry::row_simd::{self, Ball, Hits, Simd};
use crate::geometry::{Aabb, OrderedPoints};
use crate::structure::CpuStructure;
use crate::{Error, Result};

/// Queries of a task: enough to hide the cost of handing it out, few enough to balance uneven rows.
const TASK_QUERIES: usize = 4096;

/// Queries in searching order.
pub(super) struct OrderedQueries<'a> {
    pub(super) points: Cow<'a, OrderedPoints>,
    pub(super) packs: Cow<'a, [u32]>,
    /// The leaf of each pack, where the structure is a tree that is searched coherently.
    pub(super) leaves: Vec<usize>,
}

impl OrderedQueries<'_> {
    /// Places of the queries of a pack.
    pub(super) fn pack(&self, pack: usize) -> Range<usize> {
        self.packs[pack] as usize..self.packs[pack + 1] as usize
    }
}

/// One query with everything its search needs.
pub(super) struct Query<'a> {
    /// The caller's index.
    pub(super) id: u32,
    pub(super) ball: Ball,
    /// Where candidates are.
    pub(super) spans: &'a [Range<usize>],
}

pub(super) fn ordered<'a, S: CpuStructure>(structure: &'a S, queries: Queries<'_>) -> Result<OrderedQueries<'a>> {
    if let Some(tree) = structure.coherent_tree() {
        return Ok(coherent::pack_by_leaf(tree, queries));
    }
    Ok(match queries {
        Queries::Points => OrderedQueries {
            points: Cow::Borrowed(structure.points()),
            packs: Cow::Borrowed(structure.packs()),
            leaves: Vec::new(),
        },
        Queries::Other(queries) => {
            let packed = structure.pack_queries(queries)?;
            OrderedQueries {
                points: Cow::Owned(OrderedPoints::gather(queries, &packed.order)),
                packs: Cow::Owned(packed.packs),
                leaves: Vec::new(),
            }
        }
    })
}

/// What every task made, in searching order, and the times of the phases where the search has phases.
pub(super) struct Made<T> {
    pub(super) tasks: Vec<T>,
    phases: Phases,
}

/// Times of the phases of a search; none where it has one phase.
#[derive(Default)]
struct Phases(Vec<Stage>);

impl Phases {
    /// Adds the time since `start`.
    fn end(&mut self, name: &'static str, start: Instant) {
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        self.0.push(Stage { name, milliseconds, clock: Clock::Host });
    }

    /// Adds the times to a report, or that of the one phase, which began at `start`.
    fn add_to(self, report: &mut Report, start: Instant) {
        if self.0.is_empty() {
            report.host_stage("query", start);
        }
        report.stages.extend(self.0);
    }
}

/// Runs `visit` on every query, tasks of packs in parallel; returns what each task made, in searching order.
/// `visit` returns false to stop all tasks.
pub(super) fn for_each_query<S, T>(
    structure: &S,
    question: &FixedRadius<'_>,
    start_task: impl Fn(usize) -> T + Sync,
    visit: impl Fn(&mut T, &Query<'_>) -> bool + Sync,
) -> Result<Made<T>>
where
    S: CpuStructure,
    T: Send,
{
    let mut phases = Phases::default();
    let start = Instant::now();
    let queries = ordered(structure, question.queries)?;
    let candidates = structure.coherent_tree().map(|tree| {
        phases.end("pack", start);
        let start = Instant::now();
        let candidates = coherent::find_candidates(tree, question, &queries);
        phases.end("traverse", start);
        candidates
    });
    let (points, packs) = (&*queries.points, &*queries.packs);
    let start = Instant::now();
    let stopped = AtomicBool::new(false);
    let tasks = tasks(packs)
        .into_par_iter()
        .map(|task| {
            let n = packs[task.end] - packs[task.start];
            let mut made = start_task(n as usize);
            let mut looked_up = Vec::new();
            for pack in task {
                if stopped.load(Ordering::Relaxed) {
                    break;
                }
                let places = queries.pack(pack);
                let mut visit = |query: &Query<'_>| visit(&mut made, query);
                let goes_on = match &candidates {
                    Some(candidates) => visit_pack(structure, question, points, places, &candidates[pack], &mut visit),
                    None => {
                        look_up(structure, question, points, places.clone(), &mut looked_up);
                        visit_in_parts(structure, question, points, places, &looked_up, &mut visit)
                    }
                };
                if !goes_on {
                    stopped.store(true, Ordering::Relaxed);
                }
            }
            made
        })
        .collect();
    if candidates.is_some() {
        phases.end("extract", start);
    }
    Ok(Made { tasks, phases })
}

/// Cuts packs into tasks of about [`TASK_QUERIES`] queries; ranges of pack numbers.
pub(super) fn tasks(packs: &[u32]) -> Vec<Range<usize>> {
    let n_packs = packs.len().saturating_sub(1);
    let mut tasks = Vec::new();
    let mut first = 0;
    for pack in 0..n_packs {
        if (packs[pack + 1] - packs[first]) as usize >= TASK_QUERIES || pack + 1 == n_packs {
            tasks.push(first..pack + 1);
            first = pack + 1;
        }
    }
    tasks
}

pub(super) fn device_name() -> String {
    format!("cpu ({} threads, {})", rayon::current_num_threads(), Simd::best().name())
}

pub(super) fn report<S: CpuStructure>(structure: &S, kernel: &str) -> Report {
    Report {
        structure: S::NAME,
        search: structure.search(),
        device: device_name(),
        kernels: vec![kernel.to_owned()],
        batches: 1,
        ..Report::default()
    }
}

impl<S: CpuStructure> NeighborSearch for S {
    fn structure(&self) -> &'static str {
        S::NAME
    }

    fn device(&self) -> String {
        device_name()
    }

    fn len(&self) -> usize {
        self.points().len()
    }

    fn memory_bytes(&self) -> u64 {
        CpuStructure::memory_bytes(self)
    }

    fn build_stages(&self) -> Vec<Stage> {
        CpuStructure::build_stages(self).iter().map(Stage::from).collect()
    }

    fn count(&self, question: &FixedRadius<'_>) -> Result<Counts> {
        question.validate(self.points().len())?;
        let start = Instant::now();
        let (simd, points) = (Simd::best(), self.points());
        let made = for_each_query(self, question, Vec::with_capacity, |counts, query| {
            let count = row_simd::count(simd, points, query.spans, &query.ball);
            counts.push((query.id, count - u32::from(question.exclude_self)));
            true
        })?;
        let mut counts = vec![0; question.len(points.len())];
        for (id, count) in made.tasks.into_iter().flatten() {
            counts[id as usize] = count;
        }
        let mut report = report(self, "row_simd::count");
        made.phases.add_to(&mut report, start);
        Ok(Counts { counts, report })
    }

    fn list(&self, question: &FixedRadius<'_>) -> Result<Neighbors> {
        question.validate(self.points().len())?;
        let start = Instant::now();
        let n_queries = question.len(self.points().len());
        let plain = !question.distances && question.max_neighbors.is_none() && question.order != RowOrder::Distance;
        let made = match plain {
            true => find_rows::<S, false>(self, question)?,
            false => find_rows::<S, true>(self, question)?,
        };
        let Some(made) = made else {
            return Err(too_large(self, question)?);
        };
        let mut report = report(self, "row_simd::collect");
        made.phases.add_to(&mut report, start);
        let start = Instant::now();
        let mut neighbors = rows::assemble(made.tasks, n_queries, question.distances)?;
        report.host_stage("assemble", start);
        neighbors.report = report;
        Ok(neighbors)
    }

    fn nearest(&self, question: &FixedRadius<'_>) -> Result<Nearest> {
        question.validate(self.points().len())?;
        let start = Instant::now();
        let (simd, points) = (Simd::best(), self.points());
        let made = for_each_query(
            self,
            question,
            |n| (Vec::with_capacity(n), Hits::default()),
            |(found, hits), query| {
                hits.clear();
                row_simd::collect::<true>(simd, points, query.spans, &query.ball, hits);
                let nearest = hits
                    .iter()
                    .filter(|hit| !(question.exclude_self && hit.0 == query.id))
                    .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                found.push((query.id, nearest));
                true
            },
        )?;
        let n_queries = question.len(points.len());
        let (mut indices, mut dist2) = (vec![Nearest::NONE; n_queries], vec![f32::INFINITY; n_queries]);
        for (id, nearest) in made.tasks.into_iter().flat_map(|(found, _)| found) {
            if let Some((index, d2)) = nearest {
                indices[id as usize] = index;
                dist2[id as usize] = d2;
            }
        }
        let mut report = report(self, "row_simd::collect");
        made.phases.add_to(&mut report, start);
        Ok(Nearest { indices, dist2, report })
    }
}

/// All rows, task by task; `None` where they pass the memory that the answer may take.
fn find_rows<S: CpuStructure, const DIST2: bool>(
    structure: &S,
    question: &FixedRadius<'_>,
) -> Result<Option<Made<TaskRows>>> {
    let (simd, points) = (Simd::best(), structure.points());
    let limit = rows::entry_limit(question, points.len());
    let entries = AtomicU64::new(0);
    let fits = AtomicBool::new(true);
    let made = for_each_query(structure, question, TaskRows::new, |rows, query| {
        let before = rows.hits.ids.len();
        row_simd::collect::<DIST2>(simd, points, query.spans, &query.ball, &mut rows.hits);
        rows.finish_row::<DIST2>(query.id, before, question);
        let added = rows.take_unreported();
        let fine = added == 0 || entries.fetch_add(added, Ordering::Relaxed) + added <= limit;
        if !fine {
            fits.store(false, Ordering::Relaxed);
        }
        fine
    })?;
    let total: u64 = made.tasks.iter().map(|m| m.hits.ids.len() as u64).sum();
    Ok((fits.into_inner() && total <= limit).then_some(made))
}

/// The error for a list that does not fit, with the size it would have.
fn too_large<S: CpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Error> {
    let counts = structure.count(question)?;
    let cap = question.max_neighbors.unwrap_or(u32::MAX);
    let entries: u64 = counts.as_slice().iter().map(|&c| u64::from(c.min(cap))).sum();
    Ok(rows::too_large(entries, question, structure.points().len()))
}

/// Lists whose rows stand in the order in which they were finished.
///
/// Implemented for every CPU structure; `SearchOnDevice::list_rows_on_device` is its twin on the GPU.
pub trait ListRows: CpuStructure {
    /// Neighbours of every query as rows of start and length; order and cap of the question hold within a row.
    ///
    /// # Errors
    /// As [`NeighborSearch::list`].
    fn list_rows(&self, question: &FixedRadius<'_>) -> Result<NeighborRows>
    where
        Self: Sized,
    {
        question.validate(self.points().len())?;
        let start = Instant::now();
        let by_distance = question.max_neighbors.is_some() || question.order == RowOrder::Distance;
        let made = match by_distance {
            false => find_rows::<Self, false>(self, question)?,
            true => find_rows::<Self, true>(self, question)?,
        };
        let Some(made) = made else {
            return Err(too_large(self, question)?);
        };
        let mut rows = rows::concatenate(&made.tasks, question.len(self.points().len()))?;
        rows.report = report(self, "row_simd::collect");
        made.phases.add_to(&mut rows.report, start);
        Ok(rows)
    }
}

impl<S: CpuStructure> ListRows for S {}

/// Visits each neighbour with a closure that may stop early; no list is made.
///
/// Implemented for every CPU structure.
pub trait ForEachNeighbor: CpuStructure {
    /// Calls `visit(query, neighbor)` for every neighbour of every query, queries in parallel. `Break` ends the
    /// query's row, not the others. The order within a row is unspecified; the question's order, cap and distances
    /// do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`].
    fn for_each(
        &self,
        question: &FixedRadius<'_>,
        visit: impl Fn(u32, Neighbor) -> std::ops::ControlFlow<()> + Sync,
    ) -> Result<()>
    where
        Self: Sized,
    {
        question.validate(self.points().len())?;
        for_each_query(
            self,
            question,
            |_| Hits::default(),
            |hits, query| {
                let own = question.exclude_self.then_some(query.id);
                visit_row(self.points(), query.spans, &query.ball, own, hits, |neighbor| visit(query.id, neighbor));
                true
            },
        )?;
        Ok(())
    }

    /// Calls `visit` for every point within `radius` of `center`, until it returns `Break`.
    ///
    /// # Errors
    /// `InvalidRadius`, `NonFinite`, `CoordinateTooLarge`.
    fn for_each_at(
        &self,
        center: glam::Vec3,
        radius: f32,
        visit: impl FnMut(Neighbor) -> std::ops::ControlFlow<()>,
    ) -> Result<()>
    where
        Self: Sized,
    {
        FixedRadius::new(radius).queries(&[center]).validate(self.points().len())?;
        let mut spans = Vec::new();
        self.spans_near(&Aabb::new(center, center), radius, &mut spans);
        let ball = Ball { center, radius2: radius * radius, period: self.period() };
        visit_row(self.points(), &spans, &ball, None, &mut Hits::default(), visit);
        Ok(())
    }
}

impl<S: CpuStructure> ForEachNeighbor for S {}

/// Candidates tested between two looks at whether the visitor wants more.
const VISIT_STEP: usize = 256;

fn visit_row(
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    own: Option<u32>,
    hits: &mut Hits,
    mut visit: impl FnMut(Neighbor) -> std::ops::ControlFlow<()>,
) {
    let simd = Simd::best();
    for span in spans {
        for start in span.clone().step_by(VISIT_STEP) {
            hits.clear();
            let step = start..span.end.min(start + VISIT_STEP);
            row_simd::collect::<true>(simd, points, std::slice::from_ref(&step), ball, hits);
            for (index, dist2) in hits.iter() {
                if own != Some(index) && visit(Neighbor { index, dist2 }).is_break() {
                    return;
                }
            }
        }
    }
}
