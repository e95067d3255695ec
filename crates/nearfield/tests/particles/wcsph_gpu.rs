//! Weakly compressible fluids on a device: as on the CPU while rounding allows, and the same bits by every search.

use libtest_mimic::Trial;
use nearfield::application::Watch;
use nearfield::application::particles::{
    Dimensions, Fluid, GpuSimulation, Measures, ParticleModel, ParticleScene, ParticleSearch, Particles, Simulate,
    SimulationSettings, SmoothingKernel, StepReport, TimeStep, WcsphSettings,
};
use nearfield::gpu::Gpu;
use nearfield::{DVec3, Error};

use crate::dem::searches;
use crate::pbf::{SPACING, WIDE, column, disturbed, lattice, scene};
use crate::runs::{on_cpu, run};
use crate::support::{Random, gpu_trial, long_cases};

const SEED: u64 = 21;
const SOUND: f64 = 20.0;
/// Of the scenes with fixed steps.
const STEP: f64 = 0.001;
/// Steps at which the device is compared with the CPU.
const STEPS: u32 = 3;

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        gpu_trial("wcsph_on_the_device_is_that_of_the_cpu", device_is_cpu),
        gpu_trial("wcsph_pressures_on_the_device_follow_any_exponent", exponents),
        gpu_trial("wcsph_by_every_search_on_the_device_is_the_same", searches_agree),
        gpu_trial("wcsph_tanks_rest_on_the_device", tanks_rest),
        gpu_trial("wcsph_momentum_stays_on_the_device", momentum_stays),
        gpu_trial("wcsph_on_the_device_can_be_none_one_or_all_in_one_place", few_and_coincident),
        gpu_trial("wcsph_steps_on_the_device_are_those_of_the_cpu", steps_are_stable),
        gpu_trial("wcsph_on_the_device_goes_on_from_saved_particles_and_after_errors", goes_on),
    ]
}

/// The scene with weakly compressible water that laminar and artificial viscosity slow down.
fn compressible(mut scene: ParticleScene) -> ParticleScene {
    let mut settings = WcsphSettings::new(Fluid::water(SPACING), SOUND);
    (settings.viscosity, settings.artificial_viscosity) = (0.01, 0.1);
    scene.model = ParticleModel::Wcsph(settings);
    scene.time_step = TimeStep::Fixed(STEP);
    scene
}

/// Disturbed particles whose densities differ from that at rest by up to 3 %.
fn uneven(dimensions: Dimensions) -> ParticleScene {
    let mut random = Random(SEED);
    let mut scene = compressible(disturbed(dimensions, 4));
    let mut density = || 1000.0 + 60.0 * (f64::from(random.unit()) - 0.5);
    scene.particles.densities = scene.particles.positions.iter().map(|_| density()).collect();
    scene
}

fn wcsph(scene: &mut ParticleScene) -> &mut WcsphSettings {
    match &mut scene.model {
        ParticleModel::Wcsph(settings) => settings,
        other => panic!("{} is another model", other.name()),
    }
}

/// The most that any two particles differ by.
fn largest(found: &Particles, of: impl Fn(usize) -> f64) -> f64 {
    (0..found.len()).map(of).fold(0.0, f64::max)
}

