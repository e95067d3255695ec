//! Each policy builds exactly when its definition says.

use libtest_mimic::Trial;
use nearfield::{
    AabbTreeSettings, BuildOrder, Error, FixedRadius, MovingPoints, NeighborSearch, RebuildPolicy, UpdateReason, Vec3,
};

use crate::SEED;
use crate::model::Model;
use crate::motions::{Motion, RADIUS, uniform};
use crate::subject::Device;
use crate::support::{Random, gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("the_largest_coordinates_do_not_overflow_volumes", || largest_coordinates(Device::Cpu)),
        gpu_trial("the_largest_coordinates_do_not_overflow_volumes_of_the_device", |gpu| {
            largest_coordinates(Device::Gpu(gpu));
        }),
        trial("flat_sets_without_a_radius_compare_by_area", || flat_without_radius(Device::Cpu)),
        gpu_trial("flat_sets_of_the_device_without_a_radius_compare_by_area", |gpu| {
            flat_without_radius(Device::Gpu(gpu));
        }),
        trial("a_build_is_due_when_queries_have_paid_for_it", || cost(Device::Cpu)),
        gpu_trial("a_build_on_the_device_is_due_when_queries_have_paid_for_it", |gpu| cost(Device::Gpu(gpu))),
        trial("asking_records_times", asking),
        trial("settings_that_make_no_sense_are_refused", refused_settings),
    ]
}

/// How much larger the largest box is, and whether the tree was built anew.
fn ratio_after(
    device: Device<'_>,
    points: &[Vec3],
    moved: &[Vec3],
    radius: f32,
    limit: f32,
    order: BuildOrder,
) -> (f32, bool) {
    let settings = AabbTreeSettings::DEFAULT.order(order);
    let mut moving = device.start(points, radius, &settings, RebuildPolicy::VolumeRatio { limit }).unwrap();
    let report = moving.update(moved).unwrap();
    assert_eq!(moving.tree().broken_invariant(), None);
    match report.reason {
        UpdateReason::VolumeRatio { measured, .. } => (measured, report.is_rebuild()),
        reason => panic!("{reason:?}"),
    }
}

fn largest_coordinates(device: Device<'_>) {
    let mut random = Random(SEED + 3);
    let small = uniform(200, &mut random);
    let scaled = |factor: f32| -> Vec<Vec3> { small.iter().map(|&p| factor * p).collect() };
    for order in [BuildOrder::Median, BuildOrder::Hilbert] {
        let ratio = |from: f32, to: f32, radius: f32, limit: f32| {
            ratio_after(device, &scaled(from), &scaled(to), radius, limit, order)
        };
        // Volumes of 8e54 are no f32.
        let (measured, rebuilds) = ratio(5e17, 1e18, 0.0, 10.0);
        assert!((7.999..8.001).contains(&measured) && !rebuilds, "{measured}");
        let (measured, rebuilds) = ratio(1e18, 1e18, 1.0, 10.0);
        // A device may round a quotient of equals.
        assert!((0.999_999..1.000_001).contains(&measured) && !rebuilds, "{measured}");
        let (measured, rebuilds) = ratio(1e18, 1e-15, 1e-18, 10.0);
        assert!(measured < 1e-20 && !rebuilds, "{measured}");
        // The ratio itself is beyond the largest f32: it is infinite, and above all limits but the infinite one.
        let (measured, rebuilds) = ratio(1e-15, 1e18, 1e-18, f32::MAX);
        assert!(measured == f32::INFINITY && rebuilds, "{measured}");
        let (measured, rebuilds) = ratio(1e-15, 1e18, 1e-18, f32::INFINITY);
        assert!(measured == f32::INFINITY && !rebuilds, "{measured}");
        let (measured, rebuilds) = ratio(1.0, 1e8, 1e-3, 1e10);
        assert!((1e22..1e24).contains(&measured) && rebuilds, "{measured}");
        // One ulp around 1 at an enormous radius.
        let (measured, rebuilds) = ratio(1.0, 2.0, 1.8e19, 1.0);
        assert!((0.999..1.001).contains(&measured) && rebuilds == (measured > 1.0), "{measured}");
    }
}

