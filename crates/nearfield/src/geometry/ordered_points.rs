//! Points in the order of a structure, coordinate by coordinate, as SIMD tests want them.

use glam::Vec3;
use rayon::prelude::*;

use super::Aabb;

/// Points as three coordinate arrays in a structure's order, with the index each had in the caller's order.
///
/// Invariants: 1. all four arrays have `len + PADDING` elements; 2. `ids[..len]` is a permutation of `0..len`.
#[derive(Debug, Clone, Default)]
pub struct OrderedPoints {
    len: usize,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    ids: Vec<u32>,
}

impl OrderedPoints {
    /// Elements beyond the last point, so that a vector load that starts at any point stays inside.
    pub const PADDING: usize = 16;

    /// The points in the order `order`: place i holds `points[order[i]]`.
    ///
    /// # Panics
    /// If `order` is not a permutation of the points' indices (checked only as far as bounds and length).
    pub fn gather(points: &[Vec3], order: &[u32]) -> Self {
        assert_eq!(points.len(), order.len(), "an order should name every point once");
        /// Points that one thread gathers.
        const CHUNK: usize = 1 << 14;
        let n = order.len();
        let [mut x, mut y, mut z] = [(); 3].map(|()| vec![0f32; n + Self::PADDING]);
        for column in [&mut x, &mut y, &mut z] {
            column[n..].fill(f32::INFINITY);
        }
        // One look at each point: where the order is random, each look is a cache miss.
        let columns = x[..n].par_chunks_mut(CHUNK).zip(y[..n].par_chunks_mut(CHUNK)).zip(z[..n].par_chunks_mut(CHUNK));
        columns.zip(order.par_chunks(CHUNK)).for_each(|(((x, y), z), order)| {
            for (((x, y), z), &i) in x.iter_mut().zip(y).zip(z).zip(order) {
                [*x, *y, *z] = points[i as usize].to_array();
            }
        });
        let mut ids = Vec::with_capacity(order.len() + Self::PADDING);
        ids.extend_from_slice(order);
        ids.extend([u32::MAX; Self::PADDING]);
        Self { len: n, x, y, z, ids }
    }

    /// Points that stand in the order already, with the indices that they have in the caller's order.
    ///
    /// # Panics
    /// If there is not one index a point.
    pub fn in_order(points: &[Vec3], ids: Vec<u32>) -> Self {
        assert_eq!(points.len(), ids.len(), "there should be one index a point");
        let places: Vec<u32> = (0..points.len() as u32).collect();
        let mut ordered = Self::gather(points, &places);
        ordered.ids[..ids.len()].copy_from_slice(&ids);
        ordered
    }

    /// Moves every point; the order stays.
    ///
    /// - `points`: `[len]` new positions in the caller's order
    ///
    /// # Panics
    /// If there is not one position a point.
    pub fn move_to(&mut self, points: &[Vec3]) {
        assert_eq!(points.len(), self.len, "there should be one position a point");
        let ids = &self.ids[..self.len];
        for (axis, column) in [&mut self.x, &mut self.y, &mut self.z].into_iter().enumerate() {
            let places = column[..self.len].par_iter_mut().zip(ids).with_min_len(1 << 14);
            places.for_each(|(value, &id)| *value = points[id as usize][axis]);
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Position of the point at place `i`.
    #[inline(always)]
    pub fn position(&self, i: usize) -> Vec3 {
        Vec3::new(self.x[i], self.y[i], self.z[i])
    }

    /// The caller's index of the point at place `i`.
    #[inline(always)]
    pub fn id(&self, i: usize) -> u32 {
        self.ids[i]
    }

    /// `[len]` the caller's indices in this order.
    pub fn ids(&self) -> &[u32] {
        &self.ids[..self.len]
    }

    /// Bounds of the points at places `range`.
    pub fn bounds(&self, range: std::ops::Range<usize>) -> Aabb {
        range.fold(Aabb::EMPTY, |aabb, i| aabb.grown_to(self.position(i)))
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> u64 {
        (16 * (self.len + Self::PADDING)) as u64
    }

    /// The padded arrays x, y, z and ids, for vector loads.
    pub(super) fn columns(&self) -> (&[f32], &[f32], &[f32], &[u32]) {
        (&self.x, &self.y, &self.z, &self.ids)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathering_keeps_position_and_index_together() {
        let points = [Vec3::ZERO, Vec3::ONE, Vec3::new(1.0, 2.0, 3.0)];
        let ordered = OrderedPoints::gather(&points, &[2, 0, 1]);
        assert_eq!(ordered.position(0), points[2]);
        assert_eq!(ordered.ids(), [2, 0, 1]);
        assert_eq!(ordered.bounds(1..3), Aabb::new(Vec3::ZERO, Vec3::ONE));
        let mut moved = ordered;
        moved.move_to(&[Vec3::X, Vec3::Y, Vec3::Z]);
        assert_eq!([0, 1, 2].map(|place| moved.position(place)), [Vec3::Z, Vec3::X, Vec3::Y]);
        assert_eq!(moved.ids(), [2, 0, 1]);
    }
}
