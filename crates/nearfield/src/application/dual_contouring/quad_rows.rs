//! Which quads may touch a quad: quads by the rows of the nodes that their edges begin at.
//!
//! Quads are ordered by node, so those of a row of nodes along x stand next to each other, by ascending x; where each row begins is
//! all that is kept, 4 bytes a row and a quad. As long as the vertices of a quad are in their cells, it reaches no farther than one
//! width from its node: quads that may touch a box are in a few rows. Those with a vertex elsewhere are looked for in a wider range.

use rayon::prelude::*;

use super::quads::Quad;
use super::surface::{Contour, Sheet};
use crate::geometry::corner_bounds::Bounds;
use crate::geometry::{RegularGrid, Scalar};

/// Rows whose first quads are looked up together.
const ROWS: usize = 256;
/// Widths from its node that a quad reaches whose vertices are in their cells: one, and what rounding adds at most beside it.
pub(super) const IN_CELLS: f64 = 1.001;
/// Widths that a range of nodes is wider than asked for: more than the rounding of coordinates in `f64`.
const SLACK: f64 = 1e-6;

/// The quads of each row of nodes.
pub(super) struct QuadRows {
    grid: RegularGrid,
    /// `[ny · nz + 1]` the first quad of each row.
    first: Vec<u32>,
    /// `[quads]` x of the node.
    x: Vec<u32>,
}

/// The node at which the edge of a quad begins.
fn node_of<T>(quad: &Quad<T>, sheets: &[Sheet<T>]) -> [u32; 3] {
    // The vertex of the cell at that node: see `quad_around`.
    sheets[quad.vertices[if quad.upwards { 2 } else { 1 }] as usize].cell
}

impl QuadRows {
    /// The rows of quads that are ordered by node.
    pub(super) fn of<T: Scalar>(contour: &Contour<T>) -> Self {
        let (grid, quads) = (contour.grid, &contour.quads);
        let [_, ny, nz] = grid.nodes().map(|n| n as usize);
        let row_of = |quad: &Quad<T>| {
            let [_, y, z] = node_of(quad, &contour.sheets);
            z as usize * ny + y as usize
        };
        let firsts = |part: usize| {
            let rows = part * ROWS..(part * ROWS + ROWS).min(ny * nz + 1);
            let mut first = quads.partition_point(|quad| row_of(quad) < rows.start);
            rows.map(move |row| {
                while first < quads.len() && row_of(&quads[first]) < row {
                    first += 1;
                }
                first as u32
            })
        };
        let first = (0..(ny * nz + 1).div_ceil(ROWS)).into_par_iter().flat_map_iter(firsts).collect();
        let x = quads.par_iter().map(|quad| node_of(quad, &contour.sheets)[0]).collect();
        Self { grid, first, x }
    }

    /// Calls `visit` with every quad from `from` on whose node is in a range, both ends included.
    fn for_each_in(&self, low: [u32; 3], high: [u32; 3], from: u32, mut visit: impl FnMut(u32)) {
        let ny = self.grid.nodes()[1] as usize;
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                let row = z as usize * ny + y as usize;
                let (begin, end) = (self.first[row].max(from), self.first[row + 1]);
                if begin >= end {
                    continue;
                }
                let xs = &self.x[begin as usize..end as usize];
                let skipped = xs.partition_point(|&x| x < low[0]);
                let within = xs[skipped..].iter().take_while(|&&x| x <= high[0]);
                within.enumerate().for_each(|(i, _)| visit(begin + (skipped + i) as u32));
            }
        }
    }

    /// Calls `visit` with every quad from `from` on that may touch a box, if it reaches no farther than `reach` widths from its node.
    pub(super) fn for_each_near<T: Scalar>(&self, bounds: &Bounds<T>, reach: f64, from: u32, visit: impl FnMut(u32)) {
        let (nodes, width) = (self.grid.nodes(), f64::from(self.grid.spacing()));
        // Numbers below 0 become 0, and NaN too: the caller compares boxes.
        let along = |axis: usize, x: T| (x.to_f64() - self.grid.coordinate(axis, 0)) / width;
        let low = [0, 1, 2].map(|axis| (along(axis, bounds[0][axis]) - reach - SLACK).ceil() as u32);
        let high = [0, 1, 2].map(|axis| (along(axis, bounds[1][axis]) + reach + SLACK).floor() as u32);
        let high = [0, 1, 2].map(|axis| high[axis].min(nodes[axis] - 1));
        self.for_each_in(low, high, from, visit);
    }

    /// Calls `visit` with the quads of a vertex.
    pub(super) fn for_each_of<T: Scalar>(&self, contour: &Contour<T>, vertex: u32, mut visit: impl FnMut(u32)) {
        // They are around the edges of its cell.
        let low = contour.sheets[vertex as usize].cell;
        let nodes = self.grid.nodes();
        let high = [0, 1, 2].map(|axis| (low[axis] + 1).min(nodes[axis] - 1));
        self.for_each_in(low, high, 0, |q| {
            if contour.quads[q as usize].vertices.contains(&vertex) {
                visit(q);
            }
        });
    }

    /// How many widths a box reaches from the node of its quad.
    pub(super) fn reach<T: Scalar>(&self, contour: &Contour<T>, quad: u32, bounds: &Bounds<T>) -> f64 {
        let node = node_of(&contour.quads[quad as usize], &contour.sheets);
        let farthest = |axis: usize| {
            let at = self.grid.coordinate(axis, node[axis]);
            (at - bounds[0][axis].to_f64()).max(bounds[1][axis].to_f64() - at)
        };
        // A box of NaN reaches nothing.
        [0, 1, 2].map(farthest).into_iter().fold(0.0, f64::max) / f64::from(self.grid.spacing())
    }
}
