//! Normals of the faces, edges and corners of a mesh, by which the side of its closest point is told.
//!
//! Source: Baerentzen2005. The normal of an edge is the sum of those of its faces, the normal of a corner their sum weighted by
//! the angles at it: with these the sign is right wherever a closed mesh is closest. Corners at one place count as one,
//! whatever their indices.

use std::collections::HashMap;

use glam::DVec3;

use crate::geometry::TriMesh;
use crate::geometry::closest_point::TriangleFeature;

/// How the triangles of a mesh hang together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MeshClosure {
    /// Edges with one triangle: the borders of holes.
    pub border_edges: u64,
    /// Edges with more than two triangles.
    pub crowded_edges: u64,
    /// Edges whose two triangles are turned against each other.
    pub turned_edges: u64,
}

impl MeshClosure {
    /// Whether every edge has two triangles that are turned alike.
    pub fn is_closed(&self) -> bool {
        *self == Self::default()
    }
}

/// The normals of a mesh; none is of length 1.
#[derive(Debug, Clone)]
pub(super) struct Pseudonormals {
    /// `[triangles]`
    faces: Vec<DVec3>,
    /// `[triangles][3]` of the edge from each corner to the next.
    edges: Vec<[DVec3; 3]>,
    /// `[triangles][3]` of each corner.
    corners: Vec<[DVec3; 3]>,
    pub(super) closure: MeshClosure,
}

/// The triangles at an edge.
#[derive(Default)]
struct EdgeUse {
    normal: DVec3,
    forward: u32,
    backward: u32,
}

impl Pseudonormals {
    pub(super) fn new(mesh: &TriMesh) -> Self {
        let places = places(mesh);
        let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|i| places[i as usize])).collect();
        let corners_of = |t: usize| mesh.triangles[t].map(|i| mesh.vertices[i as usize].as_dvec3());
        let faces: Vec<DVec3> = (0..triangles.len())
            .map(|t| {
                let [a, b, c] = corners_of(t);
                (b - a).cross(c - a).normalize_or_zero()
            })
            .collect();
        let mut at_corner = vec![DVec3::ZERO; mesh.vertices.len()];
        let mut at_edge: HashMap<[u32; 2], EdgeUse> = HashMap::new();
        for (t, triangle) in triangles.iter().enumerate() {
            let corners = corners_of(t);
            for i in 0..3 {
                let (here, next) = (triangle[i], triangle[(i + 1) % 3]);
                let (to_next, to_last) = (corners[(i + 1) % 3] - corners[i], corners[(i + 2) % 3] - corners[i]);
                at_corner[here as usize] += faces[t] * angle(to_next, to_last);
                // A triangle with an edge of no length hangs its two others together.
                if here != next {
                    let both = at_edge.entry([here.min(next), here.max(next)]).or_default();
                    both.normal += faces[t];
                    *(if here < next { &mut both.forward } else { &mut both.backward }) += 1;
                }
            }
        }
        let mut closure = MeshClosure::default();
        for edge in at_edge.values() {
            match (edge.forward, edge.backward) {
                (1, 1) => {}
                (forward, backward) if forward + backward == 1 => closure.border_edges += 1,
                (forward, backward) if forward + backward == 2 => closure.turned_edges += 1,
                _ => closure.crowded_edges += 1,
            }
        }
        let edge_normal = |a: u32, b: u32| at_edge.get(&[a.min(b), a.max(b)]).map_or(DVec3::ZERO, |edge| edge.normal);
        let edges = triangles.iter().map(|&[a, b, c]| [edge_normal(a, b), edge_normal(b, c), edge_normal(c, a)]);
        let corners = triangles.iter().map(|triangle| triangle.map(|i| at_corner[i as usize]));
        Self { edges: edges.collect(), corners: corners.collect(), faces, closure }
    }

    /// The normal of what the closest point of a triangle lies on.
    pub(super) fn normal(&self, triangle: u32, feature: TriangleFeature) -> DVec3 {
        match feature {
            TriangleFeature::Corner(i) => self.corners[triangle as usize][i],
            TriangleFeature::Edge(i) => self.edges[triangle as usize][i],
            TriangleFeature::Face => self.faces[triangle as usize],
        }
    }
}

/// The angle between two edges; 0 where one has no length.
fn angle(a: DVec3, b: DVec3) -> f64 {
    libm::atan2(a.cross(b).length(), a.dot(b))
}

/// `[vertices]` the first vertex at the same place.
fn places(mesh: &TriMesh) -> Vec<u32> {
    let mut first = HashMap::with_capacity(mesh.vertices.len());
    // Both zeros are one coordinate.
    let key = |i: usize| mesh.vertices[i].to_array().map(|x| (x + 0.0).to_bits());
    (0..mesh.vertices.len()).map(|i| *first.entry(key(i)).or_insert(i as u32)).collect()
}