/// Compares some steps on the device with those on the CPU.
fn compare(gpu: &Gpu, scene: &ParticleScene, settings: &SimulationSettings, what: &str) {
    // Places below 1 are rounded by 3e-8 at the start and in each of three steps, so offsets are off by up to 1.2e-6 supports of 0.2, and
    // densities by 3e-8 of them at the start and in each step. Σ V |∇W| / q is 14 supports⁻² in space and 20 in the plane, a half more for
    // particles that lie unevenly, and Σ V |∇W| some 7. In c² / support, pairs push by up to 0.1: 30 · 1.2e-6 · 0.1 and 7 · 2 · 1.2e-7.
    let accelerations = SOUND * SOUND / (2.0 * SPACING) * (30.0 * 1.2e-6 * 0.1 + 7.0 * 2.0 * 1.2e-7);
    let speeds = f64::from(STEPS) * STEP * accelerations;
    let places = f64::from(STEPS + 1) * 3e-8 + f64::from(STEPS) * STEP * speeds;
    // Speeds of up to 0.1 c along offsets that are off, and speeds that are off.
    let rates = SOUND / (2.0 * SPACING) * (30.0 * 1.2e-6 * 0.1 + 7.0 * 2.0 * speeds / SOUND);
    let densities = f64::from(STEPS) * (STEP * rates + 3e-8);
    let (expected, expected_reports) = on_cpu(scene, settings, STEPS);
    let (found, reports) = run(gpu, scene, settings, STEPS);
    let time = f64::from(STEPS) * STEP;
    let alone = |i: usize| scene.particles.velocities[i] + time * scene.gravity;
    let pushed = largest(&found, |i| expected.velocities[i].distance(alone(i)));
    let apart = largest(&found, |i| found.positions[i].distance(expected.positions[i]));
    let faster = largest(&found, |i| found.velocities[i].distance(expected.velocities[i]));
    let denser = largest(&found, |i| (found.densities[i] / expected.densities[i] - 1.0).abs());
    let condensed = largest(&found, |i| (expected.densities[i] / scene.particles.densities[i] - 1.0).abs());
    println!(
        "{what}: {apart:e} of {places:e} apart, {faster:e} of {speeds:e} faster, {denser:e} of {densities:e} denser; \
         {pushed:e} pushed, {condensed:e} condensed"
    );
    assert!(pushed > 0.1 && condensed > 1e-3, "{what}: nothing happens, {pushed} and {condensed}");
    assert!(apart <= places, "{what}: {apart:e} apart");
    assert!(faster <= speeds, "{what}: {faster:e} faster");
    assert!(denser <= densities, "{what}: {denser:e} denser");
    for (found, expected) in reports.iter().zip(&expected_reports) {
        assert_eq!((found.step, found.iterations), (expected.step, 0));
        assert!((found.time_step / expected.time_step - 1.0).abs() < 1e-7, "{found:?} and {expected:?}");
        assert!((found.mean_neighbors - expected.mean_neighbors).abs() < 1e-5, "{found:?} and {expected:?}");
        for (found, expected) in found.density_error.iter().zip(&expected.density_error) {
            // The device adds up compressions, each of which is rounded to 6e-8.
            assert!((found - expected).abs() <= densities + 1.2e-7, "{what}: {found} for {expected}");
        }
    }
}

fn device_is_cpu(gpu: &Gpu) {
    for (dimensions, support, smoothing) in [
        (Dimensions::Three, 2.0, SmoothingKernel::Wendland),
        (Dimensions::Three, 2.7, SmoothingKernel::CubicSpline),
        (Dimensions::Two, 2.0, SmoothingKernel::CubicSpline),
        (Dimensions::Two, 2.7, SmoothingKernel::Wendland),
    ] {
        for (deterministic, with_walls) in [(false, true), (true, true), (true, false)] {
            let mut scene = uneven(dimensions);
            let model = wcsph(&mut scene);
            (model.fluid.support, model.smoothing) = (support * SPACING, smoothing);
            if !with_walls {
                scene.boundary.clear();
            }
            let settings = SimulationSettings { deterministic, reorder_every: 2, ..SimulationSettings::default() };
            let what = format!("{dimensions:?}, support {support}, {}, walls {with_walls}", smoothing.name());
            compare(gpu, &scene, &settings, &what);
        }
    }
}

