//! Named clouds of any dimension, and radii for them.

use nearfield::geometry::Scalar;

use crate::support::Random;

/// A cloud with other queries and a radius that finds some, but not all.
pub(crate) struct Case<T, const D: usize> {
    pub(crate) name: &'static str,
    pub(crate) points: Vec<[T; D]>,
    pub(crate) queries: Vec<[T; D]>,
    pub(crate) radius: T,
}

pub(crate) const SEED: u64 = 20_261_124;

fn uniform<T: Scalar, const D: usize>(n: usize, random: &mut Random) -> Vec<[T; D]> {
    (0..n).map(|_| std::array::from_fn(|_| T::of(2.0 * f64::from(random.unit()) - 1.0))).collect()
}

/// Points of a lattice with a step of 0.5: distances, and so ties, are exact.
fn lattice<T: Scalar, const D: usize>(n: usize) -> Vec<[T; D]> {
    let side = if D == 2 { 20 } else { 3 };
    let coordinate = |i: usize, axis: u32| (i / usize::pow(side, axis.min(6)) % side) as f64 * 0.5;
    (0..n).map(|i| std::array::from_fn(|axis| T::of(coordinate(i, axis as u32)))).collect()
}

fn clustered<T: Scalar, const D: usize>(n: usize, random: &mut Random) -> Vec<[T; D]> {
    let centers: Vec<[f64; D]> = (0..5).map(|_| std::array::from_fn(|_| 100.0 * f64::from(random.unit()))).collect();
    let mut around = |i: usize| {
        let scale = 10f64.powi(-((i % 4) as i32));
        let center = centers[i % centers.len()];
        std::array::from_fn(|axis| T::of(center[axis] + scale * f64::from(random.unit())))
    };
    (0..n).map(&mut around).collect()
}

/// A radius with about `wanted` of the points around the first one.
pub(crate) fn radius_for<T: Scalar, const D: usize>(points: &[[T; D]], wanted: usize) -> T {
    let mut dist2: Vec<f64> = points.iter().map(|p| crate::reference::dist2(p, &points[0]).to_f64()).collect();
    dist2.sort_unstable_by(f64::total_cmp);
    T::of(dist2[wanted.min(dist2.len() - 1)].sqrt())
}

pub(crate) fn cases<T: Scalar, const D: usize>(n: usize) -> Vec<Case<T, D>> {
    let mut random = Random(SEED + D as u64);
    let case = |name, points: Vec<[T; D]>, queries, radius| Case { name, points, queries, radius };
    let one = [T::of(0.25); D];
    let some: Vec<[T; D]> = uniform(n / 3, &mut random);
    let spread: Vec<[T; D]> = uniform(n, &mut random);
    let mut outlier = spread.clone();
    outlier[n / 2] = [T::of(1e6); D];
    let clusters = clustered(n, &mut random);
    let beside: Vec<[T; D]> = clusters.iter().step_by(3).map(|p| p.map(|x: T| x + T::of(0.01))).collect();
    let far: Vec<[T; D]> = some.iter().map(|p| p.map(|x: T| x * T::of(3.0))).collect();
    let radius = radius_for(&spread, 9);
    let lattice = lattice(n);
    vec![
        case("empty", vec![], some.clone(), T::of(1.0)),
        case("one", vec![one], some.clone(), T::of(1.0)),
        case("all equal", vec![one; n / 2], vec![one, [T::of(0.75); D]], T::of(0.5)),
        case("duplicates", vec![one; n / 2], vec![one], T::of(0.0)),
        case("lattice with ties", lattice.clone(), lattice[..n / 4].to_vec(), T::of(0.5)),
        case("uniform", spread.clone(), some.clone(), radius),
        case("queries outside", spread.clone(), far, radius),
        case("no queries", spread.clone(), vec![], radius),
        case("radius beyond everything", spread[..n / 4].to_vec(), some[..10.min(n / 4)].to_vec(), T::of(100.0)),
        case("clustered", clusters.clone(), beside, radius_for(&clusters, 9)),
        case("outlier", outlier, some, radius),
    ]
}
