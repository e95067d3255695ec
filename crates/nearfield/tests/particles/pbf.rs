//! Position-based fluids: the printed formulas over all pairs, fluids that rest, and what is conserved.

use libtest_mimic::Trial;
use nearfield::application::Watch;
use nearfield::application::particles::{
    Dimensions, Fluid, ParticleModel, ParticleScene, ParticleSearch, Particles, PbfSettings, Simulate, Simulation,
    SimulationSettings, TimeStep,
};
use nearfield::{DVec3, Error};

use crate::pbf_reference::{Kernels, step};
use crate::support::{Random, is_long, trial};

pub(crate) const SPACING: f64 = 0.1;
const SEED: u64 = 20;
pub(crate) const WIDE: DVec3 = DVec3::splat(10.0);

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("columns_rest_for_ten_seconds_in_space", columns_rest_for_ten_seconds_in_space),
        trial("columns_rest_for_ten_seconds_in_the_plane", columns_rest_for_ten_seconds_in_the_plane),
        trial("steps_are_the_printed_formulas_over_all_pairs", steps_are_the_printed_formulas_over_all_pairs),
        trial("free_fall_is_exact", free_fall_is_exact),
        trial("momentum_is_conserved_without_walls_and_gravity", momentum_is_conserved_without_walls_and_gravity),
        trial("all_searches_give_the_same_trajectory", all_searches_give_the_same_trajectory),
        trial("viscosity_averages_velocities", viscosity_averages_velocities),
        trial("vorticity_confinement_spins_vortices", vorticity_confinement_spins_vortices),
        trial("iterations_end_at_the_tolerance", iterations_end_at_the_tolerance),
        trial("steps_by_speed_are_a_part_of_the_diameter", steps_by_speed_are_a_part_of_the_diameter),
        trial("no_particles_and_one_are_simulated", no_particles_and_one_are_simulated),
        trial("particles_at_one_place_fall_together", particles_at_one_place_fall_together),
        trial("steps_may_be_tiny", steps_may_be_tiny),
        trial("settings_that_cannot_be_are_errors_by_name", settings_that_cannot_be_are_errors_by_name),
    ]
}

/// Coordinates in [-1, 1).
fn random_vector(random: &mut Random, dimensions: Dimensions) -> DVec3 {
    let [x, y, z] = std::array::from_fn(|_| 2.0 * f64::from(random.unit()) - 1.0);
    if dimensions == Dimensions::Two { DVec3::new(x, y, 0.0) } else { DVec3::new(x, y, z) }
}

/// A lattice of so many places along each axis, the first at `first`, one layer at z = 0 in the plane.
pub(crate) fn lattice(size: [i32; 3], spacing: f64, first: DVec3) -> Vec<DVec3> {
    let at = |x, y, z| first + spacing * DVec3::new(f64::from(x), f64::from(y), f64::from(z));
    let line = |y, z| (0..size[0]).map(move |x| at(x, y, z));
    (0..size[1]).flat_map(|y| (0..size[2]).flat_map(move |z| line(y, z))).collect()
}

/// A fluid without gravity in a wide domain around the origin.
pub(crate) fn scene(dimensions: Dimensions, positions: Vec<DVec3>, step: f64) -> ParticleScene {
    ParticleScene {
        name: "fluid".to_owned(),
        dimensions,
        domain: [-WIDE, WIDE],
        gravity: DVec3::ZERO,
        particles: Particles::at_rest(positions),
        periodic: [false; 3],
        boundary: Vec::new(),
        model: ParticleModel::Pbf(PbfSettings::new(Fluid::water(SPACING))),
        time_step: TimeStep::Fixed(step),
    }
}

pub(crate) fn pbf(scene: &mut ParticleScene) -> &mut PbfSettings {
    match &mut scene.model {
        ParticleModel::Pbf(settings) => settings,
        other => panic!("{} is another model", other.name()),
    }
}

fn simulation(scene: &ParticleScene, settings: &SimulationSettings) -> Simulation {
    Simulation::new(scene, settings).expect("a scene that can be simulated")
}

