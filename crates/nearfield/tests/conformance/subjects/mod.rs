//! What is tested: every structure on every device, built in every way that changes how it searches.

mod answered_by;
mod builds;
mod built;

use nearfield::geometry::Period;
use nearfield::{Result, Vec3};

pub(crate) use answered_by::Asked;
pub(crate) use builds::SUBJECTS;
pub(crate) use built::Built;

use crate::cases::Case;
use crate::compare::Rule;

/// One way to build one structure on one device.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Subject {
    /// The structure, as reports name it.
    pub(crate) structure: &'static str,
    pub(crate) device: Device,
    /// What is special about this build.
    pub(crate) variant: &'static str,
    build: fn(&Plan<'_>) -> Result<Box<dyn Built>>,
}

/// Where a subject runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Device {
    Cpu,
    #[cfg(feature = "gpu")]
    Gpu,
}

/// What a build gets to know.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plan<'a> {
    pub(crate) points: &'a [Vec3],
    pub(crate) radius: f32,
    pub(crate) period: Period,
}

impl<'a> Plan<'a> {
    pub(crate) fn of(case: &'a Case) -> Self {
        let period = Period::new(case.period).expect("a case should have a sound period");
        Self { points: &case.points, radius: case.radius, period }
    }
}

/// The device of the process; trials that need it do not start without it.
#[cfg(feature = "gpu")]
pub(crate) fn device() -> &'static nearfield::gpu::Gpu {
    crate::support::gpu().expect("trials on the GPU should not start without one")
}

impl Subject {
    /// "uniform-grid/cpu/cells-by-density"
    pub(crate) fn name(&self) -> String {
        let device = match self.device {
            Device::Cpu => "cpu",
            #[cfg(feature = "gpu")]
            Device::Gpu => "gpu",
        };
        format!("{}/{device}/{}", self.structure, self.variant)
    }

    /// Whether the cases are tried on this build: software devices leave out those that only change how far a query
    /// walks, unless long tests are asked for.
    pub(crate) fn is_tried_here(&self) -> bool {
        match self.device {
            Device::Cpu => true,
            #[cfg(feature = "gpu")]
            Device::Gpu => {
                let far =
                    ["cells-a-third-refined", "cells-twenty-times", "bounds-of-a-quarter", "leaves-of-500-to-level-4"];
                !far.contains(&self.variant) || crate::support::gpu().is_ok_and(crate::support::long_cases)
            }
        }
    }

    /// Whether every question is asked: software devices leave out those that differ little from others, unless long tests
    /// are asked for.
    pub(crate) fn asks_everything(&self) -> bool {
        match self.device {
            Device::Cpu => true,
            #[cfg(feature = "gpu")]
            Device::Gpu => crate::support::gpu().is_ok_and(crate::support::long_cases),
        }
    }

    /// Whether the question of this number is asked: software devices ask every case a third of the questions, and every
    /// question of a third of the cases.
    pub(crate) fn takes_turn(&self, number: usize) -> bool {
        self.asks_everything() || number.is_multiple_of(3)
    }

    /// Whether software devices ask for the nearest too: on trees they do not depend on the search.
    pub(crate) fn asks_nearest(&self) -> bool {
        self.structure != "aabb-tree" || self.variant == "packed"
    }

    /// Whether large clouds are tried: on hardware, and where long tests are asked for.
    pub(crate) fn takes_large_clouds(&self) -> bool {
        let long = std::env::var_os("NEARFIELD_LONG").is_some_and(|v| v == "1");
        match self.device {
            Device::Cpu => long,
            #[cfg(feature = "gpu")]
            Device::Gpu => long || crate::support::gpu().is_ok_and(crate::support::long_cases),
        }
    }

    /// Builds the structure.
    pub(crate) fn build(&self, plan: &Plan<'_>) -> Result<Box<dyn Built>> {
        (self.build)(plan)
    }

    /// How near its answers must come; all where every rounding of the formula gives the same.
    pub(crate) fn rule(&self, exact: bool) -> Rule {
        if exact || self.device == Device::Cpu { Rule::Exact } else { Rule::Device }
    }
}
