//! The polygon around an edge that the surface crosses, and how it is cut into two triangles. `quads.wesl` is the twin.

use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};

/// The polygon of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quad<T> {
    /// Counter-clockwise seen from outside.
    pub(super) vertices: [u32; 4],
    /// Axis of its edge.
    pub(super) axis: u8,
    /// Whether the edge leads outwards along its axis.
    pub(super) upwards: bool,
    /// Normal of the surface where it crosses the edge.
    pub(super) normal: Vector<T>,
}

/// How far one diagonal must be better than the other: where both are alike, rounding shall not decide.
pub(super) const CLEARLY: f64 = 1e-3;

/// The four cells around an edge, counter-clockwise seen from outside: steps back from its node, and the number that the edge
/// has in each.
pub(super) fn quad_around(axis: usize, upwards: bool) -> [([u32; 3], usize); 4] {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut around = [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(back_u, back_v)| {
        let mut steps = [0; 3];
        (steps[u], steps[v]) = (back_u, back_v);
        (steps, 4 * axis + (back_u | back_v << 1) as usize)
    });
    if !upwards {
        around.reverse();
    }
    around
}

impl<T: Scalar> Quad<T> {
    /// The direction of its edge outwards.
    pub(super) fn outwards(&self) -> Vector<T> {
        let mut direction = [T::ZERO; 3];
        direction[usize::from(self.axis)] = if self.upwards { T::ONE } else { -T::ONE };
        direction
    }

    /// The two triangles along the diagonal from the first vertex, or along the other one.
    pub(super) fn triangles(&self, other: bool) -> [[u32; 3]; 2] {
        let [a, b, c, d] = self.vertices;
        if other { [[b, c, d], [b, d, a]] } else { [[a, b, c], [a, c, d]] }
    }

    /// Whether the other diagonal is clearly better: fewer flipped triangles, then a flatter fold, so that creases run
    /// along diagonals. `corners` are the positions of the vertices.
    pub(super) fn prefers_other(&self, corners: &[Vector<T>; 4]) -> bool {
        let [a, b, c, d] = *corners;
        let first = self.quality([[a, b, c], [a, c, d]]);
        let other = self.quality([[b, c, d], [b, d, a]]);
        other > first + T::of(CLEARLY)
    }

    /// Cosine of the fold between two triangles, less 2 for each that is flipped.
    fn quality(&self, triangles: [[Vector<T>; 3]; 2]) -> T {
        let normals = triangles.map(|corners| normal_of(&corners));
        let flips = normals.iter().filter(|normal| self.is_flipped(normal)).count();
        let units = normals.map(|normal| vector::normalized(normal).unwrap_or([T::ZERO; 3]));
        vector::dot(units[0], units[1]) - T::of(2.0 * flips as f64)
    }

    /// Whether a triangle of this normal has no area, or faces against both the surface and the edge.
    pub(super) fn is_flipped(&self, normal: &Vector<T>) -> bool {
        let length = vector::norm(*normal);
        if !(length > T::ZERO) {
            return true;
        }
        let slack = length * T::of(CLEARLY);
        vector::dot(*normal, self.normal) < -slack && vector::dot(*normal, self.outwards()) < slack
    }
}

/// The normal of a triangle, twice its area long.
pub(super) fn normal_of<T: Scalar>([a, b, c]: &[Vector<T>; 3]) -> Vector<T> {
    vector::cross(vector::subtract(*b, *a), vector::subtract(*c, *a))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::application::dual_contouring::cell_table::{axis_of, first_corner};

    #[test]
    fn each_cell_around_an_edge_has_it_at_its_number() {
        for axis in 0..3 {
            for (steps, edge) in quad_around(axis, true) {
                assert_eq!(axis_of(edge), axis);
                let corner = first_corner(edge);
                assert_eq!(steps, [corner & 1, corner >> 1 & 1, corner >> 2].map(|step| step as u32));
            }
        }
    }

    #[test]
    fn polygons_face_outwards() {
        for axis in 0..3 {
            for upwards in [true, false] {
                let middles = quad_around(axis, upwards).map(|(steps, _)| steps.map(|step| 0.5 - f64::from(step)));
                let quad = Quad { vertices: [0, 1, 2, 3], axis: axis as u8, upwards, normal: [0.0; 3] };
                let normal = normal_of(&[middles[0], middles[1], middles[2]]);
                assert_eq!(vector::dot(normal, quad.outwards()), 1.0);
            }
        }
    }

    #[test]
    fn the_diagonal_follows_a_crease() {
        let quad = Quad { vertices: [0, 1, 2, 3], axis: 2, upwards: true, normal: [0.0, 0.0, 1.0] };
        // A roof whose ridge goes from the second to the fourth vertex, and one from the first to the third. Its eaves are
        // far from the ridge: a square would be a roof along either diagonal.
        let roof = [[-0.5, -0.5, 0.0], [1.0, 0.0, 1.0], [1.5, 1.5, 0.0], [0.0, 1.0, 1.0]];
        assert!(quad.prefers_other(&roof));
        let turned = [roof[3], roof[0], roof[1], roof[2]];
        assert!(!quad.prefers_other(&turned));
        // Flat: the first.
        assert!(!quad.prefers_other(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]));
    }

    #[test]
    fn a_corner_turned_in_takes_the_diagonal_that_keeps_both_triangles_up() {
        let quad = Quad { vertices: [0, 1, 2, 3], axis: 2, upwards: true, normal: [0.0, 0.0, 1.0] };
        let dart = [[0.0, 0.0, 0.0], [0.75, 0.25, 0.0], [1.0, 1.0, 0.0], [0.2, 0.8, 0.0]];
        assert!(!quad.prefers_other(&dart));
        let dart = [[0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [0.3, 0.25, 0.0], [0.0, 0.9, 0.0]];
        assert!(!quad.prefers_other(&dart));
        assert!(quad.prefers_other(&[dart[3], dart[0], dart[1], dart[2]]));
    }
}
