//! Grains against a table of an independent program, what they conserve, and what cannot be simulated.

use std::ops::ControlFlow;

use libtest_mimic::Trial;
use nearfield::application::particles::{
    BuiltinOptions, DemSettings, Dimensions, Measures, PairRule, ParticleModel, ParticleScene, ParticleSearch,
    Particles, Simulate, Simulation, SimulationSettings, TimeStep, builtin_scene,
};
use nearfield::application::{Progress, Watch};
use nearfield::{DVec3, Error, RebuildPolicy};

use crate::support::{Random, is_long, trial};

/// Contacts, mean height, kinetic energy a particle, highest speed after so many steps of Green2010's start with 16,384 grains, by a program
/// of its own in double precision that compares all pairs.
const GOLDEN: [(u32, u64, f64, f64, f64); 9] = [
    (1, 23_851, -0.596_846, 1.594_909e-8, 0.000_35),
    (10, 26_849, -0.600_515, 9.301_988e-7, 0.001_63),
    (50, 32_119, -0.659_663, 1.035_629e-5, 0.007_46),
    (100, 48_863, -0.771_646, 1.923_096e-5, 0.012_97),
    (200, 33_340, -0.869_467, 3.359_957e-5, 0.015_22),
    (300, 30_996, -0.922_558, 2.812_795e-5, 0.017_53),
    (500, 38_365, -0.939_226, 5.433_706e-6, 0.006_85),
    (1000, 48_017, -0.945_452, 2.333e-7, 0.002_04),
    (2000, 55_947, -0.947_626, 2.217e-8, 0.001_35),
];

pub(crate) fn trials() -> Vec<Trial> {
    let mut trials = vec![
        trial("golden_table_of_green_is_met", golden_table_is_met),
        trial("momentum_stays_where_nothing_pushes_from_outside", momentum_stays),
        trial("energy_never_grows_without_springs", energy_never_grows),
        trial("grains_can_be_none_one_or_all_in_one_place", few_and_coincident),
        trial("grains_that_are_too_fast_end_the_simulation", blow_up_is_told),
        trial("steps_before_a_blow_up_or_an_interruption_are_reported", finished_steps_are_reported),
        trial("scenes_that_cannot_be_simulated_are_errors", wrong_scenes_are_errors),
        trial("searches_are_named_with_their_numbers", searches_have_names),
        trial("a_simulation_goes_on_from_saved_grains", resumes),
        trial("a_search_by_itself_counts_all_and_changes_nothing", searches_are_timed),
        trial("a_search_by_itself_counts_by_the_reach_of_classes", classes_are_counted),
        trial("grains_in_the_plane_stay_there", plane_is_kept),
        trial("a_grain_shot_at_a_wall_stays_in_the_domain", shot_grain_stays),
    ];
    for rule in PairRule::ALL {
        let name = format!("every_search_gives_the_same_grains_{}", rule.name());
        trials.push(trial(name, move || searches_agree(rule)));
    }
    trials
}

/// Every search, trees by every policy that does not depend on times, grids with small and large cells.
pub(crate) fn searches() -> Vec<ParticleSearch> {
    let mut searches = ParticleSearch::ALL.to_vec();
    searches.push(ParticleSearch::AabbTree(RebuildPolicy::Always));
    searches.extend([1.0 / 3.0, 2.5].map(|cell| ParticleSearch::UniformGrid { cell }));
    searches.push(ParticleSearch::Coherent(RebuildPolicy::Never));
    searches
}

/// Grains of three radii that fall through each other in a box.
pub(crate) fn three_classes(rule: PairRule) -> ParticleScene {
    let mut random = Random(7);
    let mut unit = || f64::from(random.unit());
    let mut particles = Particles::default();
    for i in 0..600u32 {
        particles.positions.push(DVec3::new(0.1 + 0.8 * unit(), 0.1 + 0.8 * unit(), 0.1 + 0.8 * unit()));
        particles.velocities.push(0.01 * DVec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5));
        particles.classes.push((i % 3) as u8);
    }
    let mut settings = DemSettings::green(0.03);
    settings.radii = vec![0.09, 0.06, 0.03];
    settings.pair_rule = rule;
    settings.spring = 0.02;
    ParticleScene {
        name: "three-classes".to_owned(),
        dimensions: Dimensions::Three,
        domain: [DVec3::ZERO, DVec3::ONE],
        periodic: [false; 3],
        gravity: DVec3::new(0.0, -0.0003, 0.0),
        particles,
        boundary: Vec::new(),
        model: ParticleModel::Dem(settings),
        time_step: TimeStep::Fixed(0.5),
    }
}

