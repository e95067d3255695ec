//! What is tested: every structure on every device, built in every way that changes how it searches.

use std::ops::ControlFlow;

use nearfield::geometry::Period;
use nearfield::{
    Aabb, BruteForce, FixedRadius, ForEachNeighbor, GridSettings, Neighbor, NeighborSearch, Report, Result,
    UniformGrid, Vec3,
};

use crate::cases::Case;
use crate::compare::{Rule, Verdict};

/// One way to build one structure on one device.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Subject {
    /// The structure, as reports name it.
    pub(crate) structure: &'static str,
    pub(crate) device: Device,
    /// What is special about this build.
    pub(crate) variant: &'static str,
    /// The searches that may run.
    searches: &'static [&'static str],
    /// What the names of its kernels begin with.
    kernels: &'static [&'static str],
    build: fn(&Plan<'_>) -> Result<Box<dyn Built>>,
}

/// Where a subject runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Device {
    Cpu,
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

/// A function called with a query and its neighbour.
pub(crate) type Visitor<'a> = dyn Fn(u32, Neighbor) -> ControlFlow<()> + Sync + 'a;

/// A structure, ready for questions.
pub(crate) trait Built: NeighborSearch {
    /// Visits every neighbour; `None` where the structure has no such query.
    fn visit(&self, question: &FixedRadius<'_>, visitor: &Visitor<'_>) -> Option<Result<()>>;
    /// Visits the neighbours of one place; `None` where the structure has no such query.
    fn visit_at(&self, center: Vec3, radius: f32, visitor: &Visitor<'_>) -> Option<Result<()>>;
    /// The first broken invariant in words.
    fn broken_invariant(&self) -> Option<String>;
}

macro_rules! on_cpu {
    ($structure:ty, $invariant:expr) => {
        impl Built for $structure {
            fn visit(&self, question: &FixedRadius<'_>, visitor: &Visitor<'_>) -> Option<Result<()>> {
                Some(self.for_each(question, visitor))
            }

            fn visit_at(&self, center: Vec3, radius: f32, visitor: &Visitor<'_>) -> Option<Result<()>> {
                Some(self.for_each_at(center, radius, |neighbor| visitor(0, neighbor)))
            }

            fn broken_invariant(&self) -> Option<String> {
                $invariant(self)
            }
        }
    };
}

on_cpu!(BruteForce, |_| None);
on_cpu!(UniformGrid, UniformGrid::broken_invariant);

/// Settings of a grid over a plan.
type Settings = fn(&Plan<'_>) -> GridSettings;

/// Builds of the grid: cells as large as the radius, far smaller, far larger, and bounds that leave points out.
const GRIDS: &[(&str, Settings)] = &[
    ("cells-like-the-radius", |plan| GridSettings::for_radius(plan.radius)),
    ("cells-a-sixteenth", |plan| GridSettings { refine_x: 1, ..GridSettings::for_radius(plan.radius / 16.0) }),
    ("cells-a-third-refined", |plan| GridSettings { refine_x: 8, ..GridSettings::for_radius(plan.radius / 3.0) }),
    ("cells-twenty-times", |plan| GridSettings { refine_x: 3, ..GridSettings::for_radius(plan.radius * 20.0) }),
    ("cells-by-density", |_| GridSettings::by_density()),
    ("bounds-of-a-quarter", |plan| {
        let quarter = &plan.points[..plan.points.len() / 4];
        GridSettings::for_radius(plan.radius).bounds(Aabb::of_points(quarter))
    }),
];

macro_rules! grid_on_cpu {
    ($number:literal) => {
        Subject {
            structure: "uniform-grid",
            device: Device::Cpu,
            variant: GRIDS[$number].0,
            searches: &["row-runs"],
            kernels: &["row_simd::"],
            build: |plan| {
                let settings = GRIDS[$number].1(plan).periodic(plan.period);
                Ok(Box::new(UniformGrid::build(plan.points, &settings)?))
            },
        }
    };
}

/// Every subject.
pub(crate) const SUBJECTS: &[Subject] = &[
    Subject {
        structure: "brute-force",
        device: Device::Cpu,
        variant: "plain",
        searches: &["all-pairs"],
        kernels: &["row_simd::"],
        build: |plan| Ok(Box::new(BruteForce::build_periodic(plan.points, plan.period)?)),
    },
    grid_on_cpu!(0),
    grid_on_cpu!(1),
    grid_on_cpu!(2),
    grid_on_cpu!(3),
    grid_on_cpu!(4),
    grid_on_cpu!(5),
];

impl Subject {
    /// "uniform-grid/cpu/cells-by-density"
    pub(crate) fn name(&self) -> String {
        let device = match self.device {
            Device::Cpu => "cpu",
        };
        format!("{}/{device}/{}", self.structure, self.variant)
    }

    /// Builds the structure.
    pub(crate) fn build(&self, plan: &Plan<'_>) -> Result<Box<dyn Built>> {
        (self.build)(plan)
    }

    /// How near its answers must come.
    pub(crate) fn rule(&self, exact: bool) -> Rule {
        match self.device {
            Device::Cpu => Rule::Exact,
            #[allow(unreachable_patterns, reason = "devices beside the CPU are a feature")]
            _ if exact => Rule::Exact,
            #[allow(unreachable_patterns, reason = "devices beside the CPU are a feature")]
            _ => Rule::Device,
        }
    }

    /// Checks that this subject, and nothing else, gave an answer.
    pub(crate) fn check_report(&self, report: &Report) -> Verdict {
        let on_cpu = report.device.starts_with("cpu (");
        let right = report.structure == self.structure
            && self.searches.contains(&report.search)
            && on_cpu == (self.device == Device::Cpu)
            && report.batches > 0
            && !report.kernels.is_empty()
            && report.kernels.iter().all(|k| self.kernels.iter().any(|start| k.starts_with(start)));
        if right { Ok(()) } else { Err(format!("{} was asked, the report says {report:?}", self.name())) }
    }
}
