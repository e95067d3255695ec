//! Incompressible fluids on a device: as on the CPU while rounding allows, and the same bits by every search.

use libtest_mimic::Trial;
use nearfield::application::Watch;
use nearfield::application::particles::{
    DfsphSettings, Dimensions, Fluid, GpuSimulation, Measures, ParticleModel, ParticleScene, ParticleSearch, Simulate,
    SimulationSettings, SmoothingKernel, StepReport, TimeStep,
};
use nearfield::gpu::Gpu;
use nearfield::{DVec3, Error};

use crate::dem::searches;
use crate::pbf::{SPACING, WIDE, column, disturbed, lattice, scene};
use crate::runs::{on_cpu, run};
use crate::support::{gpu_trial, long_cases};

const GRAVITY: DVec3 = DVec3::new(0.0, -9.81, 0.0);
/// Of the scenes with fixed steps.
const STEP: f64 = 0.004;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("dfsph_on_the_device_is_that_of_the_cpu", device_is_cpu),
        gpu_trial("dfsph_solvers_on_the_device_end_where_those_of_the_cpu_do", solvers_end),
        gpu_trial("dfsph_by_every_search_on_the_device_is_the_same", searches_agree),
        gpu_trial("dfsph_tanks_settle_on_the_device_as_on_the_cpu", tanks_settle),
        gpu_trial("dfsph_columns_of_a_hundred_layers_are_held_up_on_the_device", deep_columns),
        gpu_trial("dfsph_momentum_stays_on_the_device", momentum_stays),
        gpu_trial("dfsph_on_the_device_can_be_none_one_or_all_in_one_place", few_and_coincident),
        gpu_trial("dfsph_steps_by_speed_on_the_device_follow_the_rule", steps_by_speed),
        gpu_trial("dfsph_on_the_device_goes_on_from_saved_particles_and_after_errors", goes_on),
    ]
}

/// The scene with incompressible water.
fn incompressible(mut scene: ParticleScene) -> ParticleScene {
    scene.model = ParticleModel::Dfsph(DfsphSettings::new(Fluid::water(SPACING)));
    scene
}

fn dfsph(scene: &mut ParticleScene) -> &mut DfsphSettings {
    match &mut scene.model {
        ParticleModel::Dfsph(settings) => settings,
        other => panic!("{} is another model", other.name()),
    }
}

fn device_is_cpu(gpu: &Gpu) {
    let mut most_pressed = 0.0;
    for (dimensions, support, smoothing) in [
        (Dimensions::Three, 2.0, SmoothingKernel::CubicSpline),
        (Dimensions::Three, 2.7, SmoothingKernel::Wendland),
        (Dimensions::Two, 2.0, SmoothingKernel::Wendland),
        (Dimensions::Two, 2.7, SmoothingKernel::CubicSpline),
    ] {
        let mut scene = incompressible(disturbed(dimensions, 4));
        let model = dfsph(&mut scene);
        (model.fluid.support, model.smoothing) = (support * SPACING, smoothing);
        (model.viscosity, model.xsph) = (0.01, 0.05);
        // So that both solvers make all iterations there are, but where nothing diverges at all.
        (model.divergence_tolerance, model.density_tolerance, model.most_iterations) = (1e-12, 1e-12, 4);
        for deterministic in [false, true] {
            let settings = SimulationSettings { deterministic, reorder_every: 2, ..SimulationSettings::default() };
            let (expected, expected_reports) = on_cpu(&scene, &settings, 3);
            let (found, reports) = run(gpu, &scene, &settings, 3);
            let alone = |i: usize| scene.particles.positions[i] + 3.0 * STEP * scene.particles.velocities[i];
            let largest = |of: &dyn Fn(usize) -> f64| (0..found.len()).map(of).fold(0.0, f64::max);
            let pushed = largest(&|i| expected.positions[i].distance(alone(i)));
            assert!(pushed > 0.05 * SPACING, "nothing is pushed farther than {pushed}");
            // Places below 1 are rounded by up to 6e-8 at the start of each of three steps and at its end. Offsets are then off by some 3e-7
            // supports, and gradients and densities, and so what is pushed, by some 1e-6 of themselves.
            let bound = 3.0 * 1.2e-7 + 1e-6 * pushed;
            let apart = largest(&|i| found.positions[i].distance(expected.positions[i]));
            let faster = largest(&|i| found.velocities[i].distance(expected.velocities[i]));
            let denser = largest(&|i| (found.densities[i] / expected.densities[i] - 1.0).abs());
            let what = format!("{dimensions:?}, support {support}, {}", smoothing.name());
            println!("{what}: {apart:e} apart, {faster:e} faster, {denser:e} denser, {pushed:e} pushed");
            assert!(apart <= bound, "{what}: {apart:e} apart");
            assert!(faster <= 2e-6 * pushed / STEP, "{what}: {faster:e} faster");
            assert!(denser <= 2.0 * bound / SPACING, "{what}: {denser:e} denser");
            // Velocities are off by a millionth, and pressures by as much in parts of what they push, over a spacing or two.
            let pressed = expected.pressures.iter().copied().fold(0.0, f64::max);
            let harder = largest(&|i| (found.pressures[i] - expected.pressures[i]).abs());
            println!("{what}: pressures off by {harder:e} of {pressed:e}");
            assert!(harder <= 1e-4 * pressed, "{what}: pressures off by {harder:e} of {pressed:e}");
            most_pressed = pressed.max(most_pressed);
            assert!(expected_reports[0].density_error[1] > 1e-3, "nothing is compressed: {expected_reports:?}");
            for (found, expected) in reports.iter().zip(&expected_reports) {
                assert_eq!((found.step, found.iterations), (expected.step, expected.iterations));
                assert!((found.mean_neighbors - expected.mean_neighbors).abs() < 1e-5, "{found:?} and {expected:?}");
                for (found, expected) in found.density_error.iter().zip(&expected.density_error) {
                    assert!((found - expected).abs() <= 2.0 * bound / SPACING, "{what}: {found} for {expected}");
                }
            }
        }
    }
    assert!(most_pressed > 0.0, "nothing is pressed in the last steps");
}

