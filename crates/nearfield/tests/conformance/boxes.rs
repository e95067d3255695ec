//! Points in boxes on every case. Answers are comparisons of numbers: every device must agree in every bit.

use nearfield::{Aabb, Boxes, Vec3};

use crate::cases::Case;
use crate::compare::{self, Verdict};
use crate::random::Random;
use crate::subjects::{Asked, Built, Subject};

const SEED: u64 = 0xb0e5;

/// Boxes with corners at points of the case, just beside them, without extent, without points, and without end.
pub(crate) fn boxes_of(case: &Case) -> Vec<Aabb> {
    let mut random = Random::new(SEED);
    let everywhere = Aabb::new(Vec3::NEG_INFINITY, Vec3::INFINITY);
    let bounds = Aabb::of_points(&case.points);
    let mut boxes = vec![everywhere, Aabb::EMPTY, bounds, Aabb::new(Vec3::ZERO, Vec3::ZERO)];
    boxes.push(Aabb::new(Vec3::new(-0.0, f32::NEG_INFINITY, -0.0), Vec3::new(f32::INFINITY, 0.0, f32::INFINITY)));
    boxes.push(Aabb::new(Vec3::splat(2e18), Vec3::splat(3e18)));
    if case.points.is_empty() {
        return boxes;
    }
    let each = |v: Vec3, f: fn(f32) -> f32| Vec3::from_array(v.to_array().map(f));
    for _ in 0..20 {
        let mut point = || case.points[random.below(case.points.len())];
        let (a, b) = (point(), point());
        let (low, high) = (a.min(b), a.max(b));
        boxes.extend([
            Aabb::new(a, a),
            Aabb::new(low, high),
            Aabb::new(each(low, f32::next_up), each(high, f32::next_down)),
            // Empty on the axes where b is below a.
            Aabb::new(a, b),
            Aabb::new(a - case.radius, a + case.radius),
            Aabb::new(Vec3::new(low.x, f32::NEG_INFINITY, low.z), Vec3::new(f32::INFINITY, high.y, high.z)),
        ]);
    }
    boxes.extend(case.queries.iter().take(20).map(|&q| Aabb::new(q - 2.0 * case.radius, q + 2.0 * case.radius)));
    boxes
}

/// Asks where the structure answers.
pub(crate) fn ask_everything(subject: &Subject, built: &dyn Built, case: &Case) -> Verdict {
    let boxes = boxes_of(case);
    for boxes in [&boxes[..], &[]] {
        let Some(answer) = built.in_boxes(&Boxes::new(boxes)) else { return Ok(()) };
        let (counts, list) = answer.map_err(|error| error.to_string())?;
        compare::boxes(&case.points, boxes, counts.as_slice(), (list.offsets(), list.indices()))?;
        if list.distances().is_some() || !list.cut().is_empty() {
            return Err("a list of points in boxes has neither distances nor cuts".into());
        }
        subject.check_report(&counts.report, Asked::Boxes)?;
        subject.check_report(&list.report, Asked::Boxes)?;
    }
    Ok(())
}
