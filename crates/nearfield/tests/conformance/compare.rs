//! Compares an answer with the truth. The CPU must agree in every bit; a device may differ where the distance is
//! within 4 ulp of the radius, and nowhere else. `planted.rs` feeds each comparison differences that it must find.

use std::collections::HashMap;

use nearfield::query::{CutRow, Neighbor};
use nearfield::{Aabb, FixedRadius, NearestNeighbors, RowOrder, Vec3};

use crate::reference::{Hit, Problem, Row, difference, flushed, ulp};

/// How near an answer must come to the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rule {
    /// In every bit.
    Exact,
    /// Up to the rounding of one distance: 4 ulp.
    Device,
}

/// A list as plain slices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct List<'a> {
    pub(crate) offsets: &'a [u64],
    pub(crate) indices: &'a [u32],
    pub(crate) distances: Option<&'a [f32]>,
    pub(crate) cut: &'a [CutRow],
}

/// The first difference in words.
pub(crate) type Verdict = Result<(), String>;

macro_rules! ensure {
    ($holds:expr, $($message:tt)+) => {
        if !$holds {
            return Err(format!($($message)+));
        }
    };
}

/// Checks counts [q].
pub(crate) fn counts(problem: &Problem<'_>, question: &FixedRadius<'_>, counts: &[u32], rule: Rule) -> Verdict {
    ensure!(counts.len() == problem.queries.len(), "{} counts for {} queries", counts.len(), problem.queries.len());
    for row in &problem.truth {
        check_total(problem, row, question, u64::from(counts[row.query as usize]), rule)?;
    }
    Ok(())
}

/// Checks the number of neighbours of one query.
fn check_total(problem: &Problem<'_>, row: &Row, question: &FixedRadius<'_>, found: u64, rule: Rule) -> Verdict {
    let query = row.query;
    let truth = problem.row(row, question.exclude_self);
    let expected = truth.len() as u64;
    if found == expected {
        return Ok(());
    }
    ensure!(rule == Rule::Device, "query {query}: {found} neighbours, expected {expected}");
    let marginal = truth.iter().filter(|hit| problem.is_marginal(query, hit.0)).count() as u64;
    let most = expected + problem.marginal_outside(row) as u64;
    let fewest = expected - marginal;
    ensure!((fewest..=most).contains(&found), "query {query}: {found} neighbours, expected {fewest} to {most}");
    Ok(())
}

/// Checks a list: its shape, and each row's order, membership, distances and cut.
pub(crate) fn list(problem: &Problem<'_>, question: &FixedRadius<'_>, list: &List<'_>, rule: Rule) -> Verdict {
    check_shape(problem, question, list)?;
    let missing: HashMap<u32, u32> = list.cut.iter().map(|cut| (cut.query, cut.missing)).collect();
    for row in &problem.truth {
        let range = list.offsets[row.query as usize] as usize..list.offsets[row.query as usize + 1] as usize;
        let found = &list.indices[range.clone()];
        let sorted = check_indices(problem, row.query, question, found)?;
        check_order(problem, row.query, question, found, rule)?;
        if let Some(distances) = list.distances {
            check_distances(problem, row.query, found, &distances[range], question.order, rule)?;
        }
        let cut = missing.get(&row.query).copied().unwrap_or(0);
        match rule {
            Rule::Exact => check_row_exactly(problem, row, question, &sorted, cut)?,
            Rule::Device => check_row_on_device(problem, row, question, &sorted, cut)?,
        }
    }
    Ok(())
}

