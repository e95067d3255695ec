//! Sums, extremes and bounds.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::parallel::reduce::{self, GpuBounds, GpuReduce};
use nearfield::{Aabb, Error, Vec3};

use super::support::{Random, gpu_trial, long_cases, trial};
use super::{SEED, lengths, poisoned, random_words};

pub(super) fn trials() -> Vec<Trial> {
    vec![
        trial("cpu_reductions_equal_the_loop", cpu_reductions_equal_the_loop),
        gpu_trial("gpu_reductions_equal_the_loop", gpu_reductions_equal_the_loop),
        gpu_trial("gpu_bounds_equal_the_loop", gpu_bounds_equal_the_loop),
        gpu_trial("gpu_bounds_count_points_that_are_not_finite", gpu_bounds_count_points_that_are_not_finite),
        gpu_trial("gpu_bounds_refuse_points_of_another_size", gpu_bounds_refuse_points_of_another_size),
    ]
}

fn floats(n: usize) -> Vec<f32> {
    let mut random = Random(SEED);
    (0..n).map(|_| (random.unit() - 0.5) * [1e-30, 1.0, 1e30][random.below(3) as usize]).collect()
}

fn points(n: usize) -> Vec<[f32; 4]> {
    let mut random = Random(SEED);
    // The fourth word must not count.
    (0..n).map(|_| [random.unit() - 2.0, 9.0 * random.unit() - 4.0, random.unit() + 5.0, f32::NAN]).collect()
}

fn cpu_reductions_equal_the_loop() {
    for n in lengths() {
        let (values, floats) = (random_words(n, SEED), floats(n));
        assert_eq!(reduce::sum(&values), values.iter().fold(0, |sum, &v| sum + u64::from(v)), "{n}");
        assert_eq!(reduce::smallest(&values), values.iter().copied().min(), "{n}");
        assert_eq!(reduce::largest(&values), values.iter().copied().max(), "{n}");
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for &value in &floats {
            low = if value < low { value } else { low };
            high = if value > high { value } else { high };
        }
        assert_eq!((reduce::smallest_f32(&floats), reduce::largest_f32(&floats)), (low, high), "{n}");
        let points: Vec<Vec3> = points(n).iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
        let axis = |axis: usize| {
            let values = points.iter().map(move |p| p[axis]);
            (values.clone().fold(f32::INFINITY, f32::min), values.fold(f32::NEG_INFINITY, f32::max))
        };
        let [x, y, z] = [0, 1, 2].map(axis);
        assert_eq!(reduce::bounds(&points), Aabb::new(Vec3::new(x.0, y.0, z.0), Vec3::new(x.1, y.1, z.1)), "{n}");
    }
}

fn gpu_reductions_equal_the_loop(gpu: &Gpu) {
    let plan = GpuReduce::new(gpu).unwrap();
    let mut lengths = lengths();
    if long_cases(gpu) {
        lengths.push((1 << 22) + 1);
    }
    for n in lengths {
        let (values, mut floats) = (random_words(n, SEED), floats(n));
        if n > 40 {
            (floats[7], floats[33]) = (f32::NAN, -f32::NAN);
        }
        let input = gpu.upload("values", &values).unwrap();
        let float_input = gpu.upload("floats", &floats).unwrap();
        let sum = poisoned::<u64>(gpu, 1);
        let words = [(); 2].map(|()| poisoned::<u32>(gpu, 1));
        let extremes = [(); 2].map(|()| poisoned::<f32>(gpu, 1));
        let mut commands = gpu.commands("reduce");
        plan.record_sum(&mut commands, &input, n, &sum).unwrap();
        plan.record_smallest(&mut commands, &input, n, &words[0]).unwrap();
        plan.record_largest(&mut commands, &input, n, &words[1]).unwrap();
        plan.record_smallest_f32(&mut commands, &float_input, n, &extremes[0]).unwrap();
        plan.record_largest_f32(&mut commands, &float_input, n, &extremes[1]).unwrap();
        commands.submit().unwrap();
        assert_eq!(gpu.read(&sum).unwrap()[0], values.iter().map(|&v| u64::from(v)).sum::<u64>(), "sum of {n}");
        let found = words.map(|word| gpu.read(&word).unwrap()[0]);
        let expected = [values.iter().min().copied().unwrap_or(u32::MAX), values.iter().max().copied().unwrap_or(0)];
        assert_eq!(found, expected, "{n}");
        let found = extremes.map(|float| gpu.read(&float).unwrap()[0]);
        let numbers = floats.iter().copied().filter(|v| !v.is_nan());
        let low = numbers.clone().fold(f32::INFINITY, |a, b| if b < a { b } else { a });
        let high = numbers.fold(f32::NEG_INFINITY, |a, b| if b > a { b } else { a });
        assert_eq!(found, [low, high], "{n}");
    }
}

fn gpu_bounds(gpu: &Gpu, points: &[[f32; 4]]) -> GpuBounds {
    let input = gpu.upload("points", points).unwrap();
    let result = poisoned::<GpuBounds>(gpu, 1);
    let mut commands = gpu.commands("bounds");
    GpuReduce::new(gpu).unwrap().record_bounds(&mut commands, &input, points.len(), &result).unwrap();
    commands.submit().unwrap();
    gpu.read(&result).unwrap()[0]
}

fn gpu_bounds_equal_the_loop(gpu: &Gpu) {
    for n in lengths() {
        let points = points(n);
        let found = gpu_bounds(gpu, &points);
        for axis in 0..3 {
            let values = points.iter().map(|p| p[axis]);
            assert_eq!(found.min[axis], values.clone().fold(f32::INFINITY, f32::min), "axis {axis} of {n}");
            assert_eq!(found.max[axis], values.fold(f32::NEG_INFINITY, f32::max), "axis {axis} of {n}");
        }
        assert_eq!((found.min[3], found.max[3]), (0.0, 0.0));
        assert_eq!((found.n_non_finite, found.first_non_finite), (0, u32::MAX), "{n}");
    }
}

fn gpu_bounds_count_points_that_are_not_finite(gpu: &Gpu) {
    let mut points = points(70_000);
    points[69_999] = [f32::INFINITY, 0.0, 0.0, 0.0];
    points[12_345] = [0.0, f32::NAN, 0.0, 0.0];
    points[12_346] = [0.0, 0.0, f32::NEG_INFINITY, 0.0];
    let found = gpu_bounds(gpu, &points);
    assert_eq!((found.n_non_finite, found.first_non_finite), (3, 12_345));
    // 0 lies outside the other coordinates of x and z: the three points must not have counted.
    assert!(found.max[0] < 0.0 && found.min[2] > 0.0 && found.min[2] < 5.1, "{found:?}");

    let found = gpu_bounds(gpu, &[[f32::NAN; 4]; 5]);
    assert_eq!((found.n_non_finite, found.first_non_finite), (5, 0));
    assert_eq!(
        (found.min[..3].to_vec(), found.max[..3].to_vec()),
        (vec![f32::INFINITY; 3], vec![f32::NEG_INFINITY; 3])
    );
}

fn gpu_bounds_refuse_points_of_another_size(gpu: &Gpu) {
    let (points, result) = (poisoned::<[f32; 3]>(gpu, 4), poisoned(gpu, 1));
    let found = GpuReduce::new(gpu).unwrap().record_bounds(&mut gpu.commands("bounds"), &points, 4, &result);
    assert!(matches!(found, Err(Error::Unsupported { .. })));
}
