//! What a mesh is as a surface: closed or open, manifold, oriented, in how many pieces, with how many handles.

use rayon::prelude::*;

use super::TriMesh;

/// Counts that say what kind of surface a mesh is. Vertices that no triangle uses are left out.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MeshTopology {
    /// Vertices with a triangle.
    pub vertices: u64,
    /// Edges: pairs of vertices that are neighbours in a triangle.
    pub edges: u64,
    /// Triangles.
    pub triangles: u64,
    /// Edges with one triangle.
    pub boundary_edges: u64,
    /// Pieces of the boundary: holes and rims. Loops that touch at a vertex are one.
    pub boundary_loops: u64,
    /// Length of all boundary edges.
    pub boundary_length: f64,
    /// Edges with more than two triangles.
    pub non_manifold_edges: u64,
    /// Vertices whose triangles are not one fan.
    pub non_manifold_vertices: u64,
    /// Edges with two triangles that run along it in the same direction: one of them faces the other way.
    pub misoriented_edges: u64,
    /// Triangles with a vertex twice.
    pub degenerate_triangles: u64,
    /// Pieces that share no vertex.
    pub components: u64,
}

impl MeshTopology {
    /// Counts; the mesh's indices must be below the number of its vertices ([`TriMesh::check_indices`]).
    ///
    /// # Panics
    /// If a triangle names a vertex that is not there.
    pub fn of(mesh: &TriMesh) -> Self {
        Self::of_indexed(mesh.vertices.len(), &mesh.triangles, |a, b| {
            (mesh.vertices[a as usize].as_dvec3() - mesh.vertices[b as usize].as_dvec3()).length()
        })
    }

    /// Of triangles over `n_vertices` vertices, with the distance of two of them.
    ///
    /// # Panics
    /// If a triangle names a vertex that is not there.
    pub fn of_indexed(n_vertices: usize, triangles: &[[u32; 3]], length: impl Fn(u32, u32) -> f64) -> Self {
        let sides = sorted_sides(triangles);
        let mut topology = Self {
            triangles: triangles.len() as u64,
            degenerate_triangles: triangles.iter().filter(|[a, b, c]| a == b || b == c || c == a).count() as u64,
            ..Self::default()
        };
        let mut fans = Sets::new(3 * triangles.len());
        let mut rims = Sets::new(n_vertices);
        let mut rim_vertices = vec![];
        for sides in sides.chunk_by(|a, b| a.edge == b.edge) {
            topology.edges += 1;
            match sides {
                [side] => {
                    let [a, b] = side.vertices();
                    topology.boundary_edges += 1;
                    topology.boundary_length += length(a, b);
                    rims.join(a, b);
                    rim_vertices.push(a);
                }
                [one, other] => {
                    topology.misoriented_edges += u64::from(one.reversed == other.reversed);
                    fans.join(one.low_corner(), other.low_corner());
                    fans.join(one.high_corner(), other.high_corner());
                }
                _ => topology.non_manifold_edges += 1,
            }
        }
        topology.boundary_loops = distinct(rim_vertices.iter().map(|&v| rims.find(v)).collect());
        topology.count_vertices(n_vertices, triangles, &mut fans);
        topology
    }

    fn count_vertices(&mut self, n_vertices: usize, triangles: &[[u32; 3]], fans: &mut Sets) {
        let mut pieces = Sets::new(n_vertices);
        let mut fan_of = vec![u32::MAX; n_vertices];
        let mut split = vec![false; n_vertices];
        for (corner, &v) in triangles.iter().flatten().enumerate() {
            let fan = fans.find(corner as u32);
            let known = &mut fan_of[v as usize];
            split[v as usize] |= *known != u32::MAX && *known != fan;
            *known = fan;
        }
        triangles.iter().for_each(|&[a, b, c]| {
            pieces.join(a, b);
            pieces.join(b, c);
        });
        let used: Vec<u32> = (0..n_vertices as u32).filter(|&v| fan_of[v as usize] != u32::MAX).collect();
        self.vertices = used.len() as u64;
        self.non_manifold_vertices = split.iter().filter(|&&split| split).count() as u64;
        self.components = distinct(used.iter().map(|&v| pieces.find(v)).collect());
    }

    /// Whether there are triangles and every edge has at least two.
    pub fn is_closed(&self) -> bool {
        self.triangles > 0 && self.boundary_edges == 0
    }

    /// Whether every edge has one or two triangles and the triangles of every vertex are one fan: everywhere like a plane or
    /// a half-plane.
    pub fn is_manifold(&self) -> bool {
        self.non_manifold_edges == 0 && self.non_manifold_vertices == 0 && self.degenerate_triangles == 0
    }

    /// Whether neighbours face the same side.
    pub fn is_oriented(&self) -> bool {
        self.misoriented_edges == 0
    }

