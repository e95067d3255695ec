//! Exact answers on devices that end long loops.
//!
//! Some software renderers end the loops of an invocation, silently, once all of them together have taken a number of
//! rounds ([`crate::gpu::GpuLimits::loop_rounds`]); invocations that run in step share that number. There, kernels test
//! eight points a round, and before they run their rounds are counted from above: a question that may need more is
//! answered in another way or refused. On other devices nothing of this applies.

use crate::gpu::Gpu;
use crate::parallel::reduce;
use crate::query::{FixedRadius, Queries};
use crate::structure::{Effort, GpuStructure};
use crate::{Error, Result};

/// Candidates that a round tests under `short_loops`.
const CANDIDATES_A_ROUND: u64 = 8;

/// Loop rounds of a visitor itself.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct VisitorRounds {
    /// In a call of `visit`, at most.
    pub(super) each: u64,
    /// In `finish`, at most.
    pub(super) finish: u64,
}

impl VisitorRounds {
    /// Whether a round should test eight candidates: a visitor with loops takes most rounds itself, and its code would stand in the
    /// kernel eight times.
    pub(super) fn suits_short_loops(self) -> bool {
        self.each == 0
    }
}

/// How a traversal is compiled.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Traversal {
    /// Eight candidates a round.
    pub(super) short_loops: bool,
    /// Every point is tested, wherever it lies.
    pub(super) all_points: bool,
}

/// How to traverse the structure for this question: as ever where the device lets loops run.
///
/// # Errors
/// `Unsupported` where the loops could be ended before their work is done; `OutOfDeviceMemory`, `OutOfMemory`,
/// `DeviceLost`.
pub(super) fn traversal<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    visitor: VisitorRounds,
) -> Result<Traversal> {
    let gpu = structure.gpu();
    let Some(limit) = gpu.limits().loop_rounds else { return Ok(Traversal::default()) };
    if question.len(structure.len()) == 0 {
        return Ok(Traversal::default());
    }
    let queries = match question.queries {
        Queries::Points => None,
        Queries::Other(queries) => Some(reduce::bounds(queries)),
    };
    let walk = structure.most_effort(question.largest_radius(), queries.as_ref())?;
    choose_for(structure, walk, visitor, limit)
}

/// How to go through lists of at most so many candidates.
///
/// # Errors
/// As [`traversal`].
pub(super) fn through_candidates<S: GpuStructure>(
    structure: &S,
    candidates: u32,
    visitor: VisitorRounds,
) -> Result<Traversal> {
    let Some(limit) = structure.gpu().limits().loop_rounds else { return Ok(Traversal::default()) };
    choose_for(structure, Effort { candidates: u64::from(candidates), rounds: 0 }, visitor, limit)
}

fn choose_for<S: GpuStructure>(structure: &S, walk: Effort, visitor: VisitorRounds, limit: u32) -> Result<Traversal> {
    let gpu = structure.gpu();
    let all = Effort { candidates: structure.len() as u64, rounds: 0 };
    choose(walk, all, visitor, limit).ok_or_else(|| Error::Unsupported {
        what: format!(
            "testing up to {} points a query on {}, which ends the loops of a kernel after {limit} rounds,",
            walk.candidates.min(all.candidates),
            gpu.name()
        ),
        advice: "use the CPU, a smaller radius or fewer points",
    })
}

/// Whether the visitor can be run for this question at all.
///
/// # Errors
/// As [`traversal`], but for `Unsupported`.
pub(super) fn can_visit<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    visitor: VisitorRounds,
) -> Result<bool> {
    match traversal(structure, question, visitor) {
        Err(Error::Unsupported { .. }) => Ok(false),
        other => other.map(|_| true),
    }
}

/// Whether the device lets the loops of the kernel that searches the structure's points in pairs run to their end, at least those for balls of this radius.
///
/// # Errors
/// `OutOfDeviceMemory`, `OutOfMemory`, `DeviceLost`.
pub(super) fn can_search_in_pairs<S: GpuStructure>(structure: &S, radius: f32) -> Result<bool> {
    let Some(limit) = structure.gpu().limits().loop_rounds else { return Ok(true) };
    // All that a pair touches is within twice the radius of one of the two along each axis.
    let Effort { candidates, rounds } = structure.most_effort(2.0 * radius, None)?;
    // A round tests four candidates, and writing rows takes one for each neighbour of either query. Queries apart take two walks.
    let walk = candidates.saturating_mul(3).saturating_add(rounds.saturating_mul(2));
    Ok(walk.saturating_mul(2).saturating_add(2) <= u64::from(limit))
}

