//! What must not change: the momentum of two clouds of grains that meet far from any wall, and that their kinetic energy only falls where
//! nothing repels.

use nearfield::DVec3;
use nearfield::application::Watch;
use nearfield::application::particles::{
    DemSettings, Dimensions, Measures, ParticleModel, ParticleScene, Particles, TimeStep,
};
use nearfield::geometry::generate::{CloudKind, cloud};

use super::case::{self, Case};
use super::ways::{Way, devices, searches};
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::rows::{Row, Sheet};
use crate::sets::SEED;

const PARTICLES: usize = 10_000;
const STEPS: u32 = 200;
/// Radius of the grains for as many as [`PARTICLES`].
const RADIUS: f64 = 0.02;
/// Speed of each cloud towards the other, in radii a step.
const SPEED: f64 = 0.05;
/// How much the sum of all momenta may drift by the sum of their lengths: in single and in double precision.
const DRIFT: [f64; 2] = [1e-6, 1e-13];
/// How much the kinetic energy may rise in a step by rounding, in parts.
const ROUNDING: f64 = 1e-5;

/// Measures the drift by every search.
///
/// # Errors
/// A drift or a rise that is too large; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn measure(lab: &Lab) -> Result<Vec<Row>> {
    let mut sheet = Sheet::begin(lab, "conservation")?;
    for &on_gpu in devices(lab) {
        for spring in [0.5, 0.0] {
            let setting = if spring > 0.0 { "with repulsion" } else { "without repulsion" }.to_owned();
            let scene = scene(lab.points(PARTICLES), spring);
            let steps = case::steps(lab, STEPS);
            let case = Case { scene, paper_particles: PARTICLES, setting, r_over_l: 0.0, steps };
            for search in searches() {
                let way = Way { search, on_gpu };
                let row = Row { quantity: "drift of the momentum", unit: "1e-15", ..case.row(lab, on_gpu, way.name()) };
                sheet.attempt(row.clone(), || drift(lab, &case, way, row))?;
            }
        }
    }
    Ok(sheet.into_rows())
}

/// Two balls of grains that fly at each other, turning a little, in a domain that they never reach the walls of.
pub fn scene(particles: usize, spring: f64) -> ParticleScene {
    let radius = RADIUS * (PARTICLES as f64 / particles.max(1) as f64).cbrt();
    let speed = SPEED * radius;
    let places = cloud(CloudKind::Uniform, particles, SEED).points;
    let mut all = Particles::at_rest(Vec::with_capacity(particles));
    for (i, place) in places.iter().enumerate() {
        let side = if i % 2 == 0 { 1.0 } else { -1.0 };
        let at = place.as_dvec3() - 0.5;
        let spin = 0.2 * speed * DVec3::new(-at.z, 0.0, at.x);
        all.extend(Particles {
            positions: vec![at + DVec3::new(0.4 * side, 0.1 * side, 0.0)],
            velocities: vec![DVec3::new(-side * speed, 0.0, 0.0) + spin],
            classes: vec![0],
            ..Particles::default()
        });
    }
    ParticleScene {
        name: "two-clouds".to_owned(),
        dimensions: Dimensions::Three,
        domain: [DVec3::splat(-8.0), DVec3::splat(8.0)],
        periodic: [false; 3],
        gravity: DVec3::ZERO,
        particles: all,
        boundary: Vec::new(),
        model: ParticleModel::Dem(DemSettings { spring, ..DemSettings::green(radius) }),
        time_step: TimeStep::Fixed(0.5),
    }
}

fn drift(lab: &Lab, case: &Case, way: Way, mut row: Row) -> Result<Vec<Row>> {
    let mut simulation = way.open(lab, &case.scene, false)?;
    let start = simulation.measure()?;
    let lengths = |particles: &Particles| -> f64 { particles.velocities.iter().map(|v| v.length()).sum() };
    let is_damped = matches!(&case.scene.model, ParticleModel::Dem(dem) if dem.spring == 0.0);
    let (mut energy, mut neighbors) = (start.kinetic_energy, 0.0);
    let every = (case.steps / 10).max(1);
    let mut done = 0;
    while done < case.steps {
        for report in simulation.advance(every.min(case.steps - done), &mut Watch::none())? {
            neighbors += report.mean_neighbors;
            done += 1;
        }
        let now = simulation.measure()?;
        if is_damped && !(now.kinetic_energy <= energy * (1.0 + ROUNDING)) {
            let now = now.kinetic_energy;
            return Err(
                format!("wrong answer: kinetic energy {now:.9e} after {done} steps, {energy:.9e} before").into()
            );
        }
        energy = now.kinetic_energy;
    }
    let particles = simulation.particles()?;
    let end = Measures::of(&case.scene, &particles);
    let drift = (end.momentum - start.momentum).length() / lengths(&case.scene.particles).max(lengths(&particles));
    let most = DRIFT[usize::from(!way.on_gpu)];
    if !(drift <= most) {
        return Err(format!("wrong answer: the momentum drifts by {drift:.2e}, expected {most:.0e} at most").into());
    }
    row.mean_neighbors = Some(neighbors / f64::from(done.max(1)));
    row.runs = done as usize;
    row.note = format!(
        "{drift:.2e} of all momenta's lengths after {done} steps, {most:.0e} is allowed; kinetic energy {:.4e} to {:.4e}",
        start.kinetic_energy, end.kinetic_energy
    );
    Ok(vec![row.value(drift * 1e15)])
}
