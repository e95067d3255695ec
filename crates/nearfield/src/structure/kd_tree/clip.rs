//! The part of a triangle that lies in a cell, and the box around it.

use glam::{DVec3, Vec3};

use crate::geometry::{Aabb, PreparedTriangle};

/// The part of a triangle that touches a node's cell, as the builders see it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// Smaller in every axis than any plane from which the part keeps the margin.
    pub(super) min: Vec3,
    /// Index of the triangle.
    pub(super) triangle: u32,
    /// Larger in every axis than any plane from which the part keeps the margin.
    pub(super) max: Vec3,
}

impl Piece {
    /// Whether the part comes within the margin of the smaller side of a plane.
    #[inline(always)]
    pub(super) fn is_left(&self, axis: usize, split: f32) -> bool {
        self.min[axis] < split
    }

    /// Whether the part comes within the margin of the larger side of a plane.
    #[inline(always)]
    pub(super) fn is_right(&self, axis: usize, split: f32) -> bool {
        self.max[axis] > split
    }
}

/// Most corners of a triangle that was cut by the six planes of a box and by the one between its halves: one more a plane.
const MOST_CORNERS: usize = 10;

/// Corners of a triangle that was cut, and room for what the next step looks at: an edge gives a crossing and a corner.
type Corners = [DVec3; MOST_CORNERS + 2];

/// Puts what of the first `n` corners' polygon is not beyond `plane`, above it for `side` = 1, below it for −1, into `to`;
/// the number of corners. Without a branch that depends on them.
#[inline(always)]
fn cut<const AXIS: usize>(from: &Corners, n: usize, to: &mut Corners, plane: f64, side: f64) -> usize {
    let n = n.min(MOST_CORNERS);
    let mut n_left = 0;
    let mut last = from[n.saturating_sub(1)];
    let mut last_out = side * (last[AXIS] - plane);
    for &corner in &from[..n] {
        let out = side * (corner[AXIS] - plane);
        let mut crossing = last + (corner - last) * (last_out / (last_out - out));
        crossing[AXIS] = plane;
        to[n_left] = crossing;
        n_left += usize::from((last_out < 0.0) & (out > 0.0) | (last_out > 0.0) & (out < 0.0));
        to[n_left] = corner;
        // A convex polygon gains one corner a plane at most, ten in all.
        n_left = (n_left + usize::from(out <= 0.0)).min(MOST_CORNERS);
        (last, last_out) = (corner, out);
    }
    n_left
}

/// A margin wider by a 32nd: coordinates are at most 2⁴² margins, so that a 32nd of it is 2⁵ roundings of a coordinate in
/// f64 at least, and no triangle that touches is lost.
fn wider(margin: f32) -> f64 {
    f64::from(margin) * (1.0 + 1.0 / 32.0)
}

/// What of a triangle lies within the margin of a cell.
struct Polygon {
    corners: Corners,
    n: usize,
}

impl Polygon {
    #[inline(always)]
    fn new(triangle: &PreparedTriangle, cell: &Aabb, margin: f32) -> Self {
        let (min, max) = (cell.min.as_dvec3() - wider(margin), cell.max.as_dvec3() + wider(margin));
        let corners = [triangle.low, triangle.middle, triangle.high].map(Vec3::as_dvec3);
        let low = corners[0].min(corners[1]).min(corners[2]);
        let high = corners[0].max(corners[1]).max(corners[2]);
        let (mut first, mut second) = ([DVec3::ZERO; MOST_CORNERS + 2], [DVec3::ZERO; MOST_CORNERS + 2]);
        first[..3].copy_from_slice(&corners);
        let (mut from, mut to, mut n) = (&mut first, &mut second, 3);
        macro_rules! cut_across {
            ($axis:literal) => {
                if low[$axis] < min[$axis] {
                    n = cut::<$axis>(from, n, to, min[$axis], -1.0);
                    std::mem::swap(&mut from, &mut to);
                }
                if high[$axis] > max[$axis] {
                    n = cut::<$axis>(from, n, to, max[$axis], 1.0);
                    std::mem::swap(&mut from, &mut to);
                }
            };
        }
        cut_across!(0);
        cut_across!(1);
        cut_across!(2);
        Self { corners: *from, n }
    }

    /// The piece, whose box is wider than the polygon's by the margin; `None` for an empty polygon.
    #[inline(always)]
    fn piece(&self, index: u32, margin: f32) -> Option<Piece> {
        if self.n == 0 {
            return None;
        }
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &corner in &self.corners[..self.n.min(MOST_CORNERS)] {
            (low, high) = (low.min(corner), high.max(corner));
        }
        let margin = f64::from(margin);
        // Rounded to nearest and one step further, both are strictly outside.
        let min = (low - margin).as_vec3().to_array().map(f32::next_down);
        let max = (high + margin).as_vec3().to_array().map(f32::next_up);
        Some(Piece { min: min.into(), triangle: index, max: max.into() })
    }

