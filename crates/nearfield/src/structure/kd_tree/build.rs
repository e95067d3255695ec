//! From triangles to nodes, leaves and references, on all threads.
//!
//! A node's pieces are parted between its children until a cut no longer pays. Nodes with many pieces hand their halves to two
//! threads; below that a thread builds a whole subtree in arrays of its own, which are put together at the end. The tree
//! does not depend on the number of threads.
//!
//! Memory: a node gets a share of the bytes that the tree may take. A leaf of n references takes 72 + 4 n of them. A cut
//! needs room for both of its sides as leaves; what is left is shared out by their numbers of references. So the bound
//! holds whatever is built first.

use rayon::prelude::*;

use super::clip::{Piece, clip, clip_halves};
use super::cost::{Costs, Cut};
use super::layout::{KdArrays, KdLeaf, KdNode, halves};
use super::settings::{KdBuild, KdTreeSettings};
use super::split_binned::cheapest_of_bins;
use super::split_events::{self, Sorted};
use super::split_exact::{Ends, cheapest};
use super::split_median::middle_of_longest_side;
use crate::geometry::{Aabb, PreparedTriangle, RaySpace};
use crate::{Error, Result};

/// Pieces from which on the halves of a node are built side by side.
const FORK: usize = 1 << 13;
/// Pieces up to which [`KdBuild::BinnedSah`] compares all planes: there sorting costs no more than bins do.
const FEW: usize = 64;
/// Cuts in a row of [`KdBuild::ExactSah`] that may make things worse, in the hope of a good one below. Bins do without: for a
/// cost 0.7 to 1.3 % higher there are a quarter fewer nodes, built in half the time.
const BAD_CUTS: u32 = 3;
/// Cuts of spatial median in a row that may leave all triangles on both sides.
const USELESS_CUTS: u32 = 3;
/// Pieces that a thread clips at once.
const CHUNK: usize = 1 << 12;

/// Bytes of a leaf with so many references, its node included.
pub(super) fn leaf_bytes(references: usize) -> u64 {
    (size_of::<KdNode>() + size_of::<KdLeaf>() + size_of::<u32>() * references) as u64
}

/// What a node knows of its place.
#[derive(Debug, Clone, Copy)]
struct Place {
    cell: Aabb,
    depth: u32,
    /// Cuts above it, in a row, that were worse than none.
    bad_cuts: u32,
    /// Bytes that its subtree may take.
    bytes: u64,
}

impl Place {
    /// The places of the children; `None` where there is no room for them.
    fn halves(&self, cut: &Cut, is_bad: bool, counts: [usize; 2]) -> Option<[Self; 2]> {
        let needed = counts.map(leaf_bytes);
        let spare = self.bytes.checked_sub(size_of::<KdNode>() as u64 + needed[0] + needed[1])?;
        let total = (counts[0] + counts[1]).max(1) as u128;
        let left = (u128::from(spare) * counts[0] as u128 / total) as u64;
        let [left_cell, right_cell] = halves(&self.cell, cut.axis, cut.split);
        let bad_cuts = if is_bad { self.bad_cuts + 1 } else { 0 };
        let half = |cell, bytes| Self { cell, depth: self.depth + 1, bad_cuts, bytes };
        Some([half(left_cell, needed[0] + left), half(right_cell, needed[1] + spare - left)])
    }
}

/// A subtree that one thread has built: the first node is its root, indices count from its own arrays.
#[derive(Debug, Default)]
struct Part {
    nodes: Vec<KdNode>,
    leaves: Vec<KdLeaf>,
    references: Vec<u32>,
}

impl Part {
    fn of_leaf(pieces: impl Iterator<Item = u32>) -> Self {
        let mut part = Self { nodes: vec![KdNode::leaf(0)], ..Self::default() };
        part.close(0, pieces);
        part
    }

    /// Makes a node a leaf.
    fn close(&mut self, node: usize, triangles: impl Iterator<Item = u32>) {
        let first = self.references.len();
        self.references.extend(triangles);
        let count = (self.references.len() - first) as u32;
        self.nodes[node] = KdNode::leaf(self.leaves.len() as u32);
        self.leaves.push(KdLeaf::of_references(first as u32, count));
    }
}

/// A subtree, as far as it is put together.
enum Built {
    Part(Part),
    Fork { axis: usize, split: f32, sides: Box<[Built; 2]> },
}

/// What the builders share.
pub(super) struct Builder<'a> {
    triangles: &'a [PreparedTriangle],
    margin: f32,
    settings: &'a KdTreeSettings,
    costs: Costs,
}