fn solvers_end(gpu: &Gpu) {
    let scene = incompressible(disturbed(Dimensions::Three, 6));
    let settings = SimulationSettings::default();
    let (_, expected) = on_cpu(&scene, &settings, 4);
    let (_, reports) = run(gpu, &scene, &settings, 4);
    for (found, expected) in reports.iter().zip(&expected) {
        println!("{} iterations for {}, {:?}", found.iterations, expected.iterations, found.density_error);
        assert!(found.density_error[0] <= 1e-4 * (1.0 + 1e-6), "{found:?}");
        // Means are as near to the tolerance as rounding lets them: each of the two solvers may take one more or one less.
        assert!(found.iterations.abs_diff(expected.iterations) <= 2, "{found:?} and {expected:?}");
    }
    assert!(reports.iter().any(|report| report.iterations > 8), "{reports:?}");
    // The last iterations that there can be end a solver whatever is left.
    for most in [1, 2, 30] {
        let mut strict = scene.clone();
        let model = dfsph(&mut strict);
        (model.divergence_tolerance, model.density_tolerance, model.most_iterations) = (1e-12, 1e-12, most);
        let (_, reports) = run(gpu, &strict, &settings, 1);
        assert_eq!(reports[0].iterations, 2 * most);
    }
}

fn searches_agree(gpu: &Gpu) {
    let mut scene = incompressible(disturbed(Dimensions::Three, 4));
    (dfsph(&mut scene).viscosity, dfsph(&mut scene).xsph) = (0.01, 0.05);
    let settings = |search| SimulationSettings { search, deterministic: true, reorder_every: 7, ..Default::default() };
    let (expected, expected_reports) = run(gpu, &scene, &settings(ParticleSearch::BruteForce), 10);
    for search in searches() {
        let (found, reports) = run(gpu, &scene, &settings(search), 10);
        assert!(found == expected, "{search} gives another fluid");
        let did = |reports: &[StepReport]| {
            reports.iter().map(|r| (r.mean_neighbors, r.iterations, r.density_error)).collect::<Vec<_>>()
        };
        assert_eq!(did(&reports), did(&expected_reports), "{search}");
    }
}

