//! How far apart points stand, and which stand at one place.

use nearfield::geometry::distance::dist2;
use nearfield::{FixedRadius, GridSettings, NeighborSearch, RowOrder, UniformGrid, Vec3};
use rayon::prelude::*;

/// Positions on which the first search radius is found.
const PROBES: usize = 64;

/// Spacing of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Spacing {
    /// Mean distance from a position to the nearest other position; `None` for fewer than two.
    pub(crate) mean: Option<f64>,
    /// Points at the position of an earlier point.
    pub(crate) duplicates: u64,
}

/// Measures the spacing of points that are all finite.
///
/// The radius starts at twice the median spacing of a few probes and doubles for those that found nobody, so neither a
/// far outlier nor a dense cluster makes the search slow. Positions whose squared distance underflows an f32 count as
/// standing at distance 0.
pub(crate) fn spacing(points: &[Vec3]) -> nearfield::Result<Spacing> {
    let positions = positions(points);
    let duplicates = (points.len() - positions.len()) as u64;
    if positions.len() < 2 {
        return Ok(Spacing { mean: None, duplicates });
    }
    let mut radius = first_radius(&positions);
    let grid = UniformGrid::build(&positions, &GridSettings::for_radius(radius))?;
    let nearest = grid.nearest(&FixedRadius::new(radius).exclude_self())?;
    let mut sum = 0.0;
    let mut alone = Vec::new();
    for (i, &position) in positions.iter().enumerate() {
        match nearest.get(i) {
            Some(neighbor) => sum += f64::from(neighbor.dist2).sqrt(),
            None => alone.push(position),
        }
    }
    while !alone.is_empty() {
        radius *= 2.0;
        let grid = UniformGrid::build(&positions, &GridSettings::for_radius(radius))?;
        let question = FixedRadius::new(radius).queries(&alone).order(RowOrder::Distance).max_neighbors(2).distances();
        let rows = grid.list(&question)?;
        let mut still_alone = Vec::new();
        for (i, &position) in alone.iter().enumerate() {
            // The first of a row is the position itself.
            match rows.row_distances(i).and_then(|d| d.get(1)) {
                Some(&distance) => sum += f64::from(distance),
                None => still_alone.push(position),
            }
        }
        alone = still_alone;
    }
    Ok(Spacing { mean: Some(sum / positions.len() as f64), duplicates })
}

/// The distinct positions, sorted.
fn positions(points: &[Vec3]) -> Vec<Vec3> {
    // Adding zero turns -0 into 0: both are one place.
    let mut positions: Vec<Vec3> = points.iter().map(|&p| p + Vec3::ZERO).collect();
    let key = |p: &Vec3| p.to_array().map(f32::to_bits);
    positions.par_sort_unstable_by_key(key);
    positions.dedup_by_key(|p| key(p));
    positions
}

/// Twice the median distance from a few positions to their nearest other one.
fn first_radius(positions: &[Vec3]) -> f32 {
    let step = positions.len().div_ceil(PROBES);
    let nearest = |i: usize| {
        let others = positions[..i].iter().chain(&positions[i + 1..]);
        others.map(|&p| dist2(positions[i], p)).fold(f32::INFINITY, f32::min)
    };
    let probes: Vec<usize> = (0..positions.len()).step_by(step).collect();
    let mut found: Vec<f32> = probes.into_par_iter().map(nearest).collect();
    found.sort_unstable_by(f32::total_cmp);
    // The smallest radius whose square is a normal number, and one that can double a few times.
    (2.0 * found[found.len() / 2].sqrt()).clamp(2e-19, 4e18)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute_force(points: &[Vec3]) -> f64 {
        let nearest = |i: usize| {
            let others = points.iter().enumerate().filter(|&(j, _)| j != i);
            others.map(|(_, p)| f64::from(dist2(points[i], *p)).sqrt()).fold(f64::INFINITY, f64::min)
        };
        (0..points.len()).map(nearest).sum::<f64>() / points.len() as f64
    }

    #[test]
    fn a_lattice_has_its_own_spacing() {
        let points: Vec<Vec3> =
            (0..1000).map(|i| Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100) as f32) * 0.25).collect();
        assert_eq!(spacing(&points).unwrap(), Spacing { mean: Some(0.25), duplicates: 0 });
    }

    #[test]
    fn duplicates_are_counted_and_left_out() {
        let points = [Vec3::ZERO, Vec3::X, -Vec3::ZERO, Vec3::X, Vec3::X];
        assert_eq!(spacing(&points).unwrap(), Spacing { mean: Some(1.0), duplicates: 3 });
        assert_eq!(spacing(&[Vec3::ONE; 9]).unwrap(), Spacing { mean: None, duplicates: 8 });
        assert_eq!(spacing(&[]).unwrap(), Spacing { mean: None, duplicates: 0 });
    }

    #[test]
    fn clusters_and_outliers_agree_with_brute_force() {
        let mut points: Vec<Vec3> =
            (0..600).map(|i| Vec3::new(i as f32 * 0.001, (i * i % 17) as f32 * 0.002, 5.0)).collect();
        points.extend((0..40).map(|i| Vec3::new(1e4 + (i * i) as f32, 3.0 * i as f32, 0.0)));
        points.push(Vec3::splat(-1e7));
        let (found, expected) = (spacing(&points).unwrap().mean.unwrap(), brute_force(&points));
        // Each distance is an f32: relative error 2^-24 in the root and as much in its square.
        assert!((found - expected).abs() <= 2e-7 * expected, "{found} {expected}");
    }
}
