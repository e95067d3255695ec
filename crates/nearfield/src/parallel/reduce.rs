//! stand-in
/// stand-in
pub fn bounds(points: &[glam::Vec3]) -> crate::Aabb {
    crate::Aabb::of_points(points)
}
