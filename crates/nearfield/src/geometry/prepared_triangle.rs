//! Triangles prepared for the one test that every structure uses, and that test.
//!
//! Twin of `prepared_triangle.wesl`. Source: Woop2013, with these differences: corners stand in the order of their
//! coordinates, so that two triangles evaluate the edge that they share in the same direction and agree on its sign
//! also where a compiler contracts the arithmetic; signs come from comparing the two products of an edge function, so
//! that a difference that rounds to zero is on the edge for both; and where a triangle is seen so narrow that rounding
//! puts the weighted corners off the ray, the weights are refined, or the hit is placed on the longest edge where the
//! triangle is narrower than rounding.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::{Aabb, PreparedRay, Triangle};

/// Times that weights are refined. Each leaves a share of what is off that is u = 2⁻²⁴ times the length of the triangle
/// over its width as the ray sees it.
const REFINEMENTS: usize = 3;

/// A triangle as the test takes it: 48 bytes, the same on CPU and GPU.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PreparedTriangle {
    /// The corner whose coordinates come first.
    pub low: Vec3,
    /// The caller's index of the triangle.
    pub index: u32,
    /// The second corner.
    pub middle: Vec3,
    /// The caller's number (0, 1, 2) of `low`, `middle` and `high`, two bits each from the lowest on.
    pub corners: u32,
    /// The corner whose coordinates come last.
    pub high: Vec3,
    /// Unused.
    pub padding: u32,
}

/// A hit inside a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalHit {
    /// In units of the prepared ray.
    pub t: f32,
    /// The caller's index of the triangle.
    pub triangle: u32,
    /// Weights of the caller's second and third corner.
    pub weights: [f32; 2],
}

impl LocalHit {
    /// Whether this hit comes before another one: nearer, or as near on a lower triangle.
    pub fn is_before(&self, t: f32, triangle: u32) -> bool {
        self.t < t || self.t == t && self.triangle < triangle
    }
}

impl PreparedTriangle {
    /// Prepares the triangle with this index. A triangle without an area keeps its place and is never hit.
    #[inline]
    pub fn new(triangle: &Triangle, index: u32) -> Self {
        let corners = [triangle.a, triangle.b, triangle.c];
        // Both zeros are one coordinate.
        let keys = corners.map(|corner| corner.to_array().map(|c| c + 0.0));
        let mut order = [0, 1, 2];
        for place in [0, 1, 0] {
            if keys[order[place]] > keys[order[place + 1]] {
                order.swap(place, place + 1);
            }
        }
        let [low, middle, high] =
            if is_degenerate(triangle) { [corners[order[0]]; 3] } else { order.map(|i| corners[i]) };
        let corners = order.iter().enumerate().map(|(place, &corner)| (corner as u32) << (2 * place)).sum();
        Self { low, index, middle, corners, high, padding: 0 }
    }

    /// Where the ray hits the triangle, whatever side it comes from: edges and corners belong to it, and t lies between
    /// those of the corners. The range of t is not looked at.
    ///
    /// The test multiplies coordinates as the ray sees them, so edges shorter than the square root of the smallest normal
    /// f32, 1.1e-19, leave its range: such a triangle may be missed, or hit where it is not, but no farther off the ray than
    /// 2⁻¹⁹ of the mesh's longest side; below 1e-23 it is never hit. Devices that take subnormal numbers for zero do so
    /// from edges of 1e-16 down. Meshes of such a size are to be scaled up.
    pub fn hit(&self, ray: &PreparedRay) -> Option<LocalHit> {
        let corners = [ray.sheared(self.low), ray.sheared(self.middle), ray.sheared(self.high)];
        let [low, middle, high] = corners;
        // Each edge function from the corner that comes first to the other one.
        let (opposite_high, opposite_low) = (edge(low, middle), edge(middle, high));
        let opposite_middle = edge(low, high).reversed();
        let edges = [opposite_low, opposite_middle, opposite_high];
        let left = edges.iter().any(|e| e.first < e.second);
        let right = edges.iter().any(|e| e.first > e.second);
        if left && right {
            return None;
        }
        let sizes = edges.map(|e| (e.first - e.second).abs());
        let sum = sizes[0] + sizes[1] + sizes[2];
        if sum == 0.0 {
            return None;
        }
        let mut weights = sizes.map(|size| size / sum);
        let mut point = weights[0] * low + weights[1] * middle + weights[2] * high;
        let off = |point: Vec3| point.x.abs().max(point.y.abs());
        for _ in 0..REFINEMENTS {
            if off(point) <= ray.lateral() {
                break;
            }
            let Some(better) = refined(corners, weights, point) else { break };
            (weights, point) = better;
        }
        if off(point) > ray.lateral() {
            (weights, point) = on_longest_edge(corners);
            if off(point) > ray.lateral() {
                return None;
            }
        }
        Some(LocalHit { t: point.z, triangle: self.index, weights: self.callers_weights(weights) })
    }

