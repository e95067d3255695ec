//! Outliers and duplicates on the CPU against their definitions.

use libtest_mimic::Trial;
use nearfield::Scalar;
use nearfield::application::{
    Duplicates, OutlierRule, RadiusOutlierSettings, StatisticalOutlierSettings, Watch, duplicates, radius_outliers,
    statistical_outliers,
};

use crate::clouds::{
    ABOVE_BLOCK, Points, STEP, balls, can_be_interrupted, clouds, dist2, is_refused, of, same_for_any_threads,
    with_invalid,
};
use crate::support::trial;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("statistical_outliers_are_those_of_the_rule_in_f32", statistical::<f32>),
        trial("statistical_outliers_are_those_of_the_rule_in_f64", statistical::<f64>),
        trial("the_two_rules_differ_where_points_coincide", rules_differ),
        trial("radius_outliers_have_too_few_others_within_the_closed_ball", radius),
        trial("duplicates_are_those_of_the_loop_in_f32", loop_over_duplicates::<f32>),
        trial("duplicates_are_those_of_the_loop_in_f64", loop_over_duplicates::<f64>),
        trial("invalid_points_are_no_outliers_of_others", invalid_points),
        trial("filters_refuse_what_makes_no_sense", refusals),
        trial("filters_are_the_same_for_any_number_of_threads", any_threads),
        trial("filters_can_be_interrupted", interrupted),
    ]
}

pub(crate) const TOLERANCES: [f64; 4] = [0.0, STEP, 3.0 * STEP, 0.4];

/// Mean distances, mean, deviation, and who stays, from all sorted distances.
fn by_sorting(points: &Points, k: usize, ratio: f64, rule: OutlierRule) -> (Vec<f64>, f64, f64, Vec<bool>) {
    let mean_of = |i: usize| {
        let mut all: Vec<f64> = points.iter().map(|&other| dist2(points[i], other).sqrt()).collect();
        all.sort_by(f64::total_cmp);
        // The point itself is the first.
        let taken = match rule {
            OutlierRule::Pcl => &all[1..all.len().min(k + 1)],
            OutlierRule::Open3d => &all[..all.len().min(k)],
        };
        if taken.is_empty() { 0.0 } else { taken.iter().sum::<f64>() / taken.len() as f64 }
    };
    let means: Vec<f64> = (0..points.len()).map(mean_of).collect();
    let n = points.len() as f64;
    let summed: Vec<f64> = means.iter().copied().filter(|&d| rule == OutlierRule::Pcl || d > 0.0).collect();
    let mean = if n > 0.0 { summed.iter().sum::<f64>() / n } else { 0.0 };
    let squares: f64 = summed.iter().map(|d| (d - mean) * (d - mean)).sum();
    let deviation = if n > 1.0 { (squares / (n - 1.0)).sqrt() } else { 0.0 };
    let limit = mean + ratio * deviation;
    let kept = means.iter().map(|&d| match rule {
        OutlierRule::Pcl => d <= limit,
        OutlierRule::Open3d => d > 0.0 && d < limit,
    });
    let kept = kept.collect();
    (means, mean, deviation, kept)
}

fn statistical<T: Scalar>() {
    for (name, points) in clouds() {
        for (k, ratio) in [(1, 0.5), (8, 1.0), (20, 2.0), (5000, 0.1)] {
            for rule in [OutlierRule::Pcl, OutlierRule::Open3d] {
                let case = format!("{name}, {k} nearest, {ratio}, {rule:?}");
                let settings = StatisticalOutlierSettings::new(k, ratio).rule(rule);
                let found = statistical_outliers(&of::<T>(&points), &settings, &mut Watch::none()).unwrap();
                let (means, mean, deviation, kept) = by_sorting(&points, k as usize, ratio, rule);
                // Squared distances are exact; roots, their sum and the mean are rounded once each in T or f64.
                let close = |a: f64, b: f64| (a - b).abs() <= 4.0 * T::EPSILON.to_f64() * (a.abs() + b.abs()) + 1e-13;
                assert!(close(found.mean, mean), "{case}: {} {mean}", found.mean);
                assert!((found.deviation - deviation).abs() <= 1e-6 * (mean + deviation), "{case}");
                for (i, expected) in means.iter().enumerate() {
                    assert!(close(found.mean_distances[i].to_f64(), *expected), "{case}: point {i}");
                    // At the limit itself rounding decides.
                    let is_near = (expected - found.limit).abs() <= 1e-6 * (mean + deviation);
                    assert!(is_near || found.kept[i] == kept[i], "{case}: point {i}");
                }
                let indices: Vec<u32> = (0..points.len() as u32).filter(|&i| found.kept[i as usize]).collect();
                assert_eq!(found.kept_indices(), indices);
            }
        }
    }
}

fn rules_differ() {
    let points = of::<f64>(&vec![[1.0, 2.0, 3.0]; 40]);
    let kept = |rule| {
        let settings = StatisticalOutlierSettings::new(5, 1.0).rule(rule);
        statistical_outliers(&points, &settings, &mut Watch::none()).unwrap().kept_indices().len()
    };
    assert_eq!((kept(OutlierRule::Pcl), kept(OutlierRule::Open3d)), (40, 0));
}