/// A lattice at rest one spacing away from a floor and walls of particles, which are half as high again as it.
pub(crate) fn column(dimensions: Dimensions, size: [i32; 3]) -> ParticleScene {
    let flat = dimensions == Dimensions::Two;
    let first = DVec3::new(0.5, 0.5, if flat { 0.0 } else { 0.5 }) * SPACING;
    let mut scene = scene(dimensions, lattice(size, SPACING, first), 0.005);
    let place = |i: i32| (f64::from(i) + 0.5) * SPACING;
    let top = size[1] * 3 / 2;
    let sides = if flat { 0..=0 } else { -1..=size[2] };
    for (y, z) in (-1..top).flat_map(|y| sides.clone().map(move |z| (y, z))) {
        for x in -1..=size[0] {
            if x == -1 || x == size[0] || y == -1 || (!flat && (z == -1 || z == size[2])) {
                let across = if flat { 0.0 } else { place(z) };
                scene.boundary.push(DVec3::new(place(x), place(y), across));
            }
        }
    }
    scene.domain = [DVec3::ZERO, SPACING * DVec3::new(size[0].into(), f64::from(2 * size[1]), size[2].into())];
    scene.gravity = DVec3::new(0.0, -9.81, 0.0);
    *pbf(&mut scene) =
        PbfSettings { iterations: 2, most_iterations: 100, tolerance: 1e-3, ..PbfSettings::new(Fluid::water(SPACING)) };
    scene
}

/// Ten seconds: the fluid is nowhere much denser than at rest at the end of any step, and as high as it was.
fn rests(dimensions: Dimensions, size: [i32; 3]) {
    let scene = column(dimensions, size);
    let mut simulation = simulation(&scene, &SimulationSettings::default());
    let height = f64::from(size[1]) * SPACING;
    for second in 1..=10 {
        let reports = simulation.advance(200, &mut Watch::none()).expect("steps");
        let largest = |of: usize| reports.iter().map(|report| report.density_error[of]).fold(0.0, f64::max);
        let iterations = reports.iter().map(|report| report.iterations).sum::<u32>();
        let measures = simulation.measure().expect("a simulation on the CPU should be measured");
        let relative = 2.0 * measures.mean_position.y / height;
        println!(
            "{dimensions:?}, {second} s: density error {:.5} and {:.4}, {} iterations a step, height {relative:.4}, speed {:.3}",
            largest(0),
            largest(1),
            f64::from(iterations) / 200.0,
            measures.max_speed
        );
        assert!(largest(0) <= 1e-3, "after {second} s: mean density error {}", largest(0));
        assert!(largest(1) <= 2e-2, "after {second} s: density error {}", largest(1));
        assert!((relative - 1.0).abs() <= 0.02, "after {second} s: {relative} of the height");
        assert_eq!(measures.outside, 0, "after {second} s");
    }
    assert!((simulation.time() - 10.0).abs() < 1e-9);
}

fn columns_rest_for_ten_seconds_in_space() {
    // With `NEARFIELD_LONG=1` of eight times as many particles.
    rests(Dimensions::Three, if is_long() { [12, 24, 12] } else { [6, 12, 6] });
}

fn columns_rest_for_ten_seconds_in_the_plane() {
    rests(Dimensions::Two, [10, 12, 1]);
}

/// A block that is too dense in places, near a floor of particles and one of the domain's walls, with everything that acts.
pub(crate) fn disturbed(dimensions: Dimensions, across: i32) -> ParticleScene {
    let mut random = Random(SEED);
    let size = [6, 5, if dimensions == Dimensions::Two { 1 } else { across }];
    let mut scene = scene(dimensions, lattice(size, 0.95 * SPACING, DVec3::ZERO), 0.004);
    for position in &mut scene.particles.positions {
        *position += 0.2 * SPACING * random_vector(&mut random, dimensions);
    }
    for velocity in &mut scene.particles.velocities {
        *velocity = random_vector(&mut random, dimensions);
    }
    let floor = lattice([10, 1, if dimensions == Dimensions::Two { 1 } else { 8 }], 0.8 * SPACING, DVec3::ZERO);
    scene.boundary = floor.into_iter().map(|place| place - DVec3::new(0.1, SPACING, 0.0)).collect();
    scene.domain = [DVec3::new(-0.3 * SPACING, -1.0, -1.0), DVec3::ONE];
    scene.gravity = DVec3::new(1.0, -9.0, 0.0);
    let settings = pbf(&mut scene);
    (settings.vorticity, settings.xsph, settings.iterations, settings.most_iterations) = (0.7, 0.05, 4, 4);
    scene
}

