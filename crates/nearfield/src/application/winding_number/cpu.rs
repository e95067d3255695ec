//! Winding numbers on the CPU, in either precision.

use rayon::prelude::*;

use super::solid_angle;
use super::tree::{Element, Elements, Node, Tree, Unit};
use crate::application::Watch;
use crate::geometry::Scalar;
use crate::geometry::vector::{Vector, norm2, normalized, scale, subtract};
use crate::structure::aabb_tree::TreeShape;
use crate::{Error, Result};

/// Radii of a node beyond which its expansion counts, as Barill2018 and its implementations.
const BETA: f64 = 2.0;
/// Queries between two reports.
const WINDOW: usize = 1 << 16;
/// Queries of a task.
const TASK: usize = 64;

/// The winding number of oriented samples or of triangles around any place.
///
/// ```
/// use nearfield::application::WindingNumber;
///
/// let corners = [[0.0f64, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// let tetrahedron = WindingNumber::of_triangles(&corners, &[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])?;
/// assert!((tetrahedron.at([0.2, 0.2, 0.2]) - 1.0).abs() < 1e-12);
/// assert!(tetrahedron.at([1.0, 1.0, 1.0]).abs() < 1e-2);
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct WindingNumber<T> {
    pub(super) unit: Unit,
    pub(super) shape: TreeShape,
    pub(super) nodes: Vec<Node<T>>,
    pub(super) elements: Elements<T>,
}

impl<T: Scalar> WindingNumber<T> {
    /// Of samples of a surface.
    ///
    /// - `points`: `[n]`
    /// - `normals`: `[n]` pointing outwards, of any length; a sample whose normal has none adds nothing
    /// - `areas`: `[n]` the share of the surface that each stands for, as [`super::disk_areas`] estimates it
    ///
    /// # Errors
    /// `LengthMismatch`; `NonFinite` for points and normals; `InvalidSetting` for areas that are negative or not finite;
    /// `CoordinateBeyond`; `TooMany` (2³² − 1 samples or more).
    pub fn of_points(points: &[Vector<T>], normals: &[Vector<T>], areas: &[T]) -> Result<Self> {
        for (what, found) in [("the normals", normals.len()), ("the areas", areas.len())] {
            if found != points.len() {
                return Err(Error::LengthMismatch { what, found: found as u64, expected: points.len() as u64 });
            }
        }
        check_finite("points", points)?;
        check_finite("normals", normals)?;
        if let Some(area) = areas.iter().find(|area| !(**area >= T::ZERO && area.is_finite())) {
            let found = format!("{area:?}");
            return Err(Error::InvalidSetting {
                setting: "area of a sample",
                found,
                expected: "a finite area, not negative",
            });
        }
        let places: Vec<Vector<f64>> = points.iter().map(|p| p.map(T::to_f64)).collect();
        let unit = Unit::around(&places);
        let moment = |normal: &Vector<T>, area: T| {
            let share = area.to_f64() * unit.scale * unit.scale / (4.0 * std::f64::consts::PI);
            normalized(normal.map(T::to_f64)).map_or([0.0; 3], |n| scale(n, share))
        };
        let dipoles: Vec<[Vector<f64>; 2]> =
            places.iter().zip(normals).zip(areas).map(|((p, n), &area)| [unit.of(*p), moment(n, area)]).collect();
        let elements: Vec<Element> = dipoles.iter().map(|[place, moment]| Element::dipole(*place, *moment)).collect();
        let Tree { shape, order, nodes } = Tree::build(&elements, BETA)?;
        let ordered = order.iter().map(|&id| dipoles[id as usize].map(|v| v.map(T::of))).collect();
        Ok(Self { unit, shape, nodes, elements: Elements::Dipoles(ordered) })
    }