/// Builds the arrays of a tree, all but the boxes of the leaves and their ropes.
///
/// # Errors
/// `OutOfMemory` where `max_bytes` has no room for one leaf with all triangles, or the host has none for the pieces.
pub(super) fn build(triangles: &[PreparedTriangle], space: &RaySpace, settings: &KdTreeSettings) -> Result<KdArrays> {
    let builder = Builder { triangles, margin: space.margin, settings, costs: Costs::new(settings) };
    let pieces = builder.whole_triangles(space)?;
    let bytes = settings.byte_bound(triangles.len());
    if leaf_bytes(pieces.len()) > bytes {
        return Err(Error::OutOfMemory { what: "a kd-tree", needed: leaf_bytes(pieces.len()), available: bytes });
    }
    let root = Place { cell: space.widened_bounds(), depth: 0, bad_cuts: 0, bytes };
    let (built, _) = if settings.build == KdBuild::ExactSah {
        let sorted = Sorted::new(&pieces)?;
        builder.grow_sorted(pieces, sorted, root)?
    } else {
        builder.grow(pieces, root)?
    };
    put_together(&built)
}

impl Builder<'_> {
    /// Every triangle with an area, whole.
    fn whole_triangles(&self, space: &RaySpace) -> Result<Vec<Piece>> {
        let mut pieces = with_room(self.triangles.len())?;
        let numbered = self.triangles.iter().enumerate();
        pieces.extend(numbered.filter(|(_, triangle)| triangle.has_area()).map(|(i, triangle)| {
            let Aabb { min, max } = space.widened(&triangle.bounds());
            Piece { min, triangle: i as u32, max }
        }));
        Ok(pieces)
    }

    /// Where to cut a node, and whether that is worse than not to.
    fn choose(&self, pieces: &[Piece], place: &Place, room: &mut Ends) -> Option<(Cut, bool)> {
        if !self.may_cut(pieces.len(), place) {
            return None;
        }
        let cut = match self.settings.build {
            KdBuild::SpatialMedian => {
                let (axis, split) = middle_of_longest_side(&place.cell)?;
                let useless = pieces.iter().all(|piece| piece.is_left(axis, split) && piece.is_right(axis, split));
                let stop = useless && place.bad_cuts + 1 >= USELESS_CUTS;
                return (!stop).then_some((Cut { axis, split, cost: 0.0 }, useless));
            }
            KdBuild::BinnedSah if pieces.len() > FEW => {
                cheapest_of_bins(pieces, &place.cell, &self.costs, self.settings.bins)
            }
            _ => cheapest(pieces, &place.cell, &self.costs, room),
        };
        self.weigh(cut?, pieces.len(), place)
    }

    fn may_cut(&self, n: usize, place: &Place) -> bool {
        n > self.settings.leaf_limit as usize && n > 0 && place.depth < self.settings.max_depth
    }

    /// Whether a cut of the surface area heuristic is taken.
    fn weigh(&self, cut: Cut, n: usize, place: &Place) -> Option<(Cut, bool)> {
        let as_leaf = self.costs.leaf(&place.cell, n);
        let is_bad = cut.cost >= as_leaf;
        let hopeless = self.settings.build != KdBuild::ExactSah || cut.cost > 4.0 * as_leaf && n < 16;
        (!(is_bad && (hopeless || place.bad_cuts >= BAD_CUTS))).then_some((cut, is_bad))
    }

    /// The part of a piece in one half of its cell.
    #[inline(always)]
    fn part_of(&self, piece: &Piece, cell: &Aabb) -> Option<Piece> {
        if self.settings.build == KdBuild::SpatialMedian {
            return Some(*piece);
        }
        clip(&self.triangles[piece.triangle as usize], piece.triangle, cell, self.margin)
    }

    /// The parts of a piece in both halves of its cell.
    #[inline(always)]
    fn parts_of(&self, piece: &Piece, cell: &Aabb, cut: &Cut) -> [Option<Piece>; 2] {
        if self.settings.build == KdBuild::SpatialMedian {
            return [Some(*piece); 2];
        }
        let triangle = &self.triangles[piece.triangle as usize];
        clip_halves(triangle, piece.triangle, cell, (cut.axis, cut.split), self.margin)
    }

    /// The pieces of one side of a cut, in order.
    fn side(&self, pieces: &[Piece], cut: &Cut, cell: &Aabb, is_right: bool) -> impl Iterator<Item = Piece> {
        pieces.iter().filter_map(move |piece| {
            let sides = [piece.is_left(cut.axis, cut.split), piece.is_right(cut.axis, cut.split)];
            match sides {
                [true, true] => self.part_of(piece, cell),
                _ => sides[usize::from(is_right)].then_some(*piece),
            }
        })
    }

    /// Builds a subtree; with it comes its expected cost, times the surface of its cell.
    fn grow(&self, pieces: Vec<Piece>, place: Place) -> Result<(Built, f64)> {
        if pieces.len() < FORK {
            return Ok(self.grow_alone(pieces, place));
        }
        let n = pieces.len();
        let as_leaf = self.costs.leaf(&place.cell, n);
        let leaf = |pieces: &[Piece]| Built::Part(Part::of_leaf(pieces.iter().map(|piece| piece.triangle)));
        let Some((cut, is_bad)) = self.choose(&pieces, &place, &mut Ends::default()) else {
            return Ok((leaf(&pieces), as_leaf));
        };
        let cells = halves(&place.cell, cut.axis, cut.split);
        let part = |is_right: bool| -> Result<Vec<Piece>> {
            let cell = &cells[usize::from(is_right)];
            let chunks: Vec<Vec<Piece>> =
                pieces.par_chunks(CHUNK).map(|chunk| self.side(chunk, &cut, cell, is_right).collect()).collect();
            let mut all = with_room(chunks.iter().map(Vec::len).sum())?;
            chunks.iter().for_each(|chunk| all.extend_from_slice(chunk));
            Ok(all)
        };
        let (left, right) = (part(false)?, part(true)?);
        let Some([left_place, right_place]) = place.halves(&cut, is_bad, [left.len(), right.len()]) else {
            return Ok((leaf(&pieces), as_leaf));
        };
        drop(pieces);
        let (left, right) = rayon::join(|| self.grow(left, left_place), || self.grow(right, right_place));
        let ((left, left_cost), (right, right_cost)) = (left?, right?);
        let cost = self.costs.pass(&place.cell) + left_cost + right_cost;
        Ok((Built::Fork { axis: cut.axis, split: cut.split, sides: Box::new([left, right]) }, cost))
    }

    /// Builds a subtree on this thread.
    fn grow_alone(&self, mut pieces: Vec<Piece>, place: Place) -> (Built, f64) {
        let mut part = Part { nodes: vec![KdNode::leaf(0)], ..Part::default() };
        let (left, room) = (vec![], Ends::default());
        let mut growing = Growing { builder: self, part: &mut part, pieces: &mut pieces, left, room };
        let cost = growing.grow(0, 0, place);
        (Built::Part(part), cost)
    }

    /// As [`Builder::grow`], with the ends of the pieces in order.
    fn grow_sorted(&self, pieces: Vec<Piece>, sorted: Sorted, place: Place) -> Result<(Built, f64)> {
        if pieces.len() <= split_events::FEW {
            return Ok(self.grow_alone(pieces, place));
        }
        let n = pieces.len();
        let as_leaf = self.costs.leaf(&place.cell, n);
        let leaf = |pieces: &[Piece]| Built::Part(Part::of_leaf(pieces.iter().map(|piece| piece.triangle)));
        let cut = if self.may_cut(n, &place) { sorted.cheapest(&place.cell, &self.costs) } else { None };
        let Some((cut, is_bad)) = cut.and_then(|cut| self.weigh(cut, n, &place)) else {
            return Ok((leaf(&pieces), as_leaf));
        };
        let [left_cell, right_cell] = halves(&place.cell, cut.axis, cut.split);
        let clip_to =
            |piece: &Piece, is_right: bool| self.part_of(piece, if is_right { &right_cell } else { &left_cell });
        let [left, right] = sorted.part(&pieces, &cut, clip_to)?;
        let Some([left_place, right_place]) = place.halves(&cut, is_bad, [left.0.len(), right.0.len()]) else {
            return Ok((leaf(&pieces), as_leaf));
        };
        drop((pieces, sorted));
        let left = || self.grow_sorted(left.0, left.1, left_place);
        let right = || self.grow_sorted(right.0, right.1, right_place);
        let (left, right) = if n >= FORK { rayon::join(left, right) } else { (left(), right()) };
        let ((left, left_cost), (right, right_cost)) = (left?, right?);
        let cost = self.costs.pass(&place.cell) + left_cost + right_cost;
        Ok((Built::Fork { axis: cut.axis, split: cut.split, sides: Box::new([left, right]) }, cost))
    }
}