    /// Vertices − edges + triangles: 2 for a sphere, 0 for a torus, 2 less for each further handle, the sum over the pieces.
    pub fn euler_number(&self) -> i64 {
        self.vertices as i64 - self.edges as i64 + self.triangles as i64
    }
}

/// One side of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    /// The lower vertex in the upper half, the higher one in the lower.
    edge: u64,
    /// The corner where it begins: three times the triangle, and 0, 1, 2.
    corner: u32,
    /// Whether it runs from the higher vertex to the lower.
    reversed: bool,
}

impl Side {
    fn vertices(&self) -> [u32; 2] {
        [(self.edge >> 32) as u32, self.edge as u32]
    }

    fn last_corner(&self) -> u32 {
        if self.corner % 3 == 2 { self.corner - 2 } else { self.corner + 1 }
    }

    /// The corner at its lower vertex.
    fn low_corner(&self) -> u32 {
        if self.reversed { self.last_corner() } else { self.corner }
    }

    /// The corner at its higher vertex.
    fn high_corner(&self) -> u32 {
        if self.reversed { self.corner } else { self.last_corner() }
    }
}

fn sorted_sides(triangles: &[[u32; 3]]) -> Vec<Side> {
    let sides_of = |(t, triangle): (usize, &[u32; 3])| {
        let triangle = *triangle;
        (0..3).filter_map(move |i| {
            let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
            let edge = u64::from(a.min(b)) << 32 | u64::from(a.max(b));
            (a != b).then_some(Side { edge, corner: (3 * t + i) as u32, reversed: a > b })
        })
    };
    let mut sides: Vec<Side> = triangles.par_iter().enumerate().flat_map_iter(sides_of).collect();
    sides.par_sort_unstable();
    sides
}

fn distinct(mut values: Vec<u32>) -> u64 {
    values.sort_unstable();
    values.dedup();
    values.len() as u64
}

/// Disjoint sets of numbers; each is named by its smallest.
struct Sets(Vec<u32>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    fn find(&mut self, mut x: u32) -> u32 {
        while self.0[x as usize] != x {
            // Every other link is shortened.
            self.0[x as usize] = self.0[self.0[x as usize] as usize];
            x = self.0[x as usize];
        }
        x
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generate::{MeshKind, mesh};
    use glam::Vec3;

    fn of(triangles: &[[u32; 3]]) -> MeshTopology {
        let n = triangles.iter().flatten().max().map_or(0, |&v| v as usize + 1);
        MeshTopology::of_indexed(n, triangles, |_, _| 1.0)
    }

    #[test]
    fn a_sphere_and_a_torus_are_closed() {
        for (kind, euler) in [(MeshKind::Icosphere, 2), (MeshKind::Torus, 0)] {
            let topology = MeshTopology::of(&mesh(kind, 2000, 1));
            assert!(topology.is_closed() && topology.is_manifold() && topology.is_oriented(), "{topology:?}");
            assert_eq!((topology.euler_number(), topology.components, topology.boundary_loops), (euler, 1, 0));
        }
    }

    #[test]
    fn a_square_has_a_rim() {
        let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y, Vec3::ONE];
        let topology = MeshTopology::of(&TriMesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap());
        assert!(!topology.is_closed() && topology.is_manifold() && topology.is_oriented());
        assert_eq!((topology.boundary_edges, topology.boundary_loops, topology.boundary_length), (4, 1, 4.0));
        assert_eq!((topology.vertices, topology.edges, topology.euler_number()), (4, 5, 1));
        assert!(!MeshTopology::default().is_closed());
    }

    #[test]
    fn planted_faults_are_counted() {
        let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        assert!(of(&tetrahedron).is_closed() && of(&tetrahedron).is_oriented());
        let mut turned = tetrahedron;
        turned[0].swap(0, 1);
        assert_eq!(of(&turned).misoriented_edges, 3);
        let open = of(&tetrahedron[1..]);
        assert_eq!((open.boundary_edges, open.boundary_loops, open.components), (3, 1, 1));
        // Three triangles at an edge; two that share only a vertex; two tetrahedra that do.
        assert_eq!(of(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).non_manifold_edges, 1);
        let bow = of(&[[0, 1, 2], [0, 3, 4]]);
        assert_eq!((bow.non_manifold_vertices, bow.components, bow.boundary_loops), (1, 1, 1));
        let second = tetrahedron.map(|t| t.map(|v| v + 3));
        let touching = of(&[tetrahedron, second].concat());
        assert_eq!((touching.non_manifold_vertices, touching.non_manifold_edges, touching.components), (1, 0, 1));
        let apart = of(&[tetrahedron, tetrahedron.map(|t| t.map(|v| v + 4))].concat());
        assert_eq!((apart.components, apart.euler_number()), (2, 4));
        assert_eq!(of(&[[0, 0, 1]]).degenerate_triangles, 1);
    }
}
