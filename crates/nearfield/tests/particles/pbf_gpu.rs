//! Position-based fluids on a device: as on the CPU while rounding allows, and the same bits by every search.

use libtest_mimic::Trial;
use nearfield::DVec3;
use nearfield::application::Watch;
use nearfield::application::particles::{
    Dimensions, GpuSimulation, Measures, ParticleScene, ParticleSearch, Simulate, SimulationSettings, StepReport,
    TimeStep,
};
use nearfield::gpu::Gpu;

use crate::dem::searches;
use crate::pbf::{SPACING, WIDE, column, disturbed, lattice, pbf, scene};
use crate::runs::{on_cpu, run};
use crate::support::{gpu_trial, long_cases};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("position_based_fluids_on_the_device_are_those_of_the_cpu", device_is_cpu),
        gpu_trial("iterations_on_the_device_end_where_those_of_the_cpu_do", iterations_end),
        gpu_trial("every_search_gives_the_same_position_based_fluid_on_the_device", searches_agree),
        gpu_trial("columns_rest_on_the_device", columns_rest),
        gpu_trial("momentum_of_position_based_fluids_stays_on_the_device", momentum_stays),
        gpu_trial("position_based_fluids_on_the_device_can_be_none_one_or_all_in_one_place", few_and_coincident),
        gpu_trial("steps_by_speed_on_the_device_are_those_of_the_cpu", steps_by_speed),
    ]
}

fn device_is_cpu(gpu: &Gpu) {
    // Places below 1 are rounded by up to 6e-8 in each of twelve rounds, and a little more by the sums of some thirty terms; velocities have that
    // over the step.
    let bound = 10.0 * f64::from(f32::EPSILON);
    for (dimensions, support) in [(Dimensions::Three, 2.0), (Dimensions::Three, 2.7), (Dimensions::Two, 2.0)] {
        let mut scene = disturbed(dimensions, 4);
        pbf(&mut scene).fluid.support = support * SPACING;
        for deterministic in [false, true] {
            let settings = SimulationSettings { deterministic, reorder_every: 2, ..SimulationSettings::default() };
            let (expected, expected_reports) = on_cpu(&scene, &settings, 3);
            let (found, reports) = run(gpu, &scene, &settings, 3);
            let largest = |of: &dyn Fn(usize) -> f64| (0..found.len()).map(of).fold(0.0, f64::max);
            let apart = largest(&|i| found.positions[i].distance(expected.positions[i]));
            let faster = largest(&|i| found.velocities[i].distance(expected.velocities[i]));
            let denser = largest(&|i| (found.densities[i] / expected.densities[i] - 1.0).abs());
            println!("{dimensions:?}, support {support}: {apart:e} apart, {faster:e} faster, {denser:e} denser");
            assert!(apart <= bound, "{dimensions:?}, support {support}: {apart:e} apart");
            assert!(faster <= bound / 0.004, "{dimensions:?}, support {support}: {faster:e} faster");
            assert!(denser <= 2.0 * bound / SPACING, "{dimensions:?}, support {support}: {denser:e} denser");
            for (found, expected) in reports.iter().zip(&expected_reports) {
                assert_eq!((found.step, found.iterations), (expected.step, expected.iterations));
                assert!((found.mean_neighbors - expected.mean_neighbors).abs() < 0.1, "{found:?} and {expected:?}");
                let off = |of: usize| (found.density_error[of] - expected.density_error[of]).abs();
                assert!(
                    off(0) <= 2.0 * bound / SPACING && off(1) <= 2.0 * bound / SPACING,
                    "{found:?} and {expected:?}"
                );
            }
        }
    }
}

fn iterations_end(gpu: &Gpu) {
    let mut scene = disturbed(Dimensions::Three, 6);
    let settings = pbf(&mut scene);
    (settings.iterations, settings.most_iterations, settings.tolerance) = (2, 60, 2e-3);
    let settings = SimulationSettings::default();
    let (_, expected) = on_cpu(&scene, &settings, 2);
    let (_, reports) = run(gpu, &scene, &settings, 2);
    for (found, expected) in reports.iter().zip(&expected) {
        assert!(found.iterations == 60 || found.density_error[0] <= 2e-3 * (1.0 + 1e-5), "{found:?}");
        assert!(found.iterations.abs_diff(expected.iterations) <= 1, "{found:?} and {expected:?}");
    }
    assert!(reports.iter().any(|report| (3..60).contains(&report.iterations)), "{reports:?}");
}

fn searches_agree(gpu: &Gpu) {
    let scene = disturbed(Dimensions::Three, 4);
    let settings = |search| SimulationSettings { search, deterministic: true, reorder_every: 7, ..Default::default() };
    let (expected, expected_reports) = run(gpu, &scene, &settings(ParticleSearch::BruteForce), 15);
    for search in searches() {
        let (found, reports) = run(gpu, &scene, &settings(search), 15);
        assert!(found == expected, "{search} gives another fluid");
        let did =
            |reports: &[StepReport]| reports.iter().map(|r| (r.mean_neighbors, r.density_error)).collect::<Vec<_>>();
        assert_eq!(did(&reports), did(&expected_reports), "{search}");
    }
}

