//! Clusters on the CPU against the walks that define them.

use libtest_mimic::Trial;
use nearfield::Scalar;
use nearfield::application::{Clusters, DbscanSettings, EuclideanSettings, LeftOut, Watch, dbscan, euclidean_clusters};

use crate::clouds::{
    ABOVE_BLOCK, Points, STEP, balls, can_be_interrupted, clouds, dist2, is_refused, of, same_for_any_threads,
    with_invalid,
};
use crate::support::trial;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("dbscan_is_the_walk_of_scikit_learn_in_f32", walk_of_scikit_learn::<f32>),
        trial("dbscan_is_the_walk_of_scikit_learn_in_f64", walk_of_scikit_learn::<f64>),
        trial("a_border_point_joins_the_adjacent_cluster_with_the_smallest_core", border_points),
        trial("the_ball_of_dbscan_is_closed_and_counts_the_point_itself", closed_and_own),
        trial("euclidean_clusters_are_connected_components_of_the_sizes_wanted", components),
        trial("invalid_points_are_in_no_cluster_and_told", invalid_points),
        trial("clusters_refuse_what_makes_no_sense", refusals),
        trial("clusters_are_the_same_for_any_number_of_threads", any_threads),
        trial("clustering_can_be_interrupted", interrupted),
    ]
}

/// Radii and numbers of points that make one cluster, many and none.
pub(crate) const ASKED: [(f64, u32); 6] =
    [(STEP, 2), (4.0 * STEP, 3), (8.0 * STEP, 4), (12.0 * STEP, 1), (16.0 * STEP, 12), (0.5, 2000)];

/// Labels and core points by the loop of scikit-learn: from each core point without a label on, in the order of the points, through all
/// that can be reached.
fn walk(points: &Points, eps: f64, min_points: u32) -> (Vec<i32>, Vec<bool>) {
    let near = |a: usize| (0..points.len()).filter(move |&b| dist2(points[a], points[b]) <= eps * eps);
    let is_core: Vec<bool> = (0..points.len()).map(|i| near(i).count() >= min_points as usize).collect();
    let mut labels = vec![-1; points.len()];
    let mut next = 0;
    for start in 0..points.len() {
        if labels[start] != -1 || !is_core[start] {
            continue;
        }
        let mut open = vec![start];
        while let Some(at) = open.pop() {
            if labels[at] != -1 {
                continue;
            }
            labels[at] = next;
            if is_core[at] {
                open.extend(near(at).filter(|&b| labels[b] == -1));
            }
        }
        next += 1;
    }
    (labels, is_core)
}

fn walk_of_scikit_learn<T: Scalar>() {
    for (name, points) in clouds() {
        for (eps, min_points) in ASKED {
            let case = format!("{name}, {min_points} within {eps}");
            let (labels, is_core) = walk(&points, eps, min_points);
            let found = dbscan(&of::<T>(&points), &DbscanSettings::new(eps, min_points), &mut Watch::none()).unwrap();
            assert_eq!(found.labels, labels, "{case}");
            assert_eq!(found.is_core, is_core, "{case}");
            assert_eq!(found.n_clusters as i32, labels.iter().max().map_or(0, |most| most + 1), "{case}");
            assert_eq!(found.sizes().iter().sum::<u64>() + found.unlabelled(), points.len() as u64, "{case}");
            assert!(found.invalid.is_empty());
        }
    }
}

fn border_points() {
    // Two pairs of dense ends with one point between them that is within 1 of both, but has too few near it to be a core point.
    let row = |xs: &[f64]| -> Points { xs.iter().map(|&x| [x, 0.0, 0.0]).collect() };
    let settings = DbscanSettings::new(1.0, 4);
    // The right cluster has the smallest core index, 1, and the border point stands before both.
    let points = row(&[5.0, 6.0, 4.0, 3.5, 3.25, 3.0, 6.5, 6.75, 7.0]);
    let found = dbscan(&points, &settings, &mut Watch::none()).unwrap();
    assert_eq!(found.labels, [0, 0, 1, 1, 1, 1, 0, 0, 0]);
    assert!(!found.is_core[0] && found.is_core[1] && found.is_core[2]);
    // The same with the left one first.
    let points = row(&[5.0, 4.0, 6.0, 3.5, 3.25, 3.0, 6.5, 6.75, 7.0]);
    let found = dbscan(&points, &settings, &mut Watch::none()).unwrap();
    assert_eq!(found.labels, [0, 0, 1, 0, 0, 0, 1, 1, 1]);
}

fn closed_and_own() {
    let points = [[0.0f32, 0.0, 0.0], [0.5, 0.0, 0.0], [1.25, 0.0, 0.0]];
    let labels =
        |eps, min_points| dbscan(&points, &DbscanSettings::new(eps, min_points), &mut Watch::none()).unwrap().labels;
    assert_eq!(labels(0.5, 2), [0, 0, -1]);
    assert_eq!(labels(0.4999, 2), [-1, -1, -1]);
    assert_eq!(labels(0.5, 1), [0, 0, 1]);
    assert_eq!(labels(0.75, 3), [0, 0, 0]);
}

