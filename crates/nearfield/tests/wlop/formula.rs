//! One iteration over all pairs, by the formulas as they are published, in f64; every variant of the library in both precisions
//! against it.

use libtest_mimic::Trial;
use nearfield::Scalar;
use nearfield::application::{Watch, Wlop, WlopSettings, WlopStart, WlopVariant};
use nearfield::geometry::vector;

use crate::support::trial;
use crate::surfaces::torus;
use crate::{distance, settings, tree};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("every_variant_is_its_formula_in_f64", || is_the_formula::<f64>(1e-12)),
        trial("every_variant_is_its_formula_in_f32", || is_the_formula::<f32>(4e-6)),
    ]
}

/// One iteration by the formulas of the variants, over all pairs. `weigh` asks for v.
fn plainly(
    variant: WlopVariant,
    points: &[[f64; 3]],
    samples: &[[f64; 3]],
    (h, first, weigh): (f64, bool, bool),
) -> Vec<[f64; 3]> {
    // CGAL: θ with d² in the unit of the points, no 1/r, 1/r² repulsion; samples count themselves twice; v with d² ≥ 1e-8.
    let (mu, theta): (f64, fn(f64) -> f64) = match variant {
        WlopVariant::Paper => (0.45, |q| (-(q * 4.0) * (q * 4.0)).exp()),
        WlopVariant::Authors => (0.5, |q| (-4.0 * q * q).exp()),
        WlopVariant::Cgal => (0.45, |q| (-4.0 * q * q).exp()),
        WlopVariant::Best => (0.45, |q| (-8.0 * q * q).exp()),
    };
    let attraction: fn(f64) -> f64 = match variant {
        WlopVariant::Best => |q| (-24.0 * q * q).exp(),
        _ => theta,
    };
    let reach = if variant == WlopVariant::Best { 0.65 } else { 1.0 };
    let within = |a: [f64; 3], b: [f64; 3], reach: f64| Some(distance(a, b)).filter(|r| *r <= reach * h);
    let v: Vec<f64> = points
        .iter()
        .enumerate()
        .map(|(j, p)| {
            let others = points.iter().enumerate().filter(|(k, _)| *k != j);
            let sum: f64 = match variant {
                WlopVariant::Authors => {
                    let near = others.filter_map(|(_, other)| within(*p, *other, 0.95));
                    near.map(|r| theta(r / (0.95 * h))).sum()
                }
                WlopVariant::Cgal => {
                    let near = others.filter_map(|(_, other)| within(*p, *other, 1.0));
                    near.filter(|r| r * r >= 1e-8).map(|r| theta(r / h)).sum()
                }
                _ => others.filter_map(|(_, other)| within(*p, *other, reach)).map(|r| attraction(r / h)).sum(),
            };
            if weigh { 1.0 + sum } else { 1.0 }
        })
        .collect();
    let w: Vec<f64> = samples
        .iter()
        .enumerate()
        .map(|(i, x)| {
            let others = samples.iter().enumerate().filter(|(k, _)| *k != i);
            let sum: f64 = others.filter_map(|(_, other)| within(*x, *other, 1.0)).map(|r| theta(r / h)).sum();
            match variant {
                WlopVariant::Authors => (1.0 + sum).sqrt(),
                WlopVariant::Cgal => 2.0 + sum,
                _ => 1.0 + sum,
            }
        })
        .collect();
    let least = 1e-3 * h;
    let moved = |(i, &x): (usize, &[f64; 3])| {
        let (mut pull, mut pulls) = ([0.0; 3], 0.0);
        for (j, &p) in points.iter().enumerate() {
            let Some(r) = within(x, p, reach) else { continue };
            let held = r.max(least);
            let alpha = match variant {
                WlopVariant::Cgal if r * r < 1e-10 => continue,
                WlopVariant::Cgal => theta(r / h),
                WlopVariant::Authors => theta(r / h) / held,
                WlopVariant::Paper if first => theta(r / h),
                WlopVariant::Paper => theta(r / h) / held,
                WlopVariant::Best if first => attraction(r / h),
                WlopVariant::Best => attraction(r / h) / held.sqrt(),
            };
            pull = vector::add_scaled(pull, p, alpha / v[j]);
            pulls += alpha / v[j];
        }
        let (mut push, mut pushes, mut around) = ([0.0; 3], 0.0, 0);
        for (k, &other) in samples.iter().enumerate() {
            let Some(r) = within(x, other, 1.0).filter(|_| k != i) else { continue };
            around += 1;
            let beta = match variant {
                WlopVariant::Cgal if r * r < 1e-10 => continue,
                WlopVariant::Cgal => theta(r / h) / (r * r),
                // At one place there is no direction.
                _ if r == 0.0 => continue,
                WlopVariant::Best => theta(r / h) / r.max(least).powi(3),
                _ => theta(r / h) / r.max(least),
            };
            push = vector::add_scaled(push, vector::subtract(x, other), w[k] * beta);
            pushes += w[k] * beta;
        }
        let is_cgal = variant == WlopVariant::Cgal;
        if is_cgal && (around < 2 || pushes < 1e-10) || pushes == 0.0 {
            (push, pushes) = ([0.0; 3], 1.0);
        }
        match pulls {
            _ if is_cgal && pulls < 1e-10 => vector::add_scaled(x, push, mu / pushes),
            0.0 => x,
            _ => vector::add_scaled(vector::scale(pull, 1.0 / pulls), push, mu / pushes),
        }
    };
    samples.iter().enumerate().map(moved).collect()
}