/// One thread at work on a subtree.
struct Growing<'a> {
    builder: &'a Builder<'a>,
    part: &'a mut Part,
    /// A stack: those of a node, of its right child, of that one's left child …
    pieces: &'a mut Vec<Piece>,
    /// Those of a left child while the right one's are put on the stack; empty between nodes.
    left: Vec<Piece>,
    room: Ends,
}

impl Growing<'_> {
    /// Builds the subtree of a node, whose pieces stand at the end of the stack from `first` on. They are still there when it
    /// is done.
    fn grow(&mut self, node: usize, first: usize, place: Place) -> f64 {
        let builder = self.builder;
        let end = self.pieces.len();
        let as_leaf = builder.costs.leaf(&place.cell, end - first);
        let cut = builder.choose(&self.pieces[first..], &place, &mut self.room);
        let children = cut.and_then(|(cut, is_bad)| {
            for i in first..end {
                let piece = self.pieces[i];
                let sides = [piece.is_left(cut.axis, cut.split), piece.is_right(cut.axis, cut.split)];
                let [left, right] = match sides {
                    [true, true] => builder.parts_of(&piece, &place.cell, &cut),
                    _ => sides.map(|is_here| is_here.then_some(piece)),
                };
                self.left.extend(left);
                self.pieces.extend(right);
            }
            let right_end = self.pieces.len();
            self.pieces.append(&mut self.left);
            let counts = [self.pieces.len() - right_end, right_end - end];
            Some((cut, right_end, place.halves(&cut, is_bad, counts)?))
        });
        let Some((cut, right_end, [left_place, right_place])) = children else {
            self.pieces.truncate(end);
            self.close(node, first);
            return as_leaf;
        };
        let before = (self.part.nodes.len(), self.part.leaves.len(), self.part.references.len());
        let child = before.0;
        self.part.nodes.extend([KdNode::leaf(0); 2]);
        self.part.nodes[node] = KdNode::inner(cut.axis, cut.split, child as u32);
        let mut cost = builder.costs.pass(&place.cell);
        cost += self.grow(child, right_end, left_place);
        self.pieces.truncate(right_end);
        cost += self.grow(child + 1, end, right_place);
        self.pieces.truncate(end);
        // Source: Mitsuba.
        if builder.settings.build != KdBuild::SpatialMedian && cost >= as_leaf {
            // The hope has not come true.
            self.part.nodes.truncate(before.0);
            self.part.leaves.truncate(before.1);
            self.part.references.truncate(before.2);
            self.close(node, first);
            return as_leaf;
        }
        cost
    }

    fn close(&mut self, node: usize, first: usize) {
        self.part.close(node, self.pieces[first..].iter().map(|piece| piece.triangle));
    }
}

