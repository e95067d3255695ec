//! The queries of a pack on the CPU: one set of spans for all of them, or in parts where that is too much to test.

use std::borrow::Cow;
use std::ops::Range;

use super::FixedRadius;
use crate::geometry::{Aabb, OrderedPoints};
use crate::structure::CpuStructure;

/// The spans of everything near the queries at these places.
pub(super) fn look_up<S: CpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    points: &OrderedPoints,
    places: Range<usize>,
    spans: &mut Vec<Range<usize>>,
) {
    let mut region = Aabb::EMPTY;
    let mut reach = 0f32;
    for place in places {
        region = region.grown_to(points.position(place));
        reach = reach.max(question.radius_of(points.id(place) as usize));
    }
    spans.clear();
    structure.spans_near(&region, reach, spans);
}

/// Candidates of a pack from which on it is heavy: testing them takes each query about as long as a look-up of its own.
const HEAVY: usize = 4096;

/// Takes the places of queries and the spans of their candidates; false to stop.
pub(super) type VisitPart<'a> = dyn FnMut(Range<usize>, &[Range<usize>]) -> bool + 'a;

/// Visits a pack whose candidates are in `spans`; a heavy one as two halves, and halves of those, where the halves have
/// clearly less to test, or query by query where radii differ much. What is found stays the same.
pub(super) fn visit_in_parts<S: CpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    points: &OrderedPoints,
    places: Range<usize>,
    spans: &[Range<usize>],
    visit: &mut VisitPart<'_>,
) -> bool {
    for (part, spans) in parts(structure, question, points, &places, spans) {
        let goes_on = match part == places {
            true => visit(part, &spans),
            false => visit_in_parts(structure, question, points, part, &spans, visit),
        };
        if !goes_on {
            return false;
        }
    }
    true
}

/// Places of a pack, or of a part of it, and the spans they are searched in.
type Part<'s> = (Range<usize>, Cow<'s, [Range<usize>]>);

/// The parts that a pack is searched in, each with its spans; the pack itself where it is not split.
fn parts<'s, S: CpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    points: &OrderedPoints,
    places: &Range<usize>,
    spans: &'s [Range<usize>],
) -> Vec<Part<'s>> {
    let whole = || vec![(places.clone(), Cow::Borrowed(spans))];
    let candidates = |spans: &[Range<usize>]| spans.iter().map(Range::len).sum::<usize>();
    if places.len() < 2 || candidates(spans) < HEAVY {
        return whole();
    }
    let part = |places: Range<usize>| {
        let mut spans = Vec::new();
        look_up(structure, question, points, places.clone(), &mut spans);
        (places, Cow::Owned(spans))
    };
    let tests =
        |parts: &[Part<'_>]| parts.iter().map(|(places, spans)| places.len() * candidates(spans)).sum::<usize>();
    let is_worth_it = |split: &[_]| tests(split) <= places.len() * candidates(spans) / 4 * 3;
    let middle = places.start + places.len() / 2;
    let halves = vec![part(places.start..middle), part(middle..places.end)];
    if is_worth_it(&halves) {
        return halves;
    }
    let radius = |place| question.radius_of(points.id(place) as usize);
    let (least, most) =
        places.clone().map(radius).fold((f32::INFINITY, 0f32), |(least, most), r| (least.min(r), most.max(r)));
    if most > 2.0 * least {
        let singles: Vec<_> = places.clone().map(|place| part(place..place + 1)).collect();
        if is_worth_it(&singles) {
            return singles;
        }
    }
    whole()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::visit::ordered;
    use super::*;
    use crate::geometry::generate::{CloudKind, cloud};
    use crate::structure::{AabbTree, AabbTreeSettings};

    /// Pairs of query and candidate with packs as they are, and split.
    fn pairs(tree: &AabbTree, question: &FixedRadius<'_>) -> (usize, usize) {
        let queries = ordered(tree, question.queries).unwrap();
        let (mut whole, mut split) = (0, 0);
        for pack in 0..queries.packs.len() - 1 {
            let (places, mut spans) = (queries.pack(pack), Vec::new());
            look_up(tree, question, &queries.points, places.clone(), &mut spans);
            whole += places.len() * spans.iter().map(Range::len).sum::<usize>();
            let mut add = |places: Range<usize>, spans: &[Range<usize>]| {
                split += places.len() * spans.iter().map(Range::len).sum::<usize>();
                true
            };
            assert!(visit_in_parts(tree, question, &queries.points, places, &spans, &mut add));
        }
        (whole, split)
    }

    #[test]
    fn packs_of_very_different_radii_are_split_and_even_ones_are_not() {
        let points = cloud(CloudKind::Uniform, 20_000, 7).points;
        let tree = AabbTree::build(&points, &AabbTreeSettings::DEFAULT).unwrap();
        let radii: Vec<f32> = (0..points.len()).map(|i| if i % 50 == 0 { 0.5 } else { 0.0005 }).collect();
        let (whole, split) = pairs(&tree, &FixedRadius::each(&radii));
        assert!(10 * split < whole, "{split} of {whole}");
        let (whole, split) = pairs(&tree, &FixedRadius::new(0.05));
        assert_eq!(whole, split);
        let far: Vec<Vec3> = points.iter().step_by(200).copied().collect();
        let (whole, split) = pairs(&tree, &FixedRadius::new(0.02).queries(&far));
        assert!(split <= whole, "{split} of {whole}");
    }
}
