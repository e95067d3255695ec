//! All forms against the plain loop.

use super::*;

fn forms() -> Vec<Simd> {
    let mut forms = vec![Simd::Portable];
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx2") {
            forms.push(Simd::Avx2);
        }
        if is_x86_feature_detected!("avx512f") {
            forms.push(Simd::Avx512);
        }
    }
    forms
}

/// 61 points on a lattice of eighths: distances are exact, and many are equal to the radius.
fn lattice() -> OrderedPoints {
    let points: Vec<Vec3> =
        (0..61).map(|i| Vec3::new((i % 5) as f32, (i / 5 % 5) as f32, (i / 25) as f32) * 0.125).collect();
    let order: Vec<u32> = (0..61).rev().collect();
    OrderedPoints::gather(&points, &order)
}

#[test]
fn every_form_agrees_with_the_plain_loop_on_every_span() {
    let points = lattice();
    for period in [Period::NONE, Period::new(Vec3::new(0.5, 0.0, 0.25)).unwrap()] {
        let ball = Ball { center: Vec3::splat(0.25), radius2: 0.0625, period };
        for start in 0..20 {
            for end in start..points.len() {
                let spans = [start..end, 3..5];
                let expected: Vec<(u32, f32)> = spans
                    .iter()
                    .cloned()
                    .flatten()
                    .map(|i| (points.id(i), period.dist2(ball.center, points.position(i))))
                    .filter(|&(_, d2)| d2 <= 0.0625)
                    .collect();
                for form in forms() {
                    let mut hits = Hits { ids: vec![7], dist2: vec![9.0] };
                    collect::<true>(form, &points, &spans, &ball, &mut hits);
                    let found: Vec<(u32, f32)> = hits.ids.into_iter().zip(hits.dist2).skip(1).collect();
                    assert_eq!(found, expected, "{form:?} {start}..{end}");
                    assert_eq!(count(form, &points, &spans, &ball) as usize, expected.len(), "{form:?}");
                    marks_stand_for(form, &points, &spans, &ball, &expected);
                }
            }
        }
    }
}

/// Checks marks made by a form, what is collected by them, and that each can be taken away.
fn marks_stand_for(form: Simd, points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball, expected: &[(u32, f32)]) {
    let mut marks = vec![0xaa];
    let n = mark(form, points, spans, ball, &mut marks);
    assert_eq!((n as usize, marks.len()), (expected.len(), 1 + mark_bytes(spans)), "{form:?}");
    let marks = &marks[1..];
    let pairs = |hits: Hits| hits.ids.into_iter().zip(hits.dist2).collect::<Vec<(u32, f32)>>();
    let mut hits = Hits { ids: vec![7], dist2: vec![9.0] };
    collect_marked::<true>(form, points, spans, ball, marks, &mut hits);
    assert_eq!(pairs(hits)[1..], *expected, "{form:?} by marks");
    let mut hits = Hits::default();
    collect_places::<true>(points, marked(spans, marks), ball, &mut hits);
    assert_eq!(pairs(hits), expected, "{form:?} by places");
    let mut left = marks.to_vec();
    // A place that stands in two spans is taken from the first.
    for place in spans[0].clone() {
        let inside = ball.period.dist2(ball.center, points.position(place)) <= ball.radius2;
        assert_eq!(unmark(spans, place, &mut left), inside, "{form:?} {place}");
        assert!(!unmark(spans, place, &mut left), "{form:?} {place}, again");
    }
    assert_eq!(marked(spans, &left).count(), marked(&spans[1..], &left[mark_bytes(&spans[..1])..]).count(), "{form:?}");
    assert!(!unmark(spans, points.len(), &mut left));
}

#[test]
#[should_panic(expected = "inside the points")]
fn a_span_past_the_end_is_caught() {
    let points = lattice();
    let past_the_end = 60..62;
    count(
        Simd::best(),
        &points,
        std::slice::from_ref(&past_the_end),
        &Ball { center: Vec3::ZERO, radius2: 1.0, period: Period::NONE },
    );
}