/// A vector with room, or the error that there is none.
pub(super) fn with_room<T>(n: usize) -> Result<Vec<T>> {
    let mut items = Vec::new();
    let needed = (n as u64).saturating_mul(size_of::<T>() as u64);
    let refused = |_| Error::OutOfMemory { what: "a kd-tree", needed, available: 0 };
    items.try_reserve_exact(n).map_err(refused)?;
    Ok(items)
}

/// Makes one tree of the parts.
fn put_together(built: &Built) -> Result<KdArrays> {
    fn add_sizes(built: &Built, sizes: &mut [usize; 3]) {
        match built {
            Built::Part(part) => {
                sizes[0] += part.nodes.len();
                sizes[1] += part.leaves.len();
                sizes[2] += part.references.len();
            }
            Built::Fork { sides, .. } => {
                sizes[0] += 1;
                sides.iter().for_each(|side| add_sizes(side, sizes));
            }
        }
    }

    fn place(built: &Built, node: usize, arrays: &mut KdArrays) {
        match built {
            Built::Part(part) => {
                let (base, leaf_base) = (arrays.nodes.len() as u32, arrays.leaves.len() as u32);
                let reference_base = arrays.references.len() as u32;
                // The part's first node is already here; the others follow.
                let moved = |n: &KdNode| {
                    if n.is_leaf() {
                        KdNode::leaf(leaf_base + n.index())
                    } else {
                        KdNode::inner(n.axis(), n.split, base + n.index() - 1)
                    }
                };
                let [first, others @ ..] = &part.nodes[..] else { return };
                arrays.nodes[node] = moved(first);
                arrays.nodes.extend(others.iter().map(moved));
                let leaves = part.leaves.iter();
                arrays.leaves.extend(leaves.map(|leaf| KdLeaf { first: reference_base + leaf.first, ..*leaf }));
                arrays.references.extend_from_slice(&part.references);
            }
            Built::Fork { axis, split, sides } => {
                let child = arrays.nodes.len();
                arrays.nodes.extend([KdNode::leaf(0); 2]);
                arrays.nodes[node] = KdNode::inner(*axis, *split, child as u32);
                place(&sides[0], child, arrays);
                place(&sides[1], child + 1, arrays);
            }
        }
    }

    let mut sizes = [0; 3];
    add_sizes(built, &mut sizes);
    let [nodes, leaves, references] = sizes;
    let mut arrays =
        KdArrays { nodes: with_room(nodes)?, leaves: with_room(leaves)?, references: with_room(references)? };
    arrays.nodes.push(KdNode::leaf(0));
    place(built, 0, &mut arrays);
    Ok(arrays)
}
