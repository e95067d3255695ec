//! Simulations that are saved and go on are those that were never interrupted.

use libtest_mimic::Trial;
use nearfield::Error;
use nearfield::application::Watch;
use nearfield::application::particles::{
    BuiltinOptions, Checkpoint, FluidModel, GpuSimulation, ParticleScene, ParticleSearch, Simulate, Simulation,
    SimulationSettings, StepReport, TimeStep, builtin_scene,
};
use nearfield::gpu::Gpu;

use crate::support::{gpu_trial, trial};

pub(crate) fn trials() -> Vec<Trial> {
    vec![
        trial("a_simulation_goes_on_from_a_file_bit_by_bit", goes_on),
        trial("damaged_checkpoints_are_errors", damaged_files),
        trial("checkpoints_of_other_scenes_are_errors", other_scenes),
        gpu_trial("a_simulation_on_the_device_goes_on_from_a_file", goes_on_on_the_device),
        gpu_trial("a_simulation_on_the_device_goes_on_with_steps_by_its_rule", steps_by_rule_go_on),
    ]
}

/// A new order after so many steps, and steps before and after the interruption: it lies between two orders.
const REORDER_EVERY: u32 = 4;
const BEFORE: u32 = 6;
const AFTER: u32 = 7;

fn path(name: &str) -> std::path::PathBuf {
    std::env::temp_dir().join(format!("nearfield-checkpoint-{name}-{}.npz", std::process::id()))
}

fn scenes() -> Vec<(String, ParticleScene)> {
    let of = |name: &str, model: Option<FluidModel>| {
        let options = BuiltinOptions { particles: Some(1000), model, ..BuiltinOptions::default() };
        (format!("{name}-{model:?}"), builtin_scene(name, &options).expect("a built-in scene"))
    };
    let mut scenes = vec![of("dem-box", None), of("paper-fig20", None)];
    scenes.extend([FluidModel::Pbf, FluidModel::Wcsph, FluidModel::Dfsph].map(|model| of("drop", Some(model))));
    scenes
}

fn goes_on() {
    let searches = [(ParticleSearch::UNIFORM_GRID, false), (ParticleSearch::MultiLevelGrid, true)];
    for ((name, scene), (search, deterministic)) in scenes().into_iter().flat_map(|s| searches.map(|t| (s.clone(), t)))
    {
        let settings =
            SimulationSettings { search, deterministic, reorder_every: REORDER_EVERY, ..SimulationSettings::default() };
        let start = || Simulation::new(&scene, &settings).expect("a scene that can be simulated");
        let mut whole = start();
        whole.advance(BEFORE + AFTER, &mut Watch::none()).expect("steps");

        let mut first = start();
        first.advance(BEFORE, &mut Watch::none()).expect("steps");
        let saved = Checkpoint::of(&first).expect("a checkpoint");
        let path = path(&name);
        saved.write(&path, true).expect("a file");
        let read = Checkpoint::read(&path).expect("the same file");
        std::fs::remove_file(&path).expect("the file");
        assert_eq!(read, saved, "{name}");
        let is_pressed = read.particles.pressures.iter().any(|pressure| *pressure > 0.0);
        assert_eq!(is_pressed, scene.model.name() == "dfsph", "{name}");
        // The order of the scene is not that of the simulation, or nothing would be tested.
        assert!(!read.order.is_sorted(), "{name}");
        let mut second = start();
        read.resume(&mut second).expect("particles of the same scene");
        assert_eq!((second.step(), second.time()), (first.step(), first.time()));
        second.advance(AFTER, &mut Watch::none()).expect("steps");

        let (expected, found) = (whole.particles().expect("particles"), second.particles().expect("particles"));
        assert_eq!(found, expected, "{name}, {search}");
        assert_eq!((second.step(), second.time()), (whole.step(), whole.time()));
    }
}

/// Writes a simulation on a device to a file between two steps, reads it, and compares where it goes on to with one that was never
/// interrupted; what the steps of both did.
fn compare_on_device(gpu: &Gpu, name: &str, scene: &ParticleScene) -> [Vec<StepReport>; 2] {
    // Sums in fixed point do not depend on the order, which a file of a device does not have.
    let settings =
        SimulationSettings { deterministic: true, reorder_every: REORDER_EVERY, ..SimulationSettings::default() };
    let start = || GpuSimulation::new(gpu, scene, &settings).expect("a scene that can be simulated");
    let mut whole = start();
    let mut expected_reports = whole.advance(BEFORE + AFTER, &mut Watch::none()).expect("steps");
    let mut first = start();
    first.advance(BEFORE, &mut Watch::none()).expect("steps");
    let saved = Checkpoint::of(&first).expect("a checkpoint");
    let path = path(name);
    saved.write(&path, true).expect("a file");
    let read = Checkpoint::read(&path).expect("the same file");
    std::fs::remove_file(&path).expect("the file");
    assert_eq!(read, saved, "{name}");

    let mut second = start();
    read.resume(&mut second).expect("particles of the same scene");
    assert_eq!((second.step(), second.time()), (first.step(), first.time()), "{name}");
    let reports = second.advance(AFTER, &mut Watch::none()).expect("steps");
    assert_eq!(second.step(), whole.step(), "{name}");
    assert!((second.time() / whole.time() - 1.0).abs() < 1e-5, "{name}: {} for {}", second.time(), whole.time());
    let (expected, found) = (whole.particles().expect("particles"), second.particles().expect("particles"));
    assert_eq!(found.classes, expected.classes, "{name}");
    let largest = |of: &dyn Fn(usize) -> f64| (0..found.len()).map(of).fold(0.0, f64::max);
    let apart = largest(&|i| found.positions[i].distance(expected.positions[i]));
    let faster = largest(&|i| found.velocities[i].distance(expected.velocities[i]));
    let moved = largest(&|i| expected.positions[i].distance(saved.particles.positions[i]));
    // Places in single precision are off by 6e-8 of the domain in each step, and speeds by that in a step.
    let size = (scene.domain[1] - scene.domain[0]).length();
    let places = f64::from(AFTER) * 1.2e-7 * size;
    let speeds = places / reports[0].time_step;
    println!("{name}: {apart:e} of {places:e} apart, {faster:e} of {speeds:e} faster, {moved:e} moved");
    assert!(apart <= places && faster <= speeds, "{name}: {apart:e} apart, {faster:e} faster");
    assert!(moved > 10.0 * places, "{name}: nothing happens, {moved:e} for {places:e}");
    [reports, expected_reports.split_off(BEFORE as usize)]
}

