//! The expected answers: every query against every point with the documented formula, written out here once more so
//! that nothing of the library stands on both sides of a comparison.

use std::sync::OnceLock;

use nearfield::Vec3;

/// Index and squared distance of a neighbour.
pub(crate) type Hit = (u32, f32);

/// Difference of two points, brought to the nearest image on the axes that have a period.
pub(crate) fn difference(a: Vec3, b: Vec3, period: Vec3) -> [f32; 3] {
    [0, 1, 2].map(|axis| {
        let (d, length) = (a[axis] - b[axis], period[axis]);
        if length > 0.0 { d - length * (d * (1.0 / length)).round_ties_even() } else { d }
    })
}

/// Squared distance: (dx·dx + dy·dy) + dz·dz in f32, never fused.
pub(crate) fn dist2(a: Vec3, b: Vec3, period: Vec3) -> f32 {
    let [dx, dy, dz] = difference(a, b, period);
    (dx * dx + dy * dy) + dz * dz
}

/// Length of the f32 difference, in f64: what any rounding of the formula is near to.
pub(crate) fn distance(a: Vec3, b: Vec3, period: Vec3) -> f64 {
    let [dx, dy, dz] = difference(a, b, period).map(f64::from);
    (dx * dx + dy * dy + dz * dz).sqrt()
}

/// What is asked of which points, and the true rows.
pub(crate) struct Problem<'a> {
    pub(crate) points: &'a [Vec3],
    pub(crate) queries: &'a [Vec3],
    /// Whether the queries are the points themselves.
    pub(crate) own: bool,
    /// [q]
    pub(crate) radii: Vec<f32>,
    /// Length per axis; 0 where not periodic.
    pub(crate) period: Vec3,
    /// Rows of all queries, or of a sample where all would take too long; ascending by query.
    pub(crate) truth: Vec<Row>,
}

/// Everything within the radius of a query, itself included.
pub(crate) struct Row {
    pub(crate) query: u32,
    /// Ascending by index.
    pub(crate) hits: Vec<Hit>,
    /// Places in `hits` by squared distance, ties by index.
    by_distance: OnceLock<Vec<u32>>,
    marginal_outside: OnceLock<usize>,
}

impl Row {
    /// The hits by squared distance, ties by index; sorted at the first use, for all subjects.
    pub(crate) fn nearest_first(&self) -> impl Iterator<Item = Hit> {
        let sorted = || {
            let mut places: Vec<u32> = (0..self.hits.len() as u32).collect();
            let hit = |&place: &u32| self.hits[place as usize];
            places.sort_by(|a, b| hit(a).1.total_cmp(&hit(b).1).then(a.cmp(b)));
            places
        };
        self.by_distance.get_or_init(sorted).iter().map(|&place| self.hits[place as usize])
    }
}

/// Pairs of query and point that one reference may take.
const MOST_PAIRS: usize = 400_000_000;

impl<'a> Problem<'a> {
    /// Finds the true rows.
    pub(crate) fn solve(points: &'a [Vec3], queries: &'a [Vec3], own: bool, radii: Vec<f32>, period: Vec3) -> Self {
        Self::sampled(points, queries, own, radii, period, MOST_PAIRS)
    }

    /// Finds the true rows of a sample of the queries that has at most so many pairs.
    pub(crate) fn sampled(
        points: &'a [Vec3],
        queries: &'a [Vec3],
        own: bool,
        radii: Vec<f32>,
        period: Vec3,
        most_pairs: usize,
    ) -> Self {
        let sample = (most_pairs / points.len().max(1)).clamp(1, queries.len().max(1));
        let step = queries.len().div_ceil(sample).max(1);
        let row = |query: usize| {
            let radius2 = radii[query] * radii[query];
            let hits = points.iter().enumerate().map(|(i, &p)| (i as u32, dist2(queries[query], p, period)));
            let hits = hits.filter(|&(_, d2)| d2 <= radius2).collect();
            Row { query: query as u32, hits, by_distance: OnceLock::new(), marginal_outside: OnceLock::new() }
        };
        let truth = (0..queries.len()).step_by(step).map(row).collect();
        Self { points, queries, own, radii, period, truth }
    }

    /// Whether `truth` has every row.
    pub(crate) fn is_complete(&self) -> bool {
        self.truth.len() == self.queries.len()
    }

    /// The true row without the query itself, where it is left out.
    pub(crate) fn row(&self, row: &Row, exclude_self: bool) -> Vec<Hit> {
        row.hits.iter().copied().filter(|hit| !(exclude_self && self.own && hit.0 == row.query)).collect()
    }

    /// Distance of a query from a point.
    pub(crate) fn distance(&self, query: u32, point: u32) -> f64 {
        distance(self.queries[query as usize], self.points[point as usize], self.period)
    }

    /// Distance from the sphere's surface within which a device may decide either way.
    fn slack(&self, query: u32, point: u32) -> f64 {
        let radius = self.radii[query as usize];
        4.0 * ulp(radius) + flushed(radius.into()) + self.wrap_rounding(query, point)
    }

    /// What a fused wrap saves: the rounding of length × turns, which is exact for one turn and less.
    pub(crate) fn wrap_rounding(&self, query: u32, point: u32) -> f64 {
        let (a, b) = (self.queries[query as usize], self.points[point as usize]);
        let wraps = (0..3).map(|axis| match self.period[axis] {
            length if length > 0.0 && (a[axis] - b[axis]).abs() > 1.5 * length => ulp(a[axis] - b[axis]),
            _ => 0.0,
        });
        wraps.sum()
    }

    /// Whether a device may take the point either way.
    pub(crate) fn is_marginal(&self, query: u32, point: u32) -> bool {
        let off = self.distance(query, point) - f64::from(self.radii[query as usize]);
        off.abs() <= self.slack(query, point)
    }

    /// Number of points that are no neighbours, but so near the surface that a device may count them.
    pub(crate) fn marginal_outside(&self, row: &Row) -> usize {
        *row.marginal_outside.get_or_init(|| {
            let is_inside = |i: &u32| row.hits.binary_search_by_key(i, |hit| hit.0).is_ok();
            let outside = (0..self.points.len() as u32).filter(|i| !is_inside(i));
            outside.filter(|&i| self.is_marginal(row.query, i)).count()
        })
    }
}

/// Distance from `x` to the next f32 away from zero.
pub(crate) fn ulp(x: f32) -> f64 {
    f64::from(x.abs().next_up()) - f64::from(x.abs())
}

/// How far a distance may be off on a device that flushes squares below the smallest normal number to zero: three of them
/// are missing from its own square.
pub(crate) fn flushed(distance: f64) -> f64 {
    let squares = 3.0 * f64::from(f32::MIN_POSITIVE);
    let (less, more) = ((distance.powi(2) - squares).max(0.0).sqrt(), (distance.powi(2) + squares).sqrt());
    (distance - less).max(more - distance)
}
