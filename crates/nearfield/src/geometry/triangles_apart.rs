//! Whether two triangles surely do not meet: by a plane or a line between them, in plain `f64` with bounds on the rounding.
//!
//! Most triangles of a mesh whose boxes overlap are told apart here in a few nanoseconds; what is left is for the exact signs
//! of `triangle_pair.rs`. A side counts only where the number passes what rounding can have made of it (Shewchuk1997, the
//! bounds of his first stage), so that the answer is never true for triangles that meet.

/// A position.
type Point = [f64; 3];

/// Rounding of a determinant of three differences, in sums of the sizes of its products: (7 + 56 ε) ε, and some more.
const SPACE_BOUND: f64 = 8.0e-16;
/// The same for two differences: (3 + 16 ε) ε.
const PLANE_BOUND: f64 = 4.0e-16;
/// Products may have lost digits below the smallest normal number.
const SMALLEST: f64 = 1e-280;

/// Whether triangles surely have nothing in common but the first `n_shared` corners, which are the same in both: none, one or
/// two.
pub(super) fn surely_apart(a: &[Point; 3], b: &[Point; 3], n_shared: usize) -> bool {
    let (of_a, of_b) = (Plane::of(a), Plane::of(b));
    if of_a.surely_keeps_aside(b[n_shared..].iter()) {
        return true;
    }
    // With a common edge one plane says as much as the other.
    if n_shared < 2 && of_b.surely_keeps_aside(a[n_shared..].iter()) {
        return true;
    }
    let (first, second) = (of_a.widest_axis(), of_b.widest_axis());
    surely_apart_along(first, a, b, n_shared) || second != first && surely_apart_along(second, a, b, n_shared)
}

/// Whether there surely is a plane through the points that two sets of four share, two at most, with the others of `a` on one side
/// and those of `b` on the other: then triangles of the one meet those of the other in shared corners and edges alone. Tried is the
/// plane that looks best, across the way from the middle of one to that of the other.
///
/// - `shared`: of each set one bit a point, 1 where the other has it too
#[inline]
pub(crate) fn surely_parted(a: &[Point; 4], b: &[Point; 4], shared: [u32; 2]) -> bool {
    let across = |i: usize| (b[0][i] + b[1][i] + b[2][i] + b[3][i]) - (a[0][i] + a[1][i] + a[2][i] + a[3][i]);
    // Whatever was rounded: any direction will do, if only the products with it are right.
    let across = [across(0), across(1), across(2)];
    let first = shared[0].trailing_zeros() as usize & 3;
    let plane = match shared[0].count_ones() {
        0 | 1 => Plane { at: a[first], normal: across, sizes: [across[0].abs(), across[1].abs(), across[2].abs()] },
        2 => {
            let second = 31 - shared[0].leading_zeros() as usize;
            let edge = difference(&a[second], &a[first]);
            // e × (e × d) is the part of −d across the edge.
            let along = Plane::across(a[first], &edge, &across).normal;
            Plane::across(a[first], &along, &edge)
        }
        _ => return false,
    };
    if shared[0] == 0 {
        let ends = |points: &[Point; 4], sign: f64| {
            let end = |point: &Point| {
                let (value, bound) = plane.height(point);
                sign * value + bound
            };
            points[1..].iter().map(end).fold(end(&points[0]), f64::max)
        };
        return ends(a, 1.0) + SMALLEST < -ends(b, -1.0);
    }
    let all = |points: &[Point; 4], shared: u32, sign: i8| {
        (0..4).all(|i| shared >> i & 1 == 1 || plane.surely_side(&points[i]) == sign)
    };
    all(a, shared[0], -1) && all(b, shared[1], 1)
}

/// The plane of a triangle.
pub(crate) struct Plane {
    at: Point,
    normal: Point,
    /// Sums of the sizes of the two products of each component.
    sizes: Point,
}

impl Plane {
    /// Of these corners.
    #[inline]
    pub(crate) fn of([a, b, c]: &[Point; 3]) -> Self {
        Self::across(*a, &difference(b, a), &difference(c, a))
    }

    /// Through a point along two directions.
    #[inline]
    fn across(at: Point, u: &Point, v: &Point) -> Self {
        let (x, minus_x) = (u[1] * v[2], u[2] * v[1]);
        let (y, minus_y) = (u[2] * v[0], u[0] * v[2]);
        let (z, minus_z) = (u[0] * v[1], u[1] * v[0]);
        Self {
            at,
            normal: [x - minus_x, y - minus_y, z - minus_z],
            sizes: [x.abs() + minus_x.abs(), y.abs() + minus_y.abs(), z.abs() + minus_z.abs()],
        }
    }