fn goes_on_on_the_device(gpu: &Gpu) {
    for (name, scene) in scenes() {
        let [reports, expected] = compare_on_device(gpu, &format!("device-{name}"), &scene);
        for (found, expected) in reports.iter().zip(&expected) {
            assert_eq!((found.step, found.time_step), (expected.step, expected.time_step), "{name}");
            assert!((found.mean_neighbors - expected.mean_neighbors).abs() < 0.01, "{name}: {found:?}, {expected:?}");
        }
    }
}

fn steps_by_rule_go_on(gpu: &Gpu) {
    for model in FluidModel::ALL {
        let options = BuiltinOptions { particles: Some(1000), model: Some(model), ..BuiltinOptions::default() };
        let mut scene = builtin_scene("drop", &options).expect("a built-in scene");
        scene.time_step = TimeStep::Cfl { factor: 0.1, least: 1e-7, most: 1.0 };
        let [reports, expected] = compare_on_device(gpu, &format!("rule-{model}"), &scene);
        for (found, expected) in reports.iter().zip(&expected) {
            let is_same = (found.time_step / expected.time_step - 1.0).abs() < 1e-5;
            assert!(is_same && found.step == expected.step, "{model}: {found:?} for {expected:?}");
        }
        // The rule decides, not its limits: steps differ, if only a little where the speed of sound decides.
        let lengths = || expected.iter().map(|report| report.time_step);
        let (shortest, longest) = (lengths().fold(f64::INFINITY, f64::min), lengths().fold(0.0, f64::max));
        println!("{model}: steps of {shortest:e} to {longest:e}");
        // Those of dfsph are bounded by the height of the fluid at the start, which stays.
        let varies = longest > 1.0003 * shortest || model == FluidModel::Dfsph;
        assert!(varies && shortest > 1e-6 && longest < 0.5, "{model}: {shortest} to {longest}");
    }
}

fn damaged_files() {
    let (_, scene) = scenes().swap_remove(0);
    let simulation = Simulation::new(&scene, &SimulationSettings::default()).expect("a scene");
    let path = path("damaged");
    Checkpoint::of(&simulation).expect("a checkpoint").write(&path, true).expect("a file");
    let exists = Checkpoint::of(&simulation).expect("a checkpoint").write(&path, false);
    assert!(matches!(exists, Err(Error::Io { .. })), "{exists:?}");
    let bytes = std::fs::read(&path).expect("the file");
    std::fs::remove_file(&path).expect("the file");
    for length in [0, 1, 100, bytes.len() / 2, bytes.len() - 1] {
        assert!(matches!(Checkpoint::parse(&bytes[..length]), Err(Error::File(_))), "{length} bytes");
    }
    let missing = Checkpoint::read(&path);
    assert!(matches!(missing, Err(Error::Io { .. })), "{missing:?}");
    // Steps that are no whole number, an order that is no index, a time that is none.
    let sound = Checkpoint::parse(&bytes).expect("a sound file");
    assert!(Checkpoint::parse(b"PK no archive").is_err());
    let mut few = sound.clone();
    few.particles.pressures = vec![0.0; 3];
    for wrong in [
        few,
        Checkpoint { time: f64::NAN, ..sound.clone() },
        Checkpoint { time: -1.0, ..sound.clone() },
        Checkpoint { order: vec![u32::MAX; sound.order.len()], ..sound.clone() },
        Checkpoint { order: vec![0; 3], ..sound.clone() },
    ] {
        wrong.write(&path, true).expect("a file");
        let error = Checkpoint::read(&path).expect_err("a wrong checkpoint");
        assert!(matches!(error, Error::File(_)), "{error}");
        std::fs::remove_file(&path).expect("the file");
    }
}

fn other_scenes() {
    let scenes = scenes();
    let settings = SimulationSettings::default();
    let mut simulation = Simulation::new(&scenes[0].1, &settings).expect("a scene");
    let before = simulation.particles().expect("particles");
    let saved = Checkpoint::of(&simulation).expect("a checkpoint");
    let other = Checkpoint::of(&Simulation::new(&scenes[2].1, &settings).expect("a scene")).expect("a checkpoint");
    assert!(other.resume(&mut simulation).is_err());
    // Every particle twice or none is no order.
    let mut twice = saved.clone();
    twice.order[0] = twice.order[1];
    let error = twice.resume(&mut simulation).expect_err("an order with a gap");
    assert!(matches!(error, Error::InvalidSetting { setting: "order of particles", .. }), "{error}");
    assert_eq!(simulation.particles().expect("particles"), before);
}