/// The built-in box of Green2010 with fewer grains.
pub(crate) fn few_grains(particles: u32) -> ParticleScene {
    builtin_scene("dem-box", &BuiltinOptions { particles: Some(particles), ..BuiltinOptions::default() }).unwrap()
}

fn of_grains(scene: &mut ParticleScene) -> &mut DemSettings {
    match &mut scene.model {
        ParticleModel::Dem(settings) => settings,
        other => panic!("{} is no model of grains", other.name()),
    }
}

fn run(scene: &ParticleScene, settings: &SimulationSettings, steps: u32) -> Simulation {
    let mut simulation = Simulation::new(scene, settings).unwrap();
    simulation.advance(steps, &mut Watch::none()).unwrap();
    simulation
}

fn measure(simulation: &Simulation) -> Measures {
    simulation.measure().unwrap()
}

fn golden_table_is_met() {
    let scene = builtin_scene("dem-box", &BuiltinOptions::default()).unwrap();
    // Sums in the order of indices, as there.
    let settings = SimulationSettings { deterministic: true, reorder_every: 0, ..SimulationSettings::default() };
    let mut simulation = Simulation::new(&scene, &settings).unwrap();
    for (step, contacts, height, energy, speed) in GOLDEN {
        if step > 500 && !is_long() {
            break;
        }
        let steps = step - simulation.step() as u32;
        let reports = simulation.advance(steps, &mut Watch::none()).unwrap();
        let measures = measure(&simulation);
        let n = scene.particles.len() as f64;
        let found = reports.last().map_or(0.0, |report| report.mean_neighbors * n / 2.0);
        let own = (measures.mean_position.y, measures.kinetic_energy / n, measures.max_speed);
        println!("step {step}: {found} contacts, height {}, energy {:e}, speed {}", own.0, own.1, own.2);
        // Six digits up to step 50; later rounding has grown: 1 % of the energy and 0.1 % of the height.
        let (of_height, of_energy) = if step <= 50 { (5e-7 / height.abs(), 5e-7) } else { (1e-3, 1e-2) };
        assert!((own.0 / height - 1.0).abs() <= of_height, "step {step}: height {}", own.0);
        assert!((own.1 / energy - 1.0).abs() <= of_energy, "step {step}: energy {}", own.1);
        if step <= 50 {
            assert!((found - contacts as f64).abs() < 0.5, "step {step}: {found} contacts");
            assert!((own.2 - speed).abs() <= 5.1e-6, "step {step}: speed {}", own.2);
        }
    }
}

fn momentum_stays() {
    let mut scene = three_classes(PairRule::Contact);
    scene.gravity = DVec3::ZERO;
    // Walls far away.
    scene.domain = [DVec3::splat(-1e3), DVec3::splat(1e3)];
    let before = Measures::of(&scene, &scene.particles);
    let after = measure(&run(&scene, &SimulationSettings::default(), 50));
    let moved = scene.particles.velocities.iter().map(|v| v.length()).sum::<f64>();
    assert!((after.momentum - before.momentum).length() <= 1e-13 * moved, "{} to {}", before.momentum, after.momentum);
    assert!(after.kinetic_energy != before.kinetic_energy, "the grains should have pushed each other");
}

fn energy_never_grows() {
    let mut scene = three_classes(PairRule::Contact);
    scene.gravity = DVec3::ZERO;
    of_grains(&mut scene).spring = 0.0;
    // A grain takes over a fiftieth of the relative velocity of each neighbour, and a tenth of its tangential part: below one in all with
    // fewer than eight neighbours.
    scene.particles.positions.iter_mut().for_each(|p| *p = 2.0 * *p);
    scene.domain[1] = DVec3::splat(2.0);
    let mut simulation = Simulation::new(&scene, &SimulationSettings::default()).unwrap();
    let mut energy = Measures::of(&scene, &scene.particles).kinetic_energy;
    for _ in 0..30 {
        simulation.advance(1, &mut Watch::none()).unwrap();
        let now = measure(&simulation).kinetic_energy;
        assert!(now <= energy, "from {energy:e} to {now:e}");
        energy = now;
    }
}

