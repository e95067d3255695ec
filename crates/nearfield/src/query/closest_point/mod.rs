//! The closest point of a mesh, exact, with the triangle that it lies on.
//!
//! Distances are computed in `f64` from the `f32` corners, so they are right to a few units of the last place of an `f32`
//! however far from zero the mesh is. Equal distances go to the smallest index of a triangle. Triangles without an area are
//! left out: those around them share their edges.

mod cpu;
#[cfg(test)]
mod tests;

use glam::DVec3;

/// The point of a mesh that is closest to a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// Index of the triangle.
    pub triangle: u32,
    /// The point, in the coordinates of the mesh without its origin.
    pub point: DVec3,
    /// Squared distance from the place.
    pub dist2: f64,
}

/// What finds closest points: a [`TriangleBvh`](crate::TriangleBvh), or [`BruteForceMesh`](crate::BruteForceMesh) to compare with.
pub trait ClosestPointSearch: Sync {
    /// The closest point within `radius`, which may be infinite; a point at exactly the radius is inside. `None` where there is none, and
    /// for places and radii that are not numbers.
    fn closest_point(&self, place: DVec3, radius: f64) -> Option<ClosestPoint>;
}
