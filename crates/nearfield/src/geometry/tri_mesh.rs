//! Triangle meshes.

use glam::{DVec3, Vec3};

use super::{Aabb, Triangle};
use crate::{Error, Result};

/// An indexed triangle mesh: an f64 origin plus f32 offsets, as [`super::PointCloud`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriMesh {
    /// What is added to every vertex to get world coordinates.
    pub origin: DVec3,
    /// Vertices relative to `origin`.
    pub vertices: Vec<Vec3>,
    /// Three indices into `vertices` a triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// A normal for each vertex.
    pub normals: Option<Vec<Vec3>>,
    /// A colour (red, green, blue, alpha) for each vertex.
    pub colors: Option<Vec<[u8; 4]>>,
}

impl TriMesh {
    /// A mesh at the world's origin.
    ///
    /// # Errors
    /// `TooMany` if a triangle names a vertex that is not there.
    pub fn new(vertices: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Self> {
        let mesh = Self { vertices, triangles, ..Self::default() };
        mesh.check_indices()?;
        Ok(mesh)
    }

    /// Checks that every index of a triangle has a vertex.
    ///
    /// # Errors
    /// `TooMany` with the first index that has none.
    pub fn check_indices(&self) -> Result<()> {
        let n = self.vertices.len();
        if let Some(&index) = self.triangles.iter().flatten().find(|&&i| i as usize >= n) {
            return Err(Error::TooMany {
                what: "vertex index of a triangle",
                found: u64::from(index),
                limit: (n as u64).saturating_sub(1),
                advice: "indices count from 0 and must be below the number of vertices",
            });
        }
        Ok(())
    }

    /// Triangle `i` relative to `origin`.
    ///
    /// # Panics
    /// If `i` is not below the number of triangles.
    #[inline]
    pub fn triangle(&self, i: usize) -> Triangle {
        let [a, b, c] = self.triangles[i].map(|v| self.vertices[v as usize]);
        Triangle::new(a, b, c)
    }

    /// The centroid of each triangle relative to `origin` `[triangles]`: a mesh as points.
    pub fn centroids(&self) -> Vec<Vec3> {
        (0..self.triangles.len()).map(|i| self.triangle(i).centroid()).collect()
    }

    /// Bounds relative to `origin`.
    pub fn bounds(&self) -> Aabb {
        Aabb::of_points(&self.vertices)
    }

    /// Total area.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|i| f64::from(self.triangle(i).area())).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_that_is_not_there_is_refused() {
        assert!(TriMesh::new(vec![Vec3::ZERO; 3], vec![[0, 1, 2]]).is_ok());
        let error = TriMesh::new(vec![Vec3::ZERO; 3], vec![[0, 1, 3]]).unwrap_err();
        assert!(error.to_string().contains("3 asked for, at most 2"));
    }

    #[test]
    fn centroids_are_the_means_of_corners_in_the_order_of_triangles() {
        let vertices = vec![Vec3::ZERO, Vec3::new(3.0, 0.0, 0.0), Vec3::new(0.0, 6.0, 0.0), Vec3::new(0.0, 0.0, -9.0)];
        let mesh = TriMesh::new(vertices, vec![[0, 1, 2], [3, 0, 0], [1, 2, 3]]).unwrap();
        let expected = [Vec3::new(1.0, 2.0, 0.0), Vec3::new(0.0, 0.0, -3.0), Vec3::new(1.0, 2.0, -3.0)];
        assert_eq!(mesh.centroids(), expected);
        assert!(TriMesh::default().centroids().is_empty());
    }
}