fn exponents(gpu: &Gpu) {
    for exponent in [1.0, 1.4, 7.0, 30.0] {
        let mut scene = uneven(Dimensions::Three);
        wcsph(&mut scene).exponent = exponent;
        compare(gpu, &scene, &SimulationSettings::default(), &format!("γ = {exponent}"));
    }
    // Pairs with densities far from that at rest, by the printed formula: two that push each other along x by
    // m |W′| (p₁ + p₂) / (ρ₁ ρ₂), where W′ = −norm · 20 q (1 − q)³ / support.
    for density in [600.0, 900.0, 1100.0, 1500.0] {
        let mut scene = compressible(scene(Dimensions::Three, vec![DVec3::ZERO, DVec3::new(SPACING, 0.0, 0.0)], STEP));
        scene.particles.densities = vec![density; 2];
        let model = wcsph(&mut scene);
        (model.viscosity, model.artificial_viscosity) = (0.0, 0.0);
        let (found, _) = run(gpu, &scene, &SimulationSettings::default(), 1);
        let (support, q) = (2.0 * SPACING, 0.5f64);
        let slope = 21.0 / (2.0 * std::f64::consts::PI * support.powi(4)) * 20.0 * q * (1.0 - q).powi(3);
        let pressure = SOUND * SOUND * 1000.0 / 7.0 * ((density / 1000.0).powi(7) - 1.0);
        let mass = 1000.0 * SPACING.powi(3);
        let speed = STEP * mass * slope * 2.0 * pressure / (density * density);
        let off = (found.velocities[1].x / speed - 1.0).abs().max((found.velocities[0].x / -speed - 1.0).abs());
        println!("density {density}: speed {speed}, {off:e} off");
        // Some ten roundings of 6e-8, and powers that devices may have off by some 2e-6.
        assert!(off <= 5e-6, "density {density}: {:?} for {speed}", found.velocities);
    }
}

fn searches_agree(gpu: &Gpu) {
    let mut scene = uneven(Dimensions::Three);
    scene.time_step = TimeStep::Cfl { factor: 0.25, least: 1e-6, most: 0.1 };
    let settings = |search| SimulationSettings { search, deterministic: true, reorder_every: 7, ..Default::default() };
    let (expected, expected_reports) = run(gpu, &scene, &settings(ParticleSearch::BruteForce), 20);
    for search in searches() {
        let (found, reports) = run(gpu, &scene, &settings(search), 20);
        assert!(found == expected, "{search} gives another fluid");
        let did = |reports: &[StepReport]| {
            reports.iter().map(|r| (r.mean_neighbors, r.time_step, r.density_error)).collect::<Vec<_>>()
        };
        assert_eq!(did(&reports), did(&expected_reports), "{search}");
    }
}

/// A lattice at rest between a floor and walls of two layers, as many as it feels, which are half as high again as it.
fn tank(size: [i32; 3]) -> ParticleScene {
    let mut scene = compressible(column(Dimensions::Three, size));
    let outer = [size[0] + 4, size[1] * 3 / 2 + 2, size[2] + 4];
    scene.boundary = lattice(outer, SPACING, DVec3::splat(-1.5 * SPACING));
    let end = |axis: usize| f64::from(size[axis]) * SPACING;
    scene.boundary.retain(|p| p.x < 0.0 || p.x > end(0) || p.y < 0.0 || p.z < 0.0 || p.z > end(2));
    scene
}

fn tanks_rest(gpu: &Gpu) {
    let (size, steps) = if long_cases(gpu) { ([16, 24, 16], 4000) } else { ([5, 8, 5], 600) };
    let mut scene = tank(size);
    let height = f64::from(size[1]) * SPACING;
    let sound = 10.0 * (2.0 * 9.81 * height).sqrt();
    wcsph(&mut scene).sound_speed = sound;
    scene.time_step = TimeStep::Cfl { factor: 0.4, least: 1e-6, most: 0.1 };
    let mut simulation = GpuSimulation::new(gpu, &scene, &SimulationSettings::default()).unwrap();
    let reports = simulation.advance(steps, &mut Watch::none()).unwrap();
    let measures = simulation.measure().unwrap();
    let relative = 2.0 * measures.mean_position.y / height;
    // Water of depth H gains ρ₀ g H / (2 c²) on average.
    let expected = 1000.0 * 9.81 * height / (2.0 * sound * sound);
    // Let go at once, it swings around that like a spring: the mean over the second half of the time.
    let late = &reports[reports.len() / 2..];
    let mean = 1000.0 * late.iter().map(|report| report.density_error[0]).sum::<f64>() / late.len() as f64;
    println!(
        "after {} s: density error {:?}, height {relative:.4}, speed {:.3}, compression {mean:.3} of {expected:.3}",
        simulation.time(),
        reports[reports.len() - 1].density_error,
        measures.max_speed
    );
    assert!((relative - 1.0).abs() <= 0.01, "{relative} of the height");
    // Nowhere faster than what falls half a spacing.
    assert!(measures.max_speed <= (9.81 * SPACING).sqrt(), "{}", measures.max_speed);
    assert!((mean / expected - 1.0).abs() <= 0.2, "{mean} for {expected}");
    assert_eq!(measures.outside, 0);
}

