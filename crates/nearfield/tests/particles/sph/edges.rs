//! Few particles, all in one place, settings that cannot be, the same bits by every search, and what saves and goes on.

use libtest_mimic::Trial;
use nearfield::application::Watch;
use nearfield::application::particles::{
    DfsphSettings, Dimensions, ParticleModel, ParticleScene, ParticleSearch, Particles, Simulate, Simulation,
    SimulationSettings, SmoothingKernel, TimeStep, WcsphSettings,
};
use nearfield::{DVec3, Error};

use super::scenes::{GRAVITY, dam_break, dfsph, drop, lattice, scene, tank, wcsph};
use super::simulation;
use crate::support::trial;

const SPACING: f64 = 0.05;

/// The trials of this file.
pub(super) fn trials() -> Vec<Trial> {
    vec![
        trial("smoothed_fluids::no_particle_is_nothing", no_particle_is_nothing),
        trial("smoothed_fluids::one_particle_falls_freely", one_particle_falls_freely),
        trial("smoothed_fluids::particles_in_one_place_stay_together", particles_in_one_place_stay_together),
        trial("smoothed_fluids::settings_that_cannot_be_are_errors", settings_that_cannot_be_are_errors),
        trial("smoothed_fluids::what_flies_apart_is_named", what_flies_apart_is_named),
        trial("smoothed_fluids::what_leaves_the_domain_is_counted", what_leaves_the_domain_is_counted),
        trial("smoothed_fluids::every_search_gives_the_same_bits", every_search_gives_the_same_bits),
        trial(
            "smoothed_fluids::saved_particles_go_on_as_if_nothing_had_been",
            saved_particles_go_on_as_if_nothing_had_been,
        ),
        trial("smoothed_fluids::momentum_stays_without_walls", momentum_stays_without_walls),
        trial(
            "smoothed_fluids::spaced_lattices_keep_their_density_in_space",
            spaced_lattices_keep_their_density_in_space,
        ),
    ]
}

fn models() -> [ParticleModel; 2] {
    [ParticleModel::Wcsph(wcsph(SPACING, 6.0)), ParticleModel::Dfsph(dfsph(SPACING))]
}

fn make_steps(simulation: &mut Simulation, steps: u32) {
    simulation.advance(steps, &mut Watch::none()).expect("steps");
}

fn no_particle_is_nothing() {
    for model in models() {
        for boundary in [Vec::new(), lattice([-1.0, -1.0], [1.0, 0.0], SPACING)] {
            let empty = ParticleScene { boundary, ..scene("empty", Vec::new(), model.clone()) };
            let mut simulation = simulation(&empty);
            make_steps(&mut simulation, 3);
            assert!(simulation.particles().expect("particles").is_empty());
            assert_eq!(simulation.measure().expect("measures").energy(), 0.0);
        }
    }
}

fn one_particle_falls_freely() {
    for model in models() {
        let mut alone = scene("alone", vec![DVec3::new(0.5, 1.0, 0.0)], model);
        alone.gravity = DVec3::new(0.0, -GRAVITY, 0.0);
        alone.time_step = TimeStep::Fixed(0.001);
        let mut simulation = simulation(&alone);
        make_steps(&mut simulation, 100);
        let particles = simulation.particles().expect("particles");
        // Velocities first, then places: g Δt² (1 + 2 + … + n).
        let (speed, way) = (GRAVITY * 0.1, GRAVITY * 1e-6 * 5050.0);
        assert!((particles.velocities[0] - DVec3::new(0.0, -speed, 0.0)).length() < 1e-12);
        assert!((particles.positions[0] - DVec3::new(0.5, 1.0 - way, 0.0)).length() < 1e-12);
    }
}

fn particles_in_one_place_stay_together() {
    for model in models() {
        let mut heap = scene("heap", vec![DVec3::new(0.25, 0.5, 0.0); 50], model);
        heap.time_step = TimeStep::Fixed(0.001);
        let mut simulation = simulation(&heap);
        make_steps(&mut simulation, 10);
        let particles = simulation.particles().expect("particles");
        assert_eq!(particles.positions, heap.particles.positions);
    }
}

