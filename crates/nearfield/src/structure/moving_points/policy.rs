//! When the tree of moving points is built anew.

use super::cost::Costs;
use super::report::{UpdateAction, UpdateReason};
use crate::{Error, Result};

/// When the tree of moving points is built anew instead of fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RebuildPolicy {
    /// When the largest ratio of a box's volume to its volume at the build is above `limit`. Before that, boxes are grown
    /// by the radius on each side. Source: Xing2017 §4.4, where the limit is called μ.
    VolumeRatio {
        /// At least 1.
        limit: f32,
    },
    /// In every step.
    Always,
    /// Not at all: the order of the first build stays.
    Never,
    /// When the time that queries took longer than just after the last build adds up to the time of a build. Needs times:
    /// see [`super::MovingPoints::ask`] and [`super::MovingPoints::record_query_time`].
    Cost,
}

impl Default for RebuildPolicy {
    /// [`RebuildPolicy::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What to do in a step, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Decision {
    pub(super) action: UpdateAction,
    pub(super) reason: UpdateReason,
}

impl Decision {
    fn new(rebuilds: bool, reason: UpdateReason) -> Self {
        Self { action: if rebuilds { UpdateAction::Rebuild } else { UpdateAction::Refit }, reason }
    }
}

impl RebuildPolicy {
    /// The paper's rule with its limit of 10.
    pub const DEFAULT: Self = Self::VolumeRatio { limit: 10.0 };

    /// Its name, in lower case with hyphens.
    pub fn name(self) -> &'static str {
        match self {
            Self::VolumeRatio { .. } => "volume-ratio",
            Self::Always => "always",
            Self::Never => "never",
            Self::Cost => "cost",
        }
    }

    /// Checks the limit.
    ///
    /// # Errors
    /// `InvalidSetting` for a limit below 1 or NaN.
    pub fn validate(self) -> Result<()> {
        match self {
            Self::VolumeRatio { limit } if limit.is_nan() || limit < 1.0 => Err(Error::InvalidSetting {
                setting: "limit of the volume ratio",
                found: limit.to_string(),
                expected: "a number of 1 or more",
            }),
            _ => Ok(()),
        }
    }

    /// What to do where that is known before the boxes are fitted; else the limit that their ratio is compared with.
    pub(super) fn before_fit(self, costs: &Costs) -> std::result::Result<Decision, f32> {
        match self {
            Self::VolumeRatio { limit } => Err(limit),
            Self::Always => Ok(Decision::new(true, UpdateReason::Policy { policy: self })),
            Self::Never => Ok(Decision::new(false, UpdateReason::Policy { policy: self })),
            Self::Cost => Ok(Decision::new(costs.have_paid(), costs.reason())),
        }
    }

    /// What to do after the boxes were fitted, by the largest ratio.
    pub(super) fn after_fit(measured: f32, limit: f32) -> Decision {
        Decision::new(measured > limit, UpdateReason::VolumeRatio { measured, limit })
    }
}
