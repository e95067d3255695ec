//! One cell of the grid: what is known of its corners, which of its edges become polygons, and its sheets. `cell.wesl` is the
//! twin of this file.

use super::cell_table::{EDGES, TABLE, axis_of, first_corner};
use super::node_values::NodeValues;
use crate::geometry::Scalar;

/// Sets of edges, a bit each.
pub(super) type EdgeSet = u16;

/// A node where something begins: the edges from it along the axes, and the cell whose lowest corner it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Cell {
    /// Indices of the node.
    pub(super) node: [u32; 3],
    /// Corners that are inside.
    pub(super) inside: u8,
    /// Whether the troubled face is flipped.
    pub(super) flipped: bool,
    /// Cut edges whose ends both have values.
    pub(super) cut: EdgeSet,
    /// Those among them that have a cell on all four sides: each becomes a polygon.
    pub(super) emitted: EdgeSet,
    /// The first edge of each sheet: the vertices of the cell in their order.
    pub(super) heads: EdgeSet,
}

impl Cell {
    /// The cell whose lowest corner is this node; without corners where the grid ends before it.
    pub(super) fn of<T: Scalar>(values: &NodeValues<'_, T>, node: [u32; 3]) -> Self {
        let corners = Corners::of(values, node);
        let cut = cut_edges(corners);
        let emitted = cut & edges_inside(values.nodes(), node);
        let mut cell = Self { node, inside: corners.inside, cut, emitted, ..Self::default() };
        if emitted != 0 {
            cell.flipped = is_flipped(values, node, corners.inside);
            cell.heads = heads(cell.next(), emitted);
        }
        cell
    }

    /// Whether a polygon has a vertex in this cell, or an edge from its node is cut.
    pub(super) fn is_active(&self) -> bool {
        self.emitted != 0 || self.own_cuts() != 0
    }

    /// The edges from its node along x, y, z that are cut, by bits.
    pub(super) fn own_cuts(&self) -> u32 {
        along_axes(self.cut)
    }

    /// Those among them that become polygons.
    pub(super) fn own_quads(&self) -> u32 {
        along_axes(self.emitted)
    }

    pub(super) fn next(&self) -> &'static [u8; EDGES] {
        TABLE.next(self.inside, self.flipped)
    }

    /// Number of vertices.
    pub(super) fn n_sheets(&self) -> u32 {
        self.heads.count_ones()
    }

    /// First edges of its sheets, in order.
    pub(super) fn sheets(&self) -> impl Iterator<Item = usize> {
        let heads = self.heads;
        (0..EDGES).filter(move |edge| heads >> edge & 1 == 1)
    }

    /// The edges whose crossings place the sheet that begins at `head`: along its cycle as far as the next sheet.
    pub(super) fn sheet(&self, head: usize) -> EdgeSet {
        let mut members = 0;
        let mut edge = head;
        loop {
            members |= self.cut & 1 << edge;
            edge = usize::from(self.next()[edge]);
            if self.heads >> edge & 1 == 1 {
                return members;
            }
        }
    }

    /// Which of its sheets the polygon around `edge` is of.
    pub(super) fn sheet_of(&self, edge: usize) -> u32 {
        let holds = |head: &usize| self.sheet(*head) >> edge & 1 == 1;
        self.sheets().position(|head| holds(&head)).expect("an emitted edge should be of a sheet") as u32
    }
}

/// What is known of the eight corners.
#[derive(Debug, Clone, Copy)]
struct Corners {
    inside: u8,
    defined: u8,
}

impl Corners {
    fn of<T: Scalar>(values: &NodeValues<'_, T>, node: [u32; 3]) -> Self {
        let mut corners = Self { inside: 0, defined: 0 };
        for corner in 0..8u32 {
            let at = [node[0] + (corner & 1), node[1] + (corner >> 1 & 1), node[2] + (corner >> 2)];
            let value = values.value(at);
            // A corner without a value counts as outside, but no edge at it is cut.
            corners.inside |= u8::from(value < T::ZERO) << corner;
            corners.defined |= u8::from(value.is_finite()) << corner;
        }
        corners
    }
}

/// Edges with a value at both ends, one inside and one outside.
fn cut_edges(corners: Corners) -> EdgeSet {
    let is_cut = |edge: &usize| {
        let first = first_corner(*edge);
        let last = first | 1 << axis_of(*edge);
        let both = corners.defined >> first & corners.defined >> last & 1 == 1;
        both && (corners.inside >> first ^ corners.inside >> last) & 1 == 1
    };
    (0..EDGES).filter(is_cut).fold(0, |set, edge| set | 1 << edge)
}

/// Edges of the cell at `node` that have four cells around them.
fn edges_inside(nodes: [u32; 3], node: [u32; 3]) -> EdgeSet {
    let is_inside = |edge: &usize| {
        let corner = first_corner(*edge);
        (0..3).filter(|&axis| axis != axis_of(*edge)).all(|axis| {
            let at = node[axis] + (corner >> axis & 1) as u32;
            at > 0 && at + 1 < nodes[axis]
        })
    };
    (0..EDGES).filter(is_inside).fold(0, |set, edge| set | 1 << edge)
}

/// Whether one sheet passes twice through a face of the cell, and one of the cell beyond it too.
fn is_flipped<T: Scalar>(values: &NodeValues<'_, T>, node: [u32; 3], inside: u8) -> bool {
    let Some(face) = TABLE.troubled(inside) else { return false };
    let (axis, side) = (usize::from(face / 2), face % 2);
    let mut beyond = node;
    match side {
        0 if node[axis] == 0 => return false,
        0 => beyond[axis] -= 1,
        _ if node[axis] + 2 >= values.nodes()[axis] => return false,
        _ => beyond[axis] += 1,
    }
    TABLE.troubled(Corners::of(values, beyond).inside) == Some(face ^ 1)
}

/// The first edge of each run of emitted edges along the cycles: the one after an edge that is not emitted, or the lowest
/// where all of a cycle are. A run is a fan of polygons that share edges, so a vertex for each keeps vertices manifold also
/// where values are missing or the grid ends.
fn heads(next: &[u8; EDGES], emitted: EdgeSet) -> EdgeSet {
    let is_emitted = |edge: usize| emitted >> edge & 1 == 1;
    let followers = (0..EDGES).filter(|&edge| is_emitted(edge)).fold(0, |set, edge| set | 1 << next[edge]);
    let mut heads = emitted & !followers;
    let mut covered: EdgeSet = 0;
    let cover = |head: usize, covered: &mut EdgeSet| {
        let mut edge = head;
        while is_emitted(edge) && *covered >> edge & 1 == 0 {
            *covered |= 1 << edge;
            edge = usize::from(next[edge]);
        }
    };
    for head in (0..EDGES).filter(|head| heads >> head & 1 == 1) {
        cover(head, &mut covered);
    }
    for edge in 0..EDGES {
        if is_emitted(edge) && covered >> edge & 1 == 0 {
            heads |= 1 << edge;
            cover(edge, &mut covered);
        }
    }
    heads
}

/// The edges 0, 4 and 8 as bits 0, 1 and 2.
fn along_axes(edges: EdgeSet) -> u32 {
    u32::from(edges & 1 | edges >> 3 & 2 | edges >> 6 & 4)
}
