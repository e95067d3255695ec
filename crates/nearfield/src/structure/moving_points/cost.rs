//! The rule by cost: what queries took longer since the last build, against what a build takes.

use super::report::UpdateReason;
use crate::{Error, Result};

/// Times on one clock, in milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Costs {
    /// The last build.
    build: f64,
    /// Queries of the first step after it, or of a faster one since; none before.
    base: Option<f64>,
    /// What the queries of all steps since the build took beyond the base of their time.
    extra: f64,
    /// Queries since the points moved last; none before the first.
    step: Option<f64>,
}

impl Costs {
    /// Just after a build.
    pub(super) fn built(milliseconds: f64) -> Self {
        Self { build: milliseconds, ..Self::default() }
    }

    /// Time of the last build.
    pub(super) fn build_milliseconds(&self) -> f64 {
        self.build
    }

    /// Adds a query to this step.
    ///
    /// # Errors
    /// `InvalidSetting` for a time that is not a finite number, 0 or more.
    pub(super) fn record(&mut self, milliseconds: f64) -> Result<()> {
        if !(milliseconds.is_finite() && milliseconds >= 0.0) {
            return Err(Error::InvalidSetting {
                setting: "query time",
                found: milliseconds.to_string(),
                expected: "a finite number of milliseconds, 0 or more",
            });
        }
        self.step = Some(self.step.unwrap_or(0.0) + milliseconds);
        Ok(())
    }

    /// With the queries of this step counted; steps without any do not count.
    ///
    /// The base follows a faster step: the first one may have compiled kernels or met cold caches, and would hide all that
    /// comes after it.
    pub(super) fn after_step(mut self) -> Self {
        if let Some(step) = self.step.take() {
            let base = self.base.map_or(step, |base| base.min(step));
            self.base = Some(base);
            self.extra += step - base;
        }
        self
    }

    /// Whether what queries took longer would have paid for a build.
    pub(super) fn have_paid(&self) -> bool {
        self.extra > 0.0 && self.extra >= self.build
    }

    /// The times as a reason.
    pub(super) fn reason(&self) -> UpdateReason {
        UpdateReason::QueryTime { extra_milliseconds: self.extra, build_milliseconds: self.build }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps after which a build is paid for, of queries that take these times.
    fn steps_until_paid(build: f64, times: &[f64]) -> Option<usize> {
        let mut costs = Costs::built(build);
        times.iter().position(|&time| {
            costs.record(time).unwrap();
            costs = costs.after_step();
            costs.have_paid()
        })
    }

    #[test]
    fn a_build_is_due_when_the_extra_time_has_paid_for_it() {
        // 0 + 1 + 2 + 3 ≥ 6.
        assert_eq!(steps_until_paid(6.0, &[2.0, 3.0, 4.0, 5.0, 6.0]), Some(3));
        assert_eq!(steps_until_paid(6.5, &[2.0, 3.0, 4.0, 5.0, 6.0]), Some(4));
        assert_eq!(steps_until_paid(0.0, &[2.0, 2.0, 2.0]), None, "nothing got slower");
        assert_eq!(steps_until_paid(1.0, &[]), None);
    }

    #[test]
    fn a_slow_first_query_hides_nothing() {
        assert_eq!(steps_until_paid(6.0, &[500.0, 2.0, 3.0, 4.0, 5.0, 6.0]), Some(4));
    }

    #[test]
    fn queries_of_a_step_add_up_and_steps_without_queries_do_not_count() {
        let mut costs = Costs::built(3.0);
        for times in [&[1.0, 1.0][..], &[], &[2.0, 1.0], &[], &[4.0]] {
            for &time in times {
                costs.record(time).unwrap();
            }
            costs = costs.after_step();
        }
        assert_eq!((costs.base, costs.extra, costs.have_paid()), (Some(2.0), 3.0, true));
    }

    #[test]
    fn times_that_are_none_are_refused() {
        let mut costs = Costs::built(1.0);
        for wrong in [f64::NAN, f64::INFINITY, -1.0] {
            let error = costs.record(wrong).unwrap_err();
            assert!(matches!(error, Error::InvalidSetting { setting: "query time", .. }), "{error}");
        }
        assert_eq!(costs, Costs::built(1.0));
    }
}