fn check_shape(problem: &Problem<'_>, question: &FixedRadius<'_>, list: &List<'_>) -> Verdict {
    let (offsets, n_queries) = (list.offsets, problem.queries.len());
    ensure!(offsets.len() == n_queries + 1, "{} offsets for {n_queries} queries", offsets.len());
    ensure!(offsets[0] == 0, "the first offset is {}", offsets[0]);
    ensure!(offsets.is_sorted(), "offsets are not monotone");
    let (last, n) = (offsets[n_queries], list.indices.len());
    ensure!(last == n as u64, "the last offset is {last}, and there are {n} indices");
    let (wanted, found) = (question.distances, list.distances.map(<[f32]>::len));
    ensure!(found == wanted.then_some(n), "distances asked for: {wanted}; found {found:?} for {n} indices");
    ensure!(list.cut.is_sorted_by(|a, b| a.query < b.query), "cut rows are not ascending");
    if let Some(cap) = question.max_neighbors {
        let longest = offsets.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
        ensure!(longest <= u64::from(cap), "a row of {longest} with a cap of {cap}");
    }
    for cut in list.cut {
        let Some(cap) = question.max_neighbors else { return Err(format!("{cut:?} without a cap")) };
        ensure!((cut.query as usize) < n_queries && cut.missing > 0, "{cut:?} is no cut");
        let length = offsets[cut.query as usize + 1] - offsets[cut.query as usize];
        ensure!(length == u64::from(cap), "{cut:?} in a row of {length} with a cap of {cap}");
    }
    Ok(())
}

/// The row in ascending order, after each entry was found to be possible.
fn check_indices(
    problem: &Problem<'_>,
    query: u32,
    question: &FixedRadius<'_>,
    found: &[u32],
) -> Result<Vec<u32>, String> {
    let mut sorted = found.to_vec();
    sorted.sort_unstable();
    if let Some(&last) = sorted.last() {
        ensure!((last as usize) < problem.points.len(), "query {query}: index {last} of {}", problem.points.len());
    }
    let twice = sorted.windows(2).find(|pair| pair[0] == pair[1]);
    ensure!(twice.is_none(), "query {query}: {twice:?} stands twice");
    let own = question.exclude_self && sorted.binary_search(&query).is_ok();
    ensure!(!own, "query {query}: the query itself is in its row");
    Ok(sorted)
}

fn check_order(problem: &Problem<'_>, query: u32, question: &FixedRadius<'_>, found: &[u32], rule: Rule) -> Verdict {
    for pair in found.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let in_order = match (question.order, rule) {
            (RowOrder::Unspecified, _) => true,
            (RowOrder::Index, _) => a < b,
            (RowOrder::Distance, Rule::Exact) => (dist2(problem, query, a), a) < (dist2(problem, query, b), b),
            (RowOrder::Distance, Rule::Device) => {
                let (near, far) = (problem.distance(query, a), problem.distance(query, b));
                near <= far + near_enough(problem, query, b, far) && (a < b || !certain_tie(problem, query, a, b))
            }
        };
        ensure!(in_order, "query {query}: {a} before {b} is not in order of {:?}", question.order);
    }
    Ok(())
}

fn check_distances(
    problem: &Problem<'_>,
    query: u32,
    found: &[u32],
    distances: &[f32],
    order: RowOrder,
    rule: Rule,
) -> Verdict {
    for (&i, &distance) in found.iter().zip(distances) {
        let fine = match rule {
            Rule::Exact => distance == dist2(problem, query, i).sqrt(),
            Rule::Device => {
                let expected = problem.distance(query, i);
                (f64::from(distance) - expected).abs() <= near_enough(problem, query, i, expected)
            }
        };
        ensure!(fine, "query {query}: distance {distance:e} of {i}, expected {:e}", problem.distance(query, i));
    }
    ensure!(order != RowOrder::Distance || distances.is_sorted(), "query {query}: distances are not ascending");
    Ok(())
}