    /// The corners as the caller gave them; those of a triangle without an area are one point.
    pub fn callers_corners(&self) -> [Vec3; 3] {
        let mut callers = [Vec3::ZERO; 3];
        for (place, corner) in [self.low, self.middle, self.high].into_iter().enumerate() {
            callers[(self.corners >> (2 * place) & 3) as usize] = corner;
        }
        callers
    }

    /// Unit normal, towards the side from which the caller's corners run counter-clockwise; zero without an area.
    pub fn normal(&self) -> Vec3 {
        // Products of coordinate differences can leave the range of an f32.
        let [a, b, c] = self.callers_corners().map(Vec3::as_dvec3);
        (b - a).cross(c - a).normalize_or_zero().as_vec3()
    }

    /// Whether the triangle can be hit at all: the corners of one without an area are one point.
    #[inline]
    pub fn has_area(&self) -> bool {
        self.low != self.high
    }

    /// The smallest box that holds the triangle.
    #[inline]
    pub fn bounds(&self) -> Aabb {
        Triangle::new(self.low, self.middle, self.high).bounds()
    }

    fn callers_weights(&self, weights: [f32; 3]) -> [f32; 2] {
        let mut callers = [0.0; 3];
        for (place, weight) in weights.into_iter().enumerate() {
            callers[(self.corners >> (2 * place) & 3) as usize] = weight;
        }
        [callers[1], callers[2]]
    }
}

/// The two products whose difference is an edge function.
#[derive(Clone, Copy)]
struct Edge {
    first: f32,
    second: f32,
}

impl Edge {
    fn reversed(self) -> Self {
        Self { first: self.second, second: self.first }
    }
}

fn edge(from: Vec3, to: Vec3) -> Edge {
    Edge { first: from.x * to.y, second: from.y * to.x }
}

/// Weights whose point is nearer to the ray than `point`, that of `weights`: what is left is taken apart along two edges.
/// `None` where these have no area.
fn refined(corners: [Vec3; 3], weights: [f32; 3], point: Vec3) -> Option<([f32; 3], Vec3)> {
    let (first, second) = (corners[1] - corners[0], corners[2] - corners[0]);
    let area = first.x * second.y - first.y * second.x;
    let middle = weights[1] - (point.x * second.y - point.y * second.x) / area;
    let high = weights[2] - (first.x * point.y - first.y * point.x) / area;
    let weights = [(1.0 - middle - high).max(0.0), middle.max(0.0), high.max(0.0)];
    let sum = weights[0] + weights[1] + weights[2];
    // Also where a division gave no number.
    if !(area.abs() > 0.0 && sum > 0.0 && sum < 1e30) {
        return None;
    }
    let weights = weights.map(|weight| weight / sum);
    Some((weights, weights[0] * corners[0] + weights[1] * corners[1] + weights[2] * corners[2]))
}