fn tanks_settle(gpu: &Gpu) {
    let (size, steps) = if long_cases(gpu) { ([8, 12, 8], 100) } else { ([5, 8, 5], 40) };
    let scene = incompressible(column(Dimensions::Three, size));
    let settings = SimulationSettings::default();
    let mut simulation = GpuSimulation::new(gpu, &scene, &settings).unwrap();
    let reports = simulation.advance(steps, &mut Watch::none()).unwrap();
    let measures = simulation.measure().unwrap();
    let (on_cpu, expected_reports) = on_cpu(&scene, &settings, steps);
    let expected = Measures::of(&scene, &on_cpu);
    let iterations = |reports: &[StepReport]| reports.iter().map(|report| f64::from(report.iterations)).sum::<f64>();
    let (made, expected_made) = (iterations(&reports), iterations(&expected_reports));
    let height = f64::from(size[1]) * SPACING;
    let lower = (expected.mean_position.y - measures.mean_position.y) / height;
    println!("{made} iterations for {expected_made}, {lower:e} of the height lower, {measures:?} for {expected:?}");
    for report in &reports {
        assert!(report.density_error[0] <= 1e-4 * (1.0 + 1e-6), "{report:?}");
    }
    // What rounding starts has grown a hundred times and more when the fluid has settled, but stays far below what these say of it.
    assert!(lower.abs() <= 1e-3, "{} for {}", measures.mean_position, expected.mean_position);
    assert!((made / expected_made - 1.0).abs() <= 0.05, "{made} iterations for {expected_made}");
    assert!((measures.energy() / expected.energy() - 1.0).abs() <= 1e-3, "{measures:?} for {expected:?}");
    // Walls stand half a spacing outside of the domain.
    let [low, high] = [scene.domain[0] - 0.5 * SPACING, scene.domain[1] + 0.5 * SPACING];
    assert!(measures.min.cmpge(low).all() && measures.max.cmple(high).all(), "{measures:?}");
    // It has begun to settle.
    assert!(measures.mean_position.y < 0.495 * height, "{measures:?}");
}

fn deep_columns(gpu: &Gpu) {
    let scene = crate::sph::column();
    let (settings, steps) = (SimulationSettings { reorder_every: 10, ..Default::default() }, 60);
    let mut simulation = GpuSimulation::new(gpu, &scene, &settings).unwrap();
    let reports = simulation.advance(steps, &mut Watch::none()).unwrap();
    let measures = simulation.measure().unwrap();
    let (on_cpu, expected_reports) = on_cpu(&scene, &settings, steps);
    let expected = Measures::of(&scene, &on_cpu);
    let iterations = |reports: &[StepReport]| reports.iter().map(|report| f64::from(report.iterations)).sum::<f64>();
    let (made, expected_made) = (iterations(&reports), iterations(&expected_reports));
    println!("{made} iterations for {expected_made}, {measures:?} for {expected:?}");
    for (found, expected) in reports.iter().zip(&expected_reports) {
        assert!(found.density_error[0] <= 2e-4, "{found:?}");
        assert!((found.time_step / expected.time_step - 1.0).abs() < 0.2, "{found:?} for {expected:?}");
    }
    assert!((measures.mean_position.y / expected.mean_position.y - 1.0).abs() < 2e-3, "{measures:?}");
    assert!((made / expected_made - 1.0).abs() <= 0.2, "{made} iterations for {expected_made}");
    assert!(measures.max.y > 0.98 && measures.max_compression < 0.02, "{measures:?}");
}

fn momentum_stays(gpu: &Gpu) {
    let mut scene = incompressible(disturbed(Dimensions::Three, 4));
    (scene.boundary, scene.gravity, scene.domain) = (Vec::new(), DVec3::ZERO, [-0.2 * WIDE, 0.2 * WIDE]);
    (dfsph(&mut scene).viscosity, dfsph(&mut scene).xsph) = (0.01, 0.05);
    let before = Measures::of(&scene, &scene.particles);
    let (particles, _) = run(gpu, &scene, &SimulationSettings::default(), 50);
    let after = Measures::of(&scene, &particles);
    let all: f64 = particles.velocities.iter().map(|velocity| SPACING.powi(3) * 1000.0 * velocity.length()).sum();
    let drift = (after.momentum - before.momentum).length() / all;
    // Offsets between places below 2 are exact, so that pairs push each other alike but for the rounding of sums: 6e-8 of what some twenty
    // iterations of 50 steps move, 120 particles one way or the other.
    println!("momentum drifts by {drift:e}");
    assert!(drift <= 1e-5, "momentum drifts by {drift:e}");
    let faster = (0..particles.len()).map(|i| particles.velocities[i].distance(scene.particles.velocities[i]));
    assert!(faster.fold(0.0, f64::max) > 0.5, "the block has not pushed itself apart");
}

