//! Every kind of question, asked of one structure over one case and compared with the truth.

use std::ops::ControlFlow;
use std::sync::{Mutex, OnceLock};

use nearfield::{FixedRadius, Neighbor, RowOrder, Vec3};

use crate::cases::Case;
use crate::compare::{self, List, Rule, Verdict};
use crate::reference::{Hit, Problem};
use crate::subjects::{Asked, Built, Subject};
use crate::{boxes, knn};

/// Who asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Who {
    Points,
    Others,
}

/// How far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reach {
    /// The case's radius.
    Case,
    /// Exact duplicates.
    Zero,
    /// Beyond the diagonal: everything.
    All,
    /// One radius a query: zero, half, one and two times the case's.
    Each,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verb {
    Count,
    List,
    Nearest,
    Visit,
    VisitTwo,
}

/// A question, and how to name it.
struct Question {
    verb: Verb,
    who: Who,
    reach: Reach,
    exclude_self: bool,
    order: RowOrder,
    distances: bool,
    cap: Option<u32>,
}

const fn ask(verb: Verb, who: Who, reach: Reach) -> Question {
    Question { verb, who, reach, exclude_self: false, order: RowOrder::Unspecified, distances: false, cap: None }
}

impl Question {
    const fn without_self(mut self) -> Self {
        self.exclude_self = true;
        self
    }

    const fn by(mut self, order: RowOrder) -> Self {
        self.order = order;
        self
    }

    const fn with_distances(mut self) -> Self {
        self.distances = true;
        self
    }

    const fn cap(mut self, cap: u32) -> Self {
        self.cap = Some(cap);
        self
    }

    fn name(&self) -> String {
        let Self { verb, who, reach, exclude_self, order, distances, cap } = self;
        format!(
            "{verb:?} of {who:?} within {reach:?} (self left out {exclude_self}, {order:?}, distances {distances}, cap {cap:?})"
        )
    }
}

const QUESTIONS: &[Question] = &[
    ask(Verb::Count, Who::Points, Reach::Case),
    ask(Verb::Count, Who::Points, Reach::Case).without_self(),
    ask(Verb::Count, Who::Points, Reach::Zero),
    ask(Verb::Count, Who::Points, Reach::All),
    ask(Verb::Count, Who::Points, Reach::Each),
    ask(Verb::Count, Who::Others, Reach::Case),
    ask(Verb::Count, Who::Others, Reach::Each),
    ask(Verb::List, Who::Points, Reach::Case),
    ask(Verb::List, Who::Points, Reach::Case).by(RowOrder::Index),
    ask(Verb::List, Who::Points, Reach::Case).by(RowOrder::Distance),
    ask(Verb::List, Who::Points, Reach::Case).with_distances().without_self(),
    ask(Verb::List, Who::Points, Reach::Case).by(RowOrder::Index).with_distances(),
    ask(Verb::List, Who::Points, Reach::Case).by(RowOrder::Distance).with_distances().without_self(),
    ask(Verb::List, Who::Points, Reach::Case).by(RowOrder::Index).without_self(),
    ask(Verb::List, Who::Points, Reach::Case).cap(0),
    ask(Verb::List, Who::Points, Reach::Case).cap(1).without_self(),
    ask(Verb::List, Who::Points, Reach::Case).cap(3),
    ask(Verb::List, Who::Points, Reach::Case).cap(7).by(RowOrder::Index).with_distances(),
    ask(Verb::List, Who::Points, Reach::Case).cap(12).by(RowOrder::Distance).with_distances().without_self(),
    ask(Verb::List, Who::Points, Reach::Case).cap(u32::MAX).by(RowOrder::Distance),
    ask(Verb::List, Who::Points, Reach::Zero).by(RowOrder::Index).with_distances(),
    ask(Verb::List, Who::Points, Reach::All).by(RowOrder::Index),
    ask(Verb::List, Who::Points, Reach::All).cap(5).by(RowOrder::Distance).with_distances(),
    ask(Verb::List, Who::Points, Reach::Each).by(RowOrder::Distance).with_distances(),
    ask(Verb::List, Who::Points, Reach::Each).without_self().cap(4),
    ask(Verb::List, Who::Others, Reach::Case),
    ask(Verb::List, Who::Others, Reach::Case).by(RowOrder::Distance).with_distances(),
    ask(Verb::List, Who::Others, Reach::Case).cap(2).by(RowOrder::Index),
    ask(Verb::List, Who::Others, Reach::Zero).by(RowOrder::Index),
    ask(Verb::List, Who::Others, Reach::Each).by(RowOrder::Index).with_distances(),
    ask(Verb::Nearest, Who::Points, Reach::Case),
    ask(Verb::Nearest, Who::Points, Reach::Case).without_self(),
    ask(Verb::Nearest, Who::Points, Reach::Zero).without_self(),
    ask(Verb::Nearest, Who::Points, Reach::All).without_self(),
    ask(Verb::Nearest, Who::Points, Reach::Each).without_self(),
    ask(Verb::Nearest, Who::Others, Reach::Case),
    ask(Verb::Nearest, Who::Others, Reach::All),
    ask(Verb::Nearest, Who::Others, Reach::Each),
    ask(Verb::Visit, Who::Points, Reach::Case),
    ask(Verb::Visit, Who::Points, Reach::Case).without_self(),
    ask(Verb::Visit, Who::Others, Reach::Each),
    ask(Verb::VisitTwo, Who::Points, Reach::Case),
    ask(Verb::VisitTwo, Who::Points, Reach::Each).without_self(),
];

