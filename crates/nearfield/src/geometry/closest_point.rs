//! The point of a triangle that is closest to a place, and what of the triangle it lies on.

use glam::DVec3;

/// What of a triangle a point lies on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TriangleFeature {
    /// The corner with this number, 0 to 2.
    Corner(usize),
    /// The edge from the corner with this number to the next, without its ends.
    Edge(usize),
    /// The inside.
    Face,
}

/// The offset from the place to the closest point of a triangle, given by its corners minus the place, and what that point
/// lies on. Of a triangle without an area, the closest point of one of its edges.
///
/// Source: Ericson2005, 5.1.5. Differs: the place is the origin, so nothing large cancels.
pub fn closest_point([a, b, c]: [DVec3; 3]) -> (DVec3, TriangleFeature) {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (-ab.dot(a), -ac.dot(a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, TriangleFeature::Corner(0));
    }
    let (d3, d4) = (-ab.dot(b), -ac.dot(b));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, TriangleFeature::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (a + ab * (d1 / (d1 - d3)), TriangleFeature::Edge(0));
    }
    let (d5, d6) = (-ab.dot(c), -ac.dot(c));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, TriangleFeature::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (a + ac * (d2 / (d2 - d6)), TriangleFeature::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    let (from_b, from_c) = (d4 - d3, d5 - d6);
    if va <= 0.0 && from_b >= 0.0 && from_c >= 0.0 {
        return (b + (c - b) * (from_b / (from_b + from_c)), TriangleFeature::Edge(1));
    }
    let scale = 1.0 / (va + vb + vc);
    (a + ab * (vb * scale) + ac * (vc * scale), TriangleFeature::Face)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_is_met() {
        let corners = [DVec3::ZERO, DVec3::new(4.0, 0.0, 0.0), DVec3::new(0.0, 3.0, 0.0)];
        let cases = [
            (DVec3::new(-1.0, -2.0, 1.0), DVec3::ZERO, TriangleFeature::Corner(0)),
            (DVec3::new(6.0, -1.0, 0.0), corners[1], TriangleFeature::Corner(1)),
            (DVec3::new(-1.0, 5.0, 2.0), corners[2], TriangleFeature::Corner(2)),
            (DVec3::new(2.0, -3.0, 1.0), DVec3::new(2.0, 0.0, 0.0), TriangleFeature::Edge(0)),
            (DVec3::new(2.0 + 3.0, 1.5 + 4.0, 7.0), DVec3::new(2.0, 1.5, 0.0), TriangleFeature::Edge(1)),
            (DVec3::new(-2.0, 1.0, 0.0), DVec3::new(0.0, 1.0, 0.0), TriangleFeature::Edge(2)),
            (DVec3::new(1.0, 1.0, -9.0), DVec3::new(1.0, 1.0, 0.0), TriangleFeature::Face),
        ];
        for (place, expected, feature) in cases {
            let (offset, found) = closest_point(corners.map(|corner| corner - place));
            assert!((place + offset - expected).length() < 1e-14, "{place}: {}", place + offset);
            assert_eq!(found, feature);
        }
    }

    #[test]
    fn no_point_of_the_triangle_is_closer() {
        let corners = [DVec3::new(0.3, -1.0, 0.2), DVec3::new(1.7, 0.4, -0.3), DVec3::new(-0.2, 0.9, 1.1)];
        for i in 0..200u32 {
            let at = |prime: u32| f64::from(i * prime % 199) / 199.0 * 4.0 - 2.0;
            let place = DVec3::new(at(37), at(83), at(151));
            let (offset, _) = closest_point(corners.map(|corner| corner - place));
            for (j, k) in (0..=20u32).flat_map(|j| (0..=20 - j).map(move |k| (f64::from(j), f64::from(k)))) {
                let point =
                    corners[0] + (corners[1] - corners[0]) * (j / 20.0) + (corners[2] - corners[0]) * (k / 20.0);
                assert!(offset.length() <= (point - place).length() + 1e-12, "{place}");
            }
        }
    }
}