/// A noisy torus, with points at one place, far ones, and samples in nothing and at one place.
pub(crate) fn rough_torus() -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let mut points = torus(1500, 0.005).points;
    points[7] = points[8];
    points.push([4.0; 3]);
    points.push([4.3, 4.0, 4.0]);
    let mut samples: Vec<[f64; 3]> = points.iter().step_by(9).copied().collect();
    samples.extend([[4.0; 3], [-5.0, 0.0, 0.0], [0.7, 0.8, 0.3], [0.7, 0.8, 0.3]]);
    (points, samples)
}

fn is_the_formula<T: Scalar>(bound: f64) {
    let (points, samples) = rough_torus();
    let (points, samples): (Vec<[T; 3]>, Vec<[T; 3]>) =
        (points.iter().map(|p| p.map(T::of)).collect(), samples.iter().map(|p| p.map(T::of)).collect());
    // What the formula sees is what the library sees.
    let exact = |from: &[[T; 3]]| -> Vec<[f64; 3]> { from.iter().map(|p| p.map(T::to_f64)).collect() };
    let tree = tree(&points);
    for variant in WlopVariant::ALL {
        for weigh in [false, true] {
            let settings = WlopSettings { weigh_inputs: weigh, ..settings(variant, 0.5) };
            let mut wlop = Wlop::new(&tree, &WlopStart::Positions(&samples), &settings, &mut Watch::none()).unwrap();
            for iteration in 0..3 {
                let before = exact(wlop.positions());
                let expected = plainly(variant, &exact(&points), &before, (0.5, iteration == 0, weigh));
                let report = wlop.iterate().unwrap();
                let now = exact(wlop.positions());
                let far = now.iter().zip(&expected).map(|(a, b)| distance(*a, *b)).fold(0.0, f64::max);
                assert!(far <= bound, "{variant}, {weigh}, {iteration}: {far}");
                let moves: Vec<f64> = now.iter().zip(&before).map(|(a, b)| distance(*a, *b)).collect();
                let mean = moves.iter().sum::<f64>() / moves.len() as f64;
                assert!((report.mean_move - mean).abs() < 1e-6 * mean, "{variant}: {report:?}");
                assert!(mean > 1e-4 && report.largest_move >= mean, "{variant}: {report:?}");
            }
        }
    }
}
