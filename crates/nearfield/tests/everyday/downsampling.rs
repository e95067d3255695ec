//! Fewer points, against loops over all pairs and published figures.

use std::collections::BTreeMap;

use libtest_mimic::Trial;
use nearfield::Scalar;
use nearfield::application::{
    Extent, FarthestStart, PoissonDiskSettings, VoxelOrigin, VoxelPoint, VoxelSettings, Voxels, Watch, farthest_points,
    poisson_disk, voxel_downsample,
};

use crate::clouds::{
    ABOVE_BLOCK, Points, STEP, balls, can_be_interrupted, clouds, dist2, even, is_refused, of, same_for_any_threads,
    with_invalid,
};
use crate::support::{Random, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("voxels_are_those_of_a_table_of_cells_in_f32", table_of_cells::<f32>),
        trial("voxels_are_those_of_a_table_of_cells_in_f64", table_of_cells::<f64>),
        trial("grids_that_are_too_fine_are_refused", too_fine),
        trial("elimination_is_that_of_the_loop", elimination),
        trial("poisson_disks_are_as_even_as_published", evenness),
        trial("poisson_disks_are_as_many_as_asked_for", exact_counts),
        trial("farthest_points_are_those_of_the_loop_in_f32", loop_over_farthest::<f32>),
        trial("farthest_points_are_those_of_the_loop_in_f64", loop_over_farthest::<f64>),
        trial("seeds_choose_the_first_sample", seeds),
        trial("invalid_points_are_never_taken", invalid_points),
        trial("downsampling_refuses_what_makes_no_sense", refusals),
        trial("downsampling_is_the_same_for_any_number_of_threads", any_threads),
        trial("downsampling_can_be_interrupted", interrupted),
    ]
}

fn table_of_cells<T: Scalar>() {
    for (name, points) in clouds() {
        for size in [STEP, 0.25, 0.7, 100.0] {
            for origin in [VoxelOrigin::Corner, VoxelOrigin::BelowCorner, VoxelOrigin::At([0.0; 3])] {
                let corner = [0, 1, 2].map(|axis| points.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min));
                let start = match origin {
                    VoxelOrigin::Corner => corner,
                    VoxelOrigin::BelowCorner => corner.map(|low| low - size * 0.5),
                    VoxelOrigin::At(place) => place,
                };
                let mut table: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
                for (i, p) in points.iter().enumerate() {
                    let cell = [0, 1, 2].map(|axis| ((p[axis] - start[axis]) / size).floor() as i64);
                    table.entry(cell).or_default().push(i);
                }
                let mut cells: Vec<Vec<usize>> = table.into_values().collect();
                cells.sort_by_key(|cell| cell[0]);
                for point in [VoxelPoint::Centroid, VoxelPoint::Nearest, VoxelPoint::First] {
                    let settings = VoxelSettings { size, origin, point };
                    let found = voxel_downsample(&of::<T>(&points), &settings, &mut Watch::none()).unwrap();
                    check_cells(&format!("{name}, {settings:?}"), &points, &cells, &found, point);
                }
            }
        }
    }
}

fn check_cells<T: Scalar>(case: &str, points: &Points, cells: &[Vec<usize>], found: &Voxels<T>, point: VoxelPoint) {
    assert_eq!(found.points.len(), cells.len(), "{case}");
    for (i, cell) in cells.iter().enumerate() {
        assert_eq!(found.counts[i] as usize, cell.len(), "{case}");
        assert!(cell.iter().all(|&p| found.cells[p] as usize == i), "{case}");
        let sum = |axis: usize| cell.iter().map(|&p| points[p][axis]).sum::<f64>();
        let mean = [0, 1, 2].map(|axis| sum(axis) / cell.len() as f64);
        let stands = found.representatives[i] as usize;
        if point == VoxelPoint::First {
            assert_eq!(stands, cell[0], "{case}");
        } else {
            let nearest = cell.iter().map(|&p| dist2(points[p], mean)).fold(f64::INFINITY, f64::min);
            assert_eq!(dist2(points[stands], mean), nearest, "{case}");
        }
        let expected = if point == VoxelPoint::Centroid { mean } else { points[stands] };
        // Sums of multiples of 1/64 are exact, so the mean is rounded once to f64 and once to T.
        assert_eq!(found.points[i], expected.map(T::of), "{case}");
    }
}

fn too_fine() {
    let points = [[0.0f64, 0.0, 0.0], [1.0, 4.0, 0.0]];
    let finest = 4.0 / f64::from((1u32 << 21) - 1);
    assert_eq!(voxel_downsample(&points, &VoxelSettings::new(finest), &mut Watch::none()).unwrap().points.len(), 2);
    let error = voxel_downsample(&points, &VoxelSettings::new(finest * 0.999), &mut Watch::none()).unwrap_err();
    assert!(error.to_string().contains("cells along y"), "{error}");
}

