//! What an update did, and why.

use std::fmt;

use super::policy::RebuildPolicy;
use crate::structure::BuildStage;

/// What happened to the tree when the points moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum UpdateAction {
    /// Its boxes were fitted; order and shape stayed.
    Refit,
    /// It was built anew.
    Rebuild,
}

/// Why a tree was fitted or built anew: the values that were compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum UpdateReason {
    /// The policy asks for nothing else.
    Policy {
        /// [`RebuildPolicy::Always`] or [`RebuildPolicy::Never`].
        policy: RebuildPolicy,
    },
    /// By volumes: above the limit it is built anew.
    VolumeRatio {
        /// The largest ratio of a box's volume, grown by the radius, to that at the build. Infinite where it is beyond
        /// 2^100, or a side that had no length at the build has one.
        measured: f32,
        /// The limit.
        limit: f32,
    },
    /// By cost: from the time of a build on it is built anew.
    QueryTime {
        /// What queries since the last build took longer than just after it.
        extra_milliseconds: f64,
        /// What the last build took.
        build_milliseconds: f64,
    },
}

/// What an update did, why, and how long it took. As text, one sentence of it.
#[derive(Debug, Clone, PartialEq)]
pub struct UpdateReport {
    /// What was done.
    pub action: UpdateAction,
    /// Why.
    pub reason: UpdateReason,
    /// Times of the stages, in order. A device without timestamps has none for its own.
    pub stages: Vec<BuildStage>,
    /// Time of the whole update by the host's clock.
    pub milliseconds: f64,
}

impl UpdateReport {
    /// Whether the tree was built anew.
    pub fn is_rebuild(&self) -> bool {
        self.action == UpdateAction::Rebuild
    }
}

impl fmt::Display for UpdateReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rebuilds = self.is_rebuild();
        f.write_str(if rebuilds { "built anew: " } else { "fitted: " })?;
        match self.reason {
            UpdateReason::Policy { policy } => write!(f, "the policy is `{}`", policy.name()),
            UpdateReason::VolumeRatio { measured, limit } => {
                let compared = if rebuilds { "above" } else { "not above" };
                write!(f, "a box has {measured:.3} times its volume at the build, {compared} the limit of {limit}")
            }
            UpdateReason::QueryTime { extra_milliseconds: extra, build_milliseconds: build } => {
                let compared = if rebuilds { "which pays for" } else { "which does not pay for" };
                write!(f, "queries took {extra:.3} ms longer since the last build, {compared} one of {build:.3} ms")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_say_what_was_done_and_why() {
        let said = |action, reason| UpdateReport { action, reason, stages: vec![], milliseconds: 0.0 }.to_string();
        let reason = UpdateReason::VolumeRatio { measured: 12.25, limit: 10.0 };
        let expected = "built anew: a box has 12.250 times its volume at the build, above the limit of 10";
        assert_eq!(said(UpdateAction::Rebuild, reason), expected);
        let reason = UpdateReason::QueryTime { extra_milliseconds: 1.5, build_milliseconds: 4.0 };
        let expected =
            "fitted: queries took 1.500 ms longer since the last build, which does not pay for one of 4.000 ms";
        assert_eq!(said(UpdateAction::Refit, reason), expected);
        let reason = UpdateReason::Policy { policy: RebuildPolicy::Never };
        assert_eq!(said(UpdateAction::Refit, reason), "fitted: the policy is `never`");
    }
}
