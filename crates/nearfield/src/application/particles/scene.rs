//! What a simulation starts from: particles, walls, forces and the laws by which they move.

use glam::DVec3;

use super::{DemSettings, DfsphSettings, Fluid, PbfSettings, WcsphSettings};
use crate::{Error, Result};

/// Largest number of classes of radii.
pub const MOST_CLASSES: usize = 8;

/// A problem to simulate, wherever that is done. All numbers are in one set of units of the caller's choice.
#[derive(Debug, Clone, PartialEq)]
pub struct ParticleScene {
    /// A short name in lower case with hyphens.
    pub name: String,
    /// Dimensions: 3, or 2 for scenes in the plane z = 0.
    pub dimensions: Dimensions,
    /// The space that is simulated. Its faces are walls for `dem` and `pbf`; a smoothed fluid has walls of particles only,
    /// and what leaves the domain is counted.
    pub domain: [DVec3; 2],
    /// By axis, whether the domain goes on with itself there: smoothed fluids only, which may flow out on one side and in on the other.
    pub periodic: [bool; 3],
    /// Acceleration of all particles.
    pub gravity: DVec3,
    /// What moves.
    pub particles: Particles,
    /// `[b]` particles of solid bodies and walls around a fluid, which do not move. Models without a fluid have none.
    pub boundary: Vec<DVec3>,
    /// The laws.
    pub model: ParticleModel,
    /// How far a step leads.
    pub time_step: TimeStep,
}

/// Two or three dimensions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Dimensions {
    /// The plane z = 0.
    Two,
    /// Space.
    #[default]
    Three,
}

/// Particles by index, in the order of the caller.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Particles {
    /// `[n]` where they are.
    pub positions: Vec<DVec3>,
    /// `[n]` how fast they move.
    pub velocities: Vec<DVec3>,
    /// `[n]` the class of each, below [`MOST_CLASSES`]: its radius is that of the class. All 0 for fluids.
    pub classes: Vec<u8>,
    /// `[n]` densities of a fluid, in its unit; empty for other models and before the first step.
    pub densities: Vec<f64>,
    /// `[n]` pressures of an incompressible fluid in the last step, 0 or more, as its density times a speed squared; the next step starts from
    /// them. Empty for other models and before the first step, which then starts from none.
    pub pressures: Vec<f64>,
}

/// By which laws particles move.
#[derive(Debug, Clone, PartialEq)]
pub enum ParticleModel {
    /// Grains that push each other: a discrete element method.
    Dem(DemSettings),
    /// Position-based fluids.
    Pbf(PbfSettings),
    /// Weakly compressible smoothed particle hydrodynamics.
    Wcsph(WcsphSettings),
    /// Divergence-free smoothed particle hydrodynamics.
    Dfsph(DfsphSettings),
}

/// How far a step leads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeStep {
    /// Always as far.
    Fixed(f64),
    /// As the model's rule for stability allows, between two bounds.
    Cfl {
        /// Part of the largest stable step; of the order 0.2 to 0.5.
        factor: f64,
        /// The shortest step.
        least: f64,
        /// The longest step.
        most: f64,
    },
}

impl Dimensions {
    /// 2 or 3.
    pub fn number(self) -> u32 {
        match self {
            Self::Two => 2,
            Self::Three => 3,
        }
    }
}

impl Particles {
    /// Particles of class 0 at rest.
    pub fn at_rest(positions: Vec<DVec3>) -> Self {
        let n = positions.len();
        let velocities = vec![DVec3::ZERO; n];
        Self { positions, velocities, classes: vec![0; n], densities: Vec::new(), pressures: Vec::new() }
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Adds those of another set.
    pub fn extend(&mut self, other: Self) {
        self.positions.extend(other.positions);
        self.velocities.extend(other.velocities);
        self.classes.extend(other.classes);
        self.densities.extend(other.densities);
        self.pressures.extend(other.pressures);
    }
}

impl ParticleModel {
    /// Its name: "dem", "pbf", "wcsph", "dfsph".
    pub fn name(&self) -> &'static str {
        match self {
            Self::Dem(_) => "dem",
            Self::Pbf(_) => "pbf",
            Self::Wcsph(_) => "wcsph",
            Self::Dfsph(_) => "dfsph",
        }
    }

