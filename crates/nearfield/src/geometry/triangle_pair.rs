//! Whether two triangles of a mesh meet elsewhere than in what they share, decided by exact signs (Shewchuk1997).

use robust::{Coord, Coord3D, orient2d, orient3d};

/// A position.
type Point = [f64; 3];

/// Which side of the plane through a, b, c the point d is on: only the sign counts, and it is exact.
fn side(a: &Point, b: &Point, c: &Point, d: &Point) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p[0], y: p[1], z: p[2] });
    orient3d(a, b, c, d)
}

/// Whether two triangles share a point. Triangles without area meet nothing that has none either.
pub fn triangles_meet(a: &[Point; 3], b: &[Point; 3]) -> bool {
    let sides_of_b = [0, 1, 2].map(|i| side(&a[0], &a[1], &a[2], &b[i]));
    if all_on_one_side(&sides_of_b) {
        return false;
    }
    let sides_of_a = [0, 1, 2].map(|i| side(&b[0], &b[1], &b[2], &a[i]));
    if all_on_one_side(&sides_of_a) {
        return false;
    }
    edges(a).any(|[p, q]| segment_meets(p, q, b)) || edges(b).any(|[p, q]| segment_meets(p, q, a))
}

/// Whether triangles with a common first corner share another point.
pub fn triangles_meet_beyond_corner(a: &[Point; 3], b: &[Point; 3]) -> bool {
    // Where both other corners are on one side of the plane, only the common one is in it.
    let is_apart = |a: &[Point; 3], b: &[Point; 3]| {
        let sides = [1, 2].map(|i| side(&a[0], &a[1], &a[2], &b[i]));
        sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0)
    };
    if is_apart(a, b) || is_apart(b, a) {
        return false;
    }
    segment_meets(&a[1], &a[2], b) || segment_meets(&b[1], &b[2], a)
}

/// Whether triangles with a common edge, their first two corners, lie on each other.
pub fn triangles_meet_beyond_edge(a: &[Point; 3], b: &[Point; 3]) -> bool {
    if side(&a[0], &a[1], &a[2], &b[2]) != 0.0 {
        return false;
    }
    let Some(dropped) = widest_axis(a) else { return false };
    let [p, q, r, s] = [&a[0], &a[1], &a[2], &b[2]].map(|p| flat(p, dropped));
    orient2d(p, q, r) * orient2d(p, q, s) > 0.0
}

fn all_on_one_side(sides: &[f64; 3]) -> bool {
    sides.iter().all(|&s| s > 0.0) || sides.iter().all(|&s| s < 0.0)
}

fn edges(triangle: &[Point; 3]) -> impl Iterator<Item = [&Point; 2]> {
    [[0, 1], [1, 2], [2, 0]].into_iter().map(|[i, j]| [&triangle[i], &triangle[j]])
}

/// Whether a closed segment and a closed triangle share a point; never where the triangle has no area.
fn segment_meets(p: &Point, q: &Point, [a, b, c]: &[Point; 3]) -> bool {
    let (at_p, at_q) = (side(a, b, c, p), side(a, b, c, q));
    if at_p > 0.0 && at_q > 0.0 || at_p < 0.0 && at_q < 0.0 {
        return false;
    }
    if at_p == 0.0 && at_q == 0.0 {
        return segment_meets_in_plane(p, q, &[*a, *b, *c]);
    }
    let turns = [side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)];
    turns.iter().all(|&s| s >= 0.0) || turns.iter().all(|&s| s <= 0.0)
}

/// The same for a segment in the plane of the triangle.
fn segment_meets_in_plane(p: &Point, q: &Point, triangle: &[Point; 3]) -> bool {
    let Some(dropped) = widest_axis(triangle) else { return false };
    let [p, q] = [p, q].map(|p| flat(p, dropped));
    let corners = triangle.map(|p| flat(&p, dropped));
    let holds = |point: Coord<f64>| {
        let turns = [0, 1, 2].map(|i| orient2d(corners[i], corners[(i + 1) % 3], point));
        turns.iter().all(|&s| s >= 0.0) || turns.iter().all(|&s| s <= 0.0)
    };
    holds(p) || holds(q) || (0..3).any(|i| segments_cross([p, q], [corners[i], corners[(i + 1) % 3]]))
}

/// Whether two closed segments of a plane cross, where neither has an end in a triangle whose edge the other is.
fn segments_cross([p, q]: [Coord<f64>; 2], [a, b]: [Coord<f64>; 2]) -> bool {
    let opposite = |s: f64, t: f64| s > 0.0 && t < 0.0 || s < 0.0 && t > 0.0;
    let (of_p, of_q) = (orient2d(a, b, p), orient2d(a, b, q));
    let (of_a, of_b) = (orient2d(p, q, a), orient2d(p, q, b));
    (opposite(of_p, of_q) || of_p == 0.0 || of_q == 0.0) && opposite(of_a, of_b) && opposite(of_p, of_q)
        || opposite(of_p, of_q) && (of_a == 0.0 || of_b == 0.0)
}

