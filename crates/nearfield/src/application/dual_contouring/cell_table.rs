//! How the surface runs through a cell: for each of the 256 ways that its corners can be inside, the cycles of edges that the
//! sheets of the surface cut. The table is derived when it is first used, face by face.
//!
//! On a face with two cut edges the surface joins them. A face with four, inside at opposite corners, is ambiguous: the rule
//! keeps the corners that are inside apart, so both cells that share the face agree whatever else they look like.
//!
//! With that rule alone two cells may touch in two places with the same two sheets: each has one sheet through both parts
//! of the ambiguous face between them. An edge of the mesh would have four polygons. In these two kinds of cells (a tunnel
//! of the outside through a wall of the inside, Wenger2013) that face is the only ambiguous one. Where both cells of a
//! face are such, the face joins the corners that are inside instead, and each cell has two sheets.
//!
//! Corner c stands at x, y, z by the bits 1, 2, 4 of c. Edge `4 · axis + b` runs along `axis`; the bits 1 and 2 of b are its
//! place along the next and the next but one axis. Face `2 · axis + side`.

use std::sync::LazyLock;

/// Edges of a cell.
pub(super) const EDGES: usize = 12;
/// In place of an edge where none is cut, and of a face where there is none.
pub(super) const NONE: u8 = 15;

/// The table, once a process.
pub(super) static TABLE: LazyLock<CellTable> = LazyLock::new(CellTable::derive);

/// Cycles of cut edges in every kind of cell.
pub(super) struct CellTable {
    /// The cut edge that follows on the cycle of a cut edge, by the corners that are inside and whether the troubled face is
    /// flipped: number `inside + 256 · flipped`.
    next: Vec<[u8; EDGES]>,
    /// The ambiguous face through which one sheet passes twice, by the corners that are inside.
    troubled: Vec<u8>,
}

impl CellTable {
    fn derive() -> Self {
        let plain: Vec<[u8; EDGES]> = (0..256).map(|inside| cycles(inside, NONE)).collect();
        let troubled: Vec<u8> = (0..256).map(|inside| troubled_face(inside, &plain[inside as usize])).collect();
        let flipped = (0..256).map(|inside| cycles(inside, troubled[inside as usize]));
        let next = plain.iter().copied().chain(flipped).collect();
        Self { next, troubled }
    }

    /// The edge that follows each cut edge.
    pub(super) fn next(&self, inside: u8, flipped: bool) -> &[u8; EDGES] {
        &self.next[usize::from(inside) + 256 * usize::from(flipped)]
    }

    /// The face of such a cell through which one sheet passes twice.
    pub(super) fn troubled(&self, inside: u8) -> Option<u8> {
        Some(self.troubled[usize::from(inside)]).filter(|&face| face != NONE)
    }

    /// The table for kernels: two words a row of [`CellTable::next`] with four bits an edge, eight edges in the first; the
    /// upper half of the second has the troubled face.
    #[cfg(feature = "gpu")]
    pub(super) fn words(&self) -> Vec<[u32; 2]> {
        let row = |(number, next): (usize, &[u8; EDGES])| {
            let bits = next.iter().enumerate().fold(0u64, |bits, (edge, &to)| bits | u64::from(to) << (4 * edge));
            let face = u64::from(self.troubled[number % 256]);
            [bits as u32, (bits >> 32 | face << 16) as u32]
        };
        self.next.iter().enumerate().map(row).collect()
    }
}

/// The corner where an edge begins; it ends one further along its axis.
pub(super) const fn first_corner(edge: usize) -> usize {
    let (axis, places) = (edge / 4, edge % 4);
    (places & 1) << ((axis + 1) % 3) | (places >> 1) << ((axis + 2) % 3)
}

/// The axis of an edge.
pub(super) const fn axis_of(edge: usize) -> usize {
    edge / 4
}

/// The edge between two corners that differ in one bit.
fn edge_between(a: usize, b: usize) -> u8 {
    let axis = (a ^ b).trailing_zeros() as usize;
    let corner = a & b;
    let places = corner >> ((axis + 1) % 3) & 1 | (corner >> ((axis + 2) % 3) & 1) << 1;
    (4 * axis + places) as u8
}

/// Corners of a face, counter-clockwise seen from outside the cell.
fn corners_of(face: usize) -> [usize; 4] {
    let (axis, side) = (face / 2, face % 2);
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let mut corners = [0, u, u | v, v].map(|corner| corner | side << axis);
    if side == 0 {
        corners.reverse();
    }
    corners
}

/// Whether the corners of a face are inside, outside, inside, outside on the way around.
fn is_ambiguous(inside: u32, face: usize) -> bool {
    let [a, b, c, d] = corners_of(face).map(|corner| inside >> corner & 1 == 1);
    a == c && b == d && a != b
}