/// The first traversal whose rounds fit the limit.
fn choose(walk: Effort, all: Effort, visitor: VisitorRounds, limit: u32) -> Option<Traversal> {
    let fits = |effort| rounds(effort, visitor) <= u64::from(limit);
    (fits(walk) || fits(all)).then_some(Traversal { short_loops: visitor.suits_short_loops(), all_points: !fits(walk) })
}

/// Rounds that so much takes, with those of the visitor.
pub(super) fn rounds(effort: Effort, visitor: VisitorRounds) -> u64 {
    let candidates = match visitor.suits_short_loops() {
        true => effort.candidates.div_ceil(CANDIDATES_A_ROUND),
        false => effort.candidates.saturating_mul(1 + visitor.each),
    };
    // One look ends each loop.
    candidates.saturating_add(effort.rounds).saturating_add(visitor.finish + 2)
}

/// Rounds of `visit` and `finish` of the visitor `nearest_k` that keeps `places` neighbours.
pub(super) fn of_nearest_k(places: u32) -> VisitorRounds {
    // `push` and `sift_down` both stand in `visit`.
    VisitorRounds { each: 2 * levels(places), finish: u64::from(places) * (1 + levels(places)) }
}

/// The error where the nearest `places` of the points cannot be found because the device would end the kernel's loops.
pub(super) fn too_long_for_nearest<S: GpuStructure>(
    structure: &S,
    places: usize,
    limit: u32,
    advice: &'static str,
) -> Error {
    let (n, gpu) = (structure.len(), structure.gpu().name());
    Error::Unsupported {
        what: format!(
            "finding the nearest {places} of {n} points on {gpu}, which ends the loops of a kernel after {limit} rounds,"
        ),
        advice,
    }
}

/// Rounds of the kernel `knn` that looks at up to so many nodes and points.
pub(super) fn of_knn(steps: u64, places: u32) -> u64 {
    // Eight children on each of 21 levels to find where to start.
    const LOCATE: u64 = 8 * 21 + 1;
    let (places, levels) = (u64::from(places), levels(places));
    // Invocations in step begin together with points until their rows are full, one of which may be left out: only then
    // are points pushed. Later ones may be sifted down.
    let pushed = (places + 1) * levels;
    let sorted_and_emptied = places * (1 + levels) + places + 2;
    steps.saturating_mul(1 + levels).saturating_add(LOCATE + 1 + pushed + sorted_and_emptied)
}

/// Whether the device's kernel can sort rows that long.
pub(super) fn can_sort(gpu: &Gpu, longest_row: u32) -> bool {
    // `heapify` moves half of the elements and `sort_heap` all of them.
    let moved = u64::from(longest_row) + u64::from(longest_row) / 2;
    gpu.limits().loop_rounds.is_none_or(|limit| moved * (1 + levels(longest_row)) <= u64::from(limit))
}

/// Rounds of a walk from end to end of a heap of so many elements, with the look that ends it.
fn levels(elements: u32) -> u64 {
    u64::from(u32::BITS - elements.leading_zeros()) + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: u32 = 60_000;

    fn points(candidates: u64) -> Effort {
        Effort { candidates, rounds: 0 }
    }

    #[test]
    fn eight_candidates_are_a_round() {
        let plain = Traversal { short_loops: true, all_points: false };
        let chosen = |n| choose(points(n), points(n), VisitorRounds::default(), LIMIT);
        assert_eq!(chosen(8 * 59_998), Some(plain));
        assert_eq!(chosen(8 * 59_998 + 1), None);
    }

    #[test]
    fn all_points_are_tested_where_the_walk_does_not_fit() {
        let walk = Effort { candidates: 100, rounds: 60_001 };
        let all = Traversal { short_loops: true, all_points: true };
        assert_eq!(choose(walk, points(1000), VisitorRounds::default(), LIMIT), Some(all));
        assert_eq!(choose(walk, points(500_000), VisitorRounds::default(), LIMIT), None);
    }

    #[test]
    fn rounds_of_the_nearest_grow_with_points_and_places() {
        // One place: a look at the one level of its heap and the look that ends it.
        assert_eq!(of_knn(0, 1), 169 + 1 + 2 * 2 + 3 + 3);
        assert_eq!(of_knn(1000, 1) - of_knn(0, 1), 3 * 1000);
        assert_eq!(of_knn(1000, 33) - of_knn(0, 33), 8 * 1000);
    }

    #[test]
    fn a_visitors_own_loops_count() {
        // For each point one round, up to six to push it into 16 places and six to sift it down; 16 times seven to sort.
        assert_eq!((of_nearest_k(16).each, of_nearest_k(16).finish), (12, 112));
        let own = Traversal { short_loops: false, all_points: false };
        let chosen = |n| choose(points(n), points(n), of_nearest_k(16), LIMIT);
        assert_eq!(chosen(4606), Some(own));
        assert_eq!(chosen(4607), None);
    }
}
