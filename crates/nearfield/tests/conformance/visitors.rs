//! A caller's own kernel on every neighbour, on the device: sums, and an end of the row at the second neighbour.

use nearfield::FixedRadius;
use nearfield::gpu::{Access, Buffer};
use nearfield::query::Visitor;

use crate::compare::Verdict;
use crate::questions::Solved;
use crate::subjects::{Built, device};

/// What stands in the answers before a kernel runs.
const POISON: u32 = 0xdead_beef;

/// Counts the neighbours of a query and sums their indices, up to `limit` of them.
fn source(limit: u32) -> String {
    format!(
        "import package::structure::question::{{Query, Neighbor}};

@group(1) @binding(0) var<storage, read_write> counts: array<u32>;
@group(1) @binding(1) var<storage, read_write> sums: array<u32>;

struct State {{ count: u32, sum: u32 }}

fn begin(query: Query) -> State {{ return State(0u, 0u); }}

fn visit(state: ptr<function, State>, query: Query, neighbor: Neighbor) -> bool {{
    (*state).count += 1u;
    (*state).sum += neighbor.id + 1u;
    return (*state).count < {limit}u;
}}

fn finish(state: ptr<function, State>, query: Query) {{
    counts[query.slot] = (*state).count;
    sums[query.slot] = (*state).sum;
}}
"
    )
}

/// Runs both kernels over a case and compares the rows that have no point at the boundary.
pub(crate) fn check(built: &dyn Built, solved: &Solved<'_>) -> Verdict {
    let problem = solved.own();
    let n = problem.queries.len();
    if n == 0 {
        return Ok(());
    }
    for (limit, exclude_self) in [(u32::MAX, true), (2, false)] {
        let mut question = FixedRadius::new(solved.case.radius);
        question.exclude_self = exclude_self;
        let poisoned = || -> nearfield::Result<Buffer<u32>> { device().upload("answers", &vec![POISON; n]) };
        let in_words = |error: nearfield::Error| error.to_string();
        let (counts, sums) = (poisoned().map_err(in_words)?, poisoned().map_err(in_words)?);
        let bindings = [(Access::ReadWrite, (&counts).into()), (Access::ReadWrite, (&sums).into())];
        let source = source(limit);
        let Some(outcome) = built.run_visitor(&question, &Visitor::new(&source, &bindings)) else {
            return Err("the structure runs no visitors".into());
        };
        let report = outcome.map_err(in_words)?;
        if report.device != device().name() || !report.kernels.iter().any(|k| k.contains("the caller's visitor")) {
            return Err(format!("a visitor was asked, the report says {report:?}"));
        }
        let (counts, sums) = (device().read(&counts).map_err(in_words)?, device().read(&sums).map_err(in_words)?);
        for row in &problem.truth {
            let query = row.query;
            let marginal = row.hits.iter().any(|hit| problem.is_marginal(query, hit.0));
            if !solved.case.exact && (marginal || problem.marginal_outside(row) > 0) {
                continue;
            }
            let hits = problem.row(row, exclude_self);
            let (count, sum) = (counts[query as usize], sums[query as usize]);
            let expected = (hits.len() as u32).min(limit);
            let whole: u32 = hits.iter().fold(0, |sum, hit| sum.wrapping_add(hit.0 + 1));
            if count != expected || (hits.len() as u32 <= limit && sum != whole) {
                return Err(format!(
                    "query {query} up to {limit}: {count} visits summing to {sum}, expected {expected}"
                ));
            }
        }
    }
    Ok(())
}
