//! Cells of points: against exact arithmetic, and bit for bit the same on the GPU.

use libtest_mimic::Trial;
use nearfield::curve::{GpuCurve, MAX_LEVEL};
use nearfield::{Aabb, Curve, Domain, Error, Gpu, Vec3};

use crate::support::{Random, gpu_trial, trial};
use crate::{LENGTHS, assert_same};

const SEED: u64 = 20_261_125;
const LAST: u32 = (1 << MAX_LEVEL) - 1;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("cells_equal_exact_arithmetic", cells_equal_exact_arithmetic),
        trial("cells_are_monotone_along_each_axis", cells_are_monotone_along_each_axis),
        gpu_trial("gpu_keys_of_points_equal_the_cpu", gpu_keys_of_points_equal_the_cpu),
        gpu_trial("gpu_keys_of_any_number_of_points", gpu_keys_of_any_number_of_points),
        gpu_trial("gpu_keys_refuse_points_that_are_not_finite", gpu_keys_refuse_points_that_are_not_finite),
    ]
}

/// Multiples of 1/1024 and edges that are powers of two: nothing is rounded, and integers say the cell.
fn cells_equal_exact_arithmetic() {
    let mut random = Random(SEED);
    for case in 0..50_000 {
        let edge = 1u64 << random.below(12);
        let origin: [i64; 3] = std::array::from_fn(|_| i64::from(random.below(1 << 21)) - (1 << 20));
        // Also outside, by as much as the edge on each side.
        let offset: [i64; 3] =
            std::array::from_fn(|_| i64::from(random.below(3 << 10) * edge as u32) - ((edge as i64) << 10));
        let unit = |v: i64| v as f32 / 1024.0;
        let domain = Domain::new(Vec3::from_array(origin.map(unit)), edge as f32).unwrap();
        let point = [0, 1, 2].map(|axis| origin[axis] + offset[axis]);
        // ⌊offset / 1024 · 2²¹ / edge⌋
        let expected = offset.map(|v| ((v << 11).div_euclid(edge as i64)).clamp(0, i64::from(LAST)) as u32);
        assert_eq!(domain.cell_of(Vec3::from_array(point.map(unit))), expected, "case {case}, seed {SEED}");
    }
}

fn cells_are_monotone_along_each_axis() {
    let mut random = Random(SEED);
    for _ in 0..200 {
        let size = [1e-20, 1e-3, 1.0, 7e5, 1e17][random.below(5) as usize];
        let origin = Vec3::splat((random.unit() - 0.5) * size);
        let domain = Domain::new(origin, (random.unit() + 0.1) * size).unwrap();
        let mut values: Vec<f32> = (0..200).map(|_| origin.x + (1.2 * random.unit() - 0.1) * domain.edge()).collect();
        values.sort_by(f32::total_cmp);
        let cells: Vec<u32> = values.iter().map(|&x| domain.cell_of(Vec3::splat(x))[1]).collect();
        assert!(cells.is_sorted(), "{domain:?}");
    }
}

/// Domains small and large, near zero and far from it.
fn domains() -> Vec<Domain> {
    let make = |origin: Vec3, edge: f32| Domain::new(origin, edge).unwrap();
    let smallest = 1.0 / (1u128 << 80) as f32;
    let point = Vec3::new(5.0, -3.0, 1e9);
    vec![
        make(Vec3::ZERO, 1.0),
        make(Vec3::new(0.1, -0.3, 1e-7), 3.3),
        make(Vec3::new(-1000.1, 7.3, 123_456.7), 0.7),
        make(Vec3::ZERO, smallest),
        make(Vec3::splat(f32::MIN_POSITIVE), smallest),
        make(Vec3::splat(-1e18), 2.1e18),
        make(Vec3::new(637_000.0, 5_403_059.0, 400.0), 512.3),
        Domain::of_bounds(&Aabb::new(point, point)),
    ]
}

/// Points on and beside the borders of cells, on and beyond the far faces, and with every size of coordinates.
fn points(domain: &Domain, n: usize, random: &mut Random) -> Vec<Vec3> {
    let (origin, edge) = (domain.origin(), domain.edge());
    let special = [
        0.0,
        -0.0,
        f32::MIN_POSITIVE,
        f32::MIN_POSITIVE / 8.0,
        -f32::MIN_POSITIVE / 8.0,
        f32::from_bits(1),
        1e-30,
        1e18,
        -1e18,
        9e17,
    ];
    let coordinate = |axis: usize, random: &mut Random| {
        let border = origin[axis] + (edge as f64 * f64::from(random.below(LAST + 2)) / f64::from(LAST + 1)) as f32;
        match random.below(8) {
            0 => border,
            1 => border.next_up(),
            2 => border.next_down(),
            3 => origin[axis] + edge,
            4 => [origin[axis].next_down(), (origin[axis] + edge).next_up(), origin[axis]][random.below(3) as usize],
            5 => special[random.below(special.len() as u32) as usize],
            6 => origin[axis] + edge * random.unit() * random.unit() * 1e-6,
            _ => origin[axis] + edge * random.unit(),
        }
        .clamp(-1e18, 1e18)
    };
    (0..n).map(|_| Vec3::from_array([0, 1, 2].map(|axis| coordinate(axis, random)))).collect()
}

fn gpu_keys_of_points_equal_the_cpu(gpu: &Gpu) {
    let mut random = Random(SEED);
    for (number, domain) in domains().iter().enumerate() {
        let points = points(domain, 20_000, &mut random);
        for curve in Curve::ALL {
            let plan = GpuCurve::new(gpu, curve);
            let case = format!("{curve} in domain {number}, seed {SEED}");
            let expected: Vec<u64> = points.iter().map(|&p| domain.key_of(curve, p)).collect();
            assert_same(&plan.point_keys::<u64>(domain, &points).unwrap(), &expected, &case);
            let first_30: Vec<u32> = expected.iter().map(|key| (key >> 33) as u32).collect();
            assert_same(&plan.point_keys::<u32>(domain, &points).unwrap(), &first_30, &case);
        }
    }
}

fn gpu_keys_of_any_number_of_points(gpu: &Gpu) {
    let (mut random, domain) = (Random(SEED), Domain::new(Vec3::ZERO, 1.0).unwrap());
    let plan = GpuCurve::new(gpu, Curve::Morton);
    for n in LENGTHS {
        let points = points(&domain, n, &mut random);
        let expected: Vec<u64> = points.iter().map(|&p| domain.key_of(Curve::Morton, p)).collect();
        assert_same(&plan.point_keys::<u64>(&domain, &points).unwrap(), &expected, &format!("{n} points"));
    }
}

fn gpu_keys_refuse_points_that_are_not_finite(gpu: &Gpu) {
    let (plan, domain) = (GpuCurve::new(gpu, Curve::Morton), Domain::new(Vec3::ZERO, 1.0).unwrap());
    let found = plan.point_keys::<u64>(&domain, &[Vec3::ONE, Vec3::NAN]);
    assert!(matches!(found, Err(Error::NonFinite { first: 1, .. })), "{found:?}");
}
