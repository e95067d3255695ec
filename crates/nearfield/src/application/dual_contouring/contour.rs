//! Dual contouring on the CPU: find active cells, cross edges, place vertices, join them to polygons.

use rayon::prelude::*;

use super::cell::Cell;
use super::cell_table::{axis_of, first_corner};
use super::hermite::{Crossing, FieldHermite, GridEdge, HermiteData};
use super::node_values::NodeValues;
use super::qef;
use super::quads::{Quad, quad_around};
use super::settings::{ContourSettings, VertexMode};
use super::surface::{Contour, Sheet, position};
use super::untangle::untangle;
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::parallel::{compact, scan};
use crate::{Error, Result};

/// Nodes that are looked at, and cells whose edges are crossed, between two reports.
const PART: usize = 1 << 22;
const CROSSED_PART: usize = 1 << 16;
/// Place of a node that has no active cell.
const INACTIVE: u32 = u32::MAX;

/// The surface of a field by its values alone; see [`contour_with`] and [`FieldHermite`].
///
/// ```
/// use nearfield::application::{ContourSettings, Watch, contour};
/// use nearfield::geometry::{DistanceGrid, RegularGrid, mesh_topology::MeshTopology};
/// use nearfield::{DVec3, Vec3};
///
/// // A ball of radius 1 on 33³ nodes.
/// let grid = RegularGrid::new(DVec3::ZERO, Vec3::splat(-1.25), 2.5 / 32.0, [33; 3])?;
/// let values = (0..grid.n_nodes()).map(|i| grid.position(grid.node(i).unwrap()).length() - 1.0).collect();
/// let field = DistanceGrid::new(grid, values)?;
/// let surface = contour(&(&field).into(), &ContourSettings::default(), &mut Watch::none())?;
/// let topology = MeshTopology::of(&surface.mesh());
/// assert!(topology.is_closed() && topology.is_manifold() && topology.euler_number() == 2);
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// # Errors
/// As [`contour_with`].
pub fn contour<T: Scalar>(
    values: &NodeValues<'_, T>,
    settings: &ContourSettings,
    watch: &mut Watch<'_>,
) -> Result<Contour<T>> {
    contour_with(values, &FieldHermite::new(values), settings, watch)
}

/// The surface between the nodes that are inside and those that are not, by dual contouring.
///
/// - `hermite`: where the surface crosses edges and how it is turned there
///
/// The surface is closed but where it leaves the grid and where values are undefined; see [`Contour`] for what it consists
/// of. The same bytes come out whatever the number of threads. Grids without a sign change give no vertices.
///
/// # Errors
/// `InvalidSetting` for a threshold outside 0 … 1; `TooMany` where the mesh has 2³² vertices or triangles; `OutOfMemory`;
/// `Interrupted` by the caller.
///
/// Source: Ju2002. Differs: a vertex for each sheet of a cell (Nielson2004, Wenger2013), so that the mesh is manifold.
pub fn contour_with<T: Scalar>(
    values: &NodeValues<'_, T>,
    hermite: &impl HermiteData<T>,
    settings: &ContourSettings,
    watch: &mut Watch<'_>,
) -> Result<Contour<T>> {
    settings.check()?;
    let (cells, slots) = active_cells(values, watch)?;
    let crossings = cross_edges(values, hermite, &cells, watch)?;
    let first_vertex = offsets("vertices of the surface", &cells, Cell::n_sheets)?;
    let first_quad = offsets("polygons of the surface", &cells, |cell| cell.own_quads().count_ones())?;
    let mesher = Mesher { values, cells: &cells, slots: &slots, crossings: &crossings, first_vertex: &first_vertex };
    watch.report("vertices", 0, cells.len() as u64)?;
    let sheets = mesher.sheets(T::of(settings.threshold));
    watch.report("polygons", 0, cells.len() as u64)?;
    let quads = mesher.quads(*first_quad.last().unwrap_or(&0) as usize);
    let mut contour = Contour::new(values, sheets, quads);
    if settings.mode == VertexMode::Untangled {
        untangle(&mut contour, watch)?;
    }
    Ok(contour)
}

/// The cells with vertices or cut edges, by ascending node number, and the place of each node's cell among them.
fn active_cells<T: Scalar>(values: &NodeValues<'_, T>, watch: &mut Watch<'_>) -> Result<(Vec<Cell>, Vec<u32>)> {
    let grid = values.grid();
    let n = grid.n_nodes();
    let node = |number: usize| grid.node(number).expect("the number should be below that of nodes");
    let mut cells: Vec<Cell> = Vec::new();
    let mut slots = memory("places of active cells", n, INACTIVE)?;
    let mut inside = memory("signs of nodes", n, false)?;
    inside.par_iter_mut().zip(values.raw()).for_each(|(inside, &value)| *inside = values.seen(value) < T::ZERO);
    for start in (0..n).step_by(PART) {
        watch.report("cells", start as u64, n as u64)?;
        let active = compact::indices_where(PART.min(n - start), |i| {
            near_surface(&inside, grid.nodes(), start + i) && Cell::of(values, node(start + i)).is_active()
        })?;
        for (place, &i) in active.iter().enumerate() {
            slots[start + i as usize] = (cells.len() + place) as u32;
        }
        cells.par_extend(active.par_iter().map(|&i| Cell::of(values, node(start + i as usize))));
    }
    Ok((cells, slots))
}

/// Whether some nodes of the cell may have different signs: a quick look at what stands at their places. Rows and layers that
/// wrap around only add cells to look at.
fn near_surface(inside: &[bool], [nx, ny, _]: [u32; 3], number: usize) -> bool {
    let (row, layer) = (nx as usize, nx as usize * ny as usize);
    let at = |step: usize| inside.get(number + step).copied().unwrap_or(false);
    let first = inside[number];
    [1, row, row + 1, layer, layer + 1, layer + row, layer + row + 1].iter().any(|&step| at(step) != first)
}

