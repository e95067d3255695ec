//! The cheapest of all planes at which a piece begins or ends: between two of those the expected cost is linear.
//!
//! Source: Wald2006 §4.

use super::clip::Piece;
use super::cost::{Costs, Cut, cheaper};
use crate::geometry::Aabb;

/// Room for sorting, kept from node to node.
#[derive(Debug, Default)]
pub(super) struct Ends {
    begins: Vec<u32>,
    ends: Vec<u32>,
}

/// A number that is ordered as the coordinate is.
#[inline(always)]
pub(super) fn key(coordinate: f32) -> u32 {
    let bits = coordinate.to_bits();
    bits ^ ((bits as i32 >> 31) as u32 | 0x8000_0000)
}

/// The coordinate of a key.
#[inline(always)]
pub(super) fn coordinate(key: u32) -> f32 {
    f32::from_bits(if key >> 31 == 1 { key & 0x7fff_ffff } else { !key })
}

/// The cheapest cut by sorting where the pieces begin and end; `None` where the cell is too thin for one.
pub(super) fn cheapest(pieces: &[Piece], cell: &Aabb, costs: &Costs, room: &mut Ends) -> Option<Cut> {
    let mut best = None;
    for axis in 0..3 {
        let refill = |to: &mut Vec<u32>, at: fn(&Piece, usize) -> f32| {
            to.clear();
            to.extend(pieces.iter().map(|piece| key(at(piece, axis))));
            to.sort_unstable();
        };
        refill(&mut room.begins, |piece, axis| piece.min[axis]);
        refill(&mut room.ends, |piece, axis| piece.max[axis]);
        best = cheaper(best, sweep(&room.begins, &room.ends, cell, axis, costs));
    }
    best
}

/// The cheapest cut across an axis, of ascending keys of where pieces begin and end.
pub(super) fn sweep(begins: &[u32], ends: &[u32], cell: &Aabb, axis: usize, costs: &Costs) -> Option<Cut> {
    let across = costs.across(cell, axis);
    let n = begins.len();
    let (mut begun, mut ended) = (0, 0);
    let (mut cost, mut split) = (f64::INFINITY, 0.0);
    let last = key(across.max);
    // Planes at or before the start of the cell are no cuts, but count.
    let first = key(across.min);
    while begun < n && begins[begun] <= first {
        begun += 1;
    }
    while ended < n && ends[ended] <= first {
        ended += 1;
    }
    while ended < n {
        let plane = if begun < n { begins[begun].min(ends[ended]) } else { ends[ended] };
        if plane >= last {
            break;
        }
        // A piece that ends here is not right of the plane, and one that begins here is not left of it.
        while ended < n && ends[ended] == plane {
            ended += 1;
        }
        let at = coordinate(plane);
        let here = across.cost(at, begun, n - ended);
        if here < cost {
            (cost, split) = (here, at);
        }
        while begun < n && begins[begun] == plane {
            begun += 1;
        }
    }
    (cost < f64::INFINITY).then_some(Cut { axis, split, cost })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::kd_tree::settings::KdTreeSettings;
    use glam::Vec3;

    #[test]
    fn keys_are_ordered_as_coordinates_are() {
        let ascending = [-f32::MAX, -1.5, -1e-40, -0.0, 0.0, 1e-40, 2.0, f32::MAX];
        assert!(ascending.is_sorted_by(|a, b| key(*a) < key(*b)));
        assert!(ascending.iter().all(|&c| coordinate(key(c)).to_bits() == c.to_bits()));
    }

    #[test]
    fn the_cheapest_cut_is_that_of_trying_all() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let costs = Costs::new(&KdTreeSettings::DEFAULT);
        let cell = Aabb::new(Vec3::ZERO, Vec3::new(1.0, 2.0, 0.5));
        for n in [1, 2, 7, 60] {
            let pieces: Vec<Piece> = (0..n)
                .map(|triangle| {
                    let min = Vec3::new(random() - 0.1, random(), random());
                    Piece { min, triangle, max: min + 0.2 * Vec3::new(random(), random(), random()) + 1e-3 }
                })
                .collect();
            let mut best = f64::INFINITY;
            for axis in 0..3 {
                let across = costs.across(&cell, axis);
                for split in pieces.iter().flat_map(|p| [p.min[axis], p.max[axis]]).filter(|&s| across.contains(s)) {
                    let left = pieces.iter().filter(|p| p.is_left(axis, split)).count();
                    let right = pieces.iter().filter(|p| p.is_right(axis, split)).count();
                    best = best.min(across.cost(split, left, right));
                }
            }
            let found = cheapest(&pieces, &cell, &costs, &mut Ends::default()).unwrap();
            assert_eq!(found.cost, best, "{n} pieces");
        }
    }
}