    /// The fluid; none of grains.
    pub fn fluid(&self) -> Option<&Fluid> {
        match self {
            Self::Dem(_) => None,
            Self::Pbf(pbf) => Some(&pbf.fluid),
            Self::Wcsph(wcsph) => Some(&wcsph.fluid),
            Self::Dfsph(dfsph) => Some(&dfsph.fluid),
        }
    }

    /// Whether the particles are parts of a fluid.
    pub fn is_fluid(&self) -> bool {
        self.fluid().is_some()
    }

    /// The distance within which particles act on each other, at most.
    pub fn largest_reach(&self) -> f64 {
        match self {
            Self::Dem(dem) => dem.largest_reach(),
            Self::Pbf(pbf) => pbf.fluid.support,
            Self::Wcsph(wcsph) => wcsph.fluid.support,
            Self::Dfsph(dfsph) => dfsph.fluid.support,
        }
    }

    /// Density of the fluid at rest; 1 for grains.
    pub fn rest_density(&self) -> f64 {
        self.fluid().map_or(1.0, |fluid| fluid.rest_density)
    }

    fn validate(&self) -> Result<()> {
        match self {
            Self::Dem(dem) => dem.validate(),
            Self::Pbf(pbf) => pbf.validate(),
            Self::Wcsph(wcsph) => wcsph.validate(),
            Self::Dfsph(dfsph) => dfsph.validate(),
        }
    }
}

impl TimeStep {
    /// # Errors
    /// `InvalidSetting` for steps that are not positive numbers, or bounds in the wrong order.
    pub fn validate(self) -> Result<()> {
        match self {
            Self::Fixed(step) => positive("time step", step),
            Self::Cfl { factor, least, most } => {
                positive("part of the largest stable step", factor)?;
                positive("shortest time step", least)?;
                positive("longest time step", most)?;
                let found = format!("{least} to {most}");
                let expected = "the shortest step first";
                (least <= most).then_some(()).ok_or(Error::InvalidSetting { setting: "time steps", found, expected })
            }
        }
    }

    /// The longest step.
    pub fn most(self) -> f64 {
        match self {
            Self::Fixed(step) => step,
            Self::Cfl { most, .. } => most,
        }
    }
}

impl ParticleScene {
    /// Checks everything that can be checked before the first step.
    ///
    /// # Errors
    /// `InvalidSetting` for the settings of the model, steps, an empty domain, a class without a radius, a boundary where the model has
    /// none, periodic sides where the model has none or shorter than two reaches, a scene in the plane that is not; `LengthMismatch` for arrays
    /// of different lengths; `NonFinite` and `OutsideDomain` for particles.
    pub fn validate(&self) -> Result<()> {
        self.validate_under_way()?;
        let [low, high] = self.domain;
        let flat = self.dimensions == Dimensions::Two;
        let is_outside = |p: &DVec3| p.cmplt(low).any() || p.cmpgt(high).any();
        let in_plane = |p: &DVec3| if flat { p.with_z(low.z) } else { *p };
        let positions = &self.particles.positions;
        let outside: Vec<usize> = (0..positions.len()).filter(|&i| is_outside(&in_plane(&positions[i]))).collect();
        match outside.first() {
            Some(&first) => {
                Err(Error::OutsideDomain { what: "particles", count: outside.len() as u64, first: first as u64 })
            }
            None => Ok(()),
        }
    }

