//! Nodes at equal distances along the three axes: where a sampled field has its values.

use glam::{DVec3, Vec3};

use super::Aabb;
use crate::{Error, Result};

/// Most nodes of a grid: their numbers are `u32`.
const MOST_NODES: u64 = u32::MAX as u64;

/// A regular grid of nodes, without values.
///
/// Node (i, j, k) stands at `corner + spacing · (i, j, k)` relative to `origin`, as the points of a
/// [`PointCloud`](super::PointCloud) and a [`TriMesh`](super::TriMesh) with this origin do. Its number is
/// `(k · ny + j) · nx + i`: x changes fastest. There are at least two nodes along each axis and at most 2³² − 1 in all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegularGrid {
    origin: DVec3,
    corner: Vec3,
    spacing: f32,
    nodes: [u32; 3],
}

impl RegularGrid {
    /// A grid by its first node, the distance of neighbouring nodes and the number of nodes along each axis.
    ///
    /// # Errors
    /// `InvalidSetting` where the spacing is not positive and finite, the corner or the origin is not finite, a node would
    /// lie beyond ±1e18, the spacing vanishes beside the coordinates, or there are fewer than two nodes along an axis;
    /// `TooMany` with 2³² nodes or more.
    pub fn new(origin: DVec3, corner: Vec3, spacing: f32, nodes: [u32; 3]) -> Result<Self> {
        let refused = |setting, found, expected| Err(Error::InvalidSetting { setting, found, expected });
        if !(spacing.is_normal() && spacing > 0.0) {
            return refused("grid spacing", format!("{spacing:e}"), "a positive finite length");
        }
        if let Some(few) = nodes.iter().find(|&&n| n < 2) {
            return refused("nodes along an axis", few.to_string(), "at least 2");
        }
        let count = nodes.iter().try_fold(1u64, |product, &n| product.checked_mul(u64::from(n))).unwrap_or(u64::MAX);
        if count > MOST_NODES {
            return Err(Error::TooMany {
                what: "nodes of a regular grid",
                found: count,
                limit: MOST_NODES,
                advice: "take a wider spacing, a lower resolution or a narrower band",
            });
        }
        let grid = Self { origin, corner, spacing, nodes };
        let farthest = [0usize, 1, 2].map(|axis| grid.coordinate(axis, nodes[axis] - 1).abs());
        let reach = farthest.into_iter().fold(corner.as_dvec3().abs().max_element(), f64::max);
        if !(origin.is_finite() && corner.is_finite() && reach <= 1e18) {
            return refused("grid corner", format!("{corner} of {origin}"), "coordinates within ±1e18");
        }
        if reach * f64::from(f32::EPSILON) > f64::from(spacing) {
            return refused(
                "grid spacing",
                format!("{spacing:e} at coordinates up to {reach:e}"),
                "more than the rounding of the coordinates: an origin near the grid, or a wider spacing",
            );
        }
        Ok(grid)
    }

    /// The grid over a box with this spacing: as few nodes as hold the box, in the middle of it.
    ///
    /// # Errors
    /// As [`RegularGrid::new`]; `InvalidSetting` where the box is empty.
    pub fn over(origin: DVec3, bounds: &Aabb, spacing: f32) -> Result<Self> {
        let extent = bounds.max.as_dvec3() - bounds.min.as_dvec3();
        if !(extent.is_finite() && extent.min_element() >= 0.0) {
            return Err(Error::InvalidSetting {
                setting: "bounds of a grid",
                found: format!("{} to {}", bounds.min, bounds.max),
                expected: "a box with finite corners that is not empty",
            });
        }
        let cells = (extent / f64::from(spacing)).ceil().max(DVec3::ONE);
        let nodes = cells.to_array().map(|n| if n < MOST_NODES as f64 { n as u32 + 1 } else { u32::MAX });
        let middle = 0.5 * (bounds.min.as_dvec3() + bounds.max.as_dvec3());
        let corner = middle - 0.5 * f64::from(spacing) * cells;
        Self::new(origin, corner.as_vec3(), spacing, nodes)
    }

    /// What is added to positions to get world coordinates.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Node (0, 0, 0), relative to `origin`.
    pub fn corner(&self) -> Vec3 {
        self.corner
    }

    /// Node (0, 0, 0) in world coordinates.
    pub fn world_corner(&self) -> DVec3 {
        self.origin + self.corner.as_dvec3()
    }

    /// Distance of neighbouring nodes: the width of a cell.
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Number of nodes along x, y and z.
    pub fn nodes(&self) -> [u32; 3] {
        self.nodes
    }

    /// Number of cells along x, y and z: one less than nodes.
    pub fn cells(&self) -> [u32; 3] {
        self.nodes.map(|n| n - 1)
    }

    /// Number of nodes in all.
    pub fn n_nodes(&self) -> usize {
        self.nodes.iter().map(|&n| n as usize).product()
    }

    /// The box of all nodes, relative to `origin`.
    pub fn bounds(&self) -> Aabb {
        let last = self.nodes.map(|n| n - 1);
        Aabb::new(self.corner, self.position(last))
    }

    /// Whether there is a node with these indices.
    pub fn contains(&self, node: [u32; 3]) -> bool {
        node.iter().zip(&self.nodes).all(|(i, n)| i < n)
    }

