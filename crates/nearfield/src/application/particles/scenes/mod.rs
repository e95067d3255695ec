//! Scenes that need no file.

mod fluids;
mod grains;
mod radii;

use std::fmt;
use std::str::FromStr;

use super::lattice::MOST_PARTICLES;
use super::{Dimensions, PairRule, ParticleScene};
use crate::{Error, Result};

/// What can be chosen of a built-in scene. What a scene does not have is an error there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BuiltinOptions {
    /// About how many particles; the scene's own number without. Those of walls do not count.
    pub particles: Option<u32>,
    /// How a fluid moves; position-based without.
    pub model: Option<FluidModel>,
    /// Dimensions of a fluid's scene; 3 without.
    pub dimensions: Option<Dimensions>,
    /// Which grains of `paper-fig20` act on each other; those that touch without.
    pub pair_rule: Option<PairRule>,
    /// Radius of the smallest grains of `paper-fig20`, in parts of the diagonal of the domain; 0.0025 without.
    pub radius: Option<f64>,
}

/// The models of fluids, by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum FluidModel {
    /// Position-based.
    #[default]
    Pbf,
    /// Weakly compressible smoothed particles.
    Wcsph,
    /// Divergence-free smoothed particles.
    Dfsph,
}

impl FluidModel {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Pbf, Self::Wcsph, Self::Dfsph];

    /// "pbf", "wcsph", "dfsph".
    pub fn name(self) -> &'static str {
        match self {
            Self::Pbf => "pbf",
            Self::Wcsph => "wcsph",
            Self::Dfsph => "dfsph",
        }
    }
}

impl fmt::Display for FluidModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for FluidModel {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|model| model.name() == name);
        known.ok_or_else(|| Error::InvalidSetting {
            setting: "model",
            found: name.to_owned(),
            expected: "pbf, wcsph or dfsph",
        })
    }
}

/// Names of the built-in scenes.
pub fn builtin_names() -> &'static [&'static str] {
    &["dam-break", "double-dam", "drop", "column", "accel-fluid", "dem-box", "paper-fig18", "paper-fig20"]
}

/// A built-in scene. Lengths of fluids are metres, times seconds; y points up in all.
///
/// | name | what it is | particles |
/// | --- | --- | --- |
/// | `dam-break` | a column 1 m wide and 2 m high at one end of a tank of 4 m × 3 m × 1 m (Koshizuka1996, in 2 dimensions theirs) | 16,000 |
/// | `double-dam` | two such columns, half as high, at both ends | 16,000 |
/// | `drop` | a ball of fluid above a basin | 16,000 |
/// | `column` | a column at rest, 1 m high, that fills its tank from wall to wall | 4,096 |
/// | `accel-fluid` | a block that falls apart in a domain of side 1, the fluid of Accel | 10,000 |
/// | `dem-box` | grains of Green2010 in a box of side 2, exactly its start | 16,384 |
/// | `paper-fig18` | grains, half of them as a bed and half as a block that falls into it, after figure 18 of Xing2017 | 50,000 |
/// | `paper-fig20` | grains of three radii, after figure 20 of Xing2017 | 30,000 |
///
/// Grains of the two figures are as large as their number allows, and gravity is in proportion to the grain, so that one moves as many
/// radii a step whatever their number.
///
/// # Errors
/// `InvalidSetting` for a name that is none, for options that the scene does not have, and for numbers of particles or a radius that it
/// cannot have.
pub fn builtin_scene(name: &str, options: &BuiltinOptions) -> Result<ParticleScene> {
    let Some(&name) = builtin_names().iter().find(|known| **known == name) else {
        let expected = "dam-break, double-dam, drop, column, accel-fluid, dem-box, paper-fig18 or paper-fig20";
        return Err(Error::InvalidSetting { setting: "scene", found: name.to_owned(), expected });
    };
    let is_fluid = !matches!(name, "dem-box" | "paper-fig18" | "paper-fig20");
    let refuse = |setting, found: String, expected| Err(Error::InvalidSetting { setting, found, expected });
    if let Some(model) = options.model.filter(|_| !is_fluid) {
        return refuse("model", model.to_string(), "none: the scene has grains");
    }
    if let Some(dimensions) = options.dimensions.filter(|_| !is_fluid) {
        return refuse("dimensions", dimensions.number().to_string(), "none: only scenes of fluids have a choice");
    }
    if let Some(rule) = options.pair_rule.filter(|_| name != "paper-fig20") {
        return refuse("pair rule", rule.name().to_owned(), "none: only paper-fig20 has a choice");
    }
    if let Some(radius) = options.radius.filter(|_| name != "paper-fig20") {
        return refuse("radius", radius.to_string(), "none: only paper-fig20 has a choice");
    }
    if let Some(particles) = options.particles.filter(|&n| n == 0 || f64::from(n) > MOST_PARTICLES) {
        return refuse("particles", particles.to_string(), "1 or more, and at most 2^28");
    }
    match name {
        "dem-box" => Ok(grains::dem_box(options.particles.unwrap_or(16_384))),
        "paper-fig18" => Ok(grains::paper_fig18(options.particles.unwrap_or(50_000))),
        "paper-fig20" => radii::paper_fig20(options),
        fluid => fluids::scene(fluid, options),
    }
}