    /// As [`ParticleScene::validate`], but particles may have left the domain, as those of open tanks do.
    pub(super) fn validate_under_way(&self) -> Result<()> {
        self.time_step.validate()?;
        self.model.validate()?;
        let [low, high] = self.domain;
        let invalid = |setting, found: String, expected| Err(Error::InvalidSetting { setting, found, expected });
        let flat = self.dimensions == Dimensions::Two;
        let size = high - low;
        let is_empty = !(size.x > 0.0 && size.y > 0.0 && (flat || size.z > 0.0) && size.is_finite());
        if is_empty {
            return invalid("domain", format!("{low} to {high}"), "a box with a finite, positive size");
        }
        if !self.gravity.is_finite() {
            return invalid("gravity", self.gravity.to_string(), "three finite numbers");
        }
        self.validate_period(size)?;
        let (n, moving) = (self.particles.len(), &self.particles);
        same_length("velocities of particles", moving.velocities.len(), n)?;
        same_length("classes of particles", moving.classes.len(), n)?;
        finite("positions of particles", &moving.positions)?;
        finite("velocities of particles", &moving.velocities)?;
        finite("positions of the boundary", &self.boundary)?;
        if !moving.densities.is_empty() {
            same_length("densities of particles", moving.densities.len(), n)?;
        }
        if let Some(density) = moving.densities.iter().find(|density| !(**density > 0.0 && density.is_finite())) {
            return invalid("density of a particle", density.to_string(), "a finite number above 0");
        }
        if !moving.pressures.is_empty() {
            same_length("pressures of particles", moving.pressures.len(), n)?;
        }
        if let Some(pressure) = moving.pressures.iter().find(|pressure| !(**pressure >= 0.0 && pressure.is_finite())) {
            return invalid("pressure of a particle", pressure.to_string(), "a finite number, 0 or more");
        }
        if !self.model.is_fluid() && !self.boundary.is_empty() {
            return invalid(
                "boundary",
                format!("{} particles", self.boundary.len()),
                "none, for a model without a fluid",
            );
        }
        let n_classes = match &self.model {
            ParticleModel::Dem(dem) => dem.radii.len(),
            _ => 1,
        };
        if let Some(class) = moving.classes.iter().find(|&&class| usize::from(class) >= n_classes) {
            return invalid("class of a particle", class.to_string(), "a class that has a radius");
        }
        let is_off_plane = |p: &DVec3| p.z != 0.0;
        if flat && moving.positions.iter().chain(&moving.velocities).chain(&self.boundary).any(is_off_plane) {
            return invalid("dimensions", "2".to_owned(), "3, or particles with z = 0 that stay there");
        }
        if flat && self.gravity.z != 0.0 {
            return invalid("gravity", self.gravity.to_string(), "one in the plane z = 0");
        }
        Ok(())
    }

    fn validate_period(&self, size: DVec3) -> Result<()> {
        let invalid =
            |found: String, expected| Err(Error::InvalidSetting { setting: "periodic sides", found, expected });
        if !self.periodic.contains(&true) {
            return Ok(());
        }
        if !matches!(self.model, ParticleModel::Wcsph(_) | ParticleModel::Dfsph(_)) {
            return invalid(self.model.name().to_owned(), "none, but for wcsph and dfsph");
        }
        if self.periodic[2] && self.dimensions == Dimensions::Two {
            return invalid("z".to_owned(), "x or y, for a scene in the plane");
        }
        // Nearer, a particle would meet two images of another.
        let least = 2.0 * self.model.largest_reach();
        let short = (0..3).find(|&axis| self.periodic[axis] && !(size[axis] > least));
        short.map_or(Ok(()), |axis| {
            invalid(format!("a length of {}", size[axis]), "more than two reaches of a particle")
        })
    }
}

fn same_length(what: &'static str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::LengthMismatch { what, found: found as u64, expected: expected as u64 })
}

fn finite(what: &'static str, vectors: &[DVec3]) -> Result<()> {
    let count = vectors.iter().filter(|v| !v.is_finite()).count() as u64;
    match vectors.iter().position(|v| !v.is_finite()) {
        Some(first) => Err(Error::NonFinite { what, count, first: first as u64 }),
        None => Ok(()),
    }
}

/// Checks that a setting is a positive, finite number.
pub(super) fn positive(setting: &'static str, value: f64) -> Result<()> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(Error::InvalidSetting { setting, found: value.to_string(), expected: "a finite number above 0" })
}

/// Checks that a setting is a finite number, 0 or more.
pub(super) fn not_negative(setting: &'static str, value: f64) -> Result<()> {
    if value >= 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(Error::InvalidSetting { setting, found: value.to_string(), expected: "a finite number, 0 or more" })
}