fn radius() {
    for (name, points) in clouds() {
        for (radius, least) in [(STEP, 1), (4.0 * STEP, 2), (16.0 * STEP, 20), (1.0, 0)] {
            let others = |i: usize| {
                let near = |j: &usize| *j != i && dist2(points[i], points[*j]) <= radius * radius;
                (0..points.len()).filter(near).count() as u32
            };
            let expected: Vec<u32> = (0..points.len()).map(others).collect();
            let settings = RadiusOutlierSettings::new(radius, least);
            let found = radius_outliers(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
            assert_eq!(found.neighbors, expected, "{name}, {settings:?}");
            assert!(found.kept.iter().zip(&expected).all(|(&kept, &n)| kept == (n >= least)), "{name}, {settings:?}");
            let wide = radius_outliers(&of::<f64>(&points), &settings, &mut Watch::none()).unwrap();
            assert_eq!(wide, found, "{name}, {settings:?}");
        }
    }
}

/// Originals by the loop: in order, each stays unless one that stays is near.
fn by_loop(points: &Points, tolerance: f64) -> Vec<u32> {
    let mut stay: Vec<usize> = Vec::new();
    let mut originals = Vec::new();
    for (i, &point) in points.iter().enumerate() {
        match stay.iter().find(|&&s| dist2(points[s], point) <= tolerance * tolerance) {
            Some(&original) => originals.push(original as u32),
            None => {
                stay.push(i);
                originals.push(i as u32);
            }
        }
    }
    originals
}

fn loop_over_duplicates<T: Scalar>() {
    for (name, points) in clouds() {
        for tolerance in TOLERANCES {
            let found = duplicates(&of::<T>(&points), tolerance, &mut Watch::none()).unwrap();
            let expected = by_loop(&points, tolerance);
            assert_eq!(found.originals, expected, "{name}, {tolerance}");
            let stays = |(i, &original): (usize, &u32)| original as usize == i;
            assert!(found.kept.iter().copied().eq(expected.iter().enumerate().map(stays)), "{name}, {tolerance}");
        }
    }
    let zeros = [[0.0, 1.0, 0.0], [-0.0, 1.0, 0.0]].map(|p| p.map(T::of));
    assert_eq!(duplicates(&zeros, 0.0, &mut Watch::none()).unwrap().originals, [0, 0]);
}

fn invalid_points() {
    let points = balls(500, 9);
    let (all, valid) = with_invalid(&points);
    let (all, points) = (of::<f64>(&all), of::<f64>(&points));
    let invalid: Vec<u32> = (0..all.len() as u32).filter(|&i| !valid.contains(&(i as usize))).collect();
    let at_places = |kept: &[bool]| -> Vec<bool> { valid.iter().map(|&i| kept[i]).collect() };
    let none_kept = |kept: &[bool]| invalid.iter().all(|&i| !kept[i as usize]);

    let settings = StatisticalOutlierSettings::new(10, 1.0);
    let [mixed, clean] = [&all, &points].map(|p| statistical_outliers(p, &settings, &mut Watch::none()).unwrap());
    assert_eq!((at_places(&mixed.kept), &mixed.invalid, mixed.limit), (clean.kept, &invalid, clean.limit));
    assert!(none_kept(&mixed.kept) && invalid.iter().all(|&i| mixed.mean_distances[i as usize].is_nan()));

    let settings = RadiusOutlierSettings::new(0.25, 4);
    let [mixed, clean] = [&all, &points].map(|p| radius_outliers(p, &settings, &mut Watch::none()).unwrap());
    assert_eq!((at_places(&mixed.kept), &mixed.invalid), (clean.kept, &invalid));
    assert!(none_kept(&mixed.kept));

    let [mixed, clean] = [&all, &points].map(|p| duplicates(p, 0.1, &mut Watch::none()).unwrap());
    assert_eq!((at_places(&mixed.kept), &mixed.invalid), (clean.kept, &invalid));
    assert!(none_kept(&mixed.kept) && invalid.iter().all(|&i| mixed.originals[i as usize] == Duplicates::NONE));
    let renamed: Vec<u32> = clean.originals.iter().map(|&o| valid[o as usize] as u32).collect();
    assert!(valid.iter().map(|&i| mixed.originals[i]).eq(renamed));
}

fn refusals() {
    let points = of::<f32>(&balls(50, 1));
    is_refused("k", statistical_outliers(&points, &StatisticalOutlierSettings::new(0, 1.0), &mut Watch::none()));
    let endless = StatisticalOutlierSettings::new(3, f64::NAN);
    is_refused("ratio", statistical_outliers(&points, &endless, &mut Watch::none()));
    for wrong in [-1.0, f64::NAN, f64::INFINITY, 1e-30] {
        is_refused("radius", radius_outliers(&points, &RadiusOutlierSettings::new(wrong, 1), &mut Watch::none()));
        is_refused("tolerance", duplicates(&points, wrong, &mut Watch::none()));
    }
    is_refused("radius", radius_outliers(&points, &RadiusOutlierSettings::new(0.0, 1), &mut Watch::none()));
}

fn any_threads() {
    let points = of::<f32>(&balls(3000, 13));
    let settings = StatisticalOutlierSettings::new(12, 1.0);
    same_for_any_threads("statistical", || statistical_outliers(&points, &settings, &mut Watch::none()).unwrap());
    same_for_any_threads("duplicates", || duplicates(&points, 0.1, &mut Watch::none()).unwrap());
}

fn interrupted() {
    let points = of::<f64>(&balls(ABOVE_BLOCK, 14));
    let settings = StatisticalOutlierSettings::new(4, 1.0);
    can_be_interrupted("statistical", |watch| statistical_outliers(&points, &settings, watch));
    can_be_interrupted("radius", |watch| radius_outliers(&points, &RadiusOutlierSettings::new(0.1, 1), watch));
    can_be_interrupted("duplicates", |watch| duplicates(&points, 0.1, watch));
}