fn settings_that_cannot_be_are_errors() {
    let is_refused = |what: &str, scene: &ParticleScene| {
        let made = Simulation::new(scene, &SimulationSettings::default());
        assert!(matches!(made, Err(Error::InvalidSetting { .. })), "{what} was taken");
    };
    let places = || lattice([0.0, 0.0], [1.0, 1.0], SPACING);
    let set_wcsph: [fn(&mut WcsphSettings); 8] = [
        |s| s.sound_speed = 0.0,
        |s| s.exponent = -7.0,
        |s| s.viscosity = f64::NAN,
        |s| s.artificial_viscosity = -0.1,
        |s| s.density_diffusion = f64::INFINITY,
        |s| s.smoothing = SmoothingKernel::Spiky,
        |s| s.fluid.rest_density = -1000.0,
        |s| s.fluid.support = s.fluid.spacing,
    ];
    for (i, set) in set_wcsph.into_iter().enumerate() {
        let mut settings = wcsph(SPACING, 1.0);
        set(&mut settings);
        is_refused(&format!("wcsph {i}"), &scene("bad", places(), ParticleModel::Wcsph(settings)));
    }
    let set_dfsph: [fn(&mut DfsphSettings); 5] = [
        |s| s.density_tolerance = 0.0,
        |s| s.divergence_tolerance = -1.0,
        |s| s.most_iterations = 0,
        |s| s.xsph = f64::NAN,
        |s| s.smoothing = SmoothingKernel::Poly6,
    ];
    for (i, set) in set_dfsph.into_iter().enumerate() {
        let mut settings = dfsph(SPACING);
        set(&mut settings);
        is_refused(&format!("dfsph {i}"), &scene("bad", places(), ParticleModel::Dfsph(settings)));
    }
    for model in models() {
        let good = scene("bad", places(), model);
        is_refused("a step of 0", &ParticleScene { time_step: TimeStep::Fixed(0.0), ..good.clone() });
        is_refused("a period across the plane", &ParticleScene { periodic: [false, false, true], ..good.clone() });
        let mut narrow = ParticleScene { periodic: [true, false, false], ..good.clone() };
        narrow.domain = [DVec3::new(0.0, 0.0, 0.0), DVec3::new(0.1, 1.0, 0.0)];
        narrow.particles = Particles::at_rest(lattice([0.0, 0.0], [0.1, 1.0], SPACING));
        is_refused("a period of two spacings", &narrow);
        let mut drawn = good.clone();
        drawn.particles.pressures = vec![-1.0; drawn.particles.len()];
        is_refused("a pressure below 0", &drawn);
        let mut thin = good;
        thin.particles.densities = vec![-1.0; thin.particles.len()];
        is_refused("a density below 0", &thin);
    }
}

fn what_flies_apart_is_named() {
    for model in models() {
        let mut wild = tank(0.5, 0.5, SPACING, 1, model);
        wild.particles.velocities[7] = DVec3::new(0.0, 1e9, 0.0);
        let settings = SimulationSettings { max_speed: 1e6, ..SimulationSettings::default() };
        let mut simulation = Simulation::new(&wild, &settings).expect("a scene that can be simulated");
        let ended = simulation.advance(2, &mut Watch::none());
        assert!(matches!(ended, Err(Error::BlowUp { step: 1, .. })), "{ended:?}");
        assert_eq!(simulation.particles().expect("particles").positions, wild.particles.positions);
    }
}

fn what_leaves_the_domain_is_counted() {
    for model in models() {
        let mut open = tank(0.5, 0.5, SPACING, 2, model);
        open.domain = [DVec3::new(-0.1, -0.1, 0.0), DVec3::new(0.6, 0.6, 0.0)];
        // One of the uppermost layer, through the open top.
        let shot = open.particles.len() - 5;
        open.particles.velocities[shot] = DVec3::new(0.0, 50.0, 0.0);
        let mut simulation = simulation(&open);
        while simulation.time() < 0.02 {
            make_steps(&mut simulation, 1);
        }
        let (measures, particles) =
            (simulation.measure().expect("measures"), simulation.particles().expect("particles"));
        assert!(measures.outside == 1 && particles.positions[shot].y > 0.6, "{measures:?}");
        // Such particles can be gone on from, but no scene begins with them.
        simulation.resume(&particles, simulation.step(), simulation.time()).expect("particles under way");
        make_steps(&mut simulation, 1);
        open.particles = particles;
        let refused = Simulation::new(&open, &SimulationSettings::default()).err();
        assert!(matches!(refused, Some(Error::OutsideDomain { count: 1, .. })), "{refused:?}");
    }
}

