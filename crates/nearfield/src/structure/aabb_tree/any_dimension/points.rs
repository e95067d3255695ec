//! Points in the order of the tree, a column an axis, and the inner loop of every search.

use std::ops::Range;

use rayon::prelude::*;

use super::distance::add_square;
use crate::geometry::Scalar;

/// Points whose distances are computed side by side.
const LANES: usize = 8;
/// Points of a column that one thread moves at a time.
const MOVED_BY_ONE: usize = 1 << 14;

/// Points in some order, by coordinate, with their indices in the caller's order.
#[derive(Debug, Clone)]
pub struct PointsN<T, const D: usize> {
    /// `[D × stride]` a column an axis; behind the last point there is room for all lanes.
    columns: Vec<T>,
    stride: usize,
    ids: Vec<u32>,
}

impl<T: Scalar, const D: usize> PointsN<T, D> {
    /// The points at `order[0]`, `order[1]` …
    pub(crate) fn gather(points: &[[T; D]], order: Vec<u32>) -> Self {
        let stride = order.len() + LANES;
        let mut made = Self { columns: vec![T::of(0.0); D * stride], stride, ids: order };
        made.move_to(points);
        made
    }

    /// Takes new positions, given in the caller's order.
    pub(super) fn move_to(&mut self, points: &[[T; D]]) {
        for (axis, column) in self.columns.chunks_exact_mut(self.stride).enumerate() {
            let places = column.par_iter_mut().with_min_len(MOVED_BY_ONE).zip(&self.ids);
            places.for_each(|(to, &id)| *to = points[id as usize][axis]);
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// `[n]` index in the caller's order of the point at each place.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// The point at a place.
    #[inline(always)]
    pub fn position(&self, place: usize) -> [T; D] {
        std::array::from_fn(|axis| self.columns[axis * self.stride + place])
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> u64 {
        (size_of_val(&self.columns[..]) + size_of_val(&self.ids[..])) as u64
    }

    /// Calls `visit(place, squared distance)` for every point of these places.
    #[inline(always)]
    pub(crate) fn for_each_dist2(&self, places: Range<usize>, center: &[T; D], mut visit: impl FnMut(usize, T)) {
        debug_assert!(places.end <= self.len());
        for first in places.clone().step_by(LANES) {
            let mut sums = [T::of(0.0); LANES];
            for (axis, &own) in center.iter().enumerate() {
                let column = &self.columns[axis * self.stride + first..][..LANES];
                for (sum, &coordinate) in sums.iter_mut().zip(column) {
                    *sum = add_square(*sum, own - coordinate);
                }
            }
            for (place, &sum) in (first..places.end).zip(&sums) {
                visit(place, sum);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::dist2;
    use super::*;

    #[test]
    fn every_place_is_visited_once_with_its_distance() {
        let points: Vec<[f32; 3]> = (0..50u8).map(f32::from).map(|x| [x, -x, 0.1 * x]).collect();
        let ordered = PointsN::gather(&points, (0..50).rev().collect());
        let center = [3.3f32, 0.7, -1.1];
        for places in [0..0, 0..1, 3..11, 5..50, 49..50] {
            let mut visited = Vec::new();
            ordered.for_each_dist2(places.clone(), &center, |place, d2| visited.push((place, d2)));
            let expected: Vec<_> = places.map(|place| (place, dist2(&center, &points[49 - place]))).collect();
            assert_eq!(visited, expected);
        }
    }
}
