//! Trees that follow their points: after every motion, and whatever the policy, all answers are those of the loop.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::{AabbTreeSettings, BuildOrder, FixedRadius, RebuildPolicy, TreeSearch, Vec3};

use crate::SEED;
use crate::model::Model;
use crate::motions::{Motion, RADIUS, clouds, in_box, uniform};
use crate::reference::{Expected, beyond_all};
use crate::subject::{Device, Moving};
use crate::support::{Random, gpu_trial, long_cases, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("fitted_and_built_trees_agree_with_the_loop_after_every_motion", || {
            let n_rebuilds = follow(Device::Cpu, 250, 120, &[0, 1, 2, 3]);
            assert!(n_rebuilds > 100, "{n_rebuilds} builds by volume or cost");
        }),
        gpu_trial("fitted_and_built_trees_of_the_device_agree_with_the_loop_after_every_motion", |gpu| {
            let (n, steps) = if long_cases(gpu) { (900, 60) } else { (130, Motion::ALL.len()) };
            assert!(follow(Device::Gpu(gpu), n, steps, &[1, 2]) > 5);
        }),
        trial("small_sets_follow", || small_sets(Device::Cpu)),
        gpu_trial("small_sets_of_the_device_follow", |gpu| small_sets(Device::Gpu(gpu))),
        gpu_trial("positions_on_the_device_are_followed_whatever_stands_in_w", positions_on_device),
        gpu_trial("a_cloud_of_many_workgroups_is_followed", many_workgroups),
    ]
}

/// Policies, each with an order of its builds.
fn policies() -> [(RebuildPolicy, BuildOrder); 5] {
    [
        (RebuildPolicy::Never, BuildOrder::Hilbert),
        (RebuildPolicy::Always, BuildOrder::Median),
        (RebuildPolicy::DEFAULT, BuildOrder::Hilbert),
        (RebuildPolicy::VolumeRatio { limit: 2.0 }, BuildOrder::Median),
        (RebuildPolicy::Cost, BuildOrder::Hilbert),
    ]
}

/// Moves clouds by random motions under every policy and asks in every step; returns how often those that decide built.
fn follow(device: Device<'_>, n: usize, n_steps: usize, which: &[usize]) -> u32 {
    let mut random = Random(SEED);
    let all = clouds(n, &mut random);
    let is_thorough = match device {
        Device::Cpu => true,
        Device::Gpu(gpu) => long_cases(gpu),
    };
    let mut n_rebuilds = 0;
    for (name, cloud) in which.iter().map(|&i| &all[i]) {
        let mut points = cloud.clone();
        let start = |(policy, order)| {
            let settings = AabbTreeSettings::DEFAULT.order(order).bucket_size(if n > 200 { 20 } else { 7 });
            let moving = device.start(&points, RADIUS, &settings, policy).unwrap();
            let model = Model::new(&*moving, RADIUS, policy);
            (policy, moving, model)
        };
        let mut subjects: Vec<_> = policies().into_iter().map(start).collect();
        let mut motions = Motion::ALL.to_vec();
        for step in 0..n_steps {
            // Every motion once, then at random.
            let of_all = random.below(Motion::ALL.len() as u32) as usize;
            let motion = if motions.is_empty() {
                Motion::ALL[of_all]
            } else {
                motions.swap_remove(random.below(motions.len() as u32) as usize)
            };
            motion.apply(&mut points, &mut random);
            let questions = Questions::new(&points, &mut random, step, is_thorough);
            let expected = questions.answers(&points, matches!(device, Device::Gpu(_)));
            for (policy, moving, model) in &mut subjects {
                let case = format!("{name}, step {step}, {motion:?}, {policy:?}");
                model.record(&mut **moving, f64::from(random.unit()));
                let report = moving.update(&points).unwrap_or_else(|error| panic!("{case}: {error}"));
                model.check(&**moving, &points, &report, &case);
                moving.set_search(TreeSearch::ALL[step % 3]);
                check_tree(&**moving, &points, &case);
                for ((what, question), expected) in questions.all().iter().zip(&expected) {
                    expected.check(moving.search(), question, &format!("{case}, {what}"));
                }
            }
        }
        for (policy, _, model) in &subjects {
            match policy {
                RebuildPolicy::Never => assert_eq!(model.n_rebuilds, 0),
                RebuildPolicy::Always => assert_eq!(model.n_rebuilds, n_steps as u32),
                _ => n_rebuilds += model.n_rebuilds,
            }
        }
    }
    n_rebuilds
}

/// Invariants of the tree, and positions to the bit.
fn check_tree(moving: &dyn Moving, points: &[Vec3], case: &str) {
    assert_eq!(moving.tree().broken_invariant(), None, "{case}");
    assert_eq!(moving.positions(), points, "{case}");
}

/// What is asked in a step.
struct Questions {
    radii: Vec<f32>,
    others: Vec<Vec3>,
    beyond_all: f32,
    step: usize,
    /// Whether to ask all but the longest lists in every step, or two questions of five.
    is_thorough: bool,
}