fn momentum_stays(gpu: &Gpu) {
    let mut scene = uneven(Dimensions::Three);
    (scene.boundary, scene.gravity, scene.domain) = (Vec::new(), DVec3::ZERO, [-0.2 * WIDE, 0.2 * WIDE]);
    let before = Measures::of(&scene, &scene.particles);
    let (particles, _) = run(gpu, &scene, &SimulationSettings::default(), 50);
    let after = Measures::of(&scene, &particles);
    let all: f64 = particles.velocities.iter().map(|velocity| SPACING.powi(3) * 1000.0 * velocity.length()).sum();
    let drift = (after.momentum - before.momentum).length() / all;
    // Speeds below 2 are rounded by 6e-8 in each of 50 steps: over speeds of some 0.5 that is 6e-6 if all are rounded to one side. What
    // pairs do to each other is exact but for the rounding of sums.
    println!("momentum drifts by {drift:e}");
    assert!(drift <= 6e-6, "momentum drifts by {drift:e}");
    let faster = largest(&particles, |i| particles.velocities[i].distance(scene.particles.velocities[i]));
    assert!(faster > 0.5, "the block has not pushed itself apart: {faster}");
}

fn few_and_coincident(gpu: &Gpu) {
    for n in [0, 1, 50] {
        for dimensions in [Dimensions::Two, Dimensions::Three] {
            let mut scene = compressible(scene(dimensions, vec![DVec3::new(1.0, 1.0, 0.0); n], STEP));
            scene.gravity = DVec3::new(0.0, -10.0, 0.0);
            scene.boundary = vec![DVec3::new(-3.0, 0.0, 0.0)];
            scene.time_step = TimeStep::Fixed(0.01);
            for search in searches() {
                let settings = SimulationSettings { search, ..Default::default() };
                let (particles, reports) = run(gpu, &scene, &settings, 4);
                // 10 · 0.01² · (1 + 2 + 3 + 4) below the start, 10 · 0.01 · 4 fast.
                let (fallen, speed) = (DVec3::new(1.0, 0.99, 0.0), DVec3::new(0.0, -0.4, 0.0));
                assert!(particles.positions.iter().all(|p| p.distance(fallen) < 1e-6), "{search}: {particles:?}");
                assert!(particles.velocities.iter().all(|v| v.distance(speed) < 1e-6), "{search}: {particles:?}");
                assert!(particles.densities.iter().all(|&density| density == 1000.0), "{search}: {particles:?}");
                let others = n.saturating_sub(1) as f64;
                assert_eq!((particles.len(), reports[3].mean_neighbors), (n, others), "{search}");
            }
        }
    }
}

