//! What the kernels are told and what they tell, byte for byte as `pairs.wesl`, `density.wesl` and `advance.wesl` have it.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::report::Sums;
use super::variant::{Density, DensityResult, Formula, Pairs, Power};
use crate::{Error, Result};

/// `WlopParameters` in pairs.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "pairs.wesl explains them")]
pub struct PairParameters {
    pub inverse_radius2: f32,
    pub least_y: f32,
    pub falloff: f32,
    pub skip2: f32,
    pub least_weight: f32,
    pub twice_power: u32,
    pub weighted: u32,
    pub least_samples: u32,
    pub mu: f32,
    pub least_pull: f32,
    pub drifts: u32,
    pub padding: u32,
}

impl PairParameters {
    pub(super) fn new(pairs: &Pairs, power: Power, formula: &Formula, radius: f32, mu: f64) -> Self {
        Self {
            inverse_radius2: 1.0 / (radius * radius),
            least_y: pairs.least_y as f32,
            falloff: -pairs.falloff as f32,
            skip2: pairs.skip2(),
            least_weight: pairs.least_weight as f32,
            twice_power: power.twice(),
            weighted: formula.inputs.is_some().into(),
            least_samples: formula.least_samples,
            mu: mu as f32,
            least_pull: formula.attraction.least_weight as f32,
            drifts: formula.drifts.into(),
            padding: 0,
        }
    }
}

/// `WlopDensityParameters` in density.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "density.wesl explains them")]
pub struct DensityParameters {
    pub inverse_radius2: f32,
    pub falloff: f32,
    pub skip2: f32,
    pub own: f32,
    pub result: u32,
    pub padding_0: u32,
    pub padding_1: u32,
    pub padding_2: u32,
}

impl DensityParameters {
    pub(super) fn new(density: &Density, radius: f32) -> Self {
        let result = match density.result {
            DensityResult::Inverse => 0,
            DensityResult::Sum => 1,
            DensityResult::Root => 2,
        };
        Self {
            inverse_radius2: 1.0 / (radius * radius),
            falloff: -density.falloff as f32,
            skip2: density.skip2 as f32,
            own: density.own as f32,
            result,
            ..Self::default()
        }
    }
}

/// `WlopAdvanceParameters` in advance.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "advance.wesl explains them")]
pub struct AdvanceParameters {
    pub n_samples: u32,
    pub n_parts: u32,
    pub iteration: u32,
    pub least_move: f32,
}

/// `WlopPull` in pairs.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "pairs.wesl explains them")]
pub struct Pull {
    pub offset: Vec3,
    pub weight: f32,
    pub crowd: f32,
    pub inputs: u32,
    pub padding_0: u32,
    pub padding_1: u32,
}

/// `WlopPart` in advance.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "advance.wesl explains them")]
pub struct RecordPart {
    pub moves: f32,
    pub largest: f32,
    pub inputs: f32,
    pub samples: f32,
    pub unattracted: u32,
    pub lost: u32,
    pub first_lost: u32,
}

/// `WlopRecord` in advance.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[allow(missing_docs, reason = "advance.wesl explains them")]
pub struct Record {
    pub moves: f32,
    pub largest: f32,
    pub inputs: f32,
    pub samples: f32,
    pub unattracted: u32,
    pub is_made: u32,
    pub lost: u32,
    pub first_lost: u32,
}

impl Record {
    /// Refuses an iteration that would have moved samples where nothing can be searched.
    ///
    /// # Errors
    /// `NonFinite`, as from the CPU.
    pub(super) fn check(&self) -> Result<()> {
        match self.lost {
            0 => Ok(()),
            lost => Err(Error::NonFinite { what: "points", count: lost.into(), first: self.first_lost.into() }),
        }
    }

    pub(super) fn sums(&self) -> Sums {
        Sums {
            moves: self.moves.into(),
            largest: self.largest.into(),
            inputs: self.inputs.into(),
            samples: self.samples.into(),
            unattracted: self.unattracted.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_samples_are_an_error() {
        assert!(Record { is_made: 1, first_lost: u32::MAX, ..Record::default() }.check().is_ok());
        let found = Record { is_made: 1, lost: 2, first_lost: 7, ..Record::default() }.check();
        assert!(matches!(found, Err(Error::NonFinite { what: "points", count: 2, first: 7 })), "{found:?}");
    }
}