    /// How high a point is above it, in lengths of the normal, and how far that may be off.
    #[inline]
    fn height(&self, point: &Point) -> (f64, f64) {
        let (from, n, s) = (difference(point, &self.at), &self.normal, &self.sizes);
        let value = n[0] * from[0] + n[1] * from[1] + n[2] * from[2];
        let bound = s[0] * from[0].abs() + s[1] * from[1].abs() + s[2] * from[2].abs();
        (value, SPACE_BOUND * bound)
    }

    /// The side of a point: 1, −1, and 0 where rounding may decide.
    #[inline]
    fn surely_side(&self, point: &Point) -> i8 {
        let (value, bound) = self.height(point);
        sure_sign(value, bound)
    }

    /// Whether all points are surely on one side of it, and none in it.
    #[inline]
    pub(crate) fn surely_keeps_aside<'a>(&self, mut points: impl Iterator<Item = &'a Point>) -> bool {
        let Some(first) = points.next().map(|point| self.surely_side(point)) else { return true };
        first != 0 && points.all(|point| self.surely_side(point) == first)
    }

    /// The axis along which the triangle is seen widest.
    #[inline]
    fn widest_axis(&self) -> usize {
        let [x, y, z] = self.normal.map(f64::abs);
        if x >= y && x >= z {
            0
        } else if y >= z {
            1
        } else {
            2
        }
    }
}

/// Whether the triangles are surely apart as seen along an axis: there is a line through an edge of one, or the edge they share,
/// with the rest of the triangle on one side and that of the other triangle on the other. Lines are planes along the axis.
fn surely_apart_along(axis: usize, a: &[Point; 3], b: &[Point; 3], n_shared: usize) -> bool {
    let flat = |p: &Point| [p[(axis + 1) % 3], p[(axis + 2) % 3]];
    let (a, b) = (a.each_ref().map(flat), b.each_ref().map(flat));
    match n_shared {
        0 => has_line_between(&a, &b, &[[0, 1, 2], [1, 2, 0], [2, 0, 1]], 0),
        // A line between them goes through the common corner.
        1 => has_line_between(&a, &b, &[[0, 1, 2], [0, 2, 1]], 1),
        _ => has_line_between(&a, &b, &[[0, 1, 2]], 2),
    }
}

/// Whether one of the edges, two corners each with the third behind them, of either triangle is a line between them.
fn has_line_between(a: &[[f64; 2]; 3], b: &[[f64; 2]; 3], edges: &[[usize; 3]], n_shared: usize) -> bool {
    let separates = |of: &[[f64; 2]; 3], other: &[[f64; 2]; 3], [p, q, r]: [usize; 3]| {
        let own = turn(&of[p], &of[q], &of[r]);
        own != 0 && other[n_shared..].iter().all(|point| turn(&of[p], &of[q], point) == -own)
    };
    edges.iter().any(|&edge| separates(a, b, edge) || separates(b, a, edge))
}

/// Which way p, q, r turn: 1 or −1, and 0 where rounding may decide.
#[inline]
fn turn(p: &[f64; 2], q: &[f64; 2], r: &[f64; 2]) -> i8 {
    let left = (q[0] - p[0]) * (r[1] - p[1]);
    let right = (q[1] - p[1]) * (r[0] - p[0]);
    sure_sign(left - right, PLANE_BOUND * (left.abs() + right.abs()))
}

/// The sign of a value that is off by no more than the bound; 0 where that does not tell it.
#[inline]
fn sure_sign(value: f64, bound: f64) -> i8 {
    let bound = bound + SMALLEST;
    i8::from(value > bound) - i8::from(value < -bound)
}

