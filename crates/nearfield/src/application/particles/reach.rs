//! How far particles of one class act on those of another.

use super::{PairRule, ParticleModel};
#[cfg(feature = "gpu")]
use crate::structure::LevelRule;

/// The distance within which particles of one class act on those of another.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reach {
    /// `[n_classes]`.
    radii: Vec<f64>,
    rule: PairRule,
}

impl Reach {
    /// That of a model; fluids have one class with the radius of their support.
    pub(super) fn of(model: &ParticleModel) -> Self {
        match model {
            ParticleModel::Dem(dem) => Self { radii: dem.radii.clone(), rule: dem.pair_rule },
            fluid => Self::one(fluid.largest_reach()),
        }
    }

    /// One class that acts on itself within this distance.
    pub(super) fn one(distance: f64) -> Self {
        Self { radii: vec![distance], rule: PairRule::Symmetric }
    }

    /// `[n_classes]` the radius of each class.
    pub(super) fn radii(&self) -> &[f64] {
        &self.radii
    }

    /// Within which distance the second class acts on the first.
    pub(super) fn between(&self, own: usize, other: usize) -> f64 {
        self.rule.reach(self.radii[own], self.radii[other])
    }

    /// The farthest from which any class acts on this one.
    pub(super) fn farthest(&self, own: usize) -> f64 {
        (0..self.radii.len()).map(|other| self.between(own, other)).fold(0.0, f64::max)
    }

    /// The rule as grids of several levels have it.
    #[cfg(feature = "gpu")]
    pub(super) fn level_rule(&self) -> LevelRule {
        match self.rule {
            PairRule::Contact => LevelRule::Sum,
            PairRule::Symmetric => LevelRule::Larger,
            PairRule::Gather => LevelRule::Own,
        }
    }
}