fn columns_rest(gpu: &Gpu) {
    let (size, seconds) = if long_cases(gpu) { ([8, 12, 8], 10) } else { ([4, 8, 4], 1) };
    let mut scene = column(Dimensions::Three, size);
    // Rounds that ask the host are tested above; a fixed number that is enough here runs by itself.
    (pbf(&mut scene).iterations, pbf(&mut scene).most_iterations) = (8, 8);
    let mut simulation = GpuSimulation::new(gpu, &scene, &SimulationSettings::default()).unwrap();
    for second in 1..=seconds {
        let reports = simulation.advance(200, &mut Watch::none()).unwrap();
        let largest = |of: usize| reports.iter().map(|report| report.density_error[of]).fold(0.0, f64::max);
        let measures = simulation.measure().unwrap();
        let height = 2.0 * measures.mean_position.y / (f64::from(size[1]) * SPACING);
        println!("{second} s: density error {:.5} and {:.4}, height {height:.4}", largest(0), largest(1));
        assert!(largest(0) <= 1e-3 && largest(1) <= 2e-2, "after {second} s: {} and {}", largest(0), largest(1));
        assert!((height - 1.0).abs() <= 0.02, "after {second} s: {height} of the height");
        // Faces of the domain are rounded to single precision.
        let [low, high] = [scene.domain[0] - 1e-6, scene.domain[1] + 1e-6];
        assert!(measures.min.cmpge(low).all() && measures.max.cmple(high).all(), "after {second} s: {measures:?}");
    }
}

fn momentum_stays(gpu: &Gpu) {
    let mut scene = disturbed(Dimensions::Three, 4);
    (scene.boundary, scene.gravity, scene.domain) = (Vec::new(), DVec3::ZERO, [-0.2 * WIDE, 0.2 * WIDE]);
    (pbf(&mut scene).xsph, pbf(&mut scene).vorticity) = (0.0, 0.0);
    let before = Measures::of(&scene, &scene.particles);
    let (particles, _) = run(gpu, &scene, &SimulationSettings::default(), 50);
    let after = Measures::of(&scene, &particles);
    let all: f64 = particles.velocities.iter().map(|velocity| SPACING.powi(3) * 1000.0 * velocity.length()).sum();
    let drift = (after.momentum - before.momentum).length() / all;
    // Places below 2 are rounded by up to 1.2e-7 in each of four rounds of 50 steps of 0.004, 120 particles one way or the other: over
    // speeds of some 2 that is 6e-8 · √(4 · 50) / 0.004 / 2 / √120.
    println!("momentum drifts by {drift:e}");
    assert!(drift <= 1e-5, "momentum drifts by {drift:e}");
    assert!(after.energy() > 2.0 * before.energy(), "the block has not pushed itself apart");
}

fn few_and_coincident(gpu: &Gpu) {
    for n in [0, 1, 50] {
        let mut scene = scene(Dimensions::Three, vec![DVec3::new(1.0, 1.0, 0.0); n], 0.01);
        scene.gravity = DVec3::new(0.0, -10.0, 0.0);
        pbf(&mut scene).vorticity = 1.0;
        let check = |scene: &ParticleScene, search: ParticleSearch| {
            let settings = SimulationSettings { search, ..Default::default() };
            let (particles, reports) = run(gpu, scene, &settings, 4);
            // 10 · 0.01² · (1 + 2 + 3 + 4) below the start.
            let fallen = DVec3::new(1.0, 0.99, 0.0);
            assert!(particles.positions.iter().all(|p| p.distance(fallen) < 1e-6), "{search}: {particles:?}");
            let others = n.saturating_sub(1) as f64;
            assert_eq!((particles.len(), reports[3].mean_neighbors), (n, others), "{search}");
        };
        for search in ParticleSearch::ALL {
            check(&scene, search);
        }
        scene.dimensions = Dimensions::Two;
        check(&scene, ParticleSearch::UNIFORM_GRID);
    }
}

fn steps_by_speed(gpu: &Gpu) {
    let mut scene = scene(Dimensions::Three, lattice([3, 3, 3], SPACING, DVec3::ZERO), 0.01);
    scene.gravity = DVec3::new(0.0, -9.81, 0.0);
    scene.time_step = TimeStep::Cfl { factor: 0.5, least: 1e-4, most: 1.0 };
    let (_, expected) = on_cpu(&scene, &SimulationSettings::default(), 5);
    let (_, found) = run(gpu, &scene, &SimulationSettings::default(), 5);
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found.time_step / expected.time_step - 1.0).abs() < 1e-4, "{found:?} and {expected:?}");
    }
}
