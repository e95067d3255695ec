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

/// Corners of a triangle that was cut by the six planes of a box: one more a plane.
struct Polygon {
    corners: [DVec3; 9],
    n: usize,
}

impl Polygon {
    /// Keeps what is not beyond `plane`: above it for `side` = 1, below it for −1.
    fn cut(&mut self, axis: usize, plane: f64, side: f64) {
        let before = self.corners;
        let n = std::mem::take(&mut self.n);
        for i in 0..n {
            let (from, to) = (before[i], before[(i + 1) % n]);
            let (from_out, to_out) = (side * (from[axis] - plane), side * (to[axis] - plane));
            if from_out <= 0.0 {
                self.push(from);
            }
            if from_out < 0.0 && to_out > 0.0 || from_out > 0.0 && to_out < 0.0 {
                let mut crossing = from + (to - from) * (from_out / (from_out - to_out));
                crossing[axis] = plane;
                self.push(crossing);
            }
        }
    }

    fn push(&mut self, corner: DVec3) {
        // A convex polygon gains one corner a plane at most, nine in all.
        self.n = (self.n + 1).min(self.corners.len());
        self.corners[self.n - 1] = corner;
    }
}

/// What of a triangle lies within the margin of a cell; `None` where nothing does.
///
/// In f64, with a margin wider by a 32nd: coordinates are at most 2⁴² margins, so that a 32nd of it is 2⁵ roundings of
/// a coordinate at least, and no triangle that touches is lost.
pub(super) fn clip(triangle: &PreparedTriangle, index: u32, cell: &Aabb, margin: f32) -> Option<Piece> {
    let wide = f64::from(margin) * (1.0 + 1.0 / 32.0);
    let (min, max) = (cell.min.as_dvec3() - wide, cell.max.as_dvec3() + wide);
    let corners = [triangle.low, triangle.middle, triangle.high].map(Vec3::as_dvec3);
    let mut low = corners[0].min(corners[1]).min(corners[2]);
    let mut high = corners[0].max(corners[1]).max(corners[2]);
    if low.cmplt(min).any() || high.cmpgt(max).any() {
        let mut polygon = Polygon { corners: [DVec3::ZERO; 9], n: 3 };
        polygon.corners[..3].copy_from_slice(&corners);
        for axis in 0..3 {
            if low[axis] < min[axis] {
                polygon.cut(axis, min[axis], -1.0);
            }
            if high[axis] > max[axis] {
                polygon.cut(axis, max[axis], 1.0);
            }
        }
        let left = &polygon.corners[..polygon.n];
        if left.is_empty() {
            return None;
        }
        low = left.iter().fold(DVec3::INFINITY, |low, &corner| low.min(corner));
        high = left.iter().fold(DVec3::NEG_INFINITY, |high, &corner| high.max(corner));
    }
    let margin = f64::from(margin);
    // Rounded to nearest and one step further, both are strictly outside.
    let min = (low - margin).as_vec3().to_array().map(f32::next_down);
    let max = (high + margin).as_vec3().to_array().map(f32::next_up);
    Some(Piece { min: min.into(), triangle: index, max: max.into() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Triangle;

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
    fn a_part_lies_on_one_side_of_planes_at_its_ends() {
        let part = piece([[0.0; 3], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]], Aabb::new(Vec3::ZERO, Vec3::ONE)).unwrap();
        for axis in 0..3 {
            assert!(part.min[axis] < -0.125 && !part.is_left(axis, part.min[axis]));
            assert!(part.is_right(axis, part.min[axis]) && part.is_left(axis, part.max[axis]));
            assert!(!part.is_right(axis, part.max[axis]));
        }
    }
}
