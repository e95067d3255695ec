//! Bricks of 8³ nodes: what one task computes, and how it goes back into the grid.

use rayon::prelude::*;

use super::DistanceField;
use crate::Result;
use crate::application::Watch;
use crate::geometry::{DistanceGrid, RegularGrid, Scalar};

/// Nodes along an edge of a brick.
pub(super) const EDGE: u32 = 8;
/// Bricks between two reports.
const WINDOW: usize = 1 << 10;

/// A value and the index of what is nearest.
pub(super) type NodeValue = (f32, u32);
/// A node that nothing is near.
pub(super) const UNDEFINED: NodeValue = (f32::NAN, DistanceField::NONE);

/// The nodes of a grid in bricks.
#[derive(Debug, Clone)]
pub(super) struct Bricks<T> {
    grid: RegularGrid,
    counts: [u32; 3],
    /// Coordinates of the nodes along each axis.
    axes: [Vec<T>; 3],
}

/// The nodes of one brick, from the first to behind the last along each axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Brick {
    pub(super) first: [u32; 3],
    pub(super) end: [u32; 3],
}

impl Brick {
    /// The nodes, each beside the one before it: x and y turn back at their ends.
    pub(super) fn nodes(self) -> impl Iterator<Item = [u32; 3]> {
        let [_, ny, _] = self.counts();
        (self.first[2]..self.end[2]).flat_map(move |k| {
            let layer = k - self.first[2];
            self.turning(1, layer % 2 == 1)
                .zip(0u32..)
                .flat_map(move |(j, row)| self.turning(0, (row + layer * ny) % 2 == 1).map(move |i| [i, j, k]))
        })
    }

    fn turning(self, axis: usize, backwards: bool) -> impl Iterator<Item = u32> {
        let (first, end) = (self.first[axis], self.end[axis]);
        (first..end).map(move |i| if backwards { first + end - 1 - i } else { i })
    }

    fn counts(&self) -> [u32; 3] {
        [0, 1, 2].map(|axis| self.end[axis] - self.first[axis])
    }

    /// Place of a node among those of its brick, x fastest.
    pub(super) fn place(&self, node: [u32; 3]) -> usize {
        let [i, j, k] = [0, 1, 2].map(|axis| (node[axis] - self.first[axis]) as usize);
        let [nx, ny] = [0, 1].map(|axis| (self.end[axis] - self.first[axis]) as usize);
        (k * ny + j) * nx + i
    }

    pub(super) fn len(&self) -> usize {
        (0..3).map(|axis| (self.end[axis] - self.first[axis]) as usize).product()
    }
}

impl<T: Scalar> Bricks<T> {
    pub(super) fn new(grid: &RegularGrid) -> Self {
        let nodes = grid.nodes();
        let axes = [0, 1, 2].map(|axis| (0..nodes[axis]).map(|i| T::of(grid.coordinate(axis, i))).collect());
        Self { grid: *grid, counts: nodes.map(|n| n.div_ceil(EDGE)), axes }
    }

    pub(super) fn len(&self) -> usize {
        self.counts.iter().map(|&n| n as usize).product()
    }

    pub(super) fn brick(&self, number: usize) -> Brick {
        let [nx, ny, _] = self.counts.map(|n| n as usize);
        let at = [number % nx, number / nx % ny, number / nx / ny].map(|i| i as u32 * EDGE);
        let nodes = self.grid.nodes();
        Brick { first: at, end: [0, 1, 2].map(|axis| (at[axis] + EDGE).min(nodes[axis])) }
    }

    #[inline(always)]
    pub(super) fn position(&self, node: [u32; 3]) -> [T; 3] {
        [0, 1, 2].map(|axis| self.axes[axis][node[axis] as usize])
    }