fn check_row_exactly(problem: &Problem<'_>, row: &Row, question: &FixedRadius<'_>, found: &[u32], cut: u32) -> Verdict {
    let query = row.query;
    let is_left_out = |index: u32| question.exclude_self && problem.own && index == query;
    let total = row.hits.len() - row.hits.iter().filter(|hit| is_left_out(hit.0)).count();
    let mut expected: Vec<u32> = match question.max_neighbors {
        Some(cap) if (cap as usize) < total => {
            row.nearest_first().map(|hit| hit.0).filter(|&i| !is_left_out(i)).take(cap as usize).collect()
        }
        _ => row.hits.iter().map(|hit| hit.0).filter(|&i| !is_left_out(i)).collect(),
    };
    expected.sort_unstable();
    if expected != found {
        if let Some(&i) = expected.iter().find(|i| found.binary_search(i).is_err()) {
            return Err(format!("query {query}: point {i} at {:e} is missing", problem.distance(query, i)));
        }
        if let Some(&i) = found.iter().find(|i| expected.binary_search(i).is_err()) {
            return Err(format!("query {query}: point {i} at {:e} should not be there", problem.distance(query, i)));
        }
        return Err(format!("query {query}: {} entries, expected {}", found.len(), expected.len()));
    }
    let lost = total - found.len();
    ensure!(cut as usize == lost, "query {query}: {cut} neighbours reported as cut, {lost} are");
    Ok(())
}

fn check_row_on_device(
    problem: &Problem<'_>,
    row: &Row,
    question: &FixedRadius<'_>,
    found: &[u32],
    cut: u32,
) -> Verdict {
    let query = row.query;
    let truth = problem.row(row, question.exclude_self);
    for &i in found {
        let known = truth.binary_search_by_key(&i, |hit| hit.0).is_ok() || problem.is_marginal(query, i);
        ensure!(known, "query {query}: point {i} at {:e} should not be there", problem.distance(query, i));
    }
    let farthest = found.iter().map(|&i| problem.distance(query, i)).fold(0.0, f64::max);
    let full = question.max_neighbors.is_some_and(|cap| found.len() == cap as usize);
    // Far beyond all that a full row keeps, whatever the rounding: rightly cut, and no tie.
    let is_far = |hit: &Hit| full && f64::from(hit.1).sqrt() > 1.01 * farthest + problem.wrap_rounding(query, hit.0);
    let absent = truth.iter().filter(|hit| !is_far(hit)).map(|hit| hit.0).filter(|i| found.binary_search(i).is_err());
    for i in absent {
        let distance = problem.distance(query, i);
        let may_miss = problem.is_marginal(query, i)
            || (full && (found.is_empty() || distance + near_enough(problem, query, i, distance) >= farthest));
        ensure!(may_miss, "query {query}: point {i} at {distance:e} is missing");
        let mut higher = found[found.partition_point(|&kept| kept < i)..].iter();
        let beaten = higher.find(|&&kept| full && certain_tie(problem, query, i, kept));
        ensure!(beaten.is_none(), "query {query}: {beaten:?} is kept and {i}, as near, is cut");
    }
    check_total(problem, row, question, found.len() as u64 + u64::from(cut), Rule::Device)
}

