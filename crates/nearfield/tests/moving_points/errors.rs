//! Positions that are refused, and memory that is: points and tree stay sound.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::{AabbTree, AabbTreeSettings, BuildOrder, Error, FixedRadius, GpuMovingPoints, RebuildPolicy, Vec3};

use crate::SEED;
use crate::motions::{Motion, RADIUS, uniform};
use crate::reference::Expected;
use crate::subject::{Device, Moving};
use crate::support::{Random, gpu_trial, own_context, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("refused_positions_change_nothing", || refused_positions(Device::Cpu)),
        gpu_trial("refused_positions_change_nothing_on_the_device", |gpu| refused_positions(Device::Gpu(gpu))),
        gpu_trial("memory_that_runs_out_in_an_update_leaves_a_sound_tree", refused_memory),
    ]
}

const POLICIES: [RebuildPolicy; 4] =
    [RebuildPolicy::DEFAULT, RebuildPolicy::Always, RebuildPolicy::Never, RebuildPolicy::Cost];

/// Order, boxes and positions.
fn contents(tree: &AabbTree) -> (Vec<u32>, Vec<[f32; 6]>, Vec<Vec3>) {
    let points = tree.ordered_points();
    let corners = |[a, b, c]: [f32; 3], [d, e, f]: [f32; 3]| [a, b, c, d, e, f];
    let boxes = tree.boxes().iter().map(|aabb| corners(aabb.min, aabb.max)).collect();
    (points.ids().to_vec(), boxes, (0..points.len()).map(|place| points.position(place)).collect())
}

fn refused_positions(device: Device<'_>) {
    let mut random = Random(SEED + 7);
    let points = uniform(90, &mut random);
    let mut good = points.clone();
    Motion::Drift(1.0).apply(&mut good, &mut random);
    let with = |i: usize, axis: usize, value: f32| {
        let mut bad = good.clone();
        bad[i][axis] = value;
        bad
    };
    let bad = [
        (with(17, 1, f32::NAN), "NaN"),
        (with(0, 0, f32::INFINITY), "infinity"),
        (with(89, 2, f32::NEG_INFINITY), "minus infinity"),
        (with(40, 2, -1.5e18), "too large"),
        (good[1..].to_vec(), "one less"),
        ([&good[..], &good[..1]].concat(), "one more"),
        (vec![], "none"),
    ];
    for order in [BuildOrder::Median, BuildOrder::Hilbert] {
        for policy in POLICIES {
            let settings = AabbTreeSettings::DEFAULT.order(order);
            let mut moving = device.start(&points, RADIUS, &settings, policy).unwrap();
            let before = contents(&moving.tree());
            // Under the rule by cost a build is due.
            moving.record_query_time(0.0).unwrap();
            assert_eq!(moving.update(&points).unwrap().is_rebuild(), policy == RebuildPolicy::Always);
            moving.record_query_time(1.5 * moving.build_milliseconds()).unwrap();
            for (positions, what) in &bad {
                let case = format!("{what}, {policy:?}, {order:?}");
                let error = moving.update(positions).expect_err(&case);
                let is_right = match *what {
                    "NaN" => matches!(error, Error::NonFinite { count: 1, first: 17, .. }),
                    "infinity" => matches!(error, Error::NonFinite { count: 1, first: 0, .. }),
                    "minus infinity" => matches!(error, Error::NonFinite { count: 1, first: 89, .. }),
                    "too large" => matches!(error, Error::CoordinateTooLarge { index: 40, axis: 'z', .. }),
                    "one less" => matches!(error, Error::LengthMismatch { found: 89, expected: 90, .. }),
                    "one more" => matches!(error, Error::LengthMismatch { found: 91, expected: 90, .. }),
                    _ => matches!(error, Error::LengthMismatch { found: 0, expected: 90, .. }),
                };
                assert!(is_right, "{case}: {error}");
                assert_eq!(contents(&moving.tree()), before, "{case}");
                assert_eq!(moving.positions(), points, "{case}");
            }
            let question = FixedRadius::new(RADIUS);
            Expected::by_loop(&points, &question, true).check(moving.search(), &question, "after refusals");
            let report = moving.update(&good).unwrap();
            let is_due = matches!(policy, RebuildPolicy::Always | RebuildPolicy::Cost);
            assert!(policy == RebuildPolicy::DEFAULT || report.is_rebuild() == is_due, "{policy:?}: {report}");
            assert_eq!(moving.tree().broken_invariant(), None);
            Expected::by_loop(&good, &question, true).check(moving.search(), &question, "after a good update");
        }
    }
}

fn refused_memory(gpu: &Gpu) {
    let gpu = own_context(gpu);
    let mut random = Random(SEED + 8);
    let points = uniform(70, &mut random);
    let (mut moved, mut broken) = (points.clone(), points.clone());
    Motion::Explode.apply(&mut moved, &mut random);
    broken[3].x = f32::NAN;
    for order in [BuildOrder::Median, BuildOrder::Hilbert] {
        for policy in [RebuildPolicy::DEFAULT, RebuildPolicy::Always, RebuildPolicy::Never] {
            let settings = AabbTreeSettings::DEFAULT.order(order);
            let mut moving = GpuMovingPoints::new(&gpu, &points, RADIUS, &settings, policy).unwrap();
            for positions in [&moved, &broken] {
                for n in 0.. {
                    let case = format!("{policy:?}, {order:?}, allocation {n}");
                    moving.update(&points).unwrap_or_else(|error| panic!("{case}: {error}"));
                    gpu.refuse_allocation(Some(n));
                    let updated = moving.update(positions);
                    let not_reached = gpu.refuse_allocation(None);
                    let now = Moving::positions(&moving);
                    assert_eq!(Moving::tree(&moving).broken_invariant(), None, "{case}");
                    match updated {
                        Ok(_) => assert_eq!(now, moved, "{case}"),
                        Err(Error::NonFinite { .. }) => assert_eq!(now, points, "{case}"),
                        Err(Error::OutOfDeviceMemory { .. }) => assert!(now == points || now == moved, "{case}"),
                        Err(error) => panic!("{case}: {error}"),
                    }
                    if not_reached {
                        break;
                    }
                }
            }
        }
    }
}
