//! Signed distances at the nodes of a regular grid: what a distance field is computed into and a surface is taken from.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::RegularGrid;
use crate::{Error, Result};

/// A regular grid with a signed distance at each node: negative inside, NaN where it is undefined.
///
/// Values stand in the order of the node numbers of [`RegularGrid`], x fastest. Between nodes the field is trilinear.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceGrid {
    grid: RegularGrid,
    values: Vec<f32>,
}

impl DistanceGrid {
    /// A grid whose values are all undefined.
    ///
    /// # Errors
    /// `OutOfMemory` where the host has no memory for them.
    pub fn undefined(grid: RegularGrid) -> Result<Self> {
        let mut values = Vec::new();
        values.try_reserve_exact(grid.n_nodes()).map_err(|_| Error::OutOfMemory {
            what: "a grid of distances",
            needed: grid.n_nodes() as u64 * size_of::<f32>() as u64,
            available: 0,
        })?;
        values.resize(grid.n_nodes(), f32::NAN);
        Ok(Self { grid, values })
    }

    /// A grid with these values `[nz][ny][nx]`. Infinite values become undefined.
    ///
    /// # Errors
    /// `LengthMismatch` unless there is one a node.
    pub fn new(grid: RegularGrid, mut values: Vec<f32>) -> Result<Self> {
        if values.len() != grid.n_nodes() {
            return Err(Error::LengthMismatch {
                what: "the values of a grid",
                found: values.len() as u64,
                expected: grid.n_nodes() as u64,
            });
        }
        let undefine = |value: &mut f32| *value = if value.is_finite() { *value } else { f32::NAN };
        values.par_chunks_mut(1 << 16).for_each(|values| values.iter_mut().for_each(undefine));
        Ok(Self { grid, values })
    }

    /// A grid with one value a node, none of which is infinite.
    #[cfg(feature = "gpu")]
    pub(crate) fn of_checked(grid: RegularGrid, values: Vec<f32>) -> Self {
        debug_assert!(values.len() == grid.n_nodes() && !values.par_iter().any(|value| value.is_infinite()));
        Self { grid, values }
    }

    /// The nodes.
    pub fn grid(&self) -> &RegularGrid {
        &self.grid
    }

    /// `[nz][ny][nx]`, NaN where undefined.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// `[nz][ny][nx]`, to write to: NaN where undefined.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// The values alone.
    pub fn into_values(self) -> Vec<f32> {
        self.values
    }

    /// The value of a node; NaN where undefined and outside the grid.
    #[inline]
    pub fn value(&self, node: [u32; 3]) -> f32 {
        if self.grid.contains(node) { self.values[self.grid.number_of(node)] } else { f32::NAN }
    }

    /// Number of nodes with a value.
    pub fn n_defined(&self) -> usize {
        self.values.iter().filter(|value| !value.is_nan()).count()
    }

    /// The value at a position relative to the grid's origin, trilinear between the eight nodes around it. NaN outside the
    /// grid and where a node that counts is undefined.
    pub fn sample(&self, position: Vec3) -> f32 {
        self.sample_at(position.as_dvec3()) as f32
    }

    /// As [`DistanceGrid::sample`], in the wider type.
    pub fn sample_at(&self, position: DVec3) -> f64 {
        let Some((cell, t)) = self.grid.cell_at(position) else { return f64::NAN };
        self.corners(cell).iter().zip(0..8).fold(0.0, |sum, (&value, corner)| {
            let weight = weight(&t, corner, 3);
            if weight == 0.0 { sum } else { sum + weight * f64::from(value) }
        })
    }

    /// The derivative of the trilinear field at a position relative to the grid's origin: about 1 long in a distance field.
    /// On the faces between cells it is that of the cell above. `None` where [`DistanceGrid::sample`] is NaN or a node
    /// beside it undefined.
    pub fn gradient(&self, position: Vec3) -> Option<Vec3> {
        self.gradient_at(position.as_dvec3()).map(|gradient| gradient.as_vec3())
    }