#[inline]
fn difference(a: &Point, b: &Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[cfg(test)]
mod tests {
    use super::super::triangle_pair::{triangles_meet, triangles_meet_beyond_corner, triangles_meet_beyond_edge};
    use super::*;

    const SEED: u64 = 5;

    /// Whole numbers below `n`, so that corners fall on edges and planes all the time.
    struct Random(u64);

    impl Random {
        fn below(&mut self, n: u64) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 33) % n) as f64
        }

        fn point(&mut self, n: u64) -> Point {
            [(); 3].map(|()| self.below(n))
        }
    }

    #[test]
    fn triangles_that_meet_are_never_apart() {
        let mut random = Random(SEED);
        let (mut apart, mut told) = ([0; 3], [0; 3]);
        for round in 0..200_000 {
            let n_shared = round % 3;
            let cells = 2 + (round as u64 / 3) % 7;
            let a = [(); 3].map(|()| random.point(cells));
            let mut b = [(); 3].map(|()| random.point(cells));
            b[..n_shared].copy_from_slice(&a[..n_shared]);
            // Far from 0 and in parts of a unit differences are rounded.
            let scaled = |p: Point| p.map(|x| if round % 2 == 0 { x } else { 1e6 + x * 0.1 });
            let (a, b) = (a.map(scaled), b.map(scaled));
            let meets = match n_shared {
                0 => triangles_meet(&a, &b),
                1 => triangles_meet_beyond_corner(&a, &b),
                _ => triangles_meet_beyond_edge(&a, &b),
            };
            let is_told = surely_apart(&a, &b, n_shared);
            assert!(!(meets && is_told), "round {round}: {a:?} {b:?}");
            apart[n_shared] += usize::from(!meets);
            told[n_shared] += usize::from(is_told);
        }
        // Those without area, and with corners on each other's planes, are left to the exact signs.
        for n_shared in 0..3 {
            assert!(2 * told[n_shared] > apart[n_shared], "{told:?} of {apart:?}");
        }
    }

    #[test]
    fn neighbours_on_a_smooth_surface_are_told_apart() {
        // A saddle: planes of its triangles cut each other's neighbours. No two edges are one line, as seen from above.
        let at = |i: i32, j: i32| {
            let (x, y) = (f64::from(i), f64::from(j));
            [x + 0.1 * y * y, y + 0.1 * x * x, 0.05 * (x * x - y * y)]
        };
        let fan = [(1, 0), (1, 1), (0, 1), (-1, 0), (-1, -1), (0, -1)].map(|(i, j)| at(i, j));
        for i in 0..6 {
            for j in [2, 3, 4].map(|step| (i + step) % 6) {
                let triangle = |i: usize| [at(0, 0), fan[i], fan[(i + 1) % 6]];
                assert!(surely_apart(&triangle(i), &triangle(j), 1), "{i} {j}");
            }
        }
    }

    #[test]
    fn sets_with_a_plane_between_them_have_no_triangles_that_meet() {
        let mut random = Random(SEED);
        let mut parted = [0; 3];
        for round in 0..100_000 {
            let n_shared = round % 3;
            let mut b = [(); 4].map(|()| random.point(6));
            let a = [(); 4].map(|()| random.point(6)).map(|[x, y, z]| [x + 4.0, y, z]);
            // Places among the four by chance.
            let [first, second] = [(round / 3) % 4, (round / 3 + 1 + (round / 12) % 3) % 4];
            let shared = match n_shared {
                0 => 0,
                1 => 1u32 << first,
                _ => 1 << first | 1 << second,
            };
            (0..4).filter(|i| shared >> i & 1 == 1).for_each(|i| b[i] = a[i]);
            let scaled = |p: Point| p.map(|x| if round % 2 == 0 { x } else { 1e6 + x * 0.1 });
            let (a, b) = (a.map(scaled), b.map(scaled));
            if !surely_parted(&a, &b, [shared; 2]) {
                continue;
            }
            parted[n_shared] += 1;
            // Each triangle leaves one point out; common corners first.
            for (i, j) in (0..16).map(|k| (k / 4, k % 4)) {
                let corners = |left_out: usize, other: usize| {
                    let mut of: Vec<usize> = (0..4).filter(|&k| k != left_out).collect();
                    of.sort_by_key(|&k| (shared >> k & 1 == 0 || k == other, k));
                    of
                };
                let (of_a, of_b) = (corners(i, j), corners(j, i));
                let n = (0..4).filter(|&k| shared >> k & 1 == 1 && k != i && k != j).count();
                let triangle = |of: &[usize], places: &[Point; 4]| [places[of[0]], places[of[1]], places[of[2]]];
                let (ta, tb) = (triangle(&of_a, &a), triangle(&of_b, &b));
                let meets = match n {
                    0 => triangles_meet(&ta, &tb),
                    1 => triangles_meet_beyond_corner(&ta, &tb),
                    _ => triangles_meet_beyond_edge(&ta, &tb),
                };
                assert!(!meets, "round {round}: {ta:?} {tb:?} share {n}");
            }
        }
        assert!(parted.iter().all(|&n| n > 1000), "{parted:?}");
    }

    #[test]
    fn nonsense_is_not_apart() {
        let nan = [[f64::NAN; 3]; 3];
        let flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let point = [[0.25, 0.25, 0.0]; 3];
        let four = |[a, b, c]: [Point; 3]| [a, b, c, c];
        assert!(!surely_parted(&four(nan), &four(flat), [0; 2]) && !surely_parted(&four(nan), &four(flat), [1; 2]));
        assert!(!surely_apart(&nan, &flat, 0) && !surely_apart(&flat, &nan, 0) && !surely_apart(&point, &flat, 0));
        let tiny = [0.0, 1e-200].map(|z| flat.map(|[x, y, _]| [x * 1e-200, y * 1e-200, z]));
        assert!(!surely_apart(&tiny[0], &tiny[1], 0), "products vanish");
    }
}