/// The point of the longest edge, as the ray sees it, that is nearest to the ray: weights and place.
fn on_longest_edge(corners: [Vec3; 3]) -> ([f32; 3], Vec3) {
    let length2 = |i: usize| (corners[(i + 1) % 3] - corners[i]).truncate().length_squared();
    let mut longest = 0;
    for i in 1..3 {
        if length2(i) > length2(longest) {
            longest = i;
        }
    }
    let next = (longest + 1) % 3;
    let (from, along) = (corners[longest], corners[next] - corners[longest]);
    let share = (-from.truncate().dot(along.truncate()) / length2(longest).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    let mut weights = [0.0; 3];
    (weights[longest], weights[next]) = (1.0 - share, share);
    (weights, (1.0 - share) * corners[longest] + share * corners[next])
}

/// Whether the corners lie on a line, as far as 53 bits tell.
#[inline]
fn is_degenerate(triangle: &Triangle) -> bool {
    let (ab, ac) = (triangle.b.as_dvec3() - triangle.a.as_dvec3(), triangle.c.as_dvec3() - triangle.a.as_dvec3());
    let (cross2, product2) = (ab.cross(ac).length_squared(), ab.length_squared() * ac.length_squared());
    // What is far from the limit needs no roots.
    let is_clear = cross2 > 65.0 * f64::EPSILON * f64::EPSILON * product2;
    !is_clear && ab.cross(ac).length() <= 8.0 * f64::EPSILON * ab.length() * ac.length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Ray, RaySpace};

    fn cast(triangle: &Triangle, origin: Vec3, direction: Vec3) -> Option<LocalHit> {
        let space = RaySpace::new(&triangle.bounds());
        let ray = PreparedRay::new(&Ray::new(origin, direction), &space);
        let hit = PreparedTriangle::new(triangle, 5).hit(&ray)?;
        Some(LocalHit { t: ray.caller_t(hit.t), ..hit })
    }

    #[test]
    fn weights_belong_to_the_callers_corners() {
        let corners = [Vec3::new(0.0, 0.0, 1.0), Vec3::new(4.0, 0.0, 1.0), Vec3::new(0.0, 4.0, 1.0)];
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let [a, b, c] = order.map(|i| corners[i]);
            let hit = cast(&Triangle::new(a, b, c), Vec3::new(1.0, 2.0, -1.0), Vec3::new(0.0, 0.0, 0.5)).unwrap();
            assert_eq!((hit.t, hit.triangle), (4.0, 5));
            let point = (1.0 - hit.weights[0] - hit.weights[1]) * a + hit.weights[0] * b + hit.weights[1] * c;
            assert!((point - Vec3::new(1.0, 2.0, 1.0)).length() < 1e-6, "{order:?}: {point}");
        }
    }

    #[test]
    fn edges_and_corners_belong_to_the_triangle() {
        let t = Triangle::new(Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 4.0, 0.0));
        for inside in [Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(2.0, 2.0, 0.0), Vec3::new(0.0, 1.0, 0.0)] {
            assert!(cast(&t, inside + Vec3::Z, -Vec3::Z).is_some(), "{inside}");
            assert!(cast(&t, inside - Vec3::Z, Vec3::Z).is_some(), "{inside}");
        }
        for outside in [Vec3::new(-0.001, 0.0, 0.0), Vec3::new(2.0, 2.001, 0.0), Vec3::new(5.0, 0.0, 0.0)] {
            assert!(cast(&t, outside + Vec3::Z, -Vec3::Z).is_none(), "{outside}");
        }
    }

    #[test]
    fn triangles_without_an_area_are_never_hit() {
        let line = |k: f32| Vec3::new(0.1, 0.7, 0.3) * k;
        for degenerate in [
            Triangle::new(Vec3::ONE, Vec3::ONE, Vec3::ONE),
            Triangle::new(Vec3::ZERO, Vec3::ZERO, Vec3::X),
            Triangle::new(Vec3::ZERO, line(1.0), line(2.0)),
        ] {
            let target = degenerate.centroid();
            for direction in [Vec3::X, Vec3::Y, Vec3::new(0.3, -0.7, 0.2)] {
                assert!(cast(&degenerate, target - direction, direction).is_none(), "{degenerate:?}");
            }
        }
    }

    #[test]
    fn a_ray_in_the_plane_of_a_triangle_hits_where_the_triangle_is() {
        let t = Triangle::new(Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 4.0, 0.0));
        // Exactly edge on, every edge function is zero and there is no area to hit.
        assert!(cast(&t, Vec3::new(-1.0, 1.0, 0.0), Vec3::X).is_none());
        let tilted = cast(&t, Vec3::new(-1.0, 1.0, 1e-7), Vec3::new(1.0, 0.0, -5e-8));
        if let Some(hit) = tilted {
            assert!((1.0..=5.0).contains(&hit.t), "{hit:?}");
        }
    }
}