fn steps_are_stable(gpu: &Gpu) {
    let settings = SimulationSettings::default();
    let agree = |what: &str, scene: &ParticleScene| -> f64 {
        let (_, expected) = on_cpu(scene, &settings, 5);
        let (_, found) = run(gpu, scene, &settings, 5);
        for (found, expected) in found.iter().zip(&expected) {
            println!("{what}: {} for {}", found.time_step, expected.time_step);
            // Of forces, speeds and densities that are rounded.
            assert!((found.time_step / expected.time_step - 1.0).abs() < 1e-5, "{what}: {found:?} and {expected:?}");
        }
        found[0].time_step
    };
    // Alone and from rest: a quarter of the smoothing length over the speed of sound with its viscous part.
    let mut scene = compressible(lattice_apart());
    scene.time_step = TimeStep::Cfl { factor: 0.25, least: 1e-9, most: 1.0 };
    let of_sound = 0.25 * SPACING / (SOUND * 1.06);
    assert!((agree("sound", &scene) / of_sound - 1.0).abs() < 1e-6);
    scene.particles.velocities = vec![DVec3::new(0.0, 5.0, 0.0); scene.particles.len()];
    let of_speed = 0.25 * SPACING / (SOUND * 1.06 + 5.0);
    assert!((agree("speed", &scene) / of_speed - 1.0).abs() < 1e-6);
    // Sound is 1.1³ times as fast at 1.1 times the density.
    scene.particles.densities = vec![1100.0; scene.particles.len()];
    let of_density = 0.25 * SPACING / (SOUND * 1.06 * 1.331 + 5.0);
    assert!((agree("density", &scene) / of_density - 1.0).abs() < 1e-5);
    scene.gravity = DVec3::new(0.0, -1e5, 0.0);
    let of_forces = 0.25 * (SPACING / 1e5).sqrt();
    assert!((agree("forces", &scene) / of_forces - 1.0).abs() < 1e-6);
    scene.gravity = DVec3::ZERO;
    wcsph(&mut scene).viscosity = 10.0;
    assert!((agree("viscosity", &scene) / (0.25 * 0.5 * SPACING * SPACING / 10.0) - 1.0).abs() < 1e-6);
    scene.time_step = TimeStep::Cfl { factor: 0.25, least: 2e-3, most: 1.0 };
    assert!((agree("least", &scene) / 2e-3 - 1.0).abs() < 1e-6);
    let mut scene = uneven(Dimensions::Two);
    scene.time_step = TimeStep::Cfl { factor: 0.25, least: 1e-9, most: 1.0 };
    agree("a fluid", &scene);
    scene.time_step = TimeStep::Cfl { factor: 0.25, least: 1e-9, most: 1e-5 };
    assert!((agree("most", &scene) / 1e-5 - 1.0).abs() < 1e-6);
}

/// Particles that do not meet.
fn lattice_apart() -> ParticleScene {
    scene(Dimensions::Three, lattice([2, 2, 2], 3.0 * SPACING, DVec3::ZERO), STEP)
}

fn goes_on(gpu: &Gpu) {
    let scene = uneven(Dimensions::Three);
    let settings =
        SimulationSettings { deterministic: true, reorder_every: 0, max_speed: 100.0, ..SimulationSettings::default() };
    let mut simulation = GpuSimulation::new(gpu, &scene, &settings).unwrap();
    let first = simulation.advance(3, &mut Watch::none()).unwrap();
    let saved = simulation.particles().unwrap();
    simulation.advance(3, &mut Watch::none()).unwrap();
    let expected = simulation.particles().unwrap();
    simulation.resume(&saved, 3, first[2].time).unwrap();
    simulation.advance(3, &mut Watch::none()).unwrap();
    assert!(simulation.particles().unwrap() == expected, "saved particles go another way");
    let (mut fast, mut dense) = (saved.clone(), saved.clone());
    fast.velocities[7] = DVec3::new(0.0, 200.0, 0.0);
    // More than single precision has.
    dense.densities[7] = 1e39;
    for bad in [fast, dense] {
        simulation.resume(&bad, 3, first[2].time).unwrap();
        let ended = simulation.advance(2, &mut Watch::none());
        assert!(matches!(ended, Err(Error::BlowUp { step: 4, .. })), "{ended:?}");
        assert_eq!(simulation.particles().unwrap().positions, bad.positions);
    }
    simulation.resume(&saved, 3, first[2].time).unwrap();
    simulation.advance(3, &mut Watch::none()).unwrap();
    assert!(simulation.particles().unwrap() == expected, "particles go another way after an error");
}
