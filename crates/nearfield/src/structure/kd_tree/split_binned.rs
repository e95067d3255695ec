//! The cheapest of the planes between equal bins along each axis, and of those that cut off empty space.
//!
//! Source: Mitsuba, the bins of its kd-tree. Two counts a bin, of pieces that begin and that end there, give how many
//! lie on either side of each plane in between.

use rayon::prelude::*;

use super::clip::Piece;
use super::cost::{Costs, Cut, cheaper};
use super::settings::MOST_BINS;
use crate::geometry::Aabb;

/// Pieces that a thread counts at once.
const CHUNK: usize = 1 << 14;

/// Counts of begins and ends along the three axes.
struct Bins {
    begins: [[u32; MOST_BINS as usize]; 3],
    ends: [[u32; MOST_BINS as usize]; 3],
}

impl Bins {
    fn count(pieces: &[Piece], over: &Aabb, bins: usize) -> Self {
        let mut counted = Self { begins: [[0; MOST_BINS as usize]; 3], ends: [[0; MOST_BINS as usize]; 3] };
        // A side without a length has all pieces in its first bin.
        let scale = over.extent().to_array().map(|side| if side > 0.0 { bins as f32 / side } else { 0.0 });
        let last = bins - 1;
        for piece in pieces {
            for (axis, scale) in scale.into_iter().enumerate() {
                // Conversion takes what is below the first bin as 0.
                let bin = |at: f32| (((at - over.min[axis]) * scale) as usize).min(last);
                counted.begins[axis][bin(piece.min[axis])] += 1;
                counted.ends[axis][bin(piece.max[axis])] += 1;
            }
        }
        counted
    }

    fn with(mut self, other: &Self) -> Self {
        for axis in 0..3 {
            self.begins[axis].iter_mut().zip(&other.begins[axis]).for_each(|(count, more)| *count += more);
            self.ends[axis].iter_mut().zip(&other.ends[axis]).for_each(|(count, more)| *count += more);
        }
        self
    }
}

/// The box around all pieces, inside the cell.
fn around(pieces: &[Piece], cell: &Aabb) -> Aabb {
    let union =
        |chunk: &[Piece]| chunk.iter().fold(Aabb::EMPTY, |all, piece| all.union(Aabb::new(piece.min, piece.max)));
    let all = if pieces.len() > 2 * CHUNK {
        pieces.par_chunks(CHUNK).map(union).reduce(|| Aabb::EMPTY, Aabb::union)
    } else {
        union(pieces)
    };
    Aabb::new(all.min.max(cell.min).min(cell.max), all.max.min(cell.max).max(cell.min))
}

/// The cheapest cut; `None` where the cell is too thin for one.
pub(super) fn cheapest_of_bins(pieces: &[Piece], cell: &Aabb, costs: &Costs, bins: u32) -> Option<Cut> {
    let n = pieces.len();
    let bins = bins as usize;
    let over = around(pieces, cell);
    let counted = if n > 2 * CHUNK {
        let parts = pieces.par_chunks(CHUNK).map(|chunk| Bins::count(chunk, &over, bins));
        parts.reduce_with(|a, b| a.with(&b))?
    } else {
        Bins::count(pieces, &over, bins)
    };
    let mut best = None;
    for axis in 0..3 {
        let across = costs.across(cell, axis);
        let mut consider = |split: f32, left: usize, right: usize| {
            if across.contains(split) {
                best = cheaper(best, Some(Cut { axis, split, cost: across.cost(split, left, right) }));
            }
        };
        consider(over.min[axis], 0, n);
        consider(over.max[axis], n, 0);
        let width = over.extent()[axis] / bins as f32;
        let (mut left, mut ended) = (0, 0);
        for bin in 1..bins {
            left += counted.begins[axis][bin - 1] as usize;
            ended += counted.ends[axis][bin - 1] as usize;
            consider(over.min[axis] + width * bin as f32, left, n - ended);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::kd_tree::settings::KdTreeSettings;
    use glam::Vec3;

    fn box_at(triangle: u32, x: f32) -> Piece {
        Piece { min: Vec3::new(x, 0.0, 0.0), triangle, max: Vec3::new(x + 0.01, 1.0, 1.0) }
    }

    #[test]
    fn two_clusters_are_parted_between_them() {
        let costs = Costs::new(&KdTreeSettings::DEFAULT);
        let cell = Aabb::new(Vec3::ZERO, Vec3::new(8.0, 1.0, 1.0));
        let pieces: Vec<Piece> = (0..40).map(|i| box_at(i, if i % 2 == 0 { 0.5 } else { 7.5 })).collect();
        let cut = cheapest_of_bins(&pieces, &cell, &costs, 32).unwrap();
        assert_eq!(cut.axis, 0);
        assert!(pieces.iter().all(|p| p.is_left(0, cut.split) != p.is_right(0, cut.split)), "{cut:?}");
    }

    #[test]
    fn many_pieces_are_cut_as_few_are() {
        let costs = Costs::new(&KdTreeSettings::DEFAULT);
        let cell = Aabb::new(Vec3::ZERO, Vec3::new(8.0, 1.0, 1.0));
        let few: Vec<Piece> = (0..1000).map(|i| box_at(i, (i * i % 1009) as f32 / 128.0)).collect();
        let many: Vec<Piece> = (0..64).flat_map(|_| few.iter().copied()).collect();
        let cut = |pieces: &[Piece]| cheapest_of_bins(pieces, &cell, &costs, 32).unwrap();
        assert_eq!((cut(&few).axis, cut(&few).split), (cut(&many).axis, cut(&many).split));
    }
}
