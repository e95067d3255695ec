//! Scenes that need no file.

use glam::DVec3;

use super::{Collider, DemSettings, Dimensions, ParticleModel, ParticleScene, Particles, TimeStep};
use crate::{Error, Result};

/// What can be chosen of a built-in scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BuiltinOptions {
    /// About how many particles; the scene's own number without.
    pub particles: Option<u32>,
}

/// Names of the built-in scenes.
pub fn builtin_names() -> &'static [&'static str] {
    &["dem-box"]
}

/// A built-in scene.
///
/// # Errors
/// `InvalidSetting` for a name that is none, and for numbers of particles that the scene cannot have.
pub fn builtin_scene(name: &str, options: &BuiltinOptions) -> Result<ParticleScene> {
    match name {
        "dem-box" => Ok(dem_box(options.particles.unwrap_or(16_384))),
        _ => Err(Error::InvalidSetting {
            setting: "scene",
            found: name.to_owned(),
            expected: "the name of a built-in scene",
        }),
    }
}

/// Seed of the jitter of lattices.
const SEED: u32 = 1973;

/// The start of Green2010: a cubic lattice of touching grains above the corner of a box of side 2, with a ball outside one corner. Beyond 16,384
/// grains, as in the paper's larger runs, the grains are smaller, so that as much of the box is filled.
fn dem_box(particles: u32) -> ParticleScene {
    let scale = (f64::from(particles.max(1)) / 16_384.0).cbrt().max(1.0);
    let radius = 1.0 / 64.0 / scale;
    let mut settings = DemSettings::green(radius);
    settings.collider = Some(Collider { center: DVec3::new(-1.2, -0.8, 0.8), radius: 0.2 });
    ParticleScene {
        name: "dem-box".to_owned(),
        dimensions: Dimensions::Three,
        domain: [DVec3::NEG_ONE, DVec3::ONE],
        periodic: [false; 3],
        gravity: DVec3::new(0.0, -0.0003, 0.0),
        particles: Particles::at_rest(jittered_lattice(particles, radius)),
        boundary: Vec::new(),
        model: ParticleModel::Dem(settings),
        time_step: TimeStep::Fixed(0.5),
    }
}

/// A cube of `count` places two radii apart from the lower corner of the box on, x fastest, each moved by up to a hundredth of the radius.
fn jittered_lattice(count: u32, radius: f64) -> Vec<DVec3> {
    let side = (1..).find(|side: &u32| side.pow(3) >= count).unwrap_or(1);
    let mut random = Lcg(SEED);
    let place = |i: u32| {
        let cell = DVec3::new(f64::from(i % side), f64::from(i / side % side), f64::from(i / side / side));
        let jitter = DVec3::from_array(std::array::from_fn(|_| (2.0 * random.unit() - 1.0) * 0.01 * radius));
        2.0 * radius * cell + (radius - 1.0) + jitter
    };
    (0..count).map(place).collect()
}

/// The generator of the published start.
struct Lcg(u32);

impl Lcg {
    /// The next number in [0, 1).
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(self.0) / 4_294_967_296.0
    }
}
