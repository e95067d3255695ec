//! Differences planted in a right answer: every comparison must find each of them, and let the right answer pass.

use libtest_mimic::Trial;
use nearfield::query::{CutRow, Neighbor};
use nearfield::{Aabb, FixedRadius, RowOrder, Vec3};

use crate::compare::{self, List, NearestRows, Rule, Verdict};
use crate::reference::Problem;

/// A list in plain vectors, to be changed at will.
#[derive(Debug, Clone)]
struct Owned {
    offsets: Vec<u64>,
    indices: Vec<u32>,
    distances: Option<Vec<f32>>,
    cut: Vec<CutRow>,
}

impl Owned {
    fn as_list(&self) -> List<'_> {
        let Self { offsets, indices, distances, cut } = self;
        List { offsets, indices, distances: distances.as_deref(), cut }
    }

    fn remove(&mut self, row: usize, place: usize) {
        let at = self.offsets[row] as usize + place;
        self.indices.remove(at);
        if let Some(distances) = &mut self.distances {
            distances.remove(at);
        }
        self.offsets[row + 1..].iter_mut().for_each(|offset| *offset -= 1);
    }

    fn insert(&mut self, row: usize, place: usize, index: u32, distance: f32) {
        let at = self.offsets[row] as usize + place;
        self.indices.insert(at, index);
        if let Some(distances) = &mut self.distances {
            distances.insert(at, distance);
        }
        self.offsets[row + 1..].iter_mut().for_each(|offset| *offset += 1);
    }

    fn swap(&mut self, row: usize, a: usize, b: usize) {
        let start = self.offsets[row] as usize;
        self.indices.swap(start + a, start + b);
        if let Some(distances) = &mut self.distances {
            distances.swap(start + a, start + b);
        }
    }
}

/// Points on a line at 0, 1, 2, 2 (again), 3, 10: with radius 2 the row of point 0 is 0, 1, 2, 3.
fn line() -> Vec<Vec3> {
    [0.0, 1.0, 2.0, 2.0, 3.0, 10.0].map(|x| Vec3::new(x, 0.0, 0.0)).to_vec()
}

fn problem(points: &[Vec3]) -> Problem<'_> {
    Problem::solve(points, points, true, vec![2.0; points.len()], Vec3::ZERO)
}

/// Rows of [`line`] written down by hand; within a row by index.
fn by_index() -> Owned {
    let rows: [&[u32]; 6] = [&[0, 1, 2, 3], &[0, 1, 2, 3, 4], &[0, 1, 2, 3, 4], &[0, 1, 2, 3, 4], &[1, 2, 3, 4], &[5]];
    from_rows(&rows)
}

/// The same by distance, ties by index.
fn by_distance() -> Owned {
    let rows: [&[u32]; 6] = [&[0, 1, 2, 3], &[1, 0, 2, 3, 4], &[2, 3, 1, 4, 0], &[2, 3, 1, 4, 0], &[4, 2, 3, 1], &[5]];
    from_rows(&rows)
}

/// The nearest two, by distance.
fn nearest_two() -> Owned {
    let mut list = from_rows(&[&[0, 1], &[1, 0], &[2, 3], &[2, 3], &[4, 2], &[5]]);
    let cut = [(0, 2), (1, 3), (2, 3), (3, 3), (4, 2)];
    list.cut = cut.map(|(query, missing)| CutRow { query, missing }).to_vec();
    list
}

fn from_rows(rows: &[&[u32]]) -> Owned {
    let x = [0.0f32, 1.0, 2.0, 2.0, 3.0, 10.0];
    let mut list = Owned { offsets: vec![0], indices: vec![], distances: Some(vec![]), cut: vec![] };
    for (query, row) in rows.iter().enumerate() {
        list.indices.extend_from_slice(row);
        list.distances.as_mut().expect("made above").extend(row.iter().map(|&i| (x[query] - x[i as usize]).abs()));
        list.offsets.push(list.indices.len() as u64);
    }
    list
}