fn flat_without_radius(device: Device<'_>) {
    let mut random = Random(SEED + 4);
    let flat: Vec<Vec3> = uniform(100, &mut random).iter().map(|p| Vec3::new(p.x, p.y, 0.5)).collect();
    let stretched: Vec<Vec3> = flat.iter().map(|p| Vec3::new(4.0 * p.x, 2.0 * p.y, 7.0)).collect();
    let tilted: Vec<Vec3> = flat.iter().map(|p| Vec3::new(p.x, p.y, p.x)).collect();
    for order in [BuildOrder::Median, BuildOrder::Hilbert] {
        let ratio = |from: &[Vec3], to: &[Vec3]| ratio_after(device, from, to, 0.0, 10.0, order);
        let (measured, rebuilds) = ratio(&flat, &stretched);
        assert!((7.999..8.001).contains(&measured) && !rebuilds, "{measured}");
        assert_eq!(ratio(&flat, &tilted), (f32::INFINITY, true));
        let (measured, rebuilds) = ratio(&tilted, &flat);
        assert!(measured == 0.0 && !rebuilds, "{measured}");
        // At one place there is no side at any time.
        assert_eq!(ratio(&[Vec3::ONE; 100], &[Vec3::ZERO; 100]), (1.0, false));
    }
}

fn cost(device: Device<'_>) {
    let mut random = Random(SEED + 5);
    let mut points = uniform(100, &mut random);
    let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert);
    let mut moving = device.start(&points, RADIUS, &settings, RebuildPolicy::Cost).unwrap();
    let mut model = Model::new(&*moving, RADIUS, RebuildPolicy::Cost);
    let mut builds = Vec::new();
    // Shares of a build: the extra time is 0.25, 0.75, 1.05 of one, then counts from zero, then falls to a faster base.
    for (step, share) in [0.5, 0.75, 1.0, 0.8, 3.0, 3.5, 1.0, 1.25, 1.5, 0.0].into_iter().enumerate() {
        model.record(&mut *moving, share);
        Motion::Drift(0.1).apply(&mut points, &mut random);
        let report = moving.update(&points).unwrap();
        model.check(&*moving, &points, &report, &format!("step {step}"));
        if report.is_rebuild() {
            builds.push(step);
        }
    }
    assert_eq!(builds, [3, 8]);
    // Steps without queries pay for nothing.
    for _ in 0..3 {
        assert!(!moving.update(&points).unwrap().is_rebuild());
    }
}

fn asking() {
    let points = uniform(300, &mut Random(SEED + 6));
    let mut moving = MovingPoints::new(&points, RADIUS, &AabbTreeSettings::DEFAULT, RebuildPolicy::Cost).unwrap();
    assert!(moving.build_milliseconds() > 0.0);
    let build = moving.build_milliseconds();
    let question = FixedRadius::new(RADIUS);
    let expected = moving.tree().count(&question).unwrap().into_vec();
    assert_eq!(moving.ask(|tree| tree.count(&question)).unwrap().into_vec(), expected);
    moving.update(&points).unwrap();
    // A question that waits for longer than the build took, beyond what the first one did.
    moving.ask(|_| std::thread::sleep(std::time::Duration::from_secs_f64(build / 1e3 + 0.5)));
    let report = moving.update(&points).unwrap();
    assert!(report.is_rebuild(), "{report}");
    assert!(report.to_string().contains("which pays for one of"), "{report}");
    assert!(report.milliseconds > 0.0 && !report.stages.is_empty());
}

fn refused_settings() {
    let start = |radius: f32, policy: RebuildPolicy| {
        MovingPoints::new(&[Vec3::ONE], radius, &AabbTreeSettings::DEFAULT, policy).map(drop)
    };
    for limit in [f32::NAN, 0.5, -1.0, f32::NEG_INFINITY] {
        let error = start(1.0, RebuildPolicy::VolumeRatio { limit }).unwrap_err();
        assert!(matches!(error, Error::InvalidSetting { setting: "limit of the volume ratio", .. }), "{error}");
    }
    for radius in [f32::NAN, -1.0, f32::INFINITY, 1e-30] {
        assert!(matches!(start(radius, RebuildPolicy::DEFAULT), Err(Error::InvalidRadius { .. })), "{radius}");
    }
    for limit in [1.0, 1e30, f32::INFINITY] {
        start(0.0, RebuildPolicy::VolumeRatio { limit }).unwrap();
    }
}