/// The cut edge after each cut edge: on the face where the way around enters the inside on it, the surface runs to the edge
/// where that way leaves the inside. On the face `joined` it runs to the edge where the way has left the inside before.
fn cycles(inside: u32, joined: u8) -> [u8; EDGES] {
    let mut next = [NONE; EDGES];
    let is_inside = |corner: usize| inside >> corner & 1 == 1;
    for face in 0..6 {
        let corners = corners_of(face);
        let edge = |k: usize| edge_between(corners[k % 4], corners[(k + 1) % 4]);
        let enters = |k: usize| !is_inside(corners[k % 4]) && is_inside(corners[(k + 1) % 4]);
        let leaves = |k: usize| is_inside(corners[k % 4]) && !is_inside(corners[(k + 1) % 4]);
        for k in (0..4).filter(|&k| enters(k)) {
            let step = if face == usize::from(joined) { 3 } else { 1 };
            let exit = (1..4).map(|i| k + i * step).find(|&k| leaves(k)).expect("what enters should leave");
            next[usize::from(edge(k))] = edge(exit);
        }
    }
    next
}

/// The ambiguous face whose four cut edges are on one cycle.
fn troubled_face(inside: u32, next: &[u8; EDGES]) -> u8 {
    let is_troubled = |face: &usize| {
        let corners = corners_of(*face);
        let edges: Vec<u8> = (0..4).map(|k| edge_between(corners[k], corners[(k + 1) % 4])).collect();
        let mut cycle = vec![edges[0]];
        while next[usize::from(cycle[cycle.len() - 1])] != edges[0] {
            cycle.push(next[usize::from(cycle[cycle.len() - 1])]);
        }
        edges.iter().all(|edge| cycle.contains(edge))
    };
    let face = (0..6).filter(|&face| is_ambiguous(inside, face)).find(is_troubled);
    face.map_or(NONE, |face| face as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheets(next: &[u8; EDGES]) -> Vec<Vec<u8>> {
        let mut seen = [false; EDGES];
        let mut sheets = vec![];
        for first in (0..EDGES as u8).filter(|&edge| next[usize::from(edge)] != NONE) {
            let mut sheet = vec![];
            let mut edge = first;
            while !seen[usize::from(edge)] {
                seen[usize::from(edge)] = true;
                sheet.push(edge);
                edge = next[usize::from(edge)];
            }
            if !sheet.is_empty() {
                assert_eq!(edge, first, "a cycle should close where it began");
                sheets.push(sheet);
            }
        }
        sheets
    }

    #[test]
    fn every_cut_edge_is_on_one_cycle_of_at_least_three() {
        for inside in 0..=255u8 {
            for flipped in [false, true] {
                let next = TABLE.next(inside, flipped);
                for (edge, &after) in next.iter().enumerate().take(EDGES) {
                    let corner = first_corner(edge);
                    let is_cut = (inside >> corner ^ inside >> (corner | 1 << axis_of(edge))) & 1 == 1;
                    assert_eq!(after != NONE, is_cut, "case {inside}, edge {edge}");
                }
                assert!(sheets(next).iter().all(|sheet| sheet.len() >= 3), "case {inside}");
            }
        }
    }

    #[test]
    fn numbers_of_sheets_are_those_of_dual_marching_cubes() {
        // Corners that are inside are kept apart: the sheets of a cell bound the groups of inside corners that edges join,
        // seen from each group of outside corners that edges and face diagonals join.
        assert_eq!(sheets(TABLE.next(0, false)).len(), 0);
        assert_eq!(sheets(TABLE.next(0b0000_0001, false)).len(), 1);
        assert_eq!(sheets(TABLE.next(0b0000_1001, false)).len(), 2);
        assert_eq!(sheets(TABLE.next(0b0110_1001, false)).len(), 4);
        assert_eq!(sheets(TABLE.next(0b1001_0110, false)).len(), 4);
        assert_eq!(sheets(TABLE.next(0b1000_0001, false)).len(), 2);
        assert_eq!(sheets(TABLE.next(0b1111_0110, false)).len(), 1, "two corners outside at a diagonal are one tunnel");
    }

    #[test]
    fn a_troubled_face_is_the_only_ambiguous_one_and_flipping_it_parts_the_sheet() {
        let mut kinds = std::collections::BTreeSet::new();
        let mut n_troubled = 0;
        for inside in 0..=255u8 {
            let ambiguous = (0..6).filter(|&face| is_ambiguous(inside.into(), face)).count();
            let (plain, flipped) = (sheets(TABLE.next(inside, false)), sheets(TABLE.next(inside, true)));
            match TABLE.troubled(inside) {
                Some(_) => {
                    assert_eq!((ambiguous, plain.len(), flipped.len()), (1, 1, 2), "case {inside}");
                    kinds.insert(inside.count_ones());
                    n_troubled += 1;
                }
                None => assert_eq!(plain, flipped, "case {inside}"),
            }
        }
        // Two outside at a diagonal of one of six faces; the same and one more at the far end of the cell's diagonal.
        assert_eq!((n_troubled, kinds), (12 + 24, [5, 6].into()));
    }

    #[test]
    fn edges_and_corners_agree() {
        for edge in 0..EDGES {
            let first = first_corner(edge);
            assert_eq!(first >> axis_of(edge) & 1, 0);
            assert_eq!(usize::from(edge_between(first, first | 1 << axis_of(edge))), edge);
        }
    }
}