fn few_and_coincident() {
    for n in [0, 1] {
        let mut scene = few_grains(1);
        // Away from all walls.
        scene.particles = Particles::at_rest(vec![DVec3::ZERO; n as usize]);
        for search in searches() {
            let simulation = run(&scene, &SimulationSettings { search, ..SimulationSettings::default() }, 3);
            let measures = measure(&simulation);
            // Three steps of free fall: v = g dt k, x = -½ g dt² k (k + 1).
            let fallen = f64::from(n) * -0.0003 * 0.5 * 3.0;
            assert!((measures.momentum.y - fallen).abs() < 1e-15, "{n} by {search}: {}", measures.momentum.y);
        }
    }
    let mut scene = few_grains(50);
    scene.particles.positions.fill(DVec3::new(0.25, 0.25, 0.25));
    for search in searches() {
        let particles =
            run(&scene, &SimulationSettings { search, ..SimulationSettings::default() }, 3).particles().unwrap();
        // Without a direction there is no push: they fall together.
        assert!(particles.positions.iter().all(|p| *p == particles.positions[0] && p.is_finite()), "{search}");
    }
}

fn searches_agree(rule: PairRule) {
    let scene = three_classes(rule);
    let settings =
        |search| SimulationSettings { search, deterministic: true, reorder_every: 7, ..SimulationSettings::default() };
    let expected = run(&scene, &settings(ParticleSearch::BruteForce), 40);
    let expected_reports = expected.measure().unwrap();
    let expected = expected.particles().unwrap();
    for search in searches() {
        let found = run(&scene, &settings(search), 40);
        assert_eq!(found.measure().unwrap(), expected_reports, "{search}");
        assert_eq!(found.particles().unwrap(), expected, "{search}");
    }
    // Sums as they come differ by rounding at most, after few steps.
    for search in searches() {
        let settings = SimulationSettings { search, ..SimulationSettings::default() };
        let found = run(&scene, &settings, 2).particles().unwrap();
        let exact = run(&scene, &SimulationSettings { deterministic: true, ..settings }, 2).particles().unwrap();
        for (a, b) in found.positions.iter().zip(&exact.positions) {
            assert!((*a - *b).length() < 1e-14, "{search}: {a} and {b}");
        }
    }
}

fn blow_up_is_told() {
    let mut scene = three_classes(PairRule::Contact);
    scene.particles.velocities[41] = DVec3::new(0.0, 0.5, 0.0);
    let settings = SimulationSettings { max_speed: 0.6, ..SimulationSettings::default() };
    let mut simulation = Simulation::new(&scene, &settings).unwrap();
    // A push of all its neighbours at once is more than it bears.
    of_grains(&mut scene).spring = 50.0;
    let mut hard = Simulation::new(&scene, &settings).unwrap();
    simulation.advance(1, &mut Watch::none()).unwrap();
    match hard.advance(5, &mut Watch::none()) {
        Err(Error::BlowUp { step, speed, limit, .. }) => {
            assert!(step >= 1 && speed > limit && limit == 0.6, "step {step}: {speed} above {limit}");
            assert_eq!(hard.step() + 1, step);
            let kept = hard.particles().unwrap();
            assert!(kept.velocities.iter().all(|v| v.length() <= 0.6), "what is kept should be good");
        }
        other => panic!("{other:?}"),
    }
}

/// Grains that fall freely, 0.00015 faster in each step, and may be as fast as after six.
pub(crate) fn falling() -> (ParticleScene, SimulationSettings) {
    let mut scene = few_grains(1);
    scene.particles = Particles::at_rest(vec![DVec3::ZERO; 3]);
    (scene, SimulationSettings { max_speed: 0.000_15 * 6.5, ..SimulationSettings::default() })
}

