//! Fluids in tanks whose walls are one layer of particles.

use glam::DVec3;

use super::super::lattice::{fill_ball, fill_box, line_box};
use super::super::{
    DfsphSettings, Dimensions, Fluid, ParticleModel, ParticleScene, Particles, PbfSettings, TimeStep, WcsphSettings,
};
use super::{BuiltinOptions, FluidModel};
use crate::{Error, Result};

const GRAVITY: f64 = 9.81;
/// Part of a spacing that the fastest particle moves in a step of a fixed length.
const COURANT: f64 = 0.4;

/// Fluid in a tank whose lower corner is the origin.
struct Tank {
    size: DVec3,
    blocks: Vec<Shape>,
    /// The height that the fluid falls through at most: it says how fast it becomes.
    fall: f64,
    particles: u32,
}

/// Where there is fluid at the start.
enum Shape {
    Box { low: DVec3, high: DVec3 },
    Ball { center: DVec3, radius: f64 },
}

impl Tank {
    fn named(name: &str) -> Self {
        let block = |low: [f64; 3], high: [f64; 3]| Shape::Box { low: low.into(), high: high.into() };
        match name {
            "dam-break" => Self {
                size: DVec3::new(4.0, 3.0, 1.0),
                blocks: vec![block([0.0; 3], [1.0, 2.0, 1.0])],
                fall: 2.0,
                particles: 16_000,
            },
            "double-dam" => Self {
                size: DVec3::new(4.0, 3.0, 1.0),
                blocks: vec![block([0.0; 3], [1.0, 1.0, 1.0]), block([3.0, 0.0, 0.0], [4.0, 1.0, 1.0])],
                fall: 1.0,
                particles: 16_000,
            },
            "drop" => Self {
                size: DVec3::new(2.0, 2.0, 2.0),
                blocks: vec![
                    block([0.0; 3], [2.0, 0.4, 2.0]),
                    Shape::Ball { center: DVec3::new(1.0, 1.3, 1.0), radius: 0.4 },
                ],
                fall: 1.3,
                particles: 16_000,
            },
            "accel-fluid" => Self {
                size: DVec3::ONE,
                blocks: vec![block([0.0, 0.0, 0.0], [0.5, 0.8, 0.5])],
                fall: 0.8,
                particles: 10_000,
            },
            _ => Self {
                size: DVec3::new(0.5, 1.25, 0.5),
                blocks: vec![block([0.0; 3], [0.5, 1.0, 0.5])],
                fall: 1.0,
                particles: 4096,
            },
        }
    }

    /// Lattices of this spacing.
    fn filled(&self, spacing: f64, dimensions: Dimensions) -> Vec<DVec3> {
        let fill = |shape: &Shape| match *shape {
            Shape::Box { low, high } => fill_box(low, high, spacing, dimensions),
            Shape::Ball { center, radius } => fill_ball(center, radius, spacing, dimensions),
        };
        self.blocks.iter().flat_map(fill).collect()
    }

    /// The spacing that gives about so many particles: the one that divides the tank's width and comes closest.
    fn spacing(&self, particles: u32, dimensions: Dimensions) -> f64 {
        let volume: f64 = self.blocks.iter().map(|shape| shape.volume(dimensions)).sum();
        let free = (volume / f64::from(particles)).powf(1.0 / f64::from(dimensions.number()));
        // The shortest side is divided without a rest; the others of all tanks are multiples of half of it or so.
        let shortest =
            if dimensions == Dimensions::Two { self.size.x.min(self.size.y) } else { self.size.min_element() };
        let cells = (shortest / free).round().max(1.0);
        let even = shortest / cells;
        if self.filled(even, dimensions).is_empty() { free.min(shortest) } else { even }
    }
}

impl Shape {
    fn volume(&self, dimensions: Dimensions) -> f64 {
        let flat = dimensions == Dimensions::Two;
        match *self {
            Self::Box { low, high } if flat => (high - low).truncate().element_product(),
            Self::Box { low, high } => (high - low).element_product(),
            Self::Ball { radius, .. } if flat => std::f64::consts::PI * radius.powi(2),
            Self::Ball { radius, .. } => 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3),
        }
    }
}

pub(super) fn scene(name: &str, options: &BuiltinOptions) -> Result<ParticleScene> {
    let tank = Tank::named(name);
    let dimensions = options.dimensions.unwrap_or_default();
    let particles = options.particles.unwrap_or(tank.particles);
    let spacing = tank.spacing(particles, dimensions);
    let positions = tank.filled(spacing, dimensions);
    if positions.is_empty() {
        let expected = "enough that the fluid is some particles wide";
        return Err(Error::InvalidSetting { setting: "particles", found: particles.to_string(), expected });
    }
    let speed = (2.0 * GRAVITY * tank.fall).sqrt();
    let fixed = TimeStep::Fixed(COURANT * spacing / speed);
    let cfl = |factor: f64| TimeStep::Cfl { factor, least: 1e-4 * spacing / speed, most: COURANT * spacing / speed };
    // Walls of smoothed particles give way a little; those of position-based fluids are the faces of the domain as well.
    let (model, time_step, margin) = match options.model.unwrap_or_default() {
        FluidModel::Pbf => (ParticleModel::Pbf(PbfSettings::new(Fluid::water(spacing))), fixed, 0.0),
        FluidModel::Wcsph => {
            (ParticleModel::Wcsph(WcsphSettings::new(Fluid::water(spacing), 10.0 * speed)), cfl(0.25), spacing)
        }
        FluidModel::Dfsph => (ParticleModel::Dfsph(DfsphSettings::new(Fluid::water(spacing))), cfl(0.4), spacing),
    };
    Ok(ParticleScene {
        name: name.to_owned(),
        dimensions,
        domain: [DVec3::splat(-margin), tank.size + margin],
        periodic: [false; 3],
        gravity: DVec3::new(0.0, -GRAVITY, 0.0),
        boundary: line_box(DVec3::ZERO, tank.size, spacing, dimensions),
        particles: Particles::at_rest(positions),
        model,
        time_step,
    })
}