    /// What is not beyond a plane, as [`cut`].
    #[inline(always)]
    fn half(&self, axis: usize, plane: f64, side: f64) -> Self {
        let mut half = Self { corners: [DVec3::ZERO; MOST_CORNERS + 2], n: 0 };
        half.n = match axis {
            0 => cut::<0>(&self.corners, self.n, &mut half.corners, plane, side),
            1 => cut::<1>(&self.corners, self.n, &mut half.corners, plane, side),
            _ => cut::<2>(&self.corners, self.n, &mut half.corners, plane, side),
        };
        half
    }
}

/// What of a triangle lies within the margin of a cell; `None` where nothing does.
pub(super) fn clip(triangle: &PreparedTriangle, index: u32, cell: &Aabb, margin: f32) -> Option<Piece> {
    Polygon::new(triangle, cell, margin).piece(index, margin)
}

/// [`clip`] for both halves of a cell that is cut across `axis` at `split`.
pub(super) fn clip_halves(
    triangle: &PreparedTriangle,
    index: u32,
    cell: &Aabb,
    (axis, split): (usize, f32),
    margin: f32,
) -> [Option<Piece>; 2] {
    let whole = Polygon::new(triangle, cell, margin);
    let (split, wide) = (f64::from(split), wider(margin));
    let left = whole.half(axis, split + wide, 1.0).piece(index, margin);
    [left, whole.half(axis, split - wide, -1.0).piece(index, margin)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Triangle;
    use crate::structure::kd_tree::layout::halves;

    fn piece(corners: [[f32; 3]; 3], cell: Aabb) -> Option<Piece> {
        let [a, b, c] = corners.map(Vec3::from_array);
        clip(&PreparedTriangle::new(&Triangle::new(a, b, c), 7), 7, &cell, 0.125)
    }

    #[test]
    fn the_box_of_a_part_is_tight_and_wider_by_the_margin() {
        // The line from (0, 0) to (4, 4) in the xy-plane, as a sliver.
        let cell = Aabb::new(Vec3::new(1.0, 0.0, -1.0), Vec3::new(2.0, 4.0, 1.0));
        let part = piece([[0.0, 0.0, 0.0], [4.0, 4.0, 0.0], [4.0, 4.0, 1e-3]], cell).unwrap();
        let wide = 0.125 * (1.0 + 1.0 / 32.0) + 0.125;
        let expected = Aabb::new(Vec3::new(1.0 - wide, 1.0 - wide, -0.125), Vec3::new(2.0 + wide, 2.0 + wide, 0.126));
        assert!((part.min - expected.min).abs().max_element() < 1e-3, "{part:?}");
        assert!((part.max - expected.max).abs().max_element() < 1e-3, "{part:?}");
    }

    #[test]
    fn a_triangle_at_the_margin_of_a_cell_touches_it() {
        let cell = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let at = |z: f32| piece([[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]], cell);
        assert!(at(1.125).is_some() && at(-0.125).is_some());
        assert!(at(1.25).is_none() && at(-0.25).is_none());
        // Beyond a corner, where the boxes overlap and the triangle does not come near.
        assert!(piece([[1.0, 2.0, 0.5], [2.0, 1.0, 0.5], [2.0, 2.0, 0.5]], cell).is_none());
    }

    #[test]
    fn halves_are_what_clipping_to_each_gives() {
        let mut state = 3u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let cell = Aabb::new(Vec3::splat(0.25), Vec3::new(0.75, 0.5, 0.625));
        let margin = 1e-3;
        let mut n_cut = 0;
        for i in 0..3000 {
            let mut corner = || Vec3::new(random(), random(), random());
            let triangle = PreparedTriangle::new(&Triangle::new(corner(), corner(), corner()), 7);
            let axis = i % 3;
            let split = cell.min[axis] + (0.1 + 0.8 * random()) * cell.extent()[axis];
            let expected = halves(&cell, axis, split).map(|half| clip(&triangle, 7, &half, margin));
            let found = clip_halves(&triangle, 7, &cell, (axis, split), margin);
            n_cut += usize::from(expected.iter().all(Option::is_some));
            for (expected, found) in expected.into_iter().zip(found) {
                let (Some(expected), Some(found)) = (expected, found) else {
                    assert_eq!(expected.is_some(), found.is_some(), "{i}");
                    continue;
                };
                let off = (expected.min - found.min).abs().max((expected.max - found.max).abs());
                assert!(off.max_element() <= 3e-7, "{i}: {expected:?}, {found:?}");
            }
        }
        assert!(n_cut > 300, "{n_cut}");
    }

    #[test]
    fn a_part_lies_on_one_side_of_planes_at_its_ends() {
        let part = piece([[0.0; 3], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]], Aabb::new(Vec3::ZERO, Vec3::ONE)).unwrap();
        for axis in 0..3 {
            assert!(part.min[axis] < -0.125 && !part.is_left(axis, part.min[axis]));
            assert!(part.is_right(axis, part.min[axis]) && part.is_left(axis, part.max[axis]));
            assert!(!part.is_right(axis, part.max[axis]));
        }
    }
}
