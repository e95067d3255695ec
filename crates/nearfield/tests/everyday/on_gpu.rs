//! The device against the CPU: the same labels and masks to the last one, since the clouds have exact distances.

use std::ops::ControlFlow;

use libtest_mimic::Trial;
use nearfield::application::{
    Clusters, DbscanSettings, EuclideanSettings, FarthestPoints, FarthestStart, GpuClusters, OutlierRule, Progress,
    RadiusOutlierSettings, StatisticalOutlierSettings, VoxelOrigin, VoxelPoint, VoxelSettings, Watch, dbscan,
    dbscan_on_gpu, duplicates, duplicates_on_gpu, euclidean_clusters, euclidean_clusters_on_gpu, farthest_points,
    farthest_points_on_gpu, radius_outliers, radius_outliers_on_gpu, statistical_outliers, statistical_outliers_on_gpu,
    voxel_downsample, voxel_downsample_on_gpu,
};
use nearfield::gpu::Gpu;
use nearfield::structure::GpuStructure;
use nearfield::{
    AabbTreeSettings, Error, GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuUniformGrid, GridSettings, OctreeSettings,
    TreeSearch, Vec3,
};

use crate::clouds::{
    ABOVE_BLOCK, Points, STEP, balls, can_be_interrupted, clouds, even, falling_row, is_refused, of, shuffled_row,
    with_invalid,
};
use crate::clusters::{ASKED, is_spread};
use crate::outliers::TOLERANCES;
use crate::support::{Random, gpu_trial, own_context, refuse_each};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("dbscan_on_the_device_is_that_of_the_cpu", dbscan_is_the_same),
        gpu_trial("long_chains_are_one_cluster_on_the_device", long_chains),
        gpu_trial("every_structure_gives_the_same_clusters", every_structure),
        gpu_trial("euclidean_clusters_on_the_device_are_those_of_the_cpu", euclidean_is_the_same),
        gpu_trial("invalid_points_are_told_by_the_device", invalid_points),
        gpu_trial("statistical_outliers_on_the_device_are_those_of_the_cpu", statistical_is_the_same),
        gpu_trial("radius_outliers_on_the_device_are_those_of_the_cpu", radius_is_the_same),
        gpu_trial("duplicates_on_the_device_are_those_of_the_cpu", duplicates_are_the_same),
        gpu_trial("voxels_on_the_device_are_those_of_the_cpu", voxels_are_the_same),
        gpu_trial("cells_too_full_for_the_device_are_refused", full_cells),
        gpu_trial("farthest_points_on_the_device_are_those_of_the_cpu", farthest_points_are_the_same),
        gpu_trial("farthest_points_on_the_device_are_taken_in_submissions", farthest_in_submissions),
        gpu_trial("farthest_points_keep_no_memory_that_is_refused", farthest_without_memory),
        gpu_trial("the_device_refuses_what_makes_no_sense", refusals),
    ]
}

fn vectors(points: &Points) -> Vec<Vec3> {
    of::<f32>(points).into_iter().map(Vec3::from_array).collect()
}

fn assert_same(case: &str, here: &Clusters, there: &Clusters) {
    assert_eq!(here.labels, there.labels, "{case}");
    assert_eq!(here.is_core, there.is_core, "{case}");
    assert_eq!((here.n_clusters, &here.invalid), (there.n_clusters, &there.invalid), "{case}");
    assert_eq!((here.too_small, here.too_large), (there.too_small, there.too_large), "{case}");
}