    /// Of triangles, each by its exact solid angle where it is near.
    ///
    /// - `vertices`: `[n]`
    /// - `triangles`: three indices each, counter-clockwise seen from outside
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateBeyond`; `TooMany` for indices without a vertex and with 2³² − 1 triangles or more.
    pub fn of_triangles(vertices: &[Vector<T>], triangles: &[[u32; 3]]) -> Result<Self> {
        check_finite("vertices", vertices)?;
        let n = vertices.len();
        if let Some(&index) = triangles.iter().flatten().find(|&&index| index as usize >= n) {
            return Err(Error::TooMany {
                what: "vertex index of a triangle",
                found: u64::from(index),
                limit: (n as u64).saturating_sub(1),
                advice: "indices count from 0 and must be below the number of vertices",
            });
        }
        let places: Vec<Vector<f64>> = vertices.iter().map(|p| p.map(T::to_f64)).collect();
        let unit = Unit::around(&places);
        let corners = |triangle: &[u32; 3]| triangle.map(|i| unit.of(places[i as usize]));
        let elements: Vec<Element> = triangles.iter().map(|t| Element::triangle(corners(t))).collect();
        let Tree { shape, order, nodes } = Tree::build(&elements, BETA)?;
        let ordered = order.iter().map(|&id| corners(&triangles[id as usize]).map(|v| v.map(T::of))).collect();
        Ok(Self { unit, shape, nodes, elements: Elements::Triangles(ordered) })
    }

    /// Number of samples or triangles.
    pub fn len(&self) -> usize {
        self.shape.n_points()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> u64 {
        let elements = match &self.elements {
            Elements::Dipoles(dipoles) => size_of_val(&dipoles[..]),
            Elements::Triangles(triangles) => size_of_val(&triangles[..]),
        };
        (size_of_val(&self.nodes[..]) + elements) as u64
    }

    /// The winding number at a place, within 0.01 of the sum over all elements, and within 0.05 nearer to the surface than some spacings; NaN where the place is not finite. Without elements
    /// it is 0.
    pub fn at(&self, query: Vector<T>) -> T {
        let Some(query) = self.in_unit(query) else { return T::of(f64::NAN) };
        let (mut sum, mut next) = (T::ZERO, (!self.is_empty()).then_some(0));
        while let Some(node) = next {
            next = TreeShape::rope(node);
            let Node { center, reach2, moments } = &self.nodes[node];
            let offset = subtract(*center, query);
            if norm2(offset) > *reach2 {
                sum += moments.field(offset);
            } else if self.shape.is_leaf(node) {
                sum += self.exact(self.shape.points(node), query);
            } else {
                next = Some(2 * node + 1);
            }
        }
        sum
    }

    /// The sum over all elements: what [`WindingNumber::at`] approximates, at a cost that grows with their number.
    pub fn at_by_brute_force(&self, query: Vector<T>) -> T {
        match self.in_unit(query) {
            Some(query) => self.exact(0..self.len(), query),
            None => T::of(f64::NAN),
        }
    }

    /// Whether a place is inside: the winding number passes ½.
    pub fn is_inside(&self, query: Vector<T>) -> bool {
        self.at(query) > T::of(0.5)
    }

    /// The winding numbers at `[q]` places, on all threads.
    ///
    /// # Errors
    /// `Interrupted`.
    pub fn at_each(&self, queries: &[Vector<T>], watch: &mut Watch<'_>) -> Result<Vec<T>> {
        let mut numbers = Vec::with_capacity(queries.len());
        for window in queries.chunks(WINDOW) {
            watch.report("winding numbers", numbers.len() as u64, queries.len() as u64)?;
            numbers.par_extend(window.par_iter().with_min_len(TASK).map(|&query| self.at(query)));
        }
        Ok(numbers)
    }

    fn in_unit(&self, query: Vector<T>) -> Option<Vector<T>> {
        let (center, factor) = (self.unit.center.map(T::of), T::of(self.unit.scale));
        query.iter().all(|x| x.is_finite()).then(|| scale(subtract(query, center), factor))
    }

    #[inline(always)]
    fn exact(&self, places: std::ops::Range<usize>, query: Vector<T>) -> T {
        let mut sum = T::ZERO;
        match &self.elements {
            Elements::Dipoles(dipoles) => {
                for [place, moment] in &dipoles[places] {
                    sum += solid_angle::dipole(subtract(*place, query), *moment);
                }
            }
            Elements::Triangles(triangles) => {
                for corners in &triangles[places] {
                    sum += solid_angle::triangle(corners.map(|corner| subtract(corner, query)));
                }
            }
        }
        sum
    }
}

fn check_finite<T: Scalar>(what: &'static str, vectors: &[Vector<T>]) -> Result<()> {
    let is_invalid = |v: &&Vector<T>| v.iter().any(|x| !x.is_finite());
    match vectors.iter().position(|v| is_invalid(&v)) {
        None => Ok(()),
        Some(first) => {
            let count = vectors.iter().filter(is_invalid).count() as u64;
            Err(Error::NonFinite { what, count, first: first as u64 })
        }
    }
}