/// The crossings of the edges from each active cell's node.
fn cross_edges<T: Scalar>(
    values: &NodeValues<'_, T>,
    hermite: &impl HermiteData<T>,
    cells: &[Cell],
    watch: &mut Watch<'_>,
) -> Result<Vec<[Crossing<T>; 3]>> {
    let mut crossings = Vec::with_capacity(cells.len());
    for part in cells.chunks(CROSSED_PART) {
        watch.report("crossings", crossings.len() as u64, cells.len() as u64)?;
        crossings.par_extend(part.par_iter().with_min_len(64).map(|cell| {
            [0, 1, 2].map(|axis| match cell.own_cuts() >> axis & 1 {
                1 => hermite.crossing(&edge_of(values, cell.node, axis)),
                _ => Crossing::default(),
            })
        }));
    }
    Ok(crossings)
}

fn edge_of<T: Scalar>(values: &NodeValues<'_, T>, node: [u32; 3], axis: usize) -> GridEdge<T> {
    let mut last = node;
    last[axis] += 1;
    let ends = [node, last].map(|node| position(values.grid(), node, [T::ZERO; 3]));
    GridEdge { node, axis, values: [node, last].map(|node| values.value(node)), ends }
}

/// Sums of a number over the cells before each `[n + 1]`.
fn offsets(what: &'static str, cells: &[Cell], of: impl Fn(&Cell) -> u32 + Sync + Send) -> Result<Vec<u32>> {
    let counts: Vec<u32> = cells.par_iter().map(of).collect();
    let (mut sums, total) = scan::exclusive(&counts);
    // A polygon is two triangles.
    let limit = u64::from(u32::MAX / 2);
    if total > limit {
        return Err(Error::TooMany { what, found: total, limit, advice: "take a lower resolution" });
    }
    sums.push(total as u32);
    Ok(sums)
}

/// Values of one kind in memory that can be had.
fn memory<V: Clone>(what: &'static str, n: usize, value: V) -> Result<Vec<V>> {
    let mut all = Vec::new();
    let needed = (n * size_of::<V>()) as u64;
    all.try_reserve_exact(n).map_err(|_| Error::OutOfMemory { what, needed, available: 0 })?;
    all.resize(n, value);
    Ok(all)
}

/// What the vertices and polygons are made from.
struct Mesher<'a, T> {
    values: &'a NodeValues<'a, T>,
    cells: &'a [Cell],
    slots: &'a [u32],
    crossings: &'a [[Crossing<T>; 3]],
    first_vertex: &'a [u32],
}

impl<T: Scalar> Mesher<'_, T> {
    /// Place of the active cell at a node.
    fn slot(&self, node: [u32; 3]) -> usize {
        let number = self.values.grid().number(node).expect("a cell that is needed should be in the grid");
        let slot = self.slots[number];
        debug_assert_ne!(slot, INACTIVE, "a cell that is needed should be active");
        slot as usize
    }

    /// The vertices of all cells in order.
    fn sheets(&self, threshold: T) -> Vec<Sheet<T>> {
        let of_cell = |cell: &Cell| {
            let cell = *cell;
            cell.sheets().map(move |head| self.sheet(&cell, head, threshold)).collect::<Vec<_>>()
        };
        self.cells.par_iter().with_min_len(256).flat_map_iter(of_cell).collect()
    }

    fn sheet(&self, cell: &Cell, head: usize, threshold: T) -> Sheet<T> {
        let members = cell.sheet(head);
        let half = T::of(0.5);
        let mut middle = [T::ZERO; 3];
        let crossings: Vec<(Vector<T>, Vector<T>)> = (0..12)
            .filter(|edge| members >> edge & 1 == 1)
            .map(|edge| {
                let (corner, axis) = (first_corner(edge), axis_of(edge));
                let steps = [corner & 1, corner >> 1 & 1, corner >> 2];
                let node = [0, 1, 2].map(|axis| cell.node[axis] + steps[axis] as u32);
                let crossing = self.crossings[self.slot(node)][axis];
                let mut place = steps.map(|step| T::of(step as f64));
                (0..3).for_each(|a| middle[a] += if a == axis { half } else { place[a] });
                place[axis] = crossing.place;
                (place, crossing.normal)
            })
            .collect();
        let placed = qef::place(&crossings, threshold);
        let weight = T::ONE / T::of(crossings.len() as f64);
        Sheet { cell: cell.node, place: placed.place, mass: placed.mass, middle: middle.map(|x| x * weight) }
    }

    /// The polygons of all edges in order.
    fn quads(&self, n: usize) -> Vec<Quad<T>> {
        let mut quads = Vec::with_capacity(n);
        quads.par_extend(self.cells.par_iter().enumerate().with_min_len(256).flat_map_iter(|(slot, cell)| {
            (0..3).filter(|axis| cell.own_quads() >> axis & 1 == 1).map(move |axis| {
                let starts_inside = cell.inside & 1 == 1;
                let vertices = quad_around(axis, starts_inside).map(|(steps, edge)| {
                    let node = [0, 1, 2].map(|a| cell.node[a] - steps[a]);
                    let slot = self.slot(node);
                    self.first_vertex[slot] + self.cells[slot].sheet_of(edge)
                });
                let normal = self.crossings[slot][axis].normal;
                Quad { vertices, axis: axis as u8, upwards: starts_inside, normal }
            })
        }));
        quads
    }
}
