//! The test one point at a time; the compiler makes vectors of it where it can.

use super::*;

#[inline(always)]
pub(super) fn dist2(points: &OrderedPoints, i: usize, ball: &Ball) -> f32 {
    let difference = ball.center - points.position(i);
    crate::geometry::distance::norm2(ball.period.nearest_image(difference))
}

pub(super) fn count(points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball) -> u32 {
    spans.iter().cloned().flatten().filter(|&i| dist2(points, i, ball) <= ball.radius2).count() as u32
}

pub(super) fn collect<const DIST2: bool>(points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball, hits: &mut Hits) {
    for i in spans.iter().cloned().flatten() {
        let d2 = dist2(points, i, ball);
        if d2 <= ball.radius2 {
            hits.ids.push(points.id(i));
            if DIST2 {
                hits.dist2.push(d2);
            }
        }
    }
}

pub(super) fn mark(points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball, marks: &mut Vec<u8>) -> u32 {
    let mut total = 0;
    for span in spans {
        for start in span.clone().step_by(8) {
            let inside = |i| u8::from(dist2(points, i, ball) <= ball.radius2) << (i - start);
            let mask = (start..span.end.min(start + 8)).map(inside).fold(0, |mask, bit| mask | bit);
            marks.push(mask);
            total += mask.count_ones();
        }
    }
    total
}

pub(super) fn collect_marked<const DIST2: bool>(
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    marks: &[u8],
    hits: &mut Hits,
) {
    collect_places::<DIST2>(points, marked(spans, marks), ball, hits);
}
