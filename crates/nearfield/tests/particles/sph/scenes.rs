//! Scenes in the plane with known outcomes: a column that collapses, a drop that is drawn out, vortices that decay, a tank at rest.

use std::f64::consts::TAU;

use nearfield::DVec3;
use nearfield::application::particles::{
    DfsphSettings, Dimensions, Fluid, ParticleModel, ParticleScene, Particles, SmoothingKernel, TimeStep,
    WcsphSettings,
};

pub(crate) const GRAVITY: f64 = 9.81;

/// A smoothing length of so many spacings times √2, as is usual for weakly compressible fluids in the plane; the support is two of them.
const LENGTHS: f64 = 1.0;

/// Water of density 1000.
pub(crate) fn water(spacing: f64, support: f64) -> Fluid {
    Fluid { spacing, support: support * spacing, rest_density: 1000.0 }
}

/// Weakly compressible water that expects this speed.
pub(crate) fn wcsph(spacing: f64, speed: f64) -> WcsphSettings {
    WcsphSettings::new(water(spacing, 2.0 * LENGTHS * 2.0f64.sqrt()), 10.0 * speed)
}

/// Incompressible water.
pub(crate) fn dfsph(spacing: f64) -> DfsphSettings {
    DfsphSettings::new(water(spacing, 2.0))
}

/// Places of a square lattice in a box, half a spacing from its sides.
pub(crate) fn lattice(low: [f64; 2], high: [f64; 2], spacing: f64) -> Vec<DVec3> {
    let count = |axis: usize| ((high[axis] - low[axis]) / spacing).round() as u32;
    let place = |axis: usize, i: u32| low[axis] + (f64::from(i) + 0.5) * spacing;
    let row = |y: u32| (0..count(0)).map(move |x| DVec3::new(place(0, x), place(1, y), 0.0));
    (0..count(1)).flat_map(row).collect()
}

/// A floor from 0 to `width` and two walls, of so many layers, whose first is half a spacing outside.
pub(crate) fn walls(width: f64, height: f64, spacing: f64, layers: u32) -> Vec<DVec3> {
    let thickness = f64::from(layers) * spacing;
    let all = lattice([-thickness, -thickness], [width + thickness, height], spacing);
    all.into_iter().filter(|p| p.x < 0.0 || p.x > width || p.y < 0.0).collect()
}

/// Particles at rest in the plane, without forces.
pub(crate) fn scene(name: &str, particles: Vec<DVec3>, model: ParticleModel) -> ParticleScene {
    ParticleScene {
        name: name.to_owned(),
        dimensions: Dimensions::Two,
        domain: [DVec3::new(-10.0, -10.0, 0.0), DVec3::new(10.0, 10.0, 0.0)],
        periodic: [false; 3],
        gravity: DVec3::ZERO,
        particles: Particles::at_rest(particles),
        boundary: Vec::new(),
        model,
        time_step: TimeStep::Cfl { factor: 0.25, least: 1e-9, most: 1.0 },
    }
}

/// A column of water, 1 m wide and 2 m high, whose right wall is gone (Koshizuka1996).
pub(crate) fn dam_break(spacing: f64, model: ParticleModel) -> ParticleScene {
    ParticleScene {
        gravity: DVec3::new(0.0, -GRAVITY, 0.0),
        boundary: walls(5.0, 2.5, spacing, 3),
        time_step: TimeStep::Cfl { factor: 0.4, least: 1e-9, most: 0.01 },
        ..scene("dam-break", lattice([0.0, 0.0], [1.0, 2.0], spacing), model)
    }
}

/// A disc of radius 1 and of density 1 whose velocity is (−A₀ x, A₀ y).
pub(crate) fn drop(n: u32, rate: f64, model: ParticleModel) -> ParticleScene {
    let mut places = lattice([-1.0, -1.0], [1.0, 1.0], 1.0 / f64::from(n));
    places.retain(|p| p.length() < 1.0);
    let mut scene = scene("drop", places, model);
    scene.particles.velocities = scene.particles.positions.iter().map(|p| rate * DVec3::new(-p.x, p.y, 0.0)).collect();
    scene
}

/// Vortices of speed 1 in a periodic square of side 1, n × n particles. They are a little denser than at rest, so that there is pressure
/// everywhere.
pub(crate) fn taylor_green(n: u32, compression: f64, viscosity: f64) -> ParticleScene {
    let spacing = 1.0 / f64::from(n);
    let rest_density = 1.0 / (1.0 + compression);
    let mut settings = wcsph(spacing, 1.0);
    // The mass of a particle is that of a cell.
    settings.fluid.spacing = spacing * (1.0 + compression).sqrt();
    settings.fluid.rest_density = rest_density;
    settings.artificial_viscosity = 0.0;
    settings.viscosity = viscosity;
    let mut scene = scene("taylor-green", lattice([0.0, 0.0], [1.0, 1.0], spacing), ParticleModel::Wcsph(settings));
    scene.domain = [DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)];
    scene.periodic = [true, true, false];
    let vortex = |p: &DVec3| {
        let (x, y) = (TAU * p.x, TAU * p.y);
        DVec3::new(-x.cos() * y.sin(), x.sin() * y.cos(), 0.0)
    };
    scene.particles.velocities = scene.particles.positions.iter().map(vortex).collect();
    scene.particles.densities = vec![1.0; scene.particles.len()];
    scene
}

/// Water at rest in a tank, so high.
pub(crate) fn tank(width: f64, height: f64, spacing: f64, layers: u32, model: ParticleModel) -> ParticleScene {
    ParticleScene {
        gravity: DVec3::new(0.0, -GRAVITY, 0.0),
        boundary: walls(width, 1.2 * height, spacing, layers),
        time_step: TimeStep::Cfl { factor: 0.4, least: 1e-9, most: 0.01 },
        ..scene("tank", lattice([0.0, 0.0], [width, height], spacing), model)
    }
}

/// The model with this smoothing kernel.
pub(crate) fn smoothed_by(kernel: SmoothingKernel, model: &ParticleModel) -> ParticleModel {
    let mut model = model.clone();
    match &mut model {
        ParticleModel::Wcsph(settings) => settings.smoothing = kernel,
        ParticleModel::Dfsph(settings) => settings.smoothing = kernel,
        _ => {}
    }
    model
}
