//! Brute force in the type of the coordinates.

use nearfield::geometry::Scalar;

/// d² over the axes in order.
pub(crate) fn dist2<T: Scalar, const D: usize>(a: &[T; D], b: &[T; D]) -> T {
    let mut sum = T::of(0.0);
    for axis in 0..D {
        let difference = a[axis] - b[axis];
        sum += difference * difference;
    }
    sum
}

/// Index and squared distance of all points by distance, ties by index.
pub(crate) fn by_distance<T: Scalar, const D: usize>(
    points: &[[T; D]],
    query: &[T; D],
    left_out: Option<usize>,
) -> Vec<(u32, T)> {
    let kept = points.iter().enumerate().filter(|(i, _)| Some(*i) != left_out);
    let mut all: Vec<(u32, T)> = kept.map(|(i, point)| (i as u32, dist2(point, query))).collect();
    all.sort_by(|a, b| a.1.compare(b.1).then(a.0.cmp(&b.0)));
    all
}

/// The rows of all queries within their radii, by distance.
pub(crate) fn within<T: Scalar, const D: usize>(
    points: &[[T; D]],
    queries: &[[T; D]],
    radius: impl Fn(usize) -> T,
    exclude_self: bool,
) -> Vec<Vec<(u32, T)>> {
    let row = |(i, query)| {
        let mut row = by_distance(points, query, exclude_self.then_some(i));
        row.retain(|hit| hit.1 <= radius(i) * radius(i));
        row
    };
    queries.iter().enumerate().map(row).collect()
}