fn finished_steps_are_reported() {
    let (scene, settings) = falling();
    let mut simulation = Simulation::new(&scene, &settings).unwrap();
    let first = simulation.advance(2, &mut Watch::none()).unwrap();
    assert_eq!((first.len(), simulation.take_reports().len()), (2, 0));
    let ended = simulation.advance(9, &mut Watch::none());
    assert!(matches!(ended, Err(Error::BlowUp { step: 7, .. })), "{ended:?}");
    let reports = simulation.take_reports();
    let of_steps: Vec<(u64, f64)> = reports.iter().map(|report| (report.step, report.time)).collect();
    assert_eq!(of_steps, [(3, 1.5), (4, 2.0), (5, 2.5), (6, 3.0)]);
    assert_eq!((simulation.step(), simulation.take_reports().len()), (6, 0));
    // Nothing of an earlier call is left.
    assert!(simulation.advance(1, &mut Watch::none()).is_err() && simulation.take_reports().is_empty());
    simulation.resume(&scene.particles, 0, 0.0).unwrap();
    assert!(simulation.advance(9, &mut Watch::none()).is_err());
    simulation.resume(&scene.particles, 0, 0.0).unwrap();
    assert!(simulation.take_reports().is_empty());

    let mut simulation = Simulation::new(&scene, &settings).unwrap();
    let mut third = |progress: Progress| {
        if progress.done == 3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let ended = simulation.advance(5, &mut Watch::new(&mut third));
    assert!(matches!(ended, Err(Error::Interrupted { done: 3, .. })), "{ended:?}");
    assert_eq!((simulation.step(), simulation.take_reports().len()), (3, 3));
}

fn wrong_scenes_are_errors() {
    type Damage = fn(&mut ParticleScene);
    let cases: [(&str, Damage); 12] = [
        ("time step", |scene| scene.time_step = TimeStep::Fixed(0.0)),
        ("time step", |scene| scene.time_step = TimeStep::Fixed(f64::NAN)),
        ("time steps", |scene| scene.time_step = TimeStep::Cfl { factor: 0.4, least: 2.0, most: 1.0 }),
        ("radius of grains", |scene| of_grains(scene).radii[1] = -1.0),
        ("radii of grains", |scene| of_grains(scene).radii.clear()),
        ("spring of grains", |scene| of_grains(scene).spring = f64::NAN),
        ("domain", |scene| scene.domain[1].x = -1.0),
        ("gravity", |scene| scene.gravity.x = f64::INFINITY),
        ("class of a particle", |scene| scene.particles.classes[3] = 3),
        ("boundary", |scene| scene.boundary.push(DVec3::ZERO)),
        ("dimensions", |scene| scene.dimensions = Dimensions::Two),
        ("radius of the collider", |scene| {
            let center = DVec3::ZERO;
            of_grains(scene).collider = Some(nearfield::application::particles::Collider { center, radius: 0.0 });
        }),
    ];
    for (setting, damage) in cases {
        let mut scene = three_classes(PairRule::Contact);
        damage(&mut scene);
        match Simulation::new(&scene, &SimulationSettings::default()).map(drop) {
            Err(Error::InvalidSetting { setting: told, .. }) => assert_eq!(told, setting),
            other => panic!("{setting}: {other:?}"),
        }
    }
    let mut scene = three_classes(PairRule::Contact);
    scene.particles.positions[5].y = 7.0;
    scene.particles.positions[8].y = -7.0;
    let outside = Simulation::new(&scene, &SimulationSettings::default()).map(drop);
    assert!(matches!(outside, Err(Error::OutsideDomain { count: 2, first: 5, .. })), "{outside:?}");
    scene.particles.positions[5].y = f64::NAN;
    let invalid = Simulation::new(&scene, &SimulationSettings::default()).map(drop);
    assert!(matches!(invalid, Err(Error::NonFinite { count: 1, first: 5, .. })), "{invalid:?}");
    scene.particles.velocities.pop();
    let short = Simulation::new(&scene, &SimulationSettings::default()).map(drop);
    assert!(matches!(short, Err(Error::LengthMismatch { found: 599, expected: 600, .. })), "{short:?}");
    let scene = three_classes(PairRule::Contact);
    for settings in [
        SimulationSettings { max_speed: 0.0, ..SimulationSettings::default() },
        SimulationSettings { search: ParticleSearch::Verlet { skin: 0.0 }, ..SimulationSettings::default() },
        SimulationSettings { search: ParticleSearch::UniformGrid { cell: 0.01 }, ..SimulationSettings::default() },
        SimulationSettings { search: ParticleSearch::UniformGrid { cell: f64::NAN }, ..SimulationSettings::default() },
        SimulationSettings { search: ParticleSearch::UniformGrid { cell: -1.0 }, ..SimulationSettings::default() },
        SimulationSettings {
            search: ParticleSearch::AabbTree(RebuildPolicy::VolumeRatio { limit: 0.5 }),
            ..SimulationSettings::default()
        },
    ] {
        let refused = Simulation::new(&scene, &settings).map(drop);
        assert!(matches!(refused, Err(Error::InvalidSetting { .. })), "{refused:?}");
    }
}

fn searches_have_names() {
    for search in searches() {
        // Policies have no names of their own here.
        let read: ParticleSearch = search.to_string().parse().unwrap();
        assert_eq!(read, search.with_policy(RebuildPolicy::DEFAULT), "{search}");
        if let ParticleSearch::AabbTree(_) | ParticleSearch::Coherent(_) = search {
            assert_eq!(read.to_string(), search.name());
        }
    }
    let read = |text: &str| text.parse::<ParticleSearch>();
    assert_eq!(read("uniform-grid").unwrap(), ParticleSearch::UniformGrid { cell: 1.0 });
    assert_eq!(read("uniform-grid:0.25").unwrap(), ParticleSearch::UniformGrid { cell: 0.25 });
    assert_eq!(read("uniform-grid:1").unwrap().to_string(), "uniform-grid");
    assert_eq!(read("verlet:0.1").unwrap(), ParticleSearch::Verlet { skin: 0.1 });
    for (text, told) in [
        ("octree", "multi-level-grid"),
        ("uniform-grid:", "number"),
        ("uniform-grid:small", "number"),
        ("uniform-grid:nan", "1/64"),
        ("uniform-grid:0", "1/64"),
        ("uniform-grid:-1", "1/64"),
        ("uniform-grid:inf", "1/64"),
        ("uniform-grid:0.01", "too many"),
        ("verlet:0", "skin"),
        ("coherent:2", "behind uniform-grid"),
    ] {
        match read(text) {
            Err(error @ Error::InvalidSetting { .. }) => assert!(error.to_string().contains(told), "{text}: {error}"),
            other => panic!("{text}: {other:?}"),
        }
    }
}

fn searches_are_timed() {
    let scene = few_grains(500);
    for search in searches() {
        let settings = SimulationSettings { search, deterministic: true, ..SimulationSettings::default() };
        let start = || -> Box<dyn Simulate> { Box::new(Simulation::new(&scene, &settings).unwrap()) };
        search_is_timed(&start, &scene, &search.to_string());
    }
}

/// Compares the pairs of a search by itself with a loop, and a run with such searches with one without.
pub(crate) fn search_is_timed(start: &dyn Fn() -> Box<dyn Simulate>, scene: &ParticleScene, what: &str) {
    let (mut plain, mut timed) = (start(), start());
    timed.time_search().unwrap();
    for _ in 0..4 {
        assert_eq!(
            plain.advance(2, &mut Watch::none()).unwrap(),
            timed.advance(2, &mut Watch::none()).unwrap(),
            "{what}"
        );
        let found = timed.time_search().unwrap();
        let (places, reach) = (timed.particles().unwrap().positions, scene.model.largest_reach());
        let pairs = |factor: f64| -> u64 {
            let near = |a: DVec3| places.iter().filter(|b| a.distance(**b) <= factor * reach).count() as u64;
            places.iter().map(|a| near(*a)).sum()
        };
        // Rounding needs 8e-7 in a domain that reaches to 1, for a reach of 0.03.
        let (least, most) = (pairs(1.0 - 1e-4), pairs(1.0 + 1e-4));
        assert!((least..=most).contains(&found.neighbors), "{what}: {} of {least} to {most}", found.neighbors);
        assert!(found.seconds > 0.0 && least > 2 * places.len() as u64, "{what}: {found:?}");
    }
    assert_eq!(plain.particles().unwrap(), timed.particles().unwrap(), "{what}");
}

fn classes_are_counted() {
    for rule in PairRule::ALL {
        let mut scene = three_classes(rule);
        let particles = scene.particles.clone();
        let radii = of_grains(&mut scene).radii.clone();
        let reach = |own: usize, other: usize| rule.reach(radii[own], radii[other]);
        let farthest = |own: usize, _: usize| (0..radii.len()).map(|other| reach(own, other)).fold(0.0, f64::max);
        let pairs = |reach: &dyn Fn(usize, usize) -> f64, factor: f64| {
            let all = || particles.positions.iter().zip(&particles.classes).map(|(p, &class)| (*p, usize::from(class)));
            let is_near = |a: &(DVec3, usize), b: &(DVec3, usize)| a.0.distance(b.0) <= factor * reach(a.1, b.1);
            all().map(|a| all().filter(|b| is_near(&a, b)).count() as u64).sum::<u64>()
        };
        for search in searches() {
            let settings = SimulationSettings { search, ..SimulationSettings::default() };
            let found = Simulation::new(&scene, &settings).unwrap().time_search().unwrap().neighbors;
            let reach: &dyn Fn(usize, usize) -> f64 =
                if search == ParticleSearch::MultiLevelGrid { &reach } else { &farthest };
            let (least, most) = (pairs(reach, 1.0 - 1e-5), pairs(reach, 1.0 + 1e-5));
            assert!((least..=most).contains(&found), "{search}, {rule}: {found} of {least} to {most}");
        }
    }
}

/// Grains one of which flies upwards a million times the height of the domain in a unit of time.
pub(crate) fn shot_grain() -> ParticleScene {
    let mut scene = three_classes(PairRule::Contact);
    scene.particles.velocities[41] = DVec3::new(0.0, 1e6, 0.0);
    scene
}

fn shot_grain_stays() {
    let scene = shot_grain();
    for search in searches() {
        let settings = SimulationSettings { search, ..SimulationSettings::default() };
        let mut simulation = Simulation::new(&scene, &settings).unwrap();
        for _ in 0..5 {
            simulation.advance(1, &mut Watch::none()).unwrap();
            let measures = measure(&simulation);
            assert!(measures.outside == 0 && measures.max_speed > 1.0, "{search}: {measures:?}");
        }
    }
}

fn resumes() {
    let scene = three_classes(PairRule::Contact);
    let settings = SimulationSettings { deterministic: true, reorder_every: 0, ..SimulationSettings::default() };
    let expected = run(&scene, &settings, 20);
    let half = run(&scene, &settings, 10);
    let mut resumed = Simulation::new(&scene, &settings).unwrap();
    resumed.resume(&half.particles().unwrap(), half.step(), half.time()).unwrap();
    resumed.advance(10, &mut Watch::none()).unwrap();
    assert_eq!(resumed.particles().unwrap(), expected.particles().unwrap());
    assert_eq!((resumed.step(), resumed.time()), (20, 10.0));
    let mut other = half.particles().unwrap();
    other.classes.swap(0, 1);
    let refused = resumed.resume(&other, 0, 0.0);
    assert!(matches!(refused, Err(Error::InvalidSetting { setting: "class of a particle", .. })), "{refused:?}");
    let few = Particles::at_rest(vec![DVec3::splat(0.5); 3]);
    let refused = resumed.resume(&few, 0, 0.0);
    assert!(matches!(refused, Err(Error::LengthMismatch { found: 3, expected: 600, .. })), "{refused:?}");
}

/// The same grains in a plane, which is the whole domain along z.
pub(crate) fn in_the_plane() -> ParticleScene {
    let mut scene = three_classes(PairRule::Contact);
    scene.dimensions = Dimensions::Two;
    (scene.domain[0].z, scene.domain[1].z) = (0.0, 0.0);
    let moving = &mut scene.particles;
    moving.positions.iter_mut().chain(&mut moving.velocities).for_each(|vector| vector.z = 0.0);
    scene
}

fn plane_is_kept() {
    let simulation = run(&in_the_plane(), &SimulationSettings::default(), 20);
    let particles = simulation.particles().unwrap();
    assert!(particles.positions.iter().chain(&particles.velocities).all(|vector| vector.z == 0.0));
    assert_eq!(measure(&simulation).outside, 0);
    let mut resumed = Simulation::new(&in_the_plane(), &SimulationSettings::default()).unwrap();
    resumed.resume(&particles, 20, 10.0).unwrap();
}