    /// The middle of a brick, and a distance from it within which all of its nodes lie, with room for rounding.
    pub(super) fn ball(&self, brick: &Brick) -> ([T; 3], T) {
        let ends = [brick.first, brick.end.map(|i| i - 1)].map(|node| self.position(node));
        let middle = [0, 1, 2].map(|axis| T::of(0.5) * (ends[0][axis] + ends[1][axis]));
        let half = |axis: usize| (ends[1][axis] - middle[axis]).larger(middle[axis] - ends[0][axis]);
        let radius = (half(0) * half(0) + half(1) * half(1) + half(2) * half(2)).sqrt();
        (middle, radius * T::of(1.001))
    }

    /// Runs `fill` on every brick, on all threads; bricks for which it gives nothing stay undefined.
    ///
    /// # Errors
    /// `OutOfMemory`, `Interrupted`.
    pub(super) fn compute(
        &self,
        stage: &'static str,
        watch: &mut Watch<'_>,
        fill: impl Fn(&Brick) -> Option<Vec<NodeValue>> + Sync,
    ) -> Result<DistanceField> {
        let mut distances = DistanceGrid::undefined(self.grid)?;
        let mut nearest = Vec::new();
        let needed = self.grid.n_nodes() as u64 * size_of::<u32>() as u64;
        nearest.try_reserve_exact(self.grid.n_nodes()).map_err(|_| crate::Error::OutOfMemory {
            what: "a distance field",
            needed,
            available: 0,
        })?;
        nearest.resize(self.grid.n_nodes(), DistanceField::NONE);
        let all: Vec<usize> = (0..self.len()).collect();
        for window in all.chunks(WINDOW) {
            watch.report(stage, window[0] as u64, all.len() as u64)?;
            let filled: Vec<Option<Vec<NodeValue>>> =
                window.par_iter().with_max_len(4).map(|&number| fill(&self.brick(number))).collect();
            for (&number, values) in window.iter().zip(filled).filter_map(|(n, values)| Some((n, values?))) {
                self.store(&self.brick(number), &values, distances.values_mut(), &mut nearest);
            }
        }
        Ok(DistanceField { distances, nearest })
    }

    fn store(&self, brick: &Brick, values: &[NodeValue], distances: &mut [f32], nearest: &mut [u32]) {
        let width = (brick.end[0] - brick.first[0]) as usize;
        let rows = (brick.first[2]..brick.end[2]).flat_map(|k| (brick.first[1]..brick.end[1]).map(move |j| [j, k]));
        for ([j, k], row) in rows.zip(values.chunks_exact(width)) {
            let start = self.grid.number([brick.first[0], j, k]).expect("a brick should lie in its grid");
            for (i, &(value, index)) in row.iter().enumerate() {
                (distances[start + i], nearest[start + i]) = (value, index);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};

    #[test]
    fn bricks_tile_the_grid_and_walks_go_from_node_to_neighbour() {
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, [17, 9, 11]).unwrap();
        let bricks = Bricks::<f64>::new(&grid);
        let mut met = vec![0; grid.n_nodes()];
        for number in 0..bricks.len() {
            let brick = bricks.brick(number);
            let nodes: Vec<[u32; 3]> = brick.nodes().collect();
            assert_eq!(nodes.len(), brick.len());
            let mut places: Vec<usize> = nodes.iter().map(|&node| brick.place(node)).collect();
            places.sort_unstable();
            assert!(places.iter().copied().eq(0..brick.len()));
            nodes.iter().for_each(|&node| met[grid.number(node).unwrap()] += 1);
            for pair in nodes.windows(2) {
                let step: u32 = (0..3).map(|axis| pair[0][axis].abs_diff(pair[1][axis])).sum();
                assert_eq!(step, 1, "{pair:?}");
            }
            let (middle, radius) = bricks.ball(&brick);
            let farthest = |node: &[u32; 3]| {
                crate::geometry::vector::norm(std::array::from_fn(|a| f64::from(node[a]) - middle[a]))
            };
            assert!(nodes.iter().all(|node| farthest(node) <= radius));
        }
        assert!(met.iter().all(|&times| times == 1));
    }
}