/// The axis along which the triangle is seen widest; `None` where it has no area.
fn widest_axis([a, b, c]: &[Point; 3]) -> Option<usize> {
    let area = |dropped: usize| orient2d(flat(a, dropped), flat(b, dropped), flat(c, dropped)).abs();
    let widest = (0..3).max_by(|&i, &j| area(i).total_cmp(&area(j)))?;
    (area(widest) > 0.0).then_some(widest)
}

/// A position seen along an axis.
fn flat(p: &Point, dropped: usize) -> Coord<f64> {
    Coord { x: p[(dropped + 1) % 3], y: p[(dropped + 2) % 3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLAT: [Point; 3] = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];

    /// Both orders of both triangles, all turned three ways: the same answer.
    fn meets(a: [Point; 3], b: [Point; 3]) -> bool {
        let turned = |t: [Point; 3], by: usize| [t[by % 3], t[(by + 1) % 3], t[(by + 2) % 3]];
        let first = triangles_meet(&a, &b);
        for i in 0..3 {
            for j in 0..3 {
                let (a, b) = (turned(a, i), turned(b, j));
                let mirrored = [b[1], b[0], b[2]];
                assert!(triangles_meet(&a, &b) == first && triangles_meet(&b, &a) == first, "{a:?} {b:?}");
                assert_eq!(triangles_meet(&a, &mirrored), first);
            }
        }
        first
    }

    #[test]
    fn triangles_that_pierce_touch_or_overlap_meet() {
        assert!(meets(FLAT, [[0.5, 0.5, -1.0], [0.5, 0.5, 1.0], [5.0, 5.0, 0.5]]), "piercing");
        assert!(meets(FLAT, [[0.5, 0.5, 0.0], [0.5, 0.5, 1.0], [0.5, 1.0, 1.0]]), "a corner on the face");
        assert!(meets(FLAT, [[1.0, -1.0, -1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]), "an edge on the edge");
        assert!(meets(FLAT, [[0.25, 0.25, 0.0], [0.5, 0.25, 0.0], [0.25, 0.5, 0.0]]), "inside in the plane");
        assert!(meets(FLAT, [[-1.0, 0.5, 0.0], [3.0, 0.5, 0.0], [3.0, 0.75, 0.0]]), "across in the plane");
        assert!(meets(FLAT, [[2.0, 0.0, 0.0], [3.0, 0.0, 1.0], [3.0, 1.0, 0.0]]), "corner on corner");
    }

    #[test]
    fn triangles_apart_do_not_meet() {
        assert!(!meets(FLAT, FLAT.map(|[x, y, _]| [x, y, 1e-300])), "parallel, however close");
        assert!(!meets(FLAT, [[1.1, 1.1, -1.0], [1.1, 1.1, 1.0], [5.0, 5.0, 0.5]]), "beside");
        assert!(!meets(FLAT, [[3.0, 3.0, 0.0], [4.0, 3.0, 0.0], [3.0, 4.0, 0.0]]), "in the plane");
        let tilted = [[1.0, 1.0 + 1e-15, -1.0], [1.0, 1.0 + 1e-15, 1.0], [3.0, 3.0, 0.0]];
        assert!(!meets(FLAT, tilted), "a few last bits beyond the edge");
    }

    #[test]
    fn shared_corners_and_edges_are_no_meeting() {
        let fan = |angle: f64| [0.0f64, 1.0].map(|step| [(angle + step).cos(), (angle + step).sin(), 0.0]);
        let (a, b) = (fan(0.0), fan(2.0));
        let at = [0.0; 3];
        assert!(!triangles_meet_beyond_corner(&[at, a[0], a[1]], &[at, b[0], b[1]]));
        let over = fan(0.5);
        assert!(triangles_meet_beyond_corner(&[at, a[0], a[1]], &[at, over[0], over[1]]));
        let through = [at, [0.5, 0.25, -1.0], [0.5, 0.25, 1.0]];
        assert!(triangles_meet_beyond_corner(&[at, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &through));
        let edge = |c: Point| [[0.0; 3], [1.0, 0.0, 0.0], c];
        assert!(!triangles_meet_beyond_edge(&edge([0.0, 1.0, 0.0]), &edge([0.0, -1.0, 0.0])));
        assert!(!triangles_meet_beyond_edge(&edge([0.0, 1.0, 0.0]), &edge([0.0, 1.0, 1e-9])));
        assert!(triangles_meet_beyond_edge(&edge([0.0, 1.0, 0.0]), &edge([0.5, 3.0, 0.0])));
    }
}
