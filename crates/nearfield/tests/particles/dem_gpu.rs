//! Grains on a device: as on the CPU while rounding allows, and the same bits by every search.

use libtest_mimic::Trial;
use nearfield::Error;
use nearfield::application::Watch;
use nearfield::application::particles::{
    GpuSimulation, Measures, PairRule, ParticleModel, ParticleSearch, Particles, Simulate, Simulation,
    SimulationSettings, StepReport,
};
use nearfield::gpu::Gpu;

use crate::dem::{falling, few_grains, in_the_plane, search_is_timed, searches, shot_grain, three_classes};
use crate::runs::run;
use crate::support::gpu_trial;

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![
        gpu_trial("grains_on_the_device_are_those_of_the_cpu", device_is_cpu),
        gpu_trial("momentum_stays_on_the_device", momentum_stays),
        gpu_trial("grains_in_the_plane_stay_there_on_the_device", plane_is_kept),
        gpu_trial("grains_that_are_no_numbers_are_named_on_the_device", not_a_number_is_told),
        gpu_trial("grains_on_the_device_can_be_none_one_or_all_in_one_place", few_and_coincident),
        gpu_trial("grains_that_are_too_fast_end_the_simulation_on_the_device", blow_up_is_told),
        gpu_trial("steps_before_a_blow_up_on_the_device_are_reported", finished_steps_are_reported),
        gpu_trial("a_grain_shot_at_a_wall_stays_in_the_domain_on_the_device", shot_grain_stays),
        gpu_trial("a_simulation_on_the_device_goes_on_from_saved_grains", resumes),
        gpu_trial("a_search_by_itself_on_the_device_counts_all_and_changes_nothing", searches_are_timed),
    ];
    for rule in PairRule::ALL {
        let name = format!("every_search_gives_the_same_grains_on_the_device_{}", rule.name());
        trials.push(gpu_trial(name, move |gpu| searches_agree(gpu, rule)));
    }
    trials
}

fn device_is_cpu(gpu: &Gpu) {
    // Single precision moves a coordinate in a box of side 2 by 6e-8 a step, so the direction of a contact by some 4e-6: in ten steps most grains
    // stay within a millionth. But a pair at the very border may touch a step earlier or later, which hands over up to 0.12 of its relative
    // velocity of some 0.003 in half a unit of time.
    let (most, mean) = (2e-4, 1e-6);
    for scene in [few_grains(2000), three_classes(PairRule::Contact)] {
        for deterministic in [false, true] {
            let settings = SimulationSettings { deterministic, reorder_every: 4, ..SimulationSettings::default() };
            let mut cpu = Simulation::new(&scene, &settings).unwrap();
            let expected_reports = cpu.advance(10, &mut Watch::none()).unwrap();
            let expected = cpu.particles().unwrap();
            let (found, reports) = run(gpu, &scene, &settings, 10);
            assert_eq!(found.classes, expected.classes);
            let apart = found.positions.iter().zip(&expected.positions).map(|(a, b)| (*a - *b).length());
            let (sum, largest) = apart.fold((0.0, 0.0_f64), |(sum, largest), d| (sum + d, largest.max(d)));
            let is_near = largest < most && sum < mean * expected.len() as f64;
            assert!(is_near, "{}: {largest:e} at most, {:e} on average", scene.name, sum / expected.len() as f64);
            for (found, expected) in reports.iter().zip(&expected_reports) {
                assert_eq!((found.step, found.time_step), (expected.step, expected.time_step));
                assert!((found.time - expected.time).abs() < 1e-6);
                assert!((found.mean_neighbors - expected.mean_neighbors).abs() < 0.02, "{found:?} and {expected:?}");
            }
        }
    }
}

