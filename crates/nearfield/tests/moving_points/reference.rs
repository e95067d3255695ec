//! Neighbours by the obvious loop, and the comparison with what was found.

use libtest_mimic::Trial;
use nearfield::geometry::validate::MAX_COORDINATE;
use nearfield::{FixedRadius, NeighborSearch, Queries, Radius, Vec3};

use crate::support::trial;

/// For each query the indices that must be found, and those that may be.
pub(crate) struct Expected {
    rows: Vec<(Vec<u32>, Vec<u32>)>,
}

impl Expected {
    /// By the formula of the library in f32, or under `fused` by exact distances: there a pair within 4 ulp of the radius
    /// may be found or not.
    pub(crate) fn by_loop(points: &[Vec3], question: &FixedRadius<'_>, fused: bool) -> Self {
        let queries = match question.queries {
            Queries::Points => points,
            Queries::Other(queries) => queries,
        };
        let rows = queries.iter().enumerate().map(|(i, &query)| {
            let radius = match question.radius {
                Radius::One(radius) => radius,
                Radius::Each(radii) => radii[i],
            };
            let mut row = (Vec::new(), Vec::new());
            for (j, &point) in points.iter().enumerate() {
                if question.exclude_self && i == j {
                    continue;
                }
                let (must, may) = is_near(query, point, radius, fused);
                row.0.extend(must.then_some(j as u32));
                row.1.extend(may.then_some(j as u32));
            }
            row
        });
        Self { rows: rows.collect() }
    }

    /// The first difference of a count and a list in any order.
    pub(crate) fn difference(&self, counts: &[u32], row: impl Fn(usize) -> Vec<u32>) -> Option<String> {
        if counts.len() != self.rows.len() {
            return Some(format!("{} rows, expected {}", counts.len(), self.rows.len()));
        }
        for (i, (must, may)) in self.rows.iter().enumerate() {
            if !(must.len()..=may.len()).contains(&(counts[i] as usize)) {
                return Some(format!("count {i} is {}, expected {}", counts[i], must.len()));
            }
            let mut found = row(i);
            found.sort_unstable();
            let missing = must.iter().find(|id| found.binary_search(id).is_err());
            let wrong = found.iter().find(|id| may.binary_search(id).is_err());
            let is_twice = found.windows(2).any(|pair| pair[0] == pair[1]);
            if missing.is_some() || wrong.is_some() || is_twice || found.len() != counts[i] as usize {
                return Some(format!("row {i}: {missing:?} is missing, {wrong:?} is wrong, {found:?} was found"));
            }
        }
        None
    }

    /// Asks for count and list, and fails at the first difference.
    pub(crate) fn check(&self, search: &dyn NeighborSearch, question: &FixedRadius<'_>, case: &str) {
        let counts = search.count(question).unwrap_or_else(|error| panic!("{case}: {error}"));
        let list = search.list(question).unwrap_or_else(|error| panic!("{case}: {error}"));
        if let Some(difference) = self.difference(counts.as_slice(), |i| list.row(i).to_vec()) {
            panic!("{case}: {difference}");
        }
    }
}

/// Whether a pair must and may be near.
fn is_near(a: Vec3, b: Vec3, radius: f32, fused: bool) -> (bool, bool) {
    if !fused {
        let d = a - b;
        let near = (d.x * d.x + d.y * d.y) + d.z * d.z <= radius * radius;
        return (near, near);
    }
    let distance = (a.as_dvec3() - b.as_dvec3()).length();
    let (radius, slack) = (f64::from(radius), 4.0 * f64::from(radius * f32::EPSILON));
    (distance <= radius - slack, distance <= radius + slack)
}

/// A radius that reaches every point from every other one.
pub(crate) fn beyond_all(points: &[Vec3]) -> f32 {
    let farthest = points.iter().map(|p| p.abs().max_element()).fold(1.0, f32::max);
    assert!(farthest <= MAX_COORDINATE);
    4.0 * farthest
}

pub(crate) fn trials() -> Vec<Trial> {
    vec![trial("planted_differences_are_found", || {
        let points = [Vec3::ZERO, Vec3::X, 3.0 * Vec3::X];
        for fused in [false, true] {
            let expected = Expected::by_loop(&points, &FixedRadius::new(1.5), fused);
            let rows = [vec![1, 0], vec![0, 1], vec![2]];
            let found = |counts: &[u32], rows: &[Vec<u32>]| expected.difference(counts, |i| rows[i].clone());
            assert_eq!(found(&[2, 2, 1], &rows), None);
            assert!(found(&[2, 2], &rows).is_some_and(|text| text.contains("2 rows")));
            assert!(found(&[2, 3, 1], &rows).is_some_and(|text| text.contains("count 1 is 3")));
            assert!(found(&[2, 2, 1], &[vec![1, 0], vec![0, 2], vec![2]]).is_some_and(|text| text.contains("row 1")));
            assert!(found(&[2, 2, 1], &[vec![1, 0], vec![0], vec![2]]).is_some_and(|text| text.contains("row 1")));
            assert!(found(&[2, 2, 1], &[vec![1, 1], vec![0, 1], vec![2]]).is_some_and(|text| text.contains("row 0")));
        }
        // At exactly the radius a device may decide either way.
        let at_radius = Expected::by_loop(&points, &FixedRadius::new(2.0).exclude_self(), true);
        assert_eq!(at_radius.rows[2], (vec![], vec![1]));
    })]
}
