//! Points in the order of a curve: the same on CPU and GPU.

use libtest_mimic::Trial;
use nearfield::curve::{self, GpuCurveOrder};
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::{Curve, Domain, Error, Gpu, Vec3};

use crate::support::{Random, gpu_trial};
use crate::{LENGTHS, assert_same};

const SEED: u64 = 20_261_126;
const POINTS: usize = 20_000;
/// What stands in every output before a kernel runs.
const POISON: u32 = 0xdead_beef;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("gpu_orders_equal_the_cpu", gpu_orders_equal_the_cpu),
        gpu_trial("gpu_orders_of_any_number_of_points", gpu_orders_of_any_number_of_points),
        gpu_trial("gpu_orders_leave_what_stands_behind", gpu_orders_leave_what_stands_behind),
        gpu_trial("gpu_orders_refuse_what_does_not_fit", gpu_orders_refuse_what_does_not_fit),
    ]
}

/// Points on a coarse lattice: hundreds of them in a cell.
fn stacked(n: usize) -> Vec<Vec3> {
    let mut random = Random(SEED);
    (0..n).map(|_| Vec3::from_array([0; 3].map(|_| random.below(4) as f32 - 1.5))).collect()
}

fn gpu_orders_equal_the_cpu(gpu: &Gpu) {
    let kinds = [CloudKind::Uniform, CloudKind::Clustered, CloudKind::AllEqual];
    let mut clouds: Vec<_> = kinds.map(|kind| (kind.to_string(), cloud(kind, POINTS, SEED).points)).into();
    clouds.push(("stacked".to_owned(), stacked(POINTS)));
    for curve in Curve::ALL {
        // One plan for all of them: none leaves anything to the next.
        let plan = GpuCurveOrder::new(gpu, curve, POINTS).unwrap();
        for (kind, points) in &clouds {
            let expected = curve::order(points, curve).unwrap();
            assert_same(&plan.order(points).unwrap(), &expected, &format!("{kind} along {curve}, seed {SEED}"));
        }
    }
}

fn gpu_orders_of_any_number_of_points(gpu: &Gpu) {
    for curve in Curve::ALL {
        for n in LENGTHS {
            let plan = GpuCurveOrder::new(gpu, curve, n).unwrap();
            let points = cloud(CloudKind::Uniform, n, SEED).points;
            let expected = curve::order(&points, curve).unwrap();
            assert_same(&plan.order(&points).unwrap(), &expected, &format!("{n} points along {curve}"));
        }
    }
}

/// In a domain that half of the points lie outside of.
fn gpu_orders_leave_what_stands_behind(gpu: &Gpu) {
    let points = cloud(CloudKind::Uniform, 700, SEED).points;
    let domain = Domain::new(Vec3::new(0.2, 0.1, 0.0), 0.5).unwrap();
    let on_device: Vec<[f32; 4]> = points.iter().map(|p| p.extend(f32::NAN).to_array()).collect();
    let on_device = gpu.upload("points", &on_device).unwrap();
    for curve in Curve::ALL {
        let plan = GpuCurveOrder::new(gpu, curve, 1000).unwrap();
        let order = gpu.upload("poisoned order", &[POISON; 700]).unwrap();
        let mut commands = gpu.commands("order");
        plan.record(&mut commands, &domain, &on_device, &order, 300).unwrap();
        commands.submit().unwrap();
        let order = gpu.read(&order).unwrap();
        let expected = curve::order_in(&points[..300], curve, &domain).unwrap();
        assert_same(&order[..300], &expected, &format!("points outside along {curve}"));
        assert!(order[300..].iter().all(|&index| index == POISON), "{curve}");
    }
}

fn gpu_orders_refuse_what_does_not_fit(gpu: &Gpu) {
    let plan = GpuCurveOrder::new(gpu, Curve::Hilbert, 10).unwrap();
    let found = plan.order(&[Vec3::ZERO; 11]);
    assert!(matches!(found, Err(Error::TooMany { .. })), "{found:?}");
    let found = plan.order(&[Vec3::ONE, Vec3::NAN]);
    assert!(matches!(found, Err(Error::NonFinite { first: 1, .. })), "{found:?}");
    let (domain, mut commands) = (Domain::new(Vec3::ZERO, 1.0).unwrap(), gpu.commands("order"));
    let points = gpu.buffer::<[f32; 4]>("points", 10).unwrap();
    let order = gpu.buffer::<u32>("order", 9).unwrap();
    let found = plan.record(&mut commands, &domain, &points, &order, 10);
    assert!(matches!(found, Err(Error::LengthMismatch { found: 9, expected: 10, .. })), "{found:?}");
    assert!(plan.record(&mut commands, &domain, &points, &order, 9).is_ok());
}