fn momentum_stays(gpu: &Gpu) {
    let mut scene = three_classes(PairRule::Contact);
    scene.gravity = nearfield::DVec3::ZERO;
    scene.domain = [nearfield::DVec3::splat(-10.0), nearfield::DVec3::splat(10.0)];
    let before = Measures::of(&scene, &scene.particles);
    for (deterministic, spring) in [(false, 0.02), (true, 0.02), (false, 0.0), (true, 0.0)] {
        if let ParticleModel::Dem(settings) = &mut scene.model {
            settings.spring = spring;
        }
        let settings = SimulationSettings { deterministic, ..SimulationSettings::default() };
        let (particles, _) = run(gpu, &scene, &settings, 50);
        let after = Measures::of(&scene, &particles);
        let moved = particles.velocities.iter().map(|v| v.length()).sum::<f64>();
        let drift = (after.momentum - before.momentum).length();
        assert!(drift <= 1e-6 * moved, "{deterministic}, {spring}: {} to {}", before.momentum, after.momentum);
    }
}

fn plane_is_kept(gpu: &Gpu) {
    let mut scene = in_the_plane();
    // A middle that single precision does not have.
    (scene.domain[0].z, scene.domain[1].z) = (0.0, 0.2);
    let (particles, _) = run(gpu, &scene, &SimulationSettings::default(), 20);
    assert!(particles.positions.iter().chain(&particles.velocities).all(|vector| vector.z == 0.0));
    let mut resumed = GpuSimulation::new(gpu, &scene, &SimulationSettings::default()).unwrap();
    resumed.resume(&particles, 20, 10.0).unwrap();
}

fn not_a_number_is_told(gpu: &Gpu) {
    let mut scene = three_classes(PairRule::Contact);
    // Pushes that no number has: the velocities of all that touch are infinite or none.
    if let ParticleModel::Dem(settings) = &mut scene.model {
        settings.spring = 1e38;
    }
    for search in searches() {
        let mut simulation =
            GpuSimulation::new(gpu, &scene, &SimulationSettings { search, ..Default::default() }).unwrap();
        let ended = simulation.advance(5, &mut Watch::none());
        assert!(matches!(ended, Err(Error::BlowUp { step: 1 | 2, .. })), "{search}: {ended:?}");
        assert!(simulation.particles().unwrap().positions.iter().all(|p| p.is_finite()), "{search}");
    }
}

fn few_and_coincident(gpu: &Gpu) {
    for n in [0, 1] {
        let mut scene = few_grains(1);
        // Away from all walls.
        scene.particles = Particles::at_rest(vec![nearfield::DVec3::ZERO; n as usize]);
        for search in searches() {
            let (particles, reports) = run(gpu, &scene, &SimulationSettings { search, ..Default::default() }, 3);
            assert_eq!((particles.len(), reports.len()), (n as usize, 3), "{search}");
            let fallen = f64::from(n) * -0.0003 * 0.5 * 3.0;
            assert!((Measures::of(&scene, &particles).momentum.y - fallen).abs() < 1e-9, "{search}");
        }
    }
    let mut scene = few_grains(50);
    scene.particles.positions.fill(nearfield::DVec3::splat(0.25));
    for search in searches() {
        let (particles, _) = run(gpu, &scene, &SimulationSettings { search, ..Default::default() }, 3);
        assert!(particles.positions.iter().all(|p| *p == particles.positions[0] && p.is_finite()), "{search}");
    }
}

fn searches_agree(gpu: &Gpu, rule: PairRule) {
    let scene = three_classes(rule);
    let settings = |search| SimulationSettings { search, deterministic: true, reorder_every: 7, ..Default::default() };
    let (expected, expected_reports) = run(gpu, &scene, &settings(ParticleSearch::BruteForce), 25);
    for search in searches() {
        let (found, reports) = run(gpu, &scene, &settings(search), 25);
        assert_eq!(found, expected, "{search}");
        let neighbors = |reports: &[StepReport]| reports.iter().map(|r| r.mean_neighbors).collect::<Vec<_>>();
        assert_eq!(neighbors(&reports), neighbors(&expected_reports), "{search}");
    }
}