/// Above this many points, questions that reach everything are left out: n² entries.
pub(crate) const MOST_POINTS_FOR_ALL: usize = 1000;

/// Pairs of query and point whose distances are kept for questions without a radius.
const MOST_PAIRS_EVERYWHERE: usize = 1_000_000;

/// Above this many points, no query without a radius comes from so far that all of them are equally near.
const MOST_POINTS_FROM_AFAR: usize = 1500;

/// A case with its true answers, found once for all subjects.
pub(crate) struct Solved<'a> {
    pub(crate) case: &'a Case,
    /// The number of the case, by which software devices take turns.
    pub(crate) number: usize,
    problems: [OnceLock<Problem<'a>>; 8],
    everywhere: [OnceLock<Problem<'a>>; 2],
}

impl<'a> Solved<'a> {
    pub(crate) fn new(case: &'a Case, number: usize) -> Self {
        Self { case, number, problems: Default::default(), everywhere: Default::default() }
    }

    pub(crate) fn problem(&self, who: Who, reach: Reach) -> &Problem<'a> {
        self.problems[(who as usize) * 4 + reach as usize].get_or_init(|| {
            let queries = match who {
                Who::Points => &self.case.points,
                Who::Others => &self.case.queries,
            };
            let radius = |i: usize| match reach {
                Reach::Case => self.case.radius,
                Reach::Zero => 0.0,
                Reach::All => beyond_everything(self.case),
                Reach::Each => usable(self.case.radius * [0.0, 0.5, 1.0, 2.0][i % 4]),
            };
            let radii = (0..queries.len()).map(radius).collect();
            Problem::solve(&self.case.points, queries, who == Who::Points, radii, self.case.period)
        })
    }

    /// All distances of a sample of the queries: the points, or the others. Of these the last ones, behind those that see
    /// all of a large cloud equally far away: they look at all of it, which a software renderer refuses.
    pub(crate) fn everywhere(&self, own: bool) -> &Problem<'a> {
        self.everywhere[usize::from(own)].get_or_init(|| {
            let is_large = self.case.points.len() > MOST_POINTS_FROM_AFAR;
            let is_far = |q: &Vec3| is_large && q.abs().max_element() >= 1e9;
            let first_near = self.case.queries.iter().rposition(is_far).map_or(0, |last_far| last_far + 1);
            let queries = if own { &self.case.points[..] } else { &self.case.queries[first_near..] };
            let radii = vec![compare::EVERYWHERE; queries.len()];
            Problem::sampled(&self.case.points, queries, own, radii, self.case.period, MOST_PAIRS_EVERYWHERE)
        })
    }

    /// The true answers to the case's own radius, its points asking.
    pub(crate) fn own(&self) -> &Problem<'a> {
        self.problem(Who::Points, Reach::Case)
    }
}

/// The radius, raised to the smallest that can be searched.
pub(crate) fn usable(radius: f32) -> f32 {
    if radius > 0.0 { radius.max(1.1e-19) } else { 0.0 }
}

/// A radius that reaches every point from every query, within the domain of radii.
fn beyond_everything(case: &Case) -> f32 {
    let largest = case.points.iter().chain(&case.queries).map(|p| p.abs().max_element()).fold(1e-18, f32::max);
    (4.0 * largest).min(1.8e19)
}

