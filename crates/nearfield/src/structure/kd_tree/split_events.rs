//! The cheapest of all planes where the ends of the pieces stay in order from node to node: O(n log n) for the tree.
//!
//! Source: Wald2006 §4.3: the ends are sorted once; a node's lists are parted in their order, and only the new ends of
//! pieces that a plane cuts are sorted and merged in. Differs: nodes with few pieces sort anew ([`super::split_exact`]),
//! which takes as long and needs no lists.

use super::build::with_room;
use super::clip::Piece;
use super::cost::{Costs, Cut, cheaper};
use super::split_exact::{key, sweep};
use crate::Result;
use crate::geometry::Aabb;

/// Pieces up to which nodes sort anew.
pub(super) const FEW: usize = 128;

/// An end of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct End {
    key: u32,
    /// Place of the piece in the node.
    piece: u32,
}

/// Where the pieces of a node begin and end along the axes, in order: x begins, x ends, y begins …
pub(super) struct Sorted {
    lists: [Vec<End>; 6],
}

/// The key of one of the six ends of a piece.
fn key_of(piece: &Piece, list: usize) -> u32 {
    let corner = if list.is_multiple_of(2) { piece.min } else { piece.max };
    key(corner[list / 2])
}

/// Does something for each list, the axes side by side where there are many pieces.
fn for_lists<T: Send>(n: usize, each: impl Fn(usize) -> T + Sync) -> [T; 6] {
    if n < 1 << 13 {
        return std::array::from_fn(each);
    }
    let pair = |axis: usize| rayon::join(|| each(2 * axis), || each(2 * axis + 1));
    let ((x, y), z) = rayon::join(|| rayon::join(|| pair(0), || pair(1)), || pair(2));
    [x.0, x.1, y.0, y.1, z.0, z.1]
}

/// Where a piece goes.
#[derive(Debug, Clone, Copy)]
struct Went {
    /// Its place on either side; `NOWHERE` where it is not there.
    places: [u32; 2],
    /// Whether the plane cuts it, so that it has new ends.
    is_cut: bool,
}

const NOWHERE: u32 = u32::MAX;

impl Sorted {
    /// Sorts the ends of pieces.
    pub(super) fn new(pieces: &[Piece]) -> Result<Self> {
        let lists = for_lists(pieces.len(), |list| -> Result<Vec<End>> {
            let mut ends = with_room(pieces.len())?;
            ends.extend(pieces.iter().enumerate().map(|(i, p)| End { key: key_of(p, list), piece: i as u32 }));
            ends.sort_unstable();
            Ok(ends)
        });
        Ok(Self { lists: all(lists)? })
    }

    /// The cheapest cut; `None` where the cell is too thin for one.
    pub(super) fn cheapest(&self, cell: &Aabb, costs: &Costs) -> Option<Cut> {
        let along = |axis: usize| {
            let keys = |list: usize| -> Vec<u32> { self.lists[list].iter().map(|end| end.key).collect() };
            sweep(&keys(2 * axis), &keys(2 * axis + 1), cell, axis, costs)
        };
        let [x, y, z] = if self.lists[0].len() < 1 << 13 {
            [along(0), along(1), along(2)]
        } else {
            let ((x, y), z) = rayon::join(|| rayon::join(|| along(0), || along(1)), || along(2));
            [x, y, z]
        };
        cheaper(cheaper(x, y), z)
    }