    /// The number of a node, its place among the values; `None` outside the grid.
    pub fn number(&self, node: [u32; 3]) -> Option<usize> {
        self.contains(node).then(|| self.number_of(node))
    }

    /// The node with this number; `None` beyond the last.
    pub fn node(&self, number: usize) -> Option<[u32; 3]> {
        let [nx, ny, _] = self.nodes.map(|n| n as usize);
        let node = [number % nx, number / nx % ny, number / nx / ny].map(|i| i as u32);
        (number < self.n_nodes()).then_some(node)
    }

    /// Coordinate of the nodes with index `i` along an axis, relative to `origin`, exact but for the last bits of an `f64`.
    ///
    /// # Panics
    /// If `axis` is not 0, 1 or 2.
    pub fn coordinate(&self, axis: usize, i: u32) -> f64 {
        f64::from(self.corner[axis]) + f64::from(self.spacing) * f64::from(i)
    }

    /// Position of a node, which may lie outside the grid, relative to `origin`.
    pub fn position(&self, node: [u32; 3]) -> Vec3 {
        let [x, y, z] = [0, 1, 2].map(|axis| self.coordinate(axis, node[axis]) as f32);
        Vec3::new(x, y, z)
    }

    /// The cell that holds a position relative to `origin`, by its lowest node, and the place in it from 0 to 1 along each
    /// axis. `None` outside the grid and for positions that are not numbers.
    pub fn cell_at(&self, position: DVec3) -> Option<([u32; 3], [f64; 3])> {
        let mut cell = ([0; 3], [0.0; 3]);
        for (axis, cells) in self.cells().into_iter().enumerate() {
            let along = (position[axis] - f64::from(self.corner[axis])) / f64::from(self.spacing);
            if !(along >= 0.0 && along <= f64::from(cells)) {
                return None;
            }
            cell.0[axis] = (along as u32).min(cells - 1);
            cell.1[axis] = along - f64::from(cell.0[axis]);
        }
        Some(cell)
    }

    #[inline(always)]
    pub(super) fn number_of(&self, [i, j, k]: [u32; 3]) -> usize {
        (k as usize * self.nodes[1] as usize + j as usize) * self.nodes[0] as usize + i as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_run_along_x_first() {
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, [4, 3, 2]).unwrap();
        assert_eq!(grid.number([1, 0, 0]), Some(1));
        assert_eq!(grid.number([0, 1, 0]), Some(4));
        assert_eq!(grid.number([0, 0, 1]), Some(12));
        for number in 0..grid.n_nodes() {
            assert_eq!(grid.number(grid.node(number).unwrap()), Some(number));
        }
        assert_eq!((grid.number([4, 0, 0]), grid.node(24)), (None, None));
    }

    #[test]
    fn a_box_is_held_in_the_middle_by_the_fewest_nodes() {
        let bounds = Aabb::new(Vec3::new(-1.0, 0.0, 2.0), Vec3::new(1.0, 0.75, 2.0));
        let grid = RegularGrid::over(DVec3::ZERO, &bounds, 0.5).unwrap();
        assert_eq!(grid.nodes(), [5, 3, 2]);
        assert_eq!(grid.corner(), Vec3::new(-1.0, -0.125, 1.75));
        assert_eq!(grid.position([4, 2, 1]), Vec3::new(1.0, 0.875, 2.25));
    }

    #[test]
    fn positions_have_a_cell_up_to_the_border() {
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::ONE, 0.5, [3, 3, 3]).unwrap();
        assert_eq!(grid.cell_at(DVec3::new(1.25, 2.0, 1.0)), Some(([0, 1, 0], [0.5, 1.0, 0.0])));
        assert_eq!(grid.cell_at(DVec3::new(0.999, 1.5, 1.5)), None);
        assert_eq!(grid.cell_at(DVec3::new(1.5, f64::NAN, 1.5)), None);
    }

    #[test]
    fn unusable_grids_say_why() {
        let new = |corner: f32, spacing, nodes| RegularGrid::new(DVec3::ZERO, Vec3::splat(corner), spacing, nodes);
        for spacing in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(matches!(new(0.0, spacing, [9; 3]), Err(Error::InvalidSetting { setting: "grid spacing", .. })));
        }
        assert!(new(0.0, 1.0, [5, 1, 5]).unwrap_err().to_string().contains("nodes along an axis = 1"));
        assert!(matches!(new(0.0, 1.0, [1626; 3]), Err(Error::TooMany { found: 4_298_942_376, .. })));
        assert!(matches!(new(0.0, 1.0, [u32::MAX; 3]), Err(Error::TooMany { .. })));
        assert!(new(f32::NAN, 1.0, [5; 3]).is_err() && new(0.0, 1e18, [5; 3]).is_err());
        assert!(new(1e6, 0.01, [5; 3]).unwrap_err().to_string().contains("origin near the grid"));
        assert!(RegularGrid::over(DVec3::ZERO, &Aabb::EMPTY, 1.0).is_err());
        assert!(RegularGrid::over(DVec3::ZERO, &Aabb::new(Vec3::ZERO, Vec3::ONE), 1e-9).is_err());
    }
}