/// Checks the nearest neighbours of all queries.
pub(crate) fn nearest(
    problem: &Problem<'_>,
    question: &FixedRadius<'_>,
    found: &[Option<Neighbor>],
    rule: Rule,
) -> Verdict {
    ensure!(found.len() == problem.queries.len(), "{} answers for {} queries", found.len(), problem.queries.len());
    for row in &problem.truth {
        let query = row.query;
        let truth = problem.row(row, question.exclude_self);
        let expected = truth.iter().copied().min_by(nearer);
        let found = found[query as usize].map(|n| (n.index, n.dist2));
        match (found, expected, rule) {
            (_, _, Rule::Exact) => {
                ensure!(found == expected, "query {query}: nearest {found:?}, expected {expected:?}")
            }
            (None, _, Rule::Device) => {
                let sure = truth.iter().find(|hit| !problem.is_marginal(query, hit.0));
                ensure!(sure.is_none(), "query {query}: nothing found, expected {expected:?}");
            }
            (Some((i, d2)), _, Rule::Device) => {
                ensure!((i as usize) < problem.points.len(), "query {query}: index {i} is out of range");
                ensure!(!(question.exclude_self && i == query), "query {query}: found itself");
                let known = truth.iter().any(|hit| hit.0 == i) || problem.is_marginal(query, i);
                ensure!(known, "query {query}: {i} at {:e} is no neighbour", problem.distance(query, i));
                let distance = problem.distance(query, i);
                let slack = near_enough(problem, query, i, distance);
                let off = (f64::from(d2).sqrt() - distance).abs();
                ensure!(
                    off <= slack,
                    "query {query}: squared distance {d2:e} of {i}, expected {:e}",
                    distance * distance
                );
                let best = expected.map_or(f64::INFINITY, |(best, _)| problem.distance(query, best));
                ensure!(distance <= best + slack, "query {query}: nearest {i} at {distance:e}, expected {expected:?}");
                let lower = truth.iter().find(|hit| hit.0 < i && certain_tie(problem, query, hit.0, i));
                ensure!(lower.is_none(), "query {query}: {i} is taken before {lower:?}, which is as near");
            }
        }
    }
    Ok(())
}

/// Rows of k places as plain slices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearestRows<'a> {
    pub(crate) k: usize,
    pub(crate) indices: &'a [u32],
    pub(crate) distances: &'a [f32],
}

/// Checks the k nearest points within the radii of `problem`: empty places stand at the end of a row, and all others are a
/// list with a cap of k.
pub(crate) fn knn(problem: &Problem<'_>, exclude_self: bool, rows: &NearestRows<'_>, rule: Rule) -> Verdict {
    let (k, n_queries) = (rows.k, problem.queries.len());
    let (indices, distances) = (rows.indices.len(), rows.distances.len());
    let expected = n_queries * k;
    ensure!(indices == expected && distances == expected, "{indices} and {distances} places of {n_queries} × {k}");
    let (mut offsets, mut kept_indices, mut kept_distances) = (vec![0], vec![], vec![]);
    for start in (0..n_queries).map(|query| query * k) {
        let is_none = |&index: &u32| index == NearestNeighbors::NONE;
        let found = rows.indices[start..start + k].iter().position(is_none).unwrap_or(k);
        let empty = rows.indices[start + found..start + k].iter().zip(&rows.distances[start + found..start + k]);
        for (&index, &distance) in empty {
            let is_empty = index == NearestNeighbors::NONE && distance == f32::INFINITY;
            ensure!(is_empty, "row at {start}: {index} at {distance:e} in a place that should be empty");
        }
        kept_indices.extend_from_slice(&rows.indices[start..start + found]);
        kept_distances.extend_from_slice(&rows.distances[start..start + found]);
        offsets.push(kept_indices.len() as u64);
    }
    // What a full row leaves out, which the answer does not say.
    let cut_of = |row: &Row| {
        let is_full = offsets[row.query as usize + 1] - offsets[row.query as usize] == k as u64;
        let missing = problem.row(row, exclude_self).len().saturating_sub(k) as u32;
        (is_full && missing > 0).then_some(CutRow { query: row.query, missing })
    };
    let cut: Vec<CutRow> = problem.truth.iter().filter_map(cut_of).collect();
    let question = FixedRadius {
        exclude_self,
        max_neighbors: Some(k as u32),
        order: RowOrder::Distance,
        ..FixedRadius::new(EVERYWHERE).distances()
    };
    let kept = List { offsets: &offsets, indices: &kept_indices, distances: Some(&kept_distances), cut: &cut };
    list(problem, &question, &kept, rule)
}