fn steps_are_the_printed_formulas_over_all_pairs() {
    for (dimensions, support) in [(Dimensions::Three, 2.0), (Dimensions::Three, 2.7), (Dimensions::Two, 2.0)] {
        let mut scene = disturbed(dimensions, 4);
        pbf(&mut scene).fluid.support = support * SPACING;
        // The first particle starts nearer to the wall than it may be.
        scene.particles.positions[0].x = -0.25 * SPACING;
        let expected = step(&scene);
        let mut simulation = simulation(&scene, &SimulationSettings::default());
        simulation.advance(1, &mut Watch::none()).expect("a step");
        let found = simulation.particles().expect("particles");
        let alone = |i: usize| scene.particles.velocities[i] + 0.004 * scene.gravity;
        let pushed = |i: usize| expected.positions[i].distance(scene.particles.positions[i] + 0.004 * alone(i));
        let most = (0..found.len()).map(pushed).fold(0.0, f64::max);
        assert!(most > 0.01 * SPACING, "nothing is pushed farther than {most}");
        // Sums of some fifty terms in any order, amplified by 1 / Δt for velocities.
        let bound = 1e3 * f64::EPSILON;
        for i in 0..found.len() {
            let moved = (found.positions[i] - expected.positions[i]).length();
            assert!(moved <= bound, "{dimensions:?}, particle {i} is {moved} away");
            let faster = (found.velocities[i] - expected.velocities[i]).length();
            assert!(faster <= bound / 0.004, "{dimensions:?}, particle {i} is {faster} faster");
            let denser = found.densities[i] / expected.densities[i] - 1.0;
            assert!(denser.abs() <= bound, "{dimensions:?}, particle {i} is {denser} denser");
        }
    }
}

fn free_fall_is_exact() {
    let mut scene = scene(Dimensions::Three, lattice([5, 5, 5], SPACING, DVec3::splat(1.0)), 0.01);
    scene.gravity = DVec3::new(0.3, -9.81, 0.0);
    scene.particles.velocities.fill(DVec3::new(1.0, 2.0, -3.0));
    // Without the artificial pressure, which would drive the surface apart.
    pbf(&mut scene).tensile_strength = 0.0;
    let mut simulation = simulation(&scene, &SimulationSettings::default());
    simulation.advance(100, &mut Watch::none()).expect("steps");
    let particles = simulation.particles().expect("particles");
    let (steps, step) = (100.0, 0.01);
    let velocity = scene.particles.velocities[0] + steps * step * scene.gravity;
    let way = steps * step * scene.particles.velocities[0] + 0.5 * steps * (steps + 1.0) * step * step * scene.gravity;
    for (i, start) in scene.particles.positions.iter().enumerate() {
        // A hundred steps, each rounded at numbers below 16.
        let bound = 100.0 * 16.0 * f64::EPSILON;
        let error = (particles.positions[i] - (*start + way)).length();
        assert!(error <= bound, "particle {i} is {error} away");
        let error = (particles.velocities[i] - velocity).length();
        assert!(error <= bound, "particle {i} is {error} faster");
    }
}

fn momentum_is_conserved_without_walls_and_gravity() {
    for dimensions in [Dimensions::Three, Dimensions::Two] {
        let mut scene = disturbed(dimensions, 4);
        (scene.boundary, scene.gravity, scene.domain) = (Vec::new(), DVec3::ZERO, [-WIDE, WIDE]);
        (pbf(&mut scene).xsph, pbf(&mut scene).vorticity) = (0.0, 0.0);
        let mut simulation = simulation(&scene, &SimulationSettings::default());
        let before = simulation.measure().expect("measures");
        simulation.advance(100, &mut Watch::none()).expect("steps");
        let after = simulation.measure().expect("measures");
        let mass = 1000.0 * SPACING.powi(dimensions.number() as i32);
        let all: f64 = scene.particles.velocities.iter().map(|velocity| mass * velocity.length()).sum();
        let drift = (after.momentum - before.momentum).length() / all;
        println!("{dimensions:?}: momentum drifts by {drift:e}, energy from {} to {}", before.energy(), after.energy());
        assert!(drift <= 1e-10, "{dimensions:?}: momentum drifts by {drift:e}");
        assert!(after.energy() > 2.0 * before.energy(), "the block has not pushed itself apart");
    }
}

fn all_searches_give_the_same_trajectory() {
    let scene = disturbed(Dimensions::Three, 6);
    let of = |search| {
        let settings = SimulationSettings { search, deterministic: true, reorder_every: 7, ..Default::default() };
        let mut simulation = simulation(&scene, &settings);
        let reports = simulation.advance(40, &mut Watch::none()).expect("steps");
        let did: Vec<_> =
            reports.iter().map(|report| (report.mean_neighbors, report.iterations, report.density_error)).collect();
        (simulation.particles().expect("particles"), did)
    };
    let expected = of(ParticleSearch::BruteForce);
    for search in ParticleSearch::ALL {
        assert!(of(search) == expected, "{search} gives another trajectory than brute force");
    }
}