/// Elimination with all weights summed anew each time.
fn eliminated(points: &Points, count: usize, area: f64) -> Vec<u32> {
    let n = points.len();
    let r_max = (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt();
    let r_min = r_max * (1.0 - (count as f64 / n as f64).powf(1.5)) * 0.65;
    let weight = |a: usize, b: usize| {
        let d = dist2(points[a], points[b]).sqrt();
        if d > 2.0 * r_max { 0.0 } else { (1.0 - d.max(2.0 * r_min) / (2.0 * r_max)).powf(8.0) }
    };
    let mut left: Vec<usize> = (0..n).collect();
    while left.len() > count {
        let load = |&a: &usize| left.iter().filter(|&&b| b != a).map(|&b| weight(a, b)).sum::<f64>();
        let loads: Vec<f64> = left.iter().map(load).collect();
        let heaviest = (0..left.len()).max_by(|&a, &b| loads[a].total_cmp(&loads[b])).unwrap();
        left.remove(heaviest);
    }
    left.into_iter().map(|i| i as u32).collect()
}

fn in_square(n: usize, seed: u64) -> Points {
    let mut random = Random(seed);
    (0..n).map(|_| [f64::from(random.unit()), f64::from(random.unit()), 0.5]).collect()
}

fn elimination() {
    let points = in_square(220, 21);
    for count in [20, 60, 150] {
        let settings = PoissonDiskSettings { count, extent: Extent::Area(1.0) };
        let found = poisson_disk(&points, &settings, &mut Watch::none()).unwrap();
        assert_eq!(found.indices, eliminated(&points, count, 1.0), "{count}");
    }
}

fn smallest_distance(points: &Points, indices: &[u32]) -> f64 {
    let at = |i: &u32| points[*i as usize];
    let nearest =
        |(i, a): (usize, &u32)| indices[..i].iter().map(|b| dist2(at(a), at(b))).fold(f64::INFINITY, f64::min);
    indices.iter().enumerate().map(nearest).fold(f64::INFINITY, f64::min).sqrt()
}

fn evenness() {
    // Yuksel2015: with five and more input points a sample the smallest distance comes to some 0.7 of that of the densest packing;
    // the border, where samples have no neighbours outside, lowers it a little.
    let points = in_square(6000, 22);
    let given = PoissonDiskSettings { count: 600, extent: Extent::Area(1.0) };
    for settings in [given, PoissonDiskSettings::new(600)] {
        let found = poisson_disk(&points, &settings, &mut Watch::none()).unwrap();
        let ratio = smallest_distance(&points, &found.indices) / (2.0 * found.radius);
        assert!(ratio > 0.65 && ratio <= 1.0, "{ratio} with {settings:?}");
        let random = smallest_distance(&points, &(0..600).collect::<Vec<u32>>());
        assert!(random < 0.2 * 2.0 * found.radius, "{random}");
    }
}

fn exact_counts() {
    for (name, points) in clouds() {
        for count in [0, 1, points.len() / 3, points.len()] {
            if count > points.len() {
                continue;
            }
            for extent in [Extent::Area(2.0), Extent::Volume(3.0), Extent::Solid] {
                let settings = PoissonDiskSettings { count, extent };
                let found = match poisson_disk(&of::<f32>(&points), &settings, &mut Watch::none()) {
                    // Where all points coincide nothing can be estimated.
                    Err(_) if name == "one place" && extent == Extent::Solid && count > 0 => continue,
                    found => found.unwrap(),
                };
                assert_eq!(found.indices.len(), count, "{name}, {settings:?}");
                assert!(found.indices.windows(2).all(|pair| pair[0] < pair[1]), "{name}, {settings:?}");
            }
        }
    }
}

/// Farthest points by comparing all with all.
fn by_loop(points: &Points, count: usize, first: usize) -> (Vec<u32>, Vec<f64>) {
    let mut to_samples = vec![f64::INFINITY; points.len()];
    let (mut taken, mut distances) = (vec![first as u32], vec![f64::INFINITY]);
    while taken.len() < count {
        let last = *taken.last().unwrap() as usize;
        to_samples.iter_mut().zip(points).for_each(|(d2, &p)| *d2 = d2.min(dist2(p, points[last])));
        let free = (0..points.len()).filter(|&i| !taken.contains(&(i as u32)));
        let next = free.fold(None, |best: Option<usize>, i| match best {
            Some(b) if to_samples[b] >= to_samples[i] => Some(b),
            _ => Some(i),
        });
        let next = next.unwrap();
        taken.push(next as u32);
        distances.push(to_samples[next].sqrt());
    }
    (taken, distances)
}

fn loop_over_farthest<T: Scalar>() {
    for (name, points) in clouds() {
        for first in [0, points.len() / 2] {
            for count in [1, 40, 300].map(|count| count.min(points.len())) {
                let start = FarthestStart::Index(first as u32);
                let found = farthest_points(&of::<T>(&points), count, start, &mut Watch::none()).unwrap();
                if count == 0 {
                    assert!(found.indices.is_empty());
                    continue;
                }
                let (indices, distances) = by_loop(&points, count, first);
                assert_eq!(found.indices, indices, "{name}, {count} from {first}");
                // Squares are exact, so roots are too, up to their rounding.
                let roots = found.distances.iter().map(|d| d.to_f64());
                let is_root = |(a, b): (f64, &f64)| a == *b || (a - b).abs() <= T::EPSILON.to_f64() * b;
                assert!(roots.zip(&distances).all(is_root), "{name}, {count} from {first}");
            }
        }
    }
    // All points, coinciding ones last.
    let points = balls(300, 31);
    let twice = [points.clone(), points].concat();
    let found = farthest_points(&of::<T>(&twice), 600, FarthestStart::Index(0), &mut Watch::none()).unwrap();
    let mut all = found.indices.clone();
    all.sort_unstable();
    assert!(all.into_iter().eq(0..600) && found.distances[599] == T::ZERO);
}

fn seeds() {
    let points = of::<f32>(&even(500, 2.0, 7));
    let first = |seed| farthest_points(&points, 1, FarthestStart::Seed(seed), &mut Watch::none()).unwrap().indices[0];
    assert_eq!(first(5), first(5));
    let firsts: std::collections::BTreeSet<u32> = (0..50).map(first).collect();
    assert!(firsts.len() > 30 && firsts.iter().all(|&i| i < 500), "{firsts:?}");
}

fn invalid_points() {
    let points = balls(400, 15);
    let (all, valid) = with_invalid(&points);
    let (all, points) = (of::<f64>(&all), of::<f64>(&points));
    let renamed = |indices: &[u32]| -> Vec<u32> { indices.iter().map(|&i| valid[i as usize] as u32).collect() };
    let settings = VoxelSettings::new(0.5);
    let [mixed, clean] = [&all, &points].map(|p| voxel_downsample(p, &settings, &mut Watch::none()).unwrap());
    assert_eq!((mixed.points, mixed.representatives), (clean.points, renamed(&clean.representatives)));
    let told = mixed.invalid.len();
    assert!(told == all.len() - points.len() && mixed.invalid.iter().all(|&i| mixed.cells[i as usize] == u32::MAX));
    let settings = PoissonDiskSettings::new(90);
    let [mixed, clean] = [&all, &points].map(|p| poisson_disk(p, &settings, &mut Watch::none()).unwrap());
    assert_eq!((mixed.indices, mixed.invalid.len()), (renamed(&clean.indices), told));
    let start = [FarthestStart::Index(valid[7] as u32), FarthestStart::Index(7)];
    let mixed = farthest_points(&all, 50, start[0], &mut Watch::none()).unwrap();
    let clean = farthest_points(&points, 50, start[1], &mut Watch::none()).unwrap();
    assert_eq!((mixed.indices, mixed.invalid.len()), (renamed(&clean.indices), told));
    is_refused("first sample", farthest_points(&all, 5, FarthestStart::Index(0), &mut Watch::none()));
}

fn refusals() {
    let points = of::<f32>(&balls(50, 1));
    for size in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9] {
        is_refused("size of a voxel", voxel_downsample(&points, &VoxelSettings::new(size), &mut Watch::none()));
    }
    let nowhere = VoxelSettings { origin: VoxelOrigin::At([0.0, f64::NAN, 0.0]), ..VoxelSettings::new(1.0) };
    is_refused("origin of voxels", voxel_downsample(&points, &nowhere, &mut Watch::none()));
    is_refused("number of samples", poisson_disk(&points, &PoissonDiskSettings::new(51), &mut Watch::none()));
    for area in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let settings = PoissonDiskSettings { count: 5, extent: Extent::Area(area) };
        is_refused("extent of the points", poisson_disk(&points, &settings, &mut Watch::none()));
    }
    let one_place = [[1.0f64; 3]; 9];
    is_refused("extent of the points", poisson_disk(&one_place, &PoissonDiskSettings::new(4), &mut Watch::none()));
    let far = FarthestStart::Index(50);
    is_refused("first sample", farthest_points(&points, 2, far, &mut Watch::none()));
    is_refused("number of samples", farthest_points(&points, 51, FarthestStart::Seed(1), &mut Watch::none()));
}

fn any_threads() {
    let points = of::<f32>(&balls(3000, 16));
    let settings = VoxelSettings::new(0.3);
    same_for_any_threads("voxels", || voxel_downsample(&points, &settings, &mut Watch::none()).unwrap());
    let settings = PoissonDiskSettings::new(500);
    same_for_any_threads("poisson disks", || poisson_disk(&points, &settings, &mut Watch::none()).unwrap());
}

fn interrupted() {
    let points = of::<f64>(&balls(ABOVE_BLOCK, 17));
    can_be_interrupted("voxels", |watch| voxel_downsample(&points, &VoxelSettings::new(0.5), watch));
    can_be_interrupted("poisson disks", |watch| poisson_disk(&points, &PoissonDiskSettings::new(50), watch));
    can_be_interrupted("farthest points", |watch| farthest_points(&points, 20, FarthestStart::Index(0), watch));
}