/// Checks the points in boxes, rows ascending, against the definition.
pub(crate) fn boxes(points: &[Vec3], boxes: &[Aabb], counts: &[u32], (offsets, indices): (&[u64], &[u32])) -> Verdict {
    let n = boxes.len();
    ensure!(
        counts.len() == n && offsets.len() == n + 1,
        "{} counts, {} offsets: {n} boxes",
        counts.len(),
        offsets.len()
    );
    let ends = (offsets[0], offsets[n]);
    ensure!(ends == (0, indices.len() as u64) && offsets.is_sorted(), "offsets from {} to {}", ends.0, ends.1);
    for (i, aabb) in boxes.iter().enumerate() {
        let is_inside = |p: &Vec3| (0..3).all(|axis| aabb.min[axis] <= p[axis] && p[axis] <= aabb.max[axis]);
        let expected = points.iter().enumerate().filter(|(_, p)| is_inside(p)).map(|(i, _)| i as u32);
        let expected: Vec<u32> = expected.collect();
        let row = &indices[offsets[i] as usize..offsets[i + 1] as usize];
        ensure!(row == expected, "box {i}: {} points, expected {}", row.len(), expected.len());
        ensure!(counts[i] as usize == expected.len(), "box {i}: counted {}, expected {}", counts[i], expected.len());
    }
    Ok(())
}

/// A radius beyond every distance whose square is an f32.
pub(crate) const EVERYWHERE: f32 = 1.8e19;

/// Checks neighbours visited one by one, in no order: `visited[query]`.
pub(crate) fn visits(problem: &Problem<'_>, question: &FixedRadius<'_>, visited: &[Vec<Hit>]) -> Verdict {
    ensure!(visited.len() == problem.queries.len(), "{} rows for {} queries", visited.len(), problem.queries.len());
    for row in &problem.truth {
        let mut found = visited[row.query as usize].clone();
        found.sort_by_key(|hit| hit.0);
        let expected = problem.row(row, question.exclude_self);
        ensure!(found == expected, "query {}: visited {found:?}, expected {expected:?}", row.query);
    }
    Ok(())
}

/// Checks visits that end at the second neighbour of each query.
pub(crate) fn first_visits(problem: &Problem<'_>, question: &FixedRadius<'_>, visited: &[Vec<Hit>]) -> Verdict {
    for row in &problem.truth {
        let expected = problem.row(row, question.exclude_self);
        let found = &visited[row.query as usize];
        let wanted = expected.len().min(2);
        ensure!(found.len() == wanted, "query {}: {} visits, expected {wanted}", row.query, found.len());
        let known = found.iter().all(|hit| expected.contains(hit));
        ensure!(known && (wanted < 2 || found[0] != found[1]), "query {}: visited {found:?}", row.query);
    }
    Ok(())
}

/// Order by squared distance, ties by index.
fn nearer(a: &Hit, b: &Hit) -> std::cmp::Ordering {
    a.1.total_cmp(&b.1).then(a.0.cmp(&b.0))
}

fn dist2(problem: &Problem<'_>, query: u32, point: u32) -> f32 {
    crate::reference::dist2(problem.queries[query as usize], problem.points[point as usize], problem.period)
}

/// Rounding of one distance on a device; larger where small squares are flushed or a far image is wrapped.
fn near_enough(problem: &Problem<'_>, query: u32, point: u32, distance: f64) -> f64 {
    // Where two distances are compared, both may be off.
    4.0 * ulp(distance as f32) + 2.0 * flushed(distance) + problem.wrap_rounding(query, point)
}

/// Whether two points are equally far under any rounding: the same differences by axis, up to the sign, of which none
/// is a wrap that a device may fuse.
fn certain_tie(problem: &Problem<'_>, query: u32, a: u32, b: u32) -> bool {
    let to =
        |i: u32| difference(problem.queries[query as usize], problem.points[i as usize], problem.period).map(f32::abs);
    let is_fused = |i: u32| problem.wrap_rounding(query, i) > 0.0;
    to(a) == to(b) && !is_fused(a) && !is_fused(b)
}