    /// The pieces on both sides of a cut, with their ends in order. `clip` gives what of a piece that the plane cuts lies
    /// left (`false`) and right of it.
    pub(super) fn part(
        &self,
        pieces: &[Piece],
        cut: &Cut,
        clip: impl Fn(&Piece, bool) -> Option<Piece>,
    ) -> Result<[(Vec<Piece>, Self); 2]> {
        let mut went = with_room(pieces.len())?;
        let mut sides: [Vec<Piece>; 2] = [with_room(pieces.len())?, with_room(pieces.len())?];
        // Places, on either side, of what is left of pieces that were cut.
        let mut fresh = [Vec::new(), Vec::new()];
        for piece in pieces {
            let on = [piece.is_left(cut.axis, cut.split), piece.is_right(cut.axis, cut.split)];
            let is_cut = on[0] && on[1];
            let mut places = [NOWHERE; 2];
            for side in 0..2 {
                let part = if is_cut { clip(piece, side == 1) } else { on[side].then_some(*piece) };
                if let Some(part) = part {
                    places[side] = sides[side].len() as u32;
                    if is_cut {
                        fresh[side].push(places[side]);
                    }
                    sides[side].push(part);
                }
            }
            went.push(Went { places, is_cut });
        }
        let [left_pieces, right_pieces] = sides;
        let lists_of = |side: usize, new_pieces: &[Piece]| -> Result<Self> {
            if new_pieces.len() <= FEW {
                return Ok(Self { lists: Default::default() });
            }
            let lists = for_lists(pieces.len(), |list| {
                let end = |&place: &u32| End { key: key_of(&new_pieces[place as usize], list), piece: place };
                let mut new: Vec<End> = fresh[side].iter().map(end).collect();
                new.sort_unstable();
                merged(&self.lists[list], &went, side, &new, new_pieces.len())
            });
            Ok(Self { lists: all(lists)? })
        };
        let (left, right) = (lists_of(0, &left_pieces)?, lists_of(1, &right_pieces)?);
        Ok([(left_pieces, left), (right_pieces, right)])
    }
}

/// The ends of one side in order: those that stay, and the new ones.
fn merged(before: &[End], went: &[Went], side: usize, new: &[End], n: usize) -> Result<Vec<End>> {
    let mut ends = with_room(n)?;
    let mut new = new.iter().copied().peekable();
    for end in before {
        let Went { places, is_cut } = went[end.piece as usize];
        if is_cut || places[side] == NOWHERE {
            continue;
        }
        while let Some(next) = new.next_if(|next| next.key < end.key) {
            ends.push(next);
        }
        ends.push(End { key: end.key, piece: places[side] });
    }
    ends.extend(new);
    Ok(ends)
}

fn all(lists: [Result<Vec<End>>; 6]) -> Result<[Vec<End>; 6]> {
    let [a, b, c, d, e, f] = lists;
    Ok([a?, b?, c?, d?, e?, f?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::structure::kd_tree::settings::KdTreeSettings;
    use crate::structure::kd_tree::split_exact::{Ends, cheapest};
    use glam::Vec3;

    #[test]
    fn parted_lists_are_what_sorting_anew_gives() {
        let mut state = 7u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let pieces: Vec<Piece> = (0..1000)
            .map(|triangle| {
                let min = Vec3::new(random(), random(), random());
                Piece { min, triangle, max: min + 0.1 * Vec3::new(random(), random(), random()) + 1e-3 }
            })
            .collect();
        let costs = Costs::new(&KdTreeSettings::DEFAULT);
        let cell = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let sorted = Sorted::new(&pieces).unwrap();
        let cut = sorted.cheapest(&cell, &costs).unwrap();
        assert_eq!(Some(cut), cheapest(&pieces, &cell, &costs, &mut Ends::default()));
        let halve = |piece: &Piece, is_right: bool| {
            let mut part = *piece;
            if is_right {
                part.min[cut.axis] = cut.split
            } else {
                part.max[cut.axis] = cut.split
            }
            Some(part)
        };
        for (side, lists) in sorted.part(&pieces, &cut, halve).unwrap() {
            assert!(side.is_sorted_by_key(|piece| piece.triangle));
            let anew = Sorted::new(&side).unwrap();
            for (list, anew) in lists.lists.iter().zip(&anew.lists) {
                assert!(list.iter().map(|end| end.key).eq(anew.iter().map(|end| end.key)));
                assert!(list.iter().all(|end| (end.piece as usize) < side.len()));
            }
        }
    }
}