fn viscosity_averages_velocities() {
    let near = DVec3::new(0.6 * SPACING, 0.0, 0.0);
    let mut scene = scene(Dimensions::Three, vec![DVec3::ZERO, near], 0.001);
    scene.particles.velocities = vec![DVec3::Y, -DVec3::Y];
    (pbf(&mut scene).xsph, pbf(&mut scene).tensile_strength) = (0.5, 0.0);
    let mut simulation = simulation(&scene, &SimulationSettings::default());
    simulation.advance(1, &mut Watch::none()).expect("a step");
    let particles = simulation.particles().expect("particles");
    // Two alone are below the density at rest. With W of the other, m / ρ W = W / (W(0) + W).
    let distance = near.distance(DVec3::new(0.0, 0.002, 0.0));
    let other = (1.0 - (distance / (2.0 * SPACING)).powi(2)).powi(3);
    let expected = 1.0 - 0.5 * 2.0 * other / (1.0 + other);
    for (velocity, sign) in particles.velocities.iter().zip([1.0, -1.0]) {
        assert!((*velocity - sign * expected * DVec3::Y).length() < 1e-12, "{velocity}, expected {sign} {expected}");
    }
}

fn vorticity_confinement_spins_vortices() {
    let places = lattice([21, 21, 1], SPACING, DVec3::new(-10.0 * SPACING, -10.0 * SPACING, 0.0));
    let mut scene = scene(Dimensions::Two, places.clone(), 1e-4);
    // A vortex that turns fastest in its middle.
    let swirl = |p: &DVec3| (-p.length_squared()).exp() * DVec3::new(-p.y, p.x, 0.0);
    scene.particles.velocities = places.iter().map(swirl).collect();
    (pbf(&mut scene).xsph, pbf(&mut scene).tensile_strength) = (0.0, 0.0);
    let mut spin = |vorticity: f64| {
        pbf(&mut scene).vorticity = vorticity;
        let mut simulation = simulation(&scene, &SimulationSettings::default());
        simulation.advance(1, &mut Watch::none()).expect("a step");
        let particles = simulation.particles().expect("particles");
        let momenta = particles.positions.iter().zip(&particles.velocities).map(|(p, v)| p.cross(*v).z);
        momenta.sum::<f64>()
    };
    // The vorticity is 2 (1 − r²) exp(−r²). Its length falls away from the middle, and again beyond √2, but grows where it turns the other
    // way around: everywhere in this square ε Δt |ω| is added along the way around. Of that the sums see 87 % inside (by the lattice
    // sum of V r |W′| / 2), and less at the rim.
    let vorticity = |r: f64| 2.0 * (1.0 - r * r) * (-r * r).exp();
    let expected: f64 = places.iter().map(|p| 1e-4 * p.length() * vorticity(p.length()).abs()).sum();
    let part = (spin(1.0) - spin(0.0)) / expected;
    assert!((0.6..0.88).contains(&part), "{part} of the expected spin");
}

fn iterations_end_at_the_tolerance() {
    let mut scene = disturbed(Dimensions::Three, 6);
    let settings = pbf(&mut scene);
    (settings.iterations, settings.most_iterations, settings.tolerance) = (2, 500, 1e-4);
    let mut simulation = simulation(&scene, &SimulationSettings::default());
    let reports = simulation.advance(10, &mut Watch::none()).expect("steps");
    for report in &reports {
        assert!(report.iterations == 500 || report.density_error[0] <= 1e-4, "{report:?}");
        assert!((2..=500).contains(&report.iterations), "{report:?}");
    }
    assert!(reports.iter().any(|report| (3..500).contains(&report.iterations)), "{reports:?}");
}

fn steps_by_speed_are_a_part_of_the_diameter() {
    let mut scene = scene(Dimensions::Three, vec![DVec3::ZERO, DVec3::ONE], 1.0);
    scene.gravity = DVec3::new(0.0, -9.81, 0.0);
    scene.particles.velocities[1] = DVec3::new(0.0, -2.0, 0.0);
    for factor in [0.5, 1.0] {
        scene.time_step = TimeStep::Cfl { factor, least: 1e-6, most: 1.0 };
        let mut simulation = simulation(&scene, &SimulationSettings::default());
        let found = simulation.advance(1, &mut Watch::none()).expect("a step")[0].time_step;
        let way = 0.4 * SPACING;
        let expected = factor * way / (2.0 + (9.81 * way).sqrt());
        assert!((found / expected - 1.0).abs() < 1e-12, "{found}, expected {expected}");
        // However it falls.
        assert!(2.0 * found + 9.81 * found * found <= way);
    }
}

