//! The contoured surface: vertices with the cells they belong to, polygons, and the triangles they are cut into.

use super::node_values::NodeValues;
use super::quads::Quad;
use crate::TriMesh;
use crate::geometry::vector::{self, Vector};
use crate::geometry::{RegularGrid, Scalar};
use glam::Vec3;
use rayon::prelude::*;

/// The vertex of a sheet of the surface in a cell. Places are from 0 to 1 along each axis inside the cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sheet<T> {
    pub(super) cell: [u32; 3],
    /// Where it stands.
    pub(super) place: Vector<T>,
    /// Mean of its crossings.
    pub(super) mass: Vector<T>,
    /// Mean of the middles of its edges.
    pub(super) middle: Vector<T>,
}

/// A surface in a grid as triangles.
///
/// Every edge of the grid with a sign change that has values at both ends and a cell on all four sides is a polygon of four
/// vertices, cut into the triangles 2 q and 2 q + 1. A cell has a vertex for each sheet of the surface in it. So every edge
/// of the mesh has one triangle or two, the triangles around a vertex are one fan, and all are counter-clockwise seen from
/// where values are positive.
#[derive(Debug, Clone, PartialEq)]
pub struct Contour<T> {
    pub(super) grid: RegularGrid,
    pub(super) sheets: Vec<Sheet<T>>,
    pub(super) quads: Vec<Quad<T>>,
    /// Which quads are cut along the other diagonal.
    pub(super) other: Vec<bool>,
    pub(super) vertices: Vec<Vector<T>>,
    pub(super) report: ContourReport,
}

/// What was done to vertices so that triangles do not flip or intersect; zeros in feature mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ContourReport {
    /// Vertices that were moved to the border of their cell, towards the mean of their crossings.
    pub clamped: u64,
    /// Vertices that were moved to the mean of their crossings.
    pub averaged: u64,
    /// Vertices that were moved to where they stand for the signs alone.
    pub rounded: u64,
    /// Rounds of checks.
    pub rounds: u32,
    /// Pairs of triangles that still intersect; 0 but for vertices that share their place at a border.
    pub intersections: u64,
    /// Triangles that are still flipped or without area.
    pub flipped: u64,
}

impl<T: Scalar> Contour<T> {
    pub(super) fn new(values: &NodeValues<'_, T>, sheets: Vec<Sheet<T>>, quads: Vec<Quad<T>>) -> Self {
        let vertices = sheets.par_iter().map(|sheet| position(values.grid(), sheet.cell, sheet.place)).collect();
        let (grid, report) = (*values.grid(), ContourReport::default());
        let mut contour = Self { grid, sheets, quads, other: Vec::new(), vertices, report };
        contour.other = contour.quads.par_iter().map(|quad| contour.choose(quad)).collect();
        contour
    }

    /// Whether a quad is to be cut along its other diagonal.
    pub(super) fn choose(&self, quad: &Quad<T>) -> bool {
        // Seen from its first vertex: products of small differences keep their digits.
        let corners = quad.vertices.map(|v| self.vertices[v as usize]);
        let scale = T::of(1.0 / f64::from(self.grid.spacing()));
        quad.prefers_other(&corners.map(|corner| vector::scale(vector::subtract(corner, corners[0]), scale)))
    }

    /// The grid.
    pub fn grid(&self) -> &RegularGrid {
        &self.grid
    }

    /// Positions relative to the grid's origin, ordered by the cells they belong to.
    pub fn vertices(&self) -> &[Vector<T>] {
        &self.vertices
    }

    /// The lowest node of the cell that each vertex belongs to; vertices may stand outside their cells.
    pub fn cells(&self) -> impl ExactSizeIterator<Item = [u32; 3]> + '_ {
        self.sheets.iter().map(|sheet| sheet.cell)
    }

    /// Number of polygons.
    pub fn n_quads(&self) -> usize {
        self.quads.len()
    }

    /// The polygons, counter-clockwise seen from outside, ordered by node and axis of their edges.
    pub fn quads(&self) -> impl ExactSizeIterator<Item = [u32; 4]> + '_ {
        self.quads.iter().map(|quad| quad.vertices)
    }

    /// The triangles, two a polygon.
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        let cut = |(quad, &other): (&Quad<T>, &bool)| quad.triangles(other);
        self.quads.par_iter().zip(&self.other).flat_map_iter(cut).collect()
    }

    /// What was done to vertices.
    pub fn report(&self) -> &ContourReport {
        &self.report
    }

    /// As a mesh with the grid's origin.
    pub fn mesh(&self) -> TriMesh {
        let vertices = self.vertices.par_iter().map(|p| Vec3::from_array(p.map(|x| x.to_f64() as f32))).collect();
        TriMesh { origin: self.grid.origin(), vertices, triangles: self.triangles(), ..TriMesh::default() }
    }
}

/// The position of a place in a cell, relative to the grid's origin.
pub(super) fn position<T: Scalar>(grid: &RegularGrid, cell: [u32; 3], place: Vector<T>) -> Vector<T> {
    let spacing = f64::from(grid.spacing());
    [0, 1, 2].map(|axis| T::of(grid.coordinate(axis, cell[axis]) + spacing * place[axis].to_f64()))
}
