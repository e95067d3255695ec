//! Every query of a question over a CPU structure: packs of queries with one set of candidates, tasks of packs in parallel.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::packs::{look_up, visit_in_parts};
use super::{Clock, FixedRadius, Queries, Report, Stage, coherent};
use crate::Result;
use crate::geometry::OrderedPoints;
use crate::geometry::row_simd::Ball;
use crate::structure::CpuStructure;

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

/// The queries of a question in the order in which a structure searches them.
///
/// # Errors
/// As the structure's `pack_queries`.
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

/// A question over a structure, its queries in order and, where the structure is searched coherently, their candidates.
pub(super) struct Visits<'a, S> {
    structure: &'a S,
    pub(super) question: &'a FixedRadius<'a>,
    pub(super) queries: OrderedQueries<'a>,
    candidates: Option<Vec<Vec<Range<usize>>>>,
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
}

impl<'a, S: CpuStructure> Visits<'a, S> {
    /// Orders the queries and finds candidates that are found for all packs beforehand.
    ///
    /// # Errors
    /// As the structure's `pack_queries`.
    pub(super) fn prepare(structure: &'a S, question: &'a FixedRadius<'a>) -> Result<Self> {
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
        Ok(Self { structure, question, queries, candidates, phases })
    }

    /// The query at a place of the order, with its candidates.
    #[inline]
    pub(super) fn query<'s>(&self, place: usize, spans: &'s [Range<usize>]) -> Query<'s> {
        let points = &*self.queries.points;
        let id = points.id(place);
        let radius = self.question.radius_of(id as usize);
        let ball = Ball { center: points.position(place), radius2: radius * radius, period: self.structure.period() };
        Query { id, ball, spans }
    }

    /// The place of the query itself among the points, where it is to be left out: then the queries are the points, in the
    /// structure's order.
    pub(super) fn own_place(&self, place: usize) -> Option<usize> {
        self.question.exclude_self.then_some(place)
    }

    /// Calls `visit` with the places of queries that have candidates in common, and with these; returns what each task made,
    /// in searching order. `visit` returns false to stop all tasks.
    pub(super) fn each_part<T: Send>(
        &mut self,
        start_task: impl Fn(usize) -> T + Sync,
        visit: impl Fn(&Self, &mut T, Range<usize>, &[Range<usize>]) -> bool + Sync,
    ) -> Vec<T> {
        let this = &*self;
        let (points, packs) = (&*this.queries.points, &*this.queries.packs);
        let start = Instant::now();
        let stopped = AtomicBool::new(false);
        let run = |task: Range<usize>| {
            let mut made = start_task((packs[task.end] - packs[task.start]) as usize);
            let mut looked_up = Vec::new();
            for pack in task {
                if stopped.load(Ordering::Relaxed) {
                    break;
                }
                let places = this.queries.pack(pack);
                let mut visit = |places: Range<usize>, spans: &[Range<usize>]| visit(this, &mut made, places, spans);
                let goes_on = match &this.candidates {
                    Some(candidates) => visit(places, &candidates[pack]),
                    None => {
                        look_up(this.structure, this.question, points, places.clone(), &mut looked_up);
                        visit_in_parts(this.structure, this.question, points, places, &looked_up, &mut visit)
                    }
                };
                if !goes_on {
                    stopped.store(true, Ordering::Relaxed);
                }
            }
            made
        };
        let made = tasks(packs).into_par_iter().map(run).collect();
        if self.candidates.is_some() {
            self.phases.end("extract", start);
        }
        made
    }

    /// Adds the times of the phases to a report, or that of the one phase, which took until now from `start` on.
    pub(super) fn add_times(&mut self, report: &mut Report, start: Instant) {
        if self.phases.0.is_empty() {
            report.host_stage("query", start);
        }
        report.stages.append(&mut self.phases.0);
    }
}

/// Runs `visit` on every query, tasks of packs in parallel; returns what each task made, in searching order, and the visits,
/// which have the times. `visit` returns false to stop all tasks.
///
/// # Errors
/// As [`Visits::prepare`].
pub(super) fn for_each_query<'a, S: CpuStructure, T: Send>(
    structure: &'a S,
    question: &'a FixedRadius<'a>,
    start_task: impl Fn(usize) -> T + Sync,
    visit: impl Fn(&mut T, &Query<'_>) -> bool + Sync,
) -> Result<(Vec<T>, Visits<'a, S>)> {
    let mut visits = Visits::prepare(structure, question)?;
    let tasks = visits.each_part(start_task, |visits, made, mut places, spans| {
        places.all(|place| visit(made, &visits.query(place, spans)))
    });
    Ok((tasks, visits))
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
