//! Deep water at rest: columns of a hundred layers of incompressible particles.

use libtest_mimic::Trial;
use nearfield::application::Watch;
use nearfield::application::particles::{ParticleModel, ParticleScene, Simulate, StepReport, TimeStep};

use super::scenes::{GRAVITY, dfsph, tank};
use super::{advance_to, simulation};
use crate::support::trial;

/// Layers of the columns, and particles side by side.
const LAYERS: u32 = 100;
const ACROSS: u32 = 8;
const SPACING: f64 = 0.01;
const HEIGHT: f64 = LAYERS as f64 * SPACING;
/// Steps over which a column at rest is looked at.
const STEPS: u32 = 200;

/// The trials of this file.
pub(super) fn trials() -> Vec<Trial> {
    vec![
        trial("smoothed_fluids::columns_of_a_hundred_layers_are_held_up", columns_are_held_up),
        trial("smoothed_fluids::pressures_of_the_last_step_save_iterations", last_pressures_save_iterations),
        trial("smoothed_fluids::steps_are_short_under_deep_water", steps_are_short),
    ]
}

/// Water at rest in a narrow tank with walls of one layer.
pub(crate) fn column() -> ParticleScene {
    let mut settings = dfsph(SPACING);
    settings.xsph = 0.05;
    tank(f64::from(ACROSS) * SPACING, HEIGHT, SPACING, 1, ParticleModel::Dfsph(settings))
}

/// Mean iterations of steps.
fn iterations(reports: &[StepReport]) -> f64 {
    reports.iter().map(|report| f64::from(report.iterations)).sum::<f64>() / reports.len() as f64
}

fn columns_are_held_up() {
    let mut simulation = simulation(&column());
    advance_to(&mut simulation, 0.5);
    let (mut reports, mut pressure) = (Vec::new(), 0.0);
    for _ in 0..STEPS {
        reports.extend(simulation.advance(1, &mut Watch::none()).expect("a step"));
        let pressures = simulation.particles().expect("particles").pressures;
        pressure += pressures.iter().sum::<f64>() / (pressures.len() as f64 * f64::from(STEPS));
    }
    let measures = simulation.measure().expect("measures");
    let (top, made) = (measures.max.y + 0.5 * SPACING, iterations(&reports));
    let left = reports.iter().map(|report| report.density_error[0]).fold(0.0, f64::max);
    println!("top {top}, {made} iterations, {left:e} left, {measures:?}");
    // As lower columns: the uppermost particles come nearer, for their surface counts for more than its layer.
    assert!((top - HEIGHT).abs() < 0.02 * HEIGHT, "{top}");
    assert!(measures.mean_compression < 1e-3 && measures.max_compression < 0.02, "{measures:?}");
    assert!(measures.min.y > 0.0 && measures.min.x > 0.0, "{}", measures.min);
    assert!(measures.max.x < f64::from(ACROSS) * SPACING, "{}", measures.max);
    // Some 18; without the pressures of the last step it is some 70.
    assert!(left < 2e-4 && made < 25.0, "{made} iterations, {left} left");
    // What rests is carried by pressures whose mean is that at half the height; it is met to some tenth, for particles still move about.
    let expected = 1000.0 * GRAVITY * 0.5 * HEIGHT;
    println!("mean pressure {pressure} for {expected}");
    assert!((pressure / expected - 1.0).abs() < 0.2, "{pressure} for {expected}");
}

fn last_pressures_save_iterations() {
    let mut simulation = simulation(&column());
    advance_to(&mut simulation, 0.2);
    let (mut particles, step, time) =
        (simulation.particles().expect("particles"), simulation.step(), simulation.time());
    let warm = simulation.advance(10, &mut Watch::none()).expect("steps");
    let mut cold = Vec::new();
    simulation.resume(&particles, step, time).expect("particles of the scene");
    for _ in 0..10 {
        particles = simulation.particles().expect("particles");
        particles.pressures.clear();
        simulation.resume(&particles, simulation.step(), simulation.time()).expect("particles of the scene");
        cold.extend(simulation.advance(1, &mut Watch::none()).expect("a step"));
    }
    let (warm, cold) = (iterations(&warm), iterations(&cold));
    println!("{warm} iterations, {cold} from no pressure");
    assert!(warm < 0.6 * cold, "{warm} iterations, {cold} from no pressure");
}

fn steps_are_short() {
    let mut scene = column();
    let reports = simulation(&scene).advance(1, &mut Watch::none()).expect("a step");
    // Between the lowest and the highest layer.
    let expected = 0.4 * SPACING / (GRAVITY * (HEIGHT - SPACING)).sqrt();
    assert!((reports[0].time_step / expected - 1.0).abs() < 1e-12, "{:?} for {expected}", reports[0]);
    scene.time_step = TimeStep::Fixed(0.002);
    let reports = simulation(&scene).advance(1, &mut Watch::none()).expect("a step");
    assert_eq!(reports[0].time_step, 0.002);
}