fn few_and_coincident(gpu: &Gpu) {
    for n in [0, 1, 50] {
        for dimensions in [Dimensions::Two, Dimensions::Three] {
            let mut scene = incompressible(scene(dimensions, vec![DVec3::new(1.0, 1.0, 0.0); n], 0.01));
            scene.gravity = DVec3::new(0.0, -10.0, 0.0);
            scene.boundary = vec![DVec3::new(-3.0, 0.0, 0.0)];
            // The others of a heap have no direction to give way in.
            dfsph(&mut scene).most_iterations = 3;
            for search in searches() {
                let settings = SimulationSettings { search, ..Default::default() };
                let (particles, reports) = run(gpu, &scene, &settings, 4);
                // 10 · 0.01² · (1 + 2 + 3 + 4) below the start, 10 · 0.01 · 4 fast.
                let (fallen, speed) = (DVec3::new(1.0, 0.99, 0.0), DVec3::new(0.0, -0.4, 0.0));
                assert!(particles.positions.iter().all(|p| p.distance(fallen) < 1e-6), "{search}: {particles:?}");
                assert!(particles.velocities.iter().all(|v| v.distance(speed) < 1e-6), "{search}: {particles:?}");
                let others = n.saturating_sub(1) as f64;
                assert_eq!((particles.len(), reports[3].mean_neighbors), (n, others), "{search}");
                // One for the divergence, two for the density at least; a heap is never done.
                assert_eq!(reports[3].iterations, if n > 1 { 4 } else { 3 }, "{search}");
            }
        }
    }
}

fn steps_by_speed(gpu: &Gpu) {
    let mut scene = incompressible(scene(Dimensions::Three, lattice([2, 2, 2], 3.0 * SPACING, DVec3::ZERO), 0.01));
    scene.gravity = GRAVITY;
    scene.time_step = TimeStep::Cfl { factor: 0.5, least: 1e-4, most: 1.0 };
    let settings = SimulationSettings::default();
    let (_, expected) = on_cpu(&scene, &settings, 12);
    let (_, found) = run(gpu, &scene, &settings, 12);
    // Two layers that are three spacings apart.
    let longest = SPACING / (9.81 * 3.0 * SPACING).sqrt();
    let rule = |time: f64| 0.5 * (SPACING / ((9.81 * SPACING).sqrt() + 9.81 * time)).min(longest);
    for report in &found {
        let step = rule(report.time - report.time_step);
        assert!((report.time_step / step - 1.0).abs() < 1e-5, "{report:?} for {step}");
        // What the CPU would have done at this speed.
        let speed = 9.81 * (report.time - report.time_step);
        let on_cpu = (SPACING / (speed + (speed * speed + 4.0 * 9.81 * SPACING).sqrt())).min(0.5 * longest);
        let part = report.time_step / on_cpu;
        assert!((0.8 - 1e-5..1.0 + 1e-5).contains(&part), "{part} of the step on the CPU");
    }
    assert!((found[0].time_step / expected[0].time_step - 1.0).abs() < 1e-6, "from rest: {:?}", found[0]);
    // With much viscosity, half the time in which it spreads over half a support.
    dfsph(&mut scene).viscosity = 2.0;
    let (_, expected) = on_cpu(&scene, &settings, 1);
    let (_, found) = run(gpu, &scene, &settings, 1);
    assert!((found[0].time_step / expected[0].time_step - 1.0).abs() < 1e-6, "{:?} for {:?}", found[0], expected[0]);
    assert!((found[0].time_step / (0.5 * 0.5 * SPACING * SPACING / 2.0) - 1.0).abs() < 1e-6, "{:?}", found[0]);
}

fn goes_on(gpu: &Gpu) {
    let mut scene = incompressible(disturbed(Dimensions::Three, 4));
    scene.domain = [-0.4 * WIDE, 0.4 * WIDE];
    let settings =
        SimulationSettings { deterministic: true, reorder_every: 0, max_speed: 1e6, ..SimulationSettings::default() };
    let mut simulation = GpuSimulation::new(gpu, &scene, &settings).unwrap();
    let first = simulation.advance(3, &mut Watch::none()).unwrap();
    let saved = simulation.particles().unwrap();
    simulation.advance(3, &mut Watch::none()).unwrap();
    let expected = simulation.particles().unwrap();
    simulation.resume(&saved, 3, first[2].time).unwrap();
    simulation.advance(3, &mut Watch::none()).unwrap();
    assert!(simulation.particles().unwrap() == expected, "saved particles go another way");
    let mut wild = saved.clone();
    wild.velocities[7] = DVec3::new(0.0, 1e9, 0.0);
    simulation.resume(&wild, 3, first[2].time).unwrap();
    let ended = simulation.advance(2, &mut Watch::none());
    assert!(matches!(ended, Err(Error::BlowUp { step: 4, .. })), "{ended:?}");
    assert_eq!(simulation.particles().unwrap().positions, wild.positions);
    simulation.resume(&saved, 3, first[2].time).unwrap();
    simulation.advance(3, &mut Watch::none()).unwrap();
    assert!(simulation.particles().unwrap() == expected, "particles go another way after an error");
}