fn components() {
    for (name, points) in clouds() {
        for (radius, min_size, max_size) in
            [(4.0 * STEP, 1, u64::MAX), (8.0 * STEP, 3, 40), (12.0 * STEP, 2, 100), (0.5, 2000, 3000)]
        {
            // With one point enough, all are core points.
            let (all, _) = walk(&points, radius, 1);
            let size = |label: i32| all.iter().filter(|&&other| other == label).count() as u64;
            let n_all = all.iter().max().map_or(0, |most| most + 1);
            let kept: Vec<i32> = (0..n_all).filter(|&c| (min_size..=max_size).contains(&size(c))).collect();
            let renamed = |label: &i32| kept.iter().position(|k| k == label).map_or(-1, |new| new as i32);
            let expected: Vec<i32> = all.iter().map(renamed).collect();
            let left_out = |is: &dyn Fn(u64) -> bool| {
                let sizes: Vec<u64> = (0..n_all).map(size).filter(|&s| is(s)).collect();
                LeftOut { clusters: sizes.len() as u64, points: sizes.iter().sum() }
            };
            let settings = EuclideanSettings { radius, min_size, max_size };
            let found = euclidean_clusters(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
            assert_eq!(found.labels, expected, "{name}, {settings:?}");
            assert_eq!(found.n_clusters as usize, kept.len(), "{name}, {settings:?}");
            assert_eq!(found.too_small, left_out(&|s| s < min_size), "{name}, {settings:?}");
            assert_eq!(found.too_large, left_out(&|s| s > max_size), "{name}, {settings:?}");
        }
    }
}

/// Answers for a cloud with invalid points are those for the others, at their places.
pub(crate) fn is_spread(all: &Clusters, others: &Clusters, valid: &[usize]) {
    let at_places: Vec<i32> = valid.iter().map(|&i| all.labels[i]).collect();
    let cores: Vec<bool> = valid.iter().map(|&i| all.is_core[i]).collect();
    assert_eq!((&at_places, &cores, all.n_clusters), (&others.labels, &others.is_core, others.n_clusters));
    let invalid: Vec<u32> = (0..all.labels.len()).filter(|i| !valid.contains(i)).map(|i| i as u32).collect();
    assert_eq!(all.invalid, invalid);
    assert!(invalid.iter().all(|&i| all.labels[i as usize] == Clusters::NONE && !all.is_core[i as usize]));
}

fn invalid_points() {
    let points = balls(600, 8);
    let (all, valid) = with_invalid(&points);
    let settings = DbscanSettings::new(8.0 * STEP, 4);
    let cluster = |points: &Points| dbscan(&of::<f32>(points), &settings, &mut Watch::none()).unwrap();
    is_spread(&cluster(&all), &cluster(&points), &valid);
    let nowhere = vec![[f64::NAN; 3]; 3];
    let found = cluster(&nowhere);
    assert_eq!((found.labels, found.invalid, found.n_clusters), (vec![-1; 3], vec![0, 1, 2], 0));
}

fn refusals() {
    let points = of::<f32>(&balls(50, 1));
    for eps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        is_refused("eps", dbscan(&points, &DbscanSettings::new(eps, 3), &mut Watch::none()));
        is_refused("radius", euclidean_clusters(&points, &EuclideanSettings::new(eps), &mut Watch::none()));
    }
    is_refused("min_points", dbscan(&points, &DbscanSettings::new(1.0, 0), &mut Watch::none()));
    let sizes = |min_size, max_size| EuclideanSettings { radius: 1.0, min_size, max_size };
    is_refused("min_size", euclidean_clusters(&points, &sizes(0, 5), &mut Watch::none()));
    is_refused("max_size", euclidean_clusters(&points, &sizes(6, 5), &mut Watch::none()));
}

fn any_threads() {
    let points = of::<f32>(&balls(4000, 11));
    for (eps, min_points) in [(6.0 * STEP, 3), (16.0 * STEP, 8)] {
        same_for_any_threads("dbscan", || {
            let found = dbscan(&points, &DbscanSettings::new(eps, min_points), &mut Watch::none()).unwrap();
            (found.labels, found.is_core)
        });
    }
}

fn interrupted() {
    let points = of::<f64>(&balls(ABOVE_BLOCK, 12));
    can_be_interrupted("dbscan", |watch| dbscan(&points, &DbscanSettings::new(0.25, 3), watch));
    can_be_interrupted("euclidean", |watch| euclidean_clusters(&points, &EuclideanSettings::new(0.25), watch));
}