/// A change of a list, and its name.
type Change = (&'static str, fn(&mut Owned));

const CHANGES_BY_INDEX: &[Change] = &[
    ("a-missing-neighbor", |list| list.remove(0, 1)),
    ("an-extra-neighbor", |list| list.insert(0, 4, 5, 10.0)),
    ("an-extra-neighbor-with-a-false-distance", |list| list.insert(0, 4, 5, 2.0)),
    ("a-neighbor-that-stands-twice", |list| list.insert(0, 1, 1, 1.0)),
    ("a-neighbor-replaced-by-another-twice", |list| {
        list.remove(1, 2);
        list.insert(1, 3, 3, 1.0);
    }),
    ("a-wrong-order", |list| list.swap(0, 1, 2)),
    ("a-wrong-order-of-equal-points", |list| list.swap(1, 2, 3)),
    ("a-wrong-distance", |list| list.distances.as_mut().expect("asked for")[1] = 1.00001),
    ("a-distance-of-nan", |list| list.distances.as_mut().expect("asked for")[1] = f32::NAN),
    ("a-squared-distance", |list| list.distances.as_mut().expect("asked for")[2] = 4.0),
    ("no-distances", |list| list.distances = None),
    ("an-index-out-of-range", |list| list.insert(5, 1, 6, 2.0)),
    ("the-index-that-stands-for-none", |list| list.insert(5, 1, u32::MAX, 2.0)),
    ("an-entry-in-the-row-before", |list| list.offsets[1] += 1),
    ("an-entry-in-the-row-after", |list| list.offsets[2] -= 1),
    ("offsets-that-fall", |list| list.offsets.swap(1, 2)),
    ("a-first-offset-that-is-not-zero", |list| list.offsets[0] = 1),
    ("a-last-offset-that-is-too-small", |list| list.offsets[6] -= 1),
    ("a-row-too-few", |list| list.offsets.truncate(6)),
    ("a-row-too-many", |list| list.offsets.push(list.indices.len() as u64)),
    ("a-cut-without-a-cap", |list| list.cut.push(CutRow { query: 0, missing: 1 })),
    ("everything-empty", |list| *list = from_rows(&[&[], &[], &[], &[], &[], &[]])),
    ("everything-zero", |list| list.indices.fill(0)),
];

const CHANGES_BY_DISTANCE: &[Change] = &[
    ("a-farther-one-first", |list| list.swap(1, 0, 1)),
    ("a-tie-by-higher-index", |list| list.swap(2, 0, 1)),
    ("a-missing-nearest", |list| list.remove(4, 0)),
    ("distances-of-other-neighbors", |list| list.distances.as_mut().expect("asked for").swap(1, 2)),
];

const CHANGES_OF_THE_CUT: &[Change] = &[
    ("a-farther-neighbor-kept", |list| {
        list.remove(0, 1);
        list.insert(0, 1, 2, 2.0);
    }),
    ("a-tie-kept-by-higher-index", |list| {
        list.remove(4, 1);
        list.insert(4, 1, 3, 1.0);
    }),
    ("more-than-the-cap", |list| list.insert(0, 2, 2, 2.0)),
    ("fewer-than-the-cap", |list| list.remove(1, 1)),
    ("a-cut-not-reported", |list| list.cut.retain(|cut| cut.query != 2)),
    ("a-cut-of-the-wrong-size", |list| list.cut[2].missing = 1),
    ("a-cut-of-a-whole-row", |list| list.cut.push(CutRow { query: 5, missing: 1 })),
    ("cuts-out-of-order", |list| list.cut.swap(0, 1)),
];

/// The trials of all comparisons.
pub(crate) fn trials() -> Vec<Trial> {
    let in_index = FixedRadius::new(2.0).order(RowOrder::Index).distances();
    let in_distance = FixedRadius::new(2.0).order(RowOrder::Distance).distances();
    let capped = in_distance.max_neighbors(2);
    let mut trials = vec![];
    for rule in [Rule::Exact, Rule::Device] {
        let groups: [(&str, FixedRadius<'static>, fn() -> Owned, &'static [Change]); 3] = [
            ("by-index", in_index, by_index, CHANGES_BY_INDEX),
            ("by-distance", in_distance, by_distance, CHANGES_BY_DISTANCE),
            ("capped", capped, nearest_two, CHANGES_OF_THE_CUT),
        ];
        for (group, question, right, changes) in groups {
            let name = format!("planted/{rule:?}/{group}/the-right-list-passes");
            trials.push(crate::trial(name, move || check_list(&question, &right(), rule)));
            for (change, apply) in changes {
                let name = format!("planted/{rule:?}/{group}/{change}-is-found");
                let check = move || {
                    let mut list = right();
                    apply(&mut list);
                    must_fail(check_list(&question, &list, rule))
                };
                trials.push(crate::trial(name, check));
            }
        }
        trials.push(crate::trial(format!("planted/{rule:?}/self-left-in-is-found"), move || {
            must_fail(check_list(&in_index.exclude_self(), &by_index(), rule))
        }));
        trials.push(crate::trial(format!("planted/{rule:?}/wrong-counts-are-found"), move || check_counts(rule)));
        trials.push(crate::trial(format!("planted/{rule:?}/wrong-nearest-are-found"), move || check_nearest(rule)));
        trials.push(crate::trial(format!("planted/{rule:?}/wrong-k-nearest-are-found"), move || check_knn(rule)));
    }
    trials.push(crate::trial("planted/wrong-points-in-boxes-are-found".into(), check_boxes));
    trials.push(crate::trial("planted/wrong-visits-are-found".into(), check_visits));
    trials.push(crate::trial("planted/only-a-device-may-differ-and-only-at-the-boundary".into(), check_boundary));
    trials
}

fn must_fail(verdict: Verdict) -> Verdict {
    match verdict {
        Err(_) => Ok(()),
        Ok(()) => Err("the planted difference was not found".into()),
    }
}

fn check_list(question: &FixedRadius<'_>, list: &Owned, rule: Rule) -> Verdict {
    let points = line();
    compare::list(&problem(&points), question, &list.as_list(), rule)
}

fn check_counts(rule: Rule) -> Verdict {
    let points = line();
    let (problem, question) = (problem(&points), FixedRadius::new(2.0));
    let right = [4, 5, 5, 5, 4, 1];
    compare::counts(&problem, &question, &right, rule)?;
    compare::counts(&problem, &question.exclude_self(), &right.map(|c| c - 1), rule)?;
    must_fail(compare::counts(&problem, &question.exclude_self(), &right, rule))?;
    must_fail(compare::counts(&problem, &question, &right[..5], rule))?;
    must_fail(compare::counts(&problem, &question, &[5, 5, 5, 5, 4, 1], rule))?;
    // Points 0 and 4 have two and one neighbour exactly on the sphere: a device may miss those, no more.
    must_fail(compare::counts(&problem, &question, &[1, 5, 5, 5, 4, 1], rule))?;
    must_fail(compare::counts(&problem, &question, &[4, 5, 5, 5, 4, 0], rule))
}

/// Rows of k places for [`line`], each its point included, written down by hand and filled up.
fn nearest_rows(rows: [&[u32]; 6], k: usize) -> (Vec<u32>, Vec<f32>) {
    let x = [0.0f32, 1.0, 2.0, 2.0, 3.0, 10.0];
    let (mut indices, mut distances) = (vec![], vec![]);
    for (query, row) in rows.iter().enumerate() {
        indices.extend_from_slice(row);
        distances.extend(row.iter().map(|&i| (x[query] - x[i as usize]).abs()));
        indices.resize((query + 1) * k, u32::MAX);
        distances.resize((query + 1) * k, f32::INFINITY);
    }
    (indices, distances)
}

fn check_knn(rule: Rule) -> Verdict {
    type Rows = (Vec<u32>, Vec<f32>);
    let points = line();
    let problem = Problem::solve(&points, &points, true, vec![compare::EVERYWHERE; points.len()], Vec3::ZERO);
    let check = |k: usize, exclude_self: bool, (indices, distances): &Rows| {
        compare::knn(&problem, exclude_self, &NearestRows { k, indices, distances }, rule)
    };
    let two = nearest_rows([&[0, 1], &[1, 0], &[2, 3], &[2, 3], &[4, 2], &[5, 4]], 2);
    let others: [&[u32]; 6] =
        [&[1, 2, 3, 4, 5], &[0, 2, 3, 4, 5], &[3, 1, 4, 0, 5], &[2, 1, 4, 0, 5], &[2, 3, 1, 0, 5], &[4, 2, 3, 1, 0]];
    let seven = nearest_rows(others, 7);
    check(2, false, &two)?;
    check(7, true, &seven)?;
    check(0, false, &(vec![], vec![]))?;
    let changes_of_two: [fn(&mut Rows); 6] = [
        |rows| rows.0.swap(0, 1),
        |rows| rows.0[3] = 2,
        |rows| rows.0[9] = 3,
        |rows| rows.1[11] = 49.0,
        |rows| (rows.0[11], rows.1[11]) = (u32::MAX, f32::INFINITY),
        |rows| rows.0.truncate(11),
    ];
    let changes_of_seven: [fn(&mut Rows); 5] = [
        |rows| rows.0[5] = 0,
        |rows| rows.1[5] = 0.0,
        |rows| (rows.0[4], rows.1[4]) = (u32::MAX, f32::INFINITY),
        |rows| (rows.0[0], rows.1[0]) = (0, 0.0),
        |rows| rows.0[5..7].copy_from_slice(&[5, 5]),
    ];
    for change in changes_of_two {
        let mut rows = two.clone();
        change(&mut rows);
        must_fail(check(2, false, &rows))?;
    }
    for change in changes_of_seven {
        let mut rows = seven.clone();
        change(&mut rows);
        must_fail(check(7, true, &rows))?;
    }
    must_fail(check(2, true, &two))?;
    check_knn_within(rule)
}

/// Three nearest within 2: rows that the radius ends, that k ends, and one that is alone.
fn check_knn_within(rule: Rule) -> Verdict {
    let points = line();
    let within_two = problem(&points);
    let check = |(indices, distances): &(Vec<u32>, Vec<f32>)| {
        compare::knn(&within_two, true, &NearestRows { k: 3, indices, distances }, rule)
    };
    let right: [&[u32]; 6] = [&[1, 2, 3], &[0, 2, 3], &[3, 1, 4], &[2, 1, 4], &[2, 3, 1], &[]];
    check(&nearest_rows(right, 3))?;
    let wrong: [(usize, &[u32]); 6] = [
        (5, &[4]),       // beyond the radius
        (2, &[3, 1]),    // one is missing
        (4, &[2, 3, 0]), // one beyond the radius in place of a nearer one
        (1, &[]),        // all are missing
        (1, &[0, 2]),    // a row that ends too early
        (3, &[2, 4, 1]), // a tie by the higher index
    ];
    for (query, row) in wrong {
        let mut rows = right;
        rows[query] = row;
        must_fail(check(&nearest_rows(rows, 3))).map_err(|e| format!("{query} {row:?}: {e}"))?;
    }
    let mut gap = nearest_rows(right, 3);
    (gap.0[16], gap.1[16]) = (4, 7.0);
    must_fail(check(&gap))
}

fn check_boxes() -> Verdict {
    let points = line();
    let at = |x: f32| Vec3::new(x, 0.0, 0.0);
    let boxes = [Aabb::new(at(1.0), at(2.0)), Aabb::EMPTY, Aabb::new(at(2.5), at(20.0))];
    let check =
        |counts: &[u32], offsets: &[u64], indices: &[u32]| compare::boxes(&points, &boxes, counts, (offsets, indices));
    check(&[3, 0, 2], &[0, 3, 3, 5], &[1, 2, 3, 4, 5])?;
    must_fail(check(&[3, 0, 1], &[0, 3, 3, 5], &[1, 2, 3, 4, 5]))?;
    must_fail(check(&[3, 0, 2], &[0, 3, 4, 5], &[1, 2, 3, 4, 5]))?;
    must_fail(check(&[3, 0, 2], &[0, 3, 3, 5], &[1, 3, 2, 4, 5]))?;
    must_fail(check(&[3, 0, 2], &[0, 3, 3, 5], &[1, 2, 2, 4, 5]))?;
    must_fail(check(&[2, 0, 2], &[0, 2, 2, 4], &[1, 2, 4, 5]))?;
    must_fail(check(&[3, 0, 2], &[0, 3, 3, 6], &[1, 2, 3, 4, 5]))?;
    must_fail(check(&[3, 0], &[0, 3, 3], &[1, 2, 3]))
}

fn check_nearest(rule: Rule) -> Verdict {
    let points = line();
    let (problem, question) = (problem(&points), FixedRadius::new(2.0).exclude_self());
    let answer = |index: u32, dist2: f32| Some(Neighbor { index, dist2 });
    let right = [answer(1, 1.0), answer(0, 1.0), answer(3, 0.0), answer(2, 0.0), answer(2, 1.0), None];
    compare::nearest(&problem, &question, &right, rule)?;
    let wrong = [
        (0, answer(2, 4.0)),
        (0, answer(0, 0.0)),
        (0, answer(1, 1.001)),
        (0, None),
        (1, answer(2, 1.0)),
        (4, answer(3, 1.0)),
        (5, answer(4, 49.0)),
        (5, answer(u32::MAX, 0.0)),
    ];
    for (query, planted) in wrong {
        let mut answers = right;
        answers[query] = planted;
        must_fail(compare::nearest(&problem, &question, &answers, rule)).map_err(|e| format!("{planted:?}: {e}"))?;
    }
    must_fail(compare::nearest(&problem, &question, &right[1..], rule))
}

fn check_visits() -> Verdict {
    let points = line();
    let (problem, question) = (problem(&points), FixedRadius::new(2.0));
    let rows: Vec<Vec<(u32, f32)>> = problem.truth.iter().map(|row| row.hits.iter().rev().copied().collect()).collect();
    compare::visits(&problem, &question, &rows)?;
    must_fail(compare::first_visits(&problem, &question, &rows))?;
    let two: Vec<_> = rows.iter().map(|row| row[..row.len().min(2)].to_vec()).collect();
    compare::first_visits(&problem, &question, &two)?;
    must_fail(compare::visits(&problem, &question, &two))?;
    let mut planted = rows.clone();
    planted[0].push(rows[0][0]);
    must_fail(compare::visits(&problem, &question, &planted))?;
    planted[0] = vec![(0, 0.0), (1, 1.0), (2, 4.0), (3, 4.5)];
    must_fail(compare::visits(&problem, &question, &planted))?;
    let mut planted = two;
    planted[0] = vec![(5, 1.0), (1, 1.0)];
    must_fail(compare::first_visits(&problem, &question, &planted))
}

/// Point 1 lies on the sphere, 2 and 3 are 4 ulp inside and outside, 4 and 5 are 64 ulp inside and outside.
fn check_boundary() -> Verdict {
    let ulps = |n: i32| Vec3::new(f32::from_bits((2.0f32.to_bits() as i32 + n) as u32), 0.0, 0.0);
    // One ulp of 2 is two of the numbers just below it.
    let points = [Vec3::ZERO, ulps(0), ulps(-4), ulps(3), ulps(-64), ulps(64)];
    let queries = [Vec3::ZERO];
    let problem = Problem::solve(&points, &queries, false, vec![2.0], Vec3::ZERO);
    let question = FixedRadius::new(2.0).queries(&queries).order(RowOrder::Index);
    let check = |row: &[u32], rule: Rule| {
        let offsets = [0, row.len() as u64];
        compare::list(&problem, &question, &List { offsets: &offsets, indices: row, distances: None, cut: &[] }, rule)
    };
    check(&[0, 1, 2, 4], Rule::Exact)?;
    for marginal in [&[0, 1, 2, 4][..], &[0, 2, 4], &[0, 1, 4], &[0, 1, 2, 3, 4], &[0, 3, 4]] {
        check(marginal, Rule::Device).map_err(|e| format!("{marginal:?}: {e}"))?;
    }
    for beyond in [&[0, 2, 4][..], &[0, 1, 4], &[0, 1, 2, 3, 4]] {
        must_fail(check(beyond, Rule::Exact)).map_err(|e| format!("{beyond:?}: {e}"))?;
    }
    for wrong in [&[0, 1, 2][..], &[0, 1, 2, 4, 5], &[0, 1, 2, 5], &[1, 2, 4]] {
        must_fail(check(wrong, Rule::Device)).map_err(|e| format!("{wrong:?}: {e}"))?;
    }
    Ok(())
}
