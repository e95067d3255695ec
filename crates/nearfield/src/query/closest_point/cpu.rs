//! Closest points on the CPU.

use glam::DVec3;

use super::{ClosestPoint, ClosestPointSearch};
use crate::geometry::PreparedTriangle;
use crate::geometry::closest_point::closest_point;
use crate::structure::{BruteForceMesh, RayStructure, TriangleBvh};

/// The closest so far.
struct Best {
    place: DVec3,
    dist2: f64,
    found: Option<ClosestPoint>,
}

impl Best {
    fn new(place: DVec3, radius: f64) -> Option<Self> {
        (place.is_finite() && radius >= 0.0).then_some(Self { place, dist2: radius * radius, found: None })
    }

    fn offer(&mut self, triangle: &PreparedTriangle) -> f64 {
        let corners = [triangle.low, triangle.middle, triangle.high].map(|corner| corner.as_dvec3() - self.place);
        let (offset, _) = closest_point(corners);
        let dist2 = offset.length_squared();
        let is_lower = || self.found.is_none_or(|found| triangle.index < found.triangle);
        if dist2 < self.dist2 || (dist2 == self.dist2 && is_lower()) {
            self.dist2 = dist2;
            self.found = Some(ClosestPoint { triangle: triangle.index, point: self.place + offset, dist2 });
        }
        self.dist2
    }
}

impl ClosestPointSearch for TriangleBvh {
    fn closest_point(&self, place: DVec3, radius: f64) -> Option<ClosestPoint> {
        let mut best = Best::new(place, radius)?;
        // The boxes are searched from the nearest `f32`, so farther by how much that is off.
        let near = place.as_vec3();
        let off = (near.as_dvec3() - place).length();
        let widened = |dist2: f64| if off == 0.0 { dist2 } else { (dist2.sqrt() + off).powi(2) };
        self.nearest_first(near.to_array(), widened(best.dist2), |triangle| widened(best.offer(triangle)));
        best.found
    }
}

impl ClosestPointSearch for BruteForceMesh {
    fn closest_point(&self, place: DVec3, radius: f64) -> Option<ClosestPoint> {
        let mut best = Best::new(place, radius)?;
        for triangle in self.triangles().as_slice().iter().filter(|triangle| triangle.low != triangle.high) {
            best.offer(triangle);
        }
        best.found
    }
}
