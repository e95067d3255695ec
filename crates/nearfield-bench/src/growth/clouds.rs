//! Points of a set, the radius for about as many neighbours at every number of points, and what counts must be.

use nearfield::geometry::generate::{CloudKind, cloud, radius_for};
use nearfield::{AabbTree, AabbTreeSettings, FixedRadius, NeighborSearch, Vec3};

use crate::Result;
use crate::check::{Expected, ExpectedOfSome};
use crate::sets::SEED;

/// Neighbours beside the point itself that are aimed at.
const NEIGHBORS: f64 = 49.0;
/// Points of a clustered set that its radius is found by: the first ones are as good a sample as any.
const SAMPLE: usize = 1_000_000;
/// Of which so many ask.
const ASKING: usize = 16_384;
/// Up to so many points every count is checked.
const ALL_CHECKED: usize = 300_000;
/// Beyond, as many queries as a loop can put to all points with about so many tests.
const TESTS: usize = 20_000_000_000;
/// Fewest and most of them.
const QUERIES: [usize; 2] = [64, 1024];
/// By how much the totals of two structures may differ: pairs within rounding of the radius.
const TOTALS: f64 = 1e-4;

/// Points with their radius and what their counts must be.
pub(super) struct Cloud {
    pub(super) kind: CloudKind,
    pub(super) points: Vec<Vec3>,
    pub(super) radius: f32,
    expected: Counts,
}

/// What counts are compared with.
enum Counts {
    /// All of them.
    All(Expected),
    /// Those of some queries.
    Some(ExpectedOfSome),
}

impl Cloud {
    /// # Errors
    /// As the reference.
    pub(super) fn new(kind: CloudKind, n: usize) -> Result<Self> {
        let points = cloud(kind, n, SEED).points;
        let radius = match kind {
            CloudKind::Clustered => radius_of_uneven(&points)?,
            kind => radius_for(kind, n).ok_or_else(|| format!("{kind} has no radius"))?,
        };
        let expected = if n <= ALL_CHECKED {
            Counts::All(Expected::of(&points, radius)?)
        } else {
            Counts::Some(ExpectedOfSome::of(&points, radius, (TESTS / n).clamp(QUERIES[0], QUERIES[1])))
        };
        Ok(Self { kind, points, radius, expected })
    }

    /// Checks counts, and their total against that of a structure before, if there was one; the total.
    ///
    /// # Errors
    /// A wrong answer.
    pub(super) fn check(&self, counts: &[u32], before: Option<u64>) -> Result<u64> {
        match &self.expected {
            Counts::All(expected) => expected.check_counts(counts)?,
            Counts::Some(expected) => expected.check_counts(counts)?,
        }
        let total = counts.iter().map(|&count| u64::from(count)).sum::<u64>();
        match before {
            Some(before) if (total as f64 - before as f64).abs() > TOTALS * before as f64 => {
                Err(format!("wrong answer: {total} neighbours in all, another structure found {before}").into())
            }
            _ => Ok(total),
        }
    }
}

/// The radius within which points whose density varies have [`NEIGHBORS`] others on average, found on a sample of them: of a sample of
/// a tenth of the points a tenth is found.
fn radius_of_uneven(points: &[Vec3]) -> Result<f32> {
    let sample = &points[..points.len().min(SAMPLE)];
    let asking = &sample[..sample.len().min(ASKING)];
    let wanted = NEIGHBORS * sample.len() as f64 / points.len() as f64;
    let tree = AabbTree::build(sample, &AabbTreeSettings::default())?;
    let others = |radius: f64| -> Result<f64> {
        let counts = tree.count(&FixedRadius::new(radius as f32).queries(asking))?;
        let total: u64 = counts.as_slice().iter().map(|&count| u64::from(count)).sum();
        Ok(total as f64 / asking.len() as f64 - 1.0)
    };
    // The mean rises with the radius: bisection between radii that have too few and too many.
    let start = f64::from(radius_for(CloudKind::Clustered, points.len()).unwrap_or(1e-3));
    let (mut low, mut high) = (0.25 * start, start);
    while others(high)? < wanted && high < 10.0 {
        high *= 2.0;
    }
    while others(low)? > wanted && low > 1e-7 {
        low *= 0.5;
    }
    for _ in 0..14 {
        let middle = (low * high).sqrt();
        if others(middle)? < wanted {
            low = middle;
        } else {
            high = middle;
        }
    }
    Ok((low * high).sqrt() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_stay_about_fifty_at_every_number_of_points() {
        for kind in [CloudKind::Uniform, CloudKind::Shell, CloudKind::Clustered] {
            for n in [3000, 30_000] {
                let cloud = Cloud::new(kind, n).expect("a cloud");
                let tree = AabbTree::build(&cloud.points, &AabbTreeSettings::default()).expect("a tree");
                let counts = tree.count(&FixedRadius::new(cloud.radius)).expect("counts").into_vec();
                let total = cloud.check(&counts, None).expect("right counts");
                let mean = total as f64 / n as f64;
                // At the border of a cube there are fewer.
                assert!((32.0..52.0).contains(&mean), "{kind} {n}: {mean}");
                assert!(cloud.check(&counts, Some(total + total / 1000)).is_err(), "another total");
                let mut planted = counts;
                planted[0] += 1;
                assert!(cloud.check(&planted, None).is_err(), "a planted count");
            }
        }
    }
}
