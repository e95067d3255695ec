//! The surface area heuristic: what a ray that meets a cell is expected to cost. Source: Wald2006.

use super::settings::KdTreeSettings;
use crate::geometry::Aabb;

/// A cut that was found worth looking at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cut {
    pub(super) axis: usize,
    pub(super) split: f32,
    /// Expected cost of the node, times the surface of its cell.
    pub(super) cost: f64,
}

/// Costs, and the surface of the cell that they are weighed with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Costs {
    traversal: f64,
    test: f64,
    empty_share: f64,
}

impl Costs {
    pub(super) fn new(settings: &KdTreeSettings) -> Self {
        let [traversal, test, bonus] =
            [settings.traversal_cost, settings.test_cost, settings.empty_bonus].map(f64::from);
        Self { traversal, test, empty_share: 1.0 - bonus }
    }

    /// Cost of a leaf, times its surface.
    pub(super) fn leaf(&self, cell: &Aabb, n: usize) -> f64 {
        self.test * n as f64 * surface(cell)
    }

    /// Cost of passing an inner node, times its surface.
    pub(super) fn pass(&self, cell: &Aabb) -> f64 {
        self.traversal * surface(cell)
    }

    /// Compares cuts of a cell across one axis.
    pub(super) fn across(&self, cell: &Aabb, axis: usize) -> Across {
        let [x, y, z] = (cell.max.as_dvec3() - cell.min.as_dvec3()).to_array();
        let (u, v) = [(y, z), (z, x), (x, y)][axis];
        let pass = self.pass(cell);
        let (min, max) = (cell.min[axis], cell.max[axis]);
        Across { test: self.test, empty_share: self.empty_share, pass, min, max, caps: 2.0 * u * v, rim: 2.0 * (u + v) }
    }
}

/// Surface of a cell.
pub(super) fn surface(cell: &Aabb) -> f64 {
    let [x, y, z] = (cell.max.as_dvec3() - cell.min.as_dvec3()).to_array();
    2.0 * (x * y + y * z + z * x)
}

/// Cuts of one cell across one axis.
pub(super) struct Across {
    test: f64,
    empty_share: f64,
    pass: f64,
    /// Ends of the cell.
    pub(super) min: f32,
    /// Ends of the cell.
    pub(super) max: f32,
    caps: f64,
    rim: f64,
}

impl Across {
    /// Expected cost of the node with so many triangles on both sides, times its surface.
    #[inline(always)]
    pub(super) fn cost(&self, split: f32, left: usize, right: usize) -> f64 {
        let (from_min, to_max) = (f64::from(split) - f64::from(self.min), f64::from(self.max) - f64::from(split));
        let tests = left as f64 * (self.caps + self.rim * from_min) + right as f64 * (self.caps + self.rim * to_max);
        let cost = self.pass + self.test * tests;
        if left == 0 || right == 0 { self.empty_share * cost } else { cost }
    }

    /// Whether a plane lies inside.
    #[inline(always)]
    pub(super) fn contains(&self, split: f32) -> bool {
        self.min < split && split < self.max
    }
}

/// The cheaper of two cuts; the first where they are equal.
pub(super) fn cheaper(a: Option<Cut>, b: Option<Cut>) -> Option<Cut> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.cost < a.cost { b } else { a }),
        (a, b) => a.or(b),
    }
}