fn blow_up_is_told(gpu: &Gpu) {
    let mut scene = few_grains(300);
    scene.particles.velocities[41] = nearfield::DVec3::new(0.0, 0.5, 0.0);
    let settings = SimulationSettings { max_speed: 0.4, ..SimulationSettings::default() };
    let mut simulation = GpuSimulation::new(gpu, &scene, &settings).unwrap();
    match simulation.advance(5, &mut Watch::none()) {
        Err(Error::BlowUp { step, particle, speed, limit, .. }) => {
            assert_eq!((step, particle, limit), (1, 41, 0.4));
            assert!(speed > limit, "{speed}");
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(simulation.step(), 0);
    let kept = simulation.particles().unwrap();
    assert_eq!(kept.velocities[41].y, 0.5);
}

fn finished_steps_are_reported(gpu: &Gpu) {
    let (scene, settings) = falling();
    for search in [ParticleSearch::UNIFORM_GRID, ParticleSearch::Verlet { skin: ParticleSearch::SKIN }] {
        let settings = SimulationSettings { search, ..settings };
        let mut simulation = GpuSimulation::new(gpu, &scene, &settings).unwrap();
        // The first submission is of one step; how many the next ones have, and so lose, depends on its time.
        let ended = simulation.advance(9, &mut Watch::none());
        assert!(matches!(ended, Err(Error::BlowUp { step: 7, .. })), "{search}: {ended:?}");
        let reports = simulation.take_reports();
        let steps: Vec<u64> = reports.iter().map(|report| report.step).collect();
        assert_eq!(steps, (1..=simulation.step()).collect::<Vec<u64>>(), "{search}");
        assert!(!steps.is_empty() && reports.last().map(|last| last.time) == Some(simulation.time()), "{search}");
        assert!(simulation.take_reports().is_empty(), "{search}");
        // Step by step none is lost.
        while simulation.step() < 6 {
            assert_eq!(simulation.advance(1, &mut Watch::none()).unwrap().len(), 1, "{search}");
        }
        assert!(simulation.advance(1, &mut Watch::none()).is_err() && simulation.take_reports().is_empty());
        // Nor is anything left where a simulation begins again, or makes a step that is timed.
        for is_timed in [false, true] {
            simulation.resume(&scene.particles, 0, 0.0).unwrap();
            assert!(simulation.advance(9, &mut Watch::none()).is_err(), "{search}");
            if is_timed {
                let _ = simulation.advance_timed();
            } else {
                simulation.resume(&scene.particles, 0, 0.0).unwrap();
            }
            assert!(simulation.take_reports().is_empty(), "{search}, {is_timed}");
        }
    }
}

fn shot_grain_stays(gpu: &Gpu) {
    let scene = shot_grain();
    let mut simulation = GpuSimulation::new(gpu, &scene, &SimulationSettings::default()).unwrap();
    for _ in 0..5 {
        simulation.advance(1, &mut Watch::none()).unwrap();
        let measures = simulation.measure().unwrap();
        assert!(measures.outside == 0 && measures.max_speed > 1.0, "{measures:?}");
    }
}

fn searches_are_timed(gpu: &Gpu) {
    let scene = few_grains(500);
    for search in searches() {
        let settings = SimulationSettings { search, deterministic: true, ..SimulationSettings::default() };
        let start = || -> Box<dyn Simulate> { Box::new(GpuSimulation::new(gpu, &scene, &settings).unwrap()) };
        search_is_timed(&start, &scene, &search.to_string());
    }
}

fn resumes(gpu: &Gpu) {
    let scene = three_classes(PairRule::Contact);
    let settings = SimulationSettings { deterministic: true, reorder_every: 0, ..SimulationSettings::default() };
    let (expected, _) = run(gpu, &scene, &settings, 20);
    let (half, _) = run(gpu, &scene, &settings, 10);
    let mut resumed = GpuSimulation::new(gpu, &scene, &settings).unwrap();
    resumed.resume(&half, 10, 5.0).unwrap();
    resumed.advance(10, &mut Watch::none()).unwrap();
    assert_eq!((resumed.step(), resumed.time()), (20, 10.0));
    let found = resumed.particles().unwrap();
    for (a, b) in found.positions.iter().zip(&expected.positions) {
        // The domain's middle is added and taken off on the way.
        assert!((*a - *b).length() < 1e-5, "{a} and {b}");
    }
}