fn no_particles_and_one_are_simulated() {
    for positions in [Vec::new(), vec![DVec3::ONE]] {
        for dimensions in [Dimensions::Two, Dimensions::Three] {
            let positions: Vec<DVec3> = positions.iter().map(|p: &DVec3| p.with_z(0.0)).collect();
            let scene = scene(dimensions, positions.clone(), 0.01);
            for search in ParticleSearch::ALL {
                let settings = SimulationSettings { search, ..Default::default() };
                let mut simulation = simulation(&scene, &settings);
                let reports = simulation.advance(3, &mut Watch::none()).expect("steps");
                assert_eq!((reports[2].density_error, reports[2].mean_neighbors), ([0.0, 0.0], 0.0), "{search}");
                assert_eq!(simulation.particles().expect("particles").positions, positions, "{search}");
            }
        }
    }
}

fn particles_at_one_place_fall_together() {
    let mut scene = scene(Dimensions::Three, vec![DVec3::ONE; 50], 0.01);
    scene.gravity = DVec3::new(0.0, -10.0, 0.0);
    pbf(&mut scene).vorticity = 1.0;
    let mut simulation = simulation(&scene, &SimulationSettings::default());
    let reports = simulation.advance(10, &mut Watch::none()).expect("steps");
    let particles = simulation.particles().expect("particles");
    // 10 · 0.01² · (1 + … + 10) below the start.
    assert!(particles.positions.iter().all(|p| p.distance(DVec3::new(1.0, 0.945, 1.0)) < 1e-14));
    let kernels = Kernels::new(Dimensions::Three, 2.0 * SPACING);
    let at_rest: f64 = kernels.lattice(SPACING).iter().map(|offset| kernels.value(*offset)).sum();
    let density = 1000.0 * 50.0 * kernels.value(DVec3::ZERO) / at_rest;
    assert!(particles.densities.iter().all(|own| (own / density - 1.0).abs() < 1e-12), "{:?}", particles.densities[0]);
    assert_eq!(reports[9].mean_neighbors, 49.0);
}

fn steps_may_be_tiny() {
    let mut scene = scene(Dimensions::Three, lattice([4, 4, 4], 1.05 * SPACING, DVec3::ONE), 1e-12);
    scene.gravity = DVec3::new(0.0, -10.0, 0.0);
    (pbf(&mut scene).tensile_strength, pbf(&mut scene).xsph) = (0.0, 0.0);
    let mut simulation = simulation(&scene, &SimulationSettings::default());
    simulation.advance(100, &mut Watch::none()).expect("steps");
    let particles = simulation.particles().expect("particles");
    let speed = particles.velocities.iter().map(|velocity| (*velocity + DVec3::Y * 1e-9).length()).fold(0.0, f64::max);
    assert!(speed < 1e-20, "{speed} beside the fall");
}

fn settings_that_cannot_be_are_errors_by_name() {
    type Change = fn(&mut PbfSettings);
    let changes: [(&str, Change); 11] = [
        ("spacing of the fluid", |s| s.fluid.spacing = -0.1),
        ("support of the fluid", |s| s.fluid.support = f64::NAN),
        ("support of the fluid", |s| s.fluid.support = 20.0 * SPACING),
        ("rest density of the fluid", |s| s.fluid.rest_density = 0.0),
        ("iterations", |s| s.iterations = 0),
        ("iterations", |s| s.iterations = s.most_iterations + 1),
        ("tolerance of the compression", |s| s.tolerance = 0.0),
        ("relaxation of the constraint", |s| s.relaxation = 0.0),
        ("strength of the artificial pressure", |s| s.tensile_strength = -1.0),
        ("distance of the artificial pressure", |s| s.tensile_distance = 1.0),
        ("XSPH viscosity", |s| s.xsph = f64::INFINITY),
    ];
    for (name, change) in changes {
        let mut scene = scene(Dimensions::Three, vec![DVec3::ZERO], 0.01);
        change(pbf(&mut scene));
        match Simulation::new(&scene, &SimulationSettings::default()).map(|_| ()) {
            Err(Error::InvalidSetting { setting, .. }) => assert_eq!(setting, name),
            other => panic!("{name}: {other:?}"),
        }
    }
}