fn dbscan_is_the_same(gpu: &Gpu) {
    for (name, points) in clouds().into_iter().chain([("many", even(9000, 4.0, 41))]) {
        for (eps, min_points) in ASKED {
            let settings = DbscanSettings::new(eps, min_points);
            let here = dbscan(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
            let there = dbscan_on_gpu(gpu, &vectors(&points), &settings, &mut Watch::none()).unwrap();
            assert_same(&format!("{name}, {settings:?}"), &here, &there);
        }
    }
}

fn long_chains(gpu: &Gpu) {
    let mut spiral = falling_row(3000);
    spiral.iter_mut().enumerate().for_each(|(i, p)| p[1] = (i % 2) as f64 * STEP);
    for (name, points) in [("falling", falling_row(10_000)), ("shuffled", shuffled_row(10_000, 42)), ("zigzag", spiral)]
    {
        for min_points in [1, 2, 3] {
            let settings = DbscanSettings::new(1.5 * STEP, min_points);
            let there = dbscan_on_gpu(gpu, &vectors(&points), &settings, &mut Watch::none()).unwrap();
            assert!(there.labels.iter().all(|&label| label == 0), "{name}, {min_points}: {}", there.n_clusters);
        }
    }
}

fn every_structure(gpu: &Gpu) {
    let points = balls(2500, 43);
    let (radius, min_points) = (8.0 * STEP, 4);
    let settings = DbscanSettings::new(radius, min_points);
    let here = dbscan(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
    assert!(here.n_clusters > 3 && here.unlabelled() > 10, "{} clusters", here.n_clusters);
    fn check<S: GpuStructure>(structure: &S, radius: f64, min_points: u32, here: &Clusters) {
        let there = GpuClusters::of(structure, radius as f32, min_points, &mut Watch::none()).unwrap();
        let (labels, is_core) = there.read(structure.gpu()).unwrap();
        assert_eq!(labels, here.labels, "{}", S::NAME);
        assert_eq!((is_core, there.n_clusters), (here.is_core.clone(), here.n_clusters), "{}", S::NAME);
    }
    let points = vectors(&points);
    for cell in [0.5, 1.0, 3.0] {
        let settings = GridSettings::for_radius((cell * radius) as f32);
        check(&GpuUniformGrid::build(gpu, &points, &settings).unwrap(), radius, min_points, &here);
    }
    check(&GpuBruteForce::build(gpu, &points).unwrap(), radius, min_points, &here);
    check(&GpuLinearOctree::build(gpu, &points, &OctreeSettings::default()).unwrap(), radius, min_points, &here);
    for search in TreeSearch::ALL {
        let settings = AabbTreeSettings::DEFAULT.search(search);
        check(&GpuAabbTree::build(gpu, &points, &settings).unwrap(), radius, min_points, &here);
    }
}

fn euclidean_is_the_same(gpu: &Gpu) {
    for (name, points) in clouds() {
        for (radius, min_size, max_size) in [(4.0 * STEP, 1, u64::MAX), (8.0 * STEP, 3, 40), (0.5, 2000, 3000)] {
            let settings = EuclideanSettings { radius, min_size, max_size };
            let here = euclidean_clusters(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
            let there = euclidean_clusters_on_gpu(gpu, &vectors(&points), &settings, &mut Watch::none()).unwrap();
            assert_same(&format!("{name}, {settings:?}"), &here, &there);
        }
    }
}

fn invalid_points(gpu: &Gpu) {
    let points = balls(600, 44);
    let (all, valid) = with_invalid(&points);
    let settings = DbscanSettings::new(8.0 * STEP, 4);
    let cluster = |points: &Points| dbscan_on_gpu(gpu, &vectors(points), &settings, &mut Watch::none()).unwrap();
    is_spread(&cluster(&all), &cluster(&points), &valid);
    let found = cluster(&vec![[f64::NAN; 3]; 3]);
    assert_eq!((found.labels, found.invalid), (vec![-1; 3], vec![0, 1, 2]));
    let settings = RadiusOutlierSettings::new(0.25, 4);
    let here = radius_outliers(&of::<f32>(&all), &settings, &mut Watch::none()).unwrap();
    assert_eq!(radius_outliers_on_gpu(gpu, &vectors(&all), &settings, &mut Watch::none()).unwrap(), here);
    let here = duplicates(&of::<f32>(&all), 0.125, &mut Watch::none()).unwrap();
    assert_eq!(duplicates_on_gpu(gpu, &vectors(&all), 0.125, &mut Watch::none()).unwrap(), here);
}

fn statistical_is_the_same(gpu: &Gpu) {
    let (all, _) = with_invalid(&balls(500, 45));
    for (name, points) in clouds().into_iter().chain([("invalid", all)]) {
        for (k, ratio) in [(1, 0.5), (8, 1.0), (20, 2.0)] {
            for rule in [OutlierRule::Pcl, OutlierRule::Open3d] {
                let case = format!("{name}, {k} nearest, {ratio}, {rule:?}");
                let settings = StatisticalOutlierSettings::new(k, ratio).rule(rule);
                let here = statistical_outliers(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
                let there = statistical_outliers_on_gpu(gpu, &vectors(&points), &settings, &mut Watch::none()).unwrap();
                assert_eq!(here.invalid, there.invalid, "{case}");
                // A root, and k sums of f32: k + 3 roundings, of which a device's root may be of 3 ulp.
                let slack = f32::EPSILON * (k + 6) as f32;
                let close = |a: f32, b: f32| a == b || (a - b).abs() <= slack * a || (a.is_nan() && b.is_nan());
                let means = here.mean_distances.iter().zip(&there.mean_distances);
                assert!(means.clone().all(|(&a, &b)| close(a, b)), "{case}");
                assert!((here.limit - there.limit).abs() <= f64::from(slack) * 4.0 * here.limit, "{case}");
                for (i, (&a, _)) in means.enumerate() {
                    // At the limit itself rounding decides.
                    let is_near = (f64::from(a) - here.limit).abs() <= f64::from(slack) * 8.0 * here.limit;
                    assert!(is_near || here.kept[i] == there.kept[i], "{case}: point {i}");
                }
            }
        }
    }
}

fn radius_is_the_same(gpu: &Gpu) {
    for (name, points) in clouds() {
        for (radius, least) in [(STEP, 1), (4.0 * STEP, 2), (16.0 * STEP, 20)] {
            let settings = RadiusOutlierSettings::new(radius, least);
            let here = radius_outliers(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
            let there = radius_outliers_on_gpu(gpu, &vectors(&points), &settings, &mut Watch::none()).unwrap();
            assert_eq!(here, there, "{name}, {settings:?}");
        }
    }
}

fn duplicates_are_the_same(gpu: &Gpu) {
    for (name, points) in clouds() {
        for tolerance in TOLERANCES {
            let here = duplicates(&of::<f32>(&points), tolerance, &mut Watch::none()).unwrap();
            let there = duplicates_on_gpu(gpu, &vectors(&points), tolerance, &mut Watch::none()).unwrap();
            assert_eq!(here, there, "{name}, {tolerance}");
        }
    }
}

fn voxels_are_the_same(gpu: &Gpu) {
    let (all, _) = with_invalid(&balls(500, 46));
    for (name, points) in clouds().into_iter().chain([("invalid", all), ("many", even(9000, 4.0, 47))]) {
        for (size, origin) in [
            (STEP, VoxelOrigin::Corner),
            (0.25, VoxelOrigin::BelowCorner),
            (0.7, VoxelOrigin::At([0.0; 3])),
            (100.0, VoxelOrigin::Corner),
        ] {
            for point in [VoxelPoint::Centroid, VoxelPoint::Nearest, VoxelPoint::First] {
                let settings = VoxelSettings { size, origin, point };
                let case = format!("{name}, {settings:?}");
                let here = voxel_downsample(&of::<f32>(&points), &settings, &mut Watch::none()).unwrap();
                let there = voxel_downsample_on_gpu(gpu, &vectors(&points), &settings, &mut Watch::none()).unwrap();
                assert_eq!((&here.cells, &here.counts, &here.invalid), (&there.cells, &there.counts, &there.invalid));
                assert_eq!(here.points.len(), there.points.len(), "{case}");
                let centroids = VoxelSettings { point: VoxelPoint::Centroid, ..settings };
                let means = voxel_downsample(&of::<f32>(&points), &centroids, &mut Watch::none()).unwrap();
                // Sums of up to n offsets within a cell, or within the cloud where it is smaller.
                let slack = 1e-5 * size.min(16.0) as f32;
                for cell in 0..here.points.len() {
                    let at = |i: u32| Vec3::from_array(points[i as usize].map(|x| x as f32));
                    let (mean, found) = (Vec3::from_array(here.points[cell]), Vec3::from_array(there.points[cell]));
                    let stand = [here.representatives[cell], there.representatives[cell]];
                    match point {
                        VoxelPoint::Centroid => {
                            assert!(mean.distance(found) <= slack, "{case}: {mean} {found}");
                            let far = stand.map(|i| at(i).distance(mean));
                            assert!((far[0] - far[1]).abs() <= slack, "{case}: {far:?}");
                        }
                        VoxelPoint::Nearest => {
                            assert_eq!(found, at(stand[1]), "{case}");
                            assert_eq!(here.cells[stand[1] as usize] as usize, cell, "{case}");
                            // Of nearly equals it may be another.
                            let far = stand.map(|i| at(i).distance(Vec3::from_array(means.points[cell])));
                            assert!((far[0] - far[1]).abs() <= slack, "{case}: {far:?}");
                        }
                        VoxelPoint::First => assert_eq!((found, stand[0]), (mean, stand[1]), "{case}"),
                    }
                }
            }
        }
    }
}

fn full_cells(gpu: &Gpu) {
    let Some(limit) = gpu.limits().loop_rounds else { return };
    let points = vec![Vec3::ONE; limit as usize / 2];
    let full = voxel_downsample_on_gpu(gpu, &points, &VoxelSettings::new(1.0), &mut Watch::none());
    assert!(matches!(full, Err(Error::Unsupported { .. })), "{full:?}");
    let fits = &points[..points.len() - 1];
    let found = voxel_downsample_on_gpu(gpu, fits, &VoxelSettings::new(1.0), &mut Watch::none()).unwrap();
    assert_eq!((found.points, found.counts), (vec![[1.0; 3]], vec![fits.len() as u32]));
}

/// Indices and invalid points, and the bits of the distances.
fn bits_of(found: &FarthestPoints<f32>) -> (&[u32], &[u32], Vec<u32>) {
    (&found.indices, &found.invalid, found.distances.iter().map(|d| d.to_bits()).collect())
}

fn farthest_points_are_the_same(gpu: &Gpu) {
    let (mixed, _) = with_invalid(&balls(500, 48));
    // Coordinates with all their bits: distances are rounded, and a product that is fused with a sum would show.
    let mut random = Random(49);
    let rough: Points = (0..3000).map(|_| [(); 3].map(|()| f64::from(random.unit() * random.unit()))).collect();
    let large = rough.iter().map(|p| p.map(|x| x * 1e18)).collect();
    for (name, points) in clouds().into_iter().chain([("invalid", mixed), ("rough", rough), ("large", large)]) {
        let n = points.iter().filter(|p| p.iter().all(|x| x.is_finite())).count();
        let (arrays, vectors) = (of::<f32>(&points), vectors(&points));
        for start in [FarthestStart::Index(points.len() as u32 / 2), FarthestStart::Seed(7)] {
            for count in [0, 1, 2, 300, n] {
                let case = format!("{name}, {count} of {n} from {start:?}");
                let here = farthest_points(&arrays, count, start, &mut Watch::none());
                let there = farthest_points_on_gpu(gpu, &vectors, count, start, &mut Watch::none());
                match (here, there) {
                    (Ok(here), Ok(there)) => assert_eq!(bits_of(&here), bits_of(&there), "{case}"),
                    (Err(here), Err(there)) => assert_eq!(here.to_string(), there.to_string(), "{case}"),
                    (here, there) => panic!("{case}: {here:?} and {there:?}"),
                }
            }
        }
    }
}

/// More points than one part, and more samples than one submission.
fn farthest_in_submissions(gpu: &Gpu) {
    let points = even(5000, 4.0, 50);
    let start = FarthestStart::Index(4999);
    let here = farthest_points(&of::<f32>(&points), 2000, start, &mut Watch::none()).unwrap();
    let mut told = Vec::new();
    let mut tell = |progress: Progress| {
        told.push((progress.done, progress.total));
        ControlFlow::Continue(())
    };
    let there = farthest_points_on_gpu(gpu, &vectors(&points), 2000, start, &mut Watch::new(&mut tell)).unwrap();
    assert_eq!(bits_of(&here), bits_of(&there));
    assert!(told.len() > 3 && told[0] == (0, 2000) && told[told.len() - 1] == (2000, 2000), "{told:?}");
    assert!(told.windows(2).all(|pair| pair[0].0 < pair[1].0), "{told:?}");
    can_be_interrupted("farthest points", |watch| farthest_points_on_gpu(gpu, &vectors(&points), 2000, start, watch));
}

fn farthest_without_memory(gpu: &Gpu) {
    let points = vectors(&even(3000, 4.0, 51));
    let take = |gpu: &Gpu| farthest_points_on_gpu(gpu, &points, 20, FarthestStart::Index(0), &mut Watch::none());
    let right = take(gpu).unwrap();
    let own = own_context(gpu);
    refuse_each(&own, "farthest points", || take(&own), |found| *found == right);
}

fn refusals(gpu: &Gpu) {
    let points = vectors(&balls(50, 1));
    for eps in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        is_refused("eps", dbscan_on_gpu(gpu, &points, &DbscanSettings::new(eps, 3), &mut Watch::none()));
        let settings = EuclideanSettings::new(eps);
        is_refused("radius", euclidean_clusters_on_gpu(gpu, &points, &settings, &mut Watch::none()));
    }
    let none = StatisticalOutlierSettings::new(0, 1.0);
    is_refused("k", statistical_outliers_on_gpu(gpu, &points, &none, &mut Watch::none()));
    is_refused("size of a voxel", voxel_downsample_on_gpu(gpu, &points, &VoxelSettings::new(0.0), &mut Watch::none()));
    is_refused("size of a voxel", voxel_downsample_on_gpu(gpu, &points, &VoxelSettings::new(1e-9), &mut Watch::none()));
    is_refused("tolerance", duplicates_on_gpu(gpu, &points, -1.0, &mut Watch::none()));
    let farthest = |count, start| farthest_points_on_gpu(gpu, &points, count, start, &mut Watch::none());
    is_refused("number of samples", farthest(51, FarthestStart::Seed(1)));
    is_refused("first sample", farthest(2, FarthestStart::Index(50)));
    let beyond = farthest_points_on_gpu(gpu, &[Vec3::splat(2e18)], 1, FarthestStart::Index(0), &mut Watch::none());
    assert!(matches!(beyond, Err(Error::CoordinateTooLarge { .. })), "{beyond:?}");
    can_be_interrupted("dbscan", |watch| dbscan_on_gpu(gpu, &points, &DbscanSettings::new(0.5, 3), watch));
    // Who stays goes on from point to point along the row: no pass decides all.
    let row = vectors(&falling_row(ABOVE_BLOCK));
    can_be_interrupted("duplicates", |watch| duplicates_on_gpu(gpu, &row, STEP, watch));
}
