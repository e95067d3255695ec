//! How near samples come to the surface and how evenly they lie, on the published row: a torus, 100,000 points, noise of 0.5 % of
//! the diagonal, 5,000 samples.

use libtest_mimic::Trial;
use nearfield::application::{Watch, Wlop, WlopSettings, WlopStart, WlopVariant};
use nearfield::query::NearestFew;

use crate::support::{is_long, trial};
use crate::surfaces::torus;
use crate::{settings, tree};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("best_is_accurate_and_even_at_once", best_is_accurate_and_even),
        trial("the_others_are_one_or_the_other", others_are_one_or_the_other).with_ignored_flag(!is_long()),
    ]
}

/// Variation of the distances to the nearest other sample, and their mean as a part of that in a hexagonal lattice of the same area.
fn evenness(samples: &[[f64; 3]], area: f64) -> (f64, f64) {
    let tree = tree(samples);
    let nearest = |at: &[f64; 3]| {
        let mut few = NearestFew::new(2);
        tree.nearest_few(at, f64::INFINITY, &mut few);
        few.found()[1].0.sqrt()
    };
    let all: Vec<f64> = samples.iter().map(nearest).collect();
    let n = all.len() as f64;
    let mean = all.iter().sum::<f64>() / n;
    let variance = all.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n;
    (variance.sqrt() / mean, mean / (2.0 / 3f64.sqrt() * area / n).sqrt())
}

const TORUS_AREA: f64 = 0.4 * 4.0 * std::f64::consts::PI * std::f64::consts::PI;

/// Root mean square distance by the diagonal, variation and relative mean of the nearest distances.
fn quality(settings: &WlopSettings) -> (f64, f64, f64) {
    let surface = torus(100_000, 0.005);
    let tree = tree(&surface.points);
    let mut wlop = Wlop::new(&tree, &WlopStart::Random { count: 5000, seed: 1 }, settings, &mut Watch::none()).unwrap();
    let reports = wlop.run(&mut Watch::none()).unwrap();
    let (rms, bias) = surface.error(wlop.positions());
    let (variation, ideal) = evenness(wlop.positions(), TORUS_AREA);
    let first = &reports[0];
    println!(
        "{}: {} iterations, {:.1} points and {:.1} samples around each, RMS {rms:.5}, bias {bias:.5}, variation \
         {variation:.4}, nearest {ideal:.3} of the ideal",
        settings.variant,
        reports.len(),
        first.mean_inputs,
        first.mean_samples
    );
    (rms, variation, ideal)
}

fn best_is_accurate_and_even() {
    let (rms, variation, ideal) = quality(&settings(WlopVariant::Best, 0.4).iterations(50));
    assert!(rms <= 0.0009 && variation <= 0.07 && ideal > 0.85, "{rms}, {variation}, {ideal}");
}

/// Some minutes: all variants, and the defaults of the best.
fn others_are_one_or_the_other() {
    let best = quality(&WlopSettings::new(WlopVariant::Best));
    assert!(best.0 <= 0.0009 && best.1 <= 0.07, "{best:?}");
    let of = |variant, radius, iterations| quality(&settings(variant, radius).iterations(iterations));
    let paper = of(WlopVariant::Paper, 0.4, 35);
    assert!(paper.0 < 0.0009 && paper.1 > 0.1, "{paper:?}");
    let cgal = of(WlopVariant::Cgal, 0.1, 35);
    assert!(cgal.0 > 0.001 && cgal.1 < 0.08, "{cgal:?}");
    let authors = of(WlopVariant::Authors, 0.2, 35);
    assert!(authors.0 < 0.002, "{authors:?}");
}
