//! The k nearest points of every case: k around the capacities of leaves, without any, and more than there are; with and
//! without a radius, which may be zero, lie exactly on distances, reach everything, or be one for each query.

use nearfield::{Knn, NearestNeighbors};

use crate::compare::{self, NearestRows, Verdict};
use crate::questions::{self, Reach, Solved, Who};
use crate::subjects::{Asked, Built, Subject};

/// Who asks, for how many, within what radius if any, and whether without the point itself.
struct Question {
    own: bool,
    k: u32,
    reach: Option<Reach>,
    exclude_self: bool,
}

impl Question {
    const fn within(mut self, reach: Reach) -> Self {
        self.reach = Some(reach);
        self
    }
}

const fn points(k: u32) -> Question {
    Question { own: true, k, reach: None, exclude_self: false }
}

const fn points_without_self(k: u32) -> Question {
    Question { own: true, k, reach: None, exclude_self: true }
}

const fn others(k: u32) -> Question {
    Question { own: false, k, reach: None, exclude_self: false }
}

const QUESTIONS: &[Question] = &[
    points(0),
    points(1),
    points_without_self(1),
    points_without_self(3),
    points(16),
    points(31),
    points(32),
    points_without_self(32),
    points(33),
    points(128),
    others(0),
    others(1),
    others(4),
    others(33),
    points(0).within(Reach::Case),
    points(1).within(Reach::Case),
    points_without_self(1).within(Reach::Case),
    points(7).within(Reach::Case),
    points_without_self(33).within(Reach::Case),
    points(128).within(Reach::Case),
    points(3).within(Reach::Zero),
    points_without_self(2).within(Reach::Zero),
    points_without_self(5).within(Reach::All),
    points(4).within(Reach::Each),
    points_without_self(16).within(Reach::Each),
    others(1).within(Reach::Case),
    others(12).within(Reach::Case),
    others(2).within(Reach::Zero),
    others(3).within(Reach::All),
    others(6).within(Reach::Each),
];

/// Up to this many points, all and more than all of them are asked for, too.
const MOST_POINTS_FOR_ALL: usize = 100;

/// Above this many points, software devices leave out the largest k without a radius.
const MOST_POINTS_FOR_LARGEST_K: usize = 700;

/// Asks every question, where the structure answers them.
pub(crate) fn ask_everything(subject: &Subject, built: &dyn Built, solved: &Solved<'_>) -> Verdict {
    let n = solved.case.points.len();
    let beyond = [points(2 * n as u32 + 3), points_without_self(n as u32), others(n as u32 + 1)];
    let beyond = beyond.iter().filter(|_| n <= MOST_POINTS_FOR_ALL);
    // One neighbour more or less than a leaf holds.
    let is_asked = |(turn, question): &(usize, &Question)| {
        let is_too_much = question.reach == Some(Reach::All) && n > questions::MOST_POINTS_FOR_ALL;
        let is_long = question.k == 128 && question.reach.is_none() && n > MOST_POINTS_FOR_LARGEST_K;
        let is_special = [31, 33].contains(&question.k) || is_long || !subject.asks_nearest();
        !is_too_much && (subject.asks_everything() || !is_special) && subject.takes_turn(solved.number + turn)
    };
    let asked = QUESTIONS.iter().enumerate().filter(is_asked).map(|(_, question)| question);
    for question in asked.chain(beyond) {
        let &Question { own, k, reach, exclude_self } = question;
        put(subject, built, solved, question).map_err(|difference| {
            format!("{k} nearest within {reach:?}, of points {own}, self left out {exclude_self}: {difference}")
        })?;
    }
    Ok(())
}

fn put(subject: &Subject, built: &dyn Built, solved: &Solved<'_>, ask: &Question) -> Verdict {
    let who = if ask.own { Who::Points } else { Who::Others };
    let problem = ask.reach.map_or_else(|| solved.everywhere(ask.own), |reach| solved.problem(who, reach));
    let mut question = Knn::new(ask.k);
    match ask.reach {
        None => {}
        Some(Reach::Each) => question = question.within_each(&problem.radii),
        Some(_) => question = question.within(problem.radii.first().copied().unwrap_or(0.0)),
    }
    if !ask.own {
        question = question.queries(problem.queries);
    }
    question.exclude_self = ask.exclude_self;
    let Some(answer) = built.knn(&question) else { return Ok(()) };
    let answer = answer.map_err(|error| error.to_string())?;
    if answer.len() != problem.queries.len() || answer.k() != ask.k as usize {
        return Err(format!("{} rows of {}", answer.len(), answer.k()));
    }
    let rows = NearestRows { k: answer.k(), indices: answer.indices(), distances: answer.distances() };
    compare::knn(problem, ask.exclude_self, &rows, subject.rule(solved.case.exact && problem.own))?;
    check_accessors(&answer)?;
    subject.check_report(&answer.report, Asked::Knn)
}

/// Rows and single neighbours are parts of the arrays.
fn check_accessors(answer: &NearestNeighbors) -> Verdict {
    for i in 0..answer.len() {
        let (start, found) = (i * answer.k(), answer.found(i));
        let same = answer.row(i) == &answer.indices()[start..start + found]
            && answer.row_distances(i) == &answer.distances()[start..start + found]
            && answer.nearest(i).map(|n| n.index) == answer.row(i).first().copied();
        if !same {
            return Err(format!("row {i} is not that of the arrays"));
        }
    }
    Ok(())
}