impl Questions {
    fn new(points: &[Vec3], random: &mut Random, step: usize, is_thorough: bool) -> Self {
        // From a thirtieth of the radius to thirty times it, both among them.
        let mut radii: Vec<f32> = points.iter().map(|_| RADIUS * 1000f32.powf(random.unit() - 0.5)).collect();
        if let [first, last, ..] = &mut radii[..] {
            (*first, *last) = (RADIUS / 1000f32.sqrt(), RADIUS * 1000f32.sqrt());
        }
        let mut others = uniform(points.len() / 4, random);
        others.extend(points.iter().step_by(7).map(|&p| p + RADIUS * in_box(random)));
        Self { radii, others, beyond_all: beyond_all(points), step, is_thorough }
    }

    fn all(&self) -> Vec<(&'static str, FixedRadius<'_>)> {
        let mut all = vec![
            ("one radius", FixedRadius::new(RADIUS).exclude_self()),
            ("radii 1000 : 1", FixedRadius::each(&self.radii)),
            ("radius 0", FixedRadius::new(0.0)),
            ("other queries", FixedRadius::new(RADIUS).queries(&self.others)),
            ("a radius beyond all", FixedRadius::new(self.beyond_all)),
        ];
        match (self.is_thorough, self.step % 4) {
            (true, 0) => all,
            (true, _) => all[..4].to_vec(),
            (false, which) => vec![all[0], all.swap_remove(1 + which)],
        }
    }

    fn answers(&self, points: &[Vec3], fused: bool) -> Vec<Expected> {
        self.all().iter().map(|(_, question)| Expected::by_loop(points, question, fused)).collect()
    }
}

/// No point, one point, and two.
fn small_sets(device: Device<'_>) {
    let places = [Vec3::new(0.5, -0.25, 2.0), Vec3::new(0.5, -0.125, 2.0)];
    for n in 0..=2 {
        for (policy, order) in policies() {
            let case = format!("{n} points, {policy:?}");
            let mut points = places[..n].to_vec();
            let settings = AabbTreeSettings::DEFAULT.order(order).bucket_size(1);
            let mut moving = device.start(&points, RADIUS, &settings, policy).unwrap();
            let mut model = Model::new(&*moving, RADIUS, policy);
            for step in 0..4 {
                points.iter_mut().for_each(|p| *p *= 1.5);
                model.record(&mut *moving, 1.0 + f64::from(step));
                let report = moving.update(&points).unwrap_or_else(|error| panic!("{case}: {error}"));
                model.check(&*moving, &points, &report, &case);
                check_tree(&*moving, &points, &case);
                for question in [FixedRadius::new(RADIUS), FixedRadius::new(0.0), FixedRadius::new(1e6)] {
                    Expected::by_loop(&points, &question, true).check(moving.search(), &question, &case);
                }
            }
        }
    }
}

/// A kernel of the caller's may leave anything in w.
fn positions_on_device(gpu: &Gpu) {
    let mut random = Random(SEED + 1);
    let mut points = uniform(130, &mut random);
    for (policy, order) in policies() {
        let settings = AabbTreeSettings::DEFAULT.order(order);
        let mut moving = nearfield::GpuMovingPoints::new(gpu, &points, RADIUS, &settings, policy).unwrap();
        for w in [f32::NAN, -3.0] {
            Motion::Drift(1.0).apply(&mut points, &mut random);
            let moved: Vec<[f32; 4]> = points.iter().map(|p| p.extend(w).to_array()).collect();
            let moved = gpu.upload("moved by a kernel", &moved).unwrap();
            moving.update_on_device(&moved).unwrap();
            let case = format!("{policy:?} with {w} in w");
            check_tree(&moving, &points, &case);
            let question = FixedRadius::new(RADIUS).exclude_self();
            Expected::by_loop(&points, &question, true).check(moving.tree(), &question, &case);
        }
    }
}

/// Boxes are compared by many workgroups: the ratio is that of the plain computation, wherever its box stands.
fn many_workgroups(gpu: &Gpu) {
    let mut random = Random(SEED + 2);
    let mut points = uniform(9000, &mut random);
    let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert).bucket_size(4);
    let policy = RebuildPolicy::VolumeRatio { limit: 50.0 };
    let mut moving = Device::Gpu(gpu).start(&points, 0.01, &settings, policy).unwrap();
    let mut model = Model::new(&*moving, 0.01, policy);
    for step in 0..8 {
        Motion::Drift(0.1).apply(&mut points, &mut random);
        // One point far from where it was makes one box large.
        let i = random.below(9000) as usize;
        points[i] += 0.2 * in_box(&mut random);
        let report = moving.update(&points).unwrap();
        model.check(&*moving, &points, &report, &format!("step {step}"));
        check_tree(&*moving, &points, &format!("step {step}"));
    }
    assert!(0 < model.n_rebuilds && model.n_rebuilds < 8, "{} builds", model.n_rebuilds);
}