/// Asks every question of `built` and compares each answer.
pub(crate) fn ask_everything(subject: &Subject, built: &dyn Built, solved: &Solved<'_>) -> Verdict {
    for (turn, question) in QUESTIONS.iter().enumerate() {
        let is_too_much = question.reach == Reach::All && solved.case.points.len() > MOST_POINTS_FOR_ALL;
        if is_too_much || !subject.takes_turn(solved.number + turn) {
            continue;
        }
        let problem = solved.problem(question.who, question.reach);
        let rule = subject.rule(solved.case.exact && problem.own);
        put(subject, built, question, problem, rule)
            .map_err(|difference| format!("{}: {difference}", question.name()))?;
    }
    if built.visit_at(Vec3::ZERO, 0.0, &|_, _| ControlFlow::Continue(())).is_some() {
        check_visits_at(built, solved.problem(Who::Others, Reach::Case))?;
    }
    knn::ask_everything(subject, built, solved)?;
    boxes::ask_everything(subject, built, solved.case).map_err(|difference| format!("points in boxes: {difference}"))
}

fn put(subject: &Subject, built: &dyn Built, ask: &Question, problem: &Problem<'_>, rule: Rule) -> Verdict {
    let mut question = match ask.reach {
        Reach::Each => FixedRadius::each(&problem.radii),
        _ => FixedRadius::new(problem.radii.first().copied().unwrap_or(0.0)),
    };
    if !problem.own {
        question = question.queries(problem.queries);
    }
    question.exclude_self = ask.exclude_self;
    question.order = ask.order;
    question.distances = ask.distances;
    question.max_neighbors = ask.cap;
    let in_words = |error: nearfield::Error| error.to_string();
    match ask.verb {
        Verb::Count => {
            let counts = built.count(&question).map_err(in_words)?;
            compare::counts(problem, &question, counts.as_slice(), rule)?;
            subject.check_report(&counts.report, Asked::Count)
        }
        Verb::List => {
            let list = built.list(&question).map_err(in_words)?;
            let slices =
                List { offsets: list.offsets(), indices: list.indices(), distances: list.distances(), cut: list.cut() };
            compare::list(problem, &question, &slices, rule)?;
            let sorted = question.order != RowOrder::Unspecified;
            let asked =
                if ask.cap.is_some() { Asked::CappedList } else { Asked::List { sorted, distances: ask.distances } };
            subject.check_report(&list.report, asked)
        }
        Verb::Nearest => {
            let nearest = built.nearest(&question).map_err(in_words)?;
            let found: Vec<Option<Neighbor>> = (0..nearest.len()).map(|i| nearest.get(i)).collect();
            compare::nearest(problem, &question, &found, rule)?;
            subject.check_report(&nearest.report, Asked::Nearest)
        }
        Verb::Visit => match visited(built, &question, problem.queries.len(), usize::MAX) {
            Some(rows) => compare::visits(problem, &question, &rows.map_err(in_words)?),
            None => Ok(()),
        },
        Verb::VisitTwo => match visited(built, &question, problem.queries.len(), 2) {
            Some(rows) => compare::first_visits(problem, &question, &rows.map_err(in_words)?),
            None => Ok(()),
        },
    }
}

/// The neighbours that a visitor sees which stops each row after `most`.
fn visited(
    built: &dyn Built,
    question: &FixedRadius<'_>,
    n_queries: usize,
    most: usize,
) -> Option<nearfield::Result<Vec<Vec<Hit>>>> {
    let rows: Vec<Mutex<Vec<Hit>>> = (0..n_queries).map(|_| Mutex::default()).collect();
    let visitor = |query: u32, neighbor: Neighbor| {
        let mut row = rows[query as usize].lock().expect("no visitor should panic");
        row.push((neighbor.index, neighbor.dist2));
        if row.len() >= most { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let outcome = built.visit(question, &visitor)?;
    let taken = || rows.into_iter().map(|row| row.into_inner().expect("no visitor should panic")).collect();
    Some(outcome.map(|()| taken()))
}

/// Visits the neighbours of each query by itself.
fn check_visits_at(built: &dyn Built, problem: &Problem<'_>) -> Verdict {
    let mut rows = vec![];
    for (&center, &radius) in problem.queries.iter().zip(&problem.radii) {
        let row = Mutex::new(Vec::new());
        let visitor = |_, neighbor: Neighbor| {
            row.lock().expect("no visitor should panic").push((neighbor.index, neighbor.dist2));
            ControlFlow::Continue(())
        };
        if let Some(Err(error)) = built.visit_at(center, radius, &visitor) {
            return Err(format!("visit at {center}: {error}"));
        }
        rows.push(row.into_inner().expect("no visitor should panic"));
    }
    compare::visits(problem, &FixedRadius::new(0.0), &rows).map_err(|difference| format!("visit at: {difference}"))
}