    /// As [`DistanceGrid::gradient`], in the wider type.
    pub fn gradient_at(&self, position: DVec3) -> Option<DVec3> {
        let (cell, t) = self.grid.cell_at(position)?;
        let corners = self.corners(cell);
        let along = |axis: usize| {
            let slopes = (0..8usize).filter(|corner| corner >> axis & 1 == 0).map(|corner| {
                let weight = weight(&t, corner, axis);
                let difference = f64::from(corners[corner | 1 << axis]) - f64::from(corners[corner]);
                if weight == 0.0 { 0.0 } else { weight * difference }
            });
            slopes.sum::<f64>() / f64::from(self.grid.spacing())
        };
        let gradient = DVec3::new(along(0), along(1), along(2));
        gradient.is_finite().then_some(gradient)
    }

    /// Values of the nodes of a cell given by its lowest node: node b is one further along x, y, z by the bits 1, 2, 4 of b.
    /// NaN for nodes outside the grid.
    pub fn corners(&self, [i, j, k]: [u32; 3]) -> [f32; 8] {
        let at = |b: u32| self.value([i.saturating_add(b & 1), j.saturating_add(b >> 1 & 1), k.saturating_add(b >> 2)]);
        [0, 1, 2, 3, 4, 5, 6, 7].map(at)
    }
}

/// Weight of a corner at place `t` of its cell, without the factor of one axis (3 leaves none out).
fn weight(t: &[f64; 3], corner: usize, without: usize) -> f64 {
    (0..3)
        .filter(|&axis| axis != without)
        .map(|axis| if corner >> axis & 1 == 1 { t[axis] } else { 1.0 - t[axis] })
        .product()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(of: impl Fn(Vec3) -> f32) -> DistanceGrid {
        let grid = RegularGrid::new(DVec3::new(1e6, 0.0, 0.0), Vec3::new(-1.0, 2.0, 0.5), 0.25, [5, 4, 3]).unwrap();
        let values = (0..grid.n_nodes()).map(|number| of(grid.position(grid.node(number).unwrap()))).collect();
        DistanceGrid::new(grid, values).unwrap()
    }

    #[test]
    fn trilinear_functions_are_met_exactly() {
        let of = |p: Vec3| 3.0 + p.x - 2.0 * p.y + 4.0 * p.z + p.x * p.y * p.z;
        let field = field(of);
        for p in [Vec3::new(-0.9, 2.3, 0.6), Vec3::new(0.0, 2.75, 1.0), Vec3::new(-0.375, 2.5, 0.75)] {
            assert!((field.sample(p) - of(p)).abs() < 1e-5, "{p}");
            let expected = Vec3::new(1.0 + p.y * p.z, -2.0 + p.x * p.z, 4.0 + p.x * p.y);
            assert!((field.gradient(p).unwrap() - expected).length() < 1e-5, "{p}");
        }
        assert!(field.sample(Vec3::new(0.1, 2.5, 0.75)).is_nan() && field.gradient(Vec3::ZERO).is_none());
    }

    #[test]
    fn undefined_nodes_count_only_where_they_have_weight() {
        let mut field = field(|p| p.x);
        let number = field.grid().number([1, 1, 1]).unwrap();
        field.values_mut()[number] = f32::NAN;
        assert_eq!(field.n_defined(), field.grid().n_nodes() - 1);
        let node = field.grid().position([1, 1, 1]);
        let across = field.grid().position([2, 1, 1]);
        assert!(field.sample(node).is_nan() && field.sample(node.midpoint(across)).is_nan());
        assert_eq!(field.sample(across), across.x);
        assert!(field.gradient(node.midpoint(across)).is_none());
        assert!(field.gradient(field.grid().position([2, 2, 1])).is_some());
    }

    #[test]
    fn values_that_do_not_fit_are_refused() {
        let grid = *field(|p| p.x).grid();
        assert!(matches!(DistanceGrid::new(grid, vec![0.0; 3]), Err(Error::LengthMismatch { expected: 60, .. })));
        let mut values = vec![0.0; 60];
        values[5] = f32::INFINITY;
        assert_eq!(DistanceGrid::new(grid, values).unwrap().n_defined(), 59);
        assert!(DistanceGrid::undefined(grid).unwrap().value([0, 0, 9]).is_nan());
    }
}
