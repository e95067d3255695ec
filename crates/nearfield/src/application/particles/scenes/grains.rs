//! Grains of one radius: the start of Green2010, and a block that falls into a bed.

use glam::DVec3;

use super::super::{Collider, DemSettings, Dimensions, ParticleModel, ParticleScene, Particles, TimeStep};

/// Seed of the jitter of lattices.
const SEED: u32 = 1973;
/// Grains of Green2010 whose radius is [`GREEN_RADIUS`].
const GREEN_GRAINS: f64 = 16_384.0;
const GREEN_RADIUS: f64 = 1.0 / 64.0;
/// Gravity for that radius.
const GREEN_GRAVITY: f64 = 0.0003;

/// The start of Green2010: a cubic lattice of touching grains above the corner of a box of side 2, with a ball outside one corner. Beyond 16,384
/// grains, as in the paper's larger runs, the grains are smaller, so that as much of the box is filled.
pub(super) fn dem_box(particles: u32) -> ParticleScene {
    let radius = radius_of(particles);
    let mut settings = DemSettings::green(radius);
    settings.collider = Some(Collider { center: DVec3::new(-1.2, -0.8, 0.8), radius: 0.2 });
    ParticleScene {
        gravity: DVec3::new(0.0, -GREEN_GRAVITY, 0.0),
        ..in_box("dem-box", Particles::at_rest(jittered_lattice(particles, radius)), settings)
    }
}

/// Half of the grains as a bed over the whole floor, half as a cube above its middle. As much of the box is filled as in `dem-box`.
pub(super) fn paper_fig18(particles: u32) -> ParticleScene {
    let radius = radius_of(particles);
    let bed = particles / 2;
    let mut jitter = Jitter::new(radius);
    let across = ((1.0 / radius).floor() as u32).max(1);
    let mut positions: Vec<DVec3> = lattice(bed, across, across, radius).map(|p| p - (1.0 - radius)).collect();
    let block = particles - bed;
    let side = cube_side(block);
    let half = radius * f64::from(side - 1);
    let start = DVec3::new(-half, (0.9 - 2.0 * half).max(-0.5), -half);
    positions.extend(lattice(block, side, side, radius).map(|p| p + start));
    for position in &mut positions {
        *position = (*position + jitter.next()).clamp(DVec3::NEG_ONE, DVec3::ONE);
    }
    in_box("paper-fig18", Particles::at_rest(positions), DemSettings::green(radius))
}

/// Grains in the box of Green2010, with a gravity in proportion to the smallest of them.
pub(super) fn in_box(name: &str, particles: Particles, settings: DemSettings) -> ParticleScene {
    let smallest = settings.radii.iter().copied().fold(f64::INFINITY, f64::min);
    ParticleScene {
        name: name.to_owned(),
        dimensions: Dimensions::Three,
        domain: [DVec3::NEG_ONE, DVec3::ONE],
        periodic: [false; 3],
        gravity: DVec3::new(0.0, -GREEN_GRAVITY * smallest / GREEN_RADIUS, 0.0),
        particles,
        boundary: Vec::new(),
        model: ParticleModel::Dem(settings),
        time_step: TimeStep::Fixed(0.5),
    }
}

fn radius_of(particles: u32) -> f64 {
    let scale = (f64::from(particles.max(1)) / GREEN_GRAINS).cbrt().max(1.0);
    GREEN_RADIUS / scale
}

/// The side of the smallest cube of so many places.
fn cube_side(count: u32) -> u32 {
    (1..).find(|&side: &u32| u64::from(side).pow(3) >= u64::from(count)).unwrap_or(1)
}

/// The first `count` places of a lattice of touching grains, from the origin up: x fastest, then z, in rows of `nx` and `nz` places.
fn lattice(count: u32, nx: u32, nz: u32, radius: f64) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |i| {
        let cell = DVec3::new(f64::from(i % nx), f64::from(i / nx / nz), f64::from(i / nx % nz));
        2.0 * radius * cell
    })
}

/// A cube of `count` places two radii apart from the lower corner of the box on, x fastest, each moved by up to a hundredth of the radius.
fn jittered_lattice(count: u32, radius: f64) -> Vec<DVec3> {
    let side = cube_side(count);
    let mut jitter = Jitter::new(radius);
    let place = |i: u32| {
        let cell = DVec3::new(f64::from(i % side), f64::from(i / side % side), f64::from(i / side / side));
        2.0 * radius * cell + (radius - 1.0) + jitter.next()
    };
    (0..count).map(place).collect()
}

/// Moves of up to a hundredth of a radius along each axis, by the generator of the published start.
pub(super) struct Jitter {
    state: u32,
    radius: f64,
}

impl Jitter {
    pub(super) fn new(radius: f64) -> Self {
        Self { state: SEED, radius }
    }

    pub(super) fn next(&mut self) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| (2.0 * self.unit() - 1.0) * 0.01 * self.radius))
    }

    /// The next number in [0, 1).
    fn unit(&mut self) -> f64 {
        self.state = self.state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.state) / 4_294_967_296.0
    }
}