fn every_search_gives_the_same_bits() {
    for model in models() {
        let mut flow = dam_break(0.1, model.clone());
        let mut drift = scene("drift", lattice([-0.5, -0.5], [0.5, 0.5], SPACING), model);
        drift.domain = [DVec3::new(-0.5, -0.5, 0.0), DVec3::new(0.5, 0.5, 0.0)];
        drift.periodic = [true, true, false];
        drift.particles.velocities =
            drift.particles.positions.iter().map(|p| DVec3::new(1.0 + p.y, (6.0 * p.x).sin(), 0.0)).collect();
        for scene in [&mut flow, &mut drift] {
            if let ParticleModel::Wcsph(settings) = &mut scene.model {
                settings.viscosity = 1e-3;
            }
            let run = |search: ParticleSearch| {
                let settings =
                    SimulationSettings { search, deterministic: true, reorder_every: 4, ..Default::default() };
                let mut simulation = Simulation::new(scene, &settings).expect("a scene that can be simulated");
                make_steps(&mut simulation, 10);
                simulation.particles().expect("particles")
            };
            let expected = run(ParticleSearch::BruteForce);
            for search in ParticleSearch::ALL {
                let found = run(search);
                assert!(found == expected, "{} of {} differs", search, scene.name);
            }
        }
    }
}

fn saved_particles_go_on_as_if_nothing_had_been() {
    for model in models() {
        let mut drawn = drop(20, 1.0, model);
        drawn.time_step = TimeStep::Cfl { factor: 0.3, least: 1e-9, most: 0.01 };
        let settings = SimulationSettings { deterministic: true, reorder_every: 0, ..Default::default() };
        let mut whole = Simulation::new(&drawn, &settings).expect("a scene that can be simulated");
        make_steps(&mut whole, 12);
        let saved = whole.particles().expect("particles");
        let (step, time) = (whole.step(), whole.time());
        make_steps(&mut whole, 12);
        let mut resumed = Simulation::new(&drawn, &settings).expect("a scene that can be simulated");
        resumed.resume(&saved, step, time).expect("particles of the same scene");
        make_steps(&mut resumed, 12);
        assert_eq!((resumed.step(), resumed.time()), (whole.step(), whole.time()));
        assert_eq!(resumed.particles().expect("particles"), whole.particles().expect("particles"));
    }
}

fn momentum_stays_without_walls() {
    for model in models() {
        let mut drawn = drop(20, 1.0, model);
        for velocity in &mut drawn.particles.velocities {
            *velocity += DVec3::new(1.0, -0.5, 0.0);
        }
        let mut simulation = simulation(&drawn);
        let before = simulation.measure().expect("measures").momentum;
        make_steps(&mut simulation, 60);
        let after = simulation.measure().expect("measures").momentum;
        // Every pair acts both ways by the same number, so only rounding is left.
        assert!((after - before).length() < 1e-12 * before.length(), "{before} became {after}");
    }
}

fn spaced_lattices_keep_their_density_in_space() {
    // Four cells of a lattice at rest in a periodic cube: nothing moves it.
    for model in models() {
        let places = (0..216u8).map(|i| DVec3::new((i % 6).into(), (i / 6 % 6).into(), (i / 36).into()));
        let places = places.map(|p| (p + 0.5) * SPACING).collect();
        let mut still = scene("lattice", places, model);
        still.dimensions = Dimensions::Three;
        still.domain = [DVec3::ZERO, DVec3::splat(6.0 * SPACING)];
        still.periodic = [true; 3];
        let mut simulation = simulation(&still);
        make_steps(&mut simulation, 5);
        let particles = simulation.particles().expect("particles");
        for (density, velocity) in particles.densities.iter().zip(&particles.velocities) {
            assert!((density / 1000.0 - 1.0).abs() < 1e-12 && velocity.length() < 1e-9, "{density}, {velocity}");
        }
    }
}
