//! What is tested: every structure on every device, built in every way that changes how it searches.

use std::ops::ControlFlow;

use nearfield::geometry::Period;
use nearfield::{
    Aabb, AabbTree, AabbTreeSettings, BoxSearch, Boxes, BruteForce, BuildOrder, Counts, Curve, FixedRadius,
    ForEachNeighbor, GridSettings, Knn, KnnSearch, LinearOctree, NearestNeighbors, Neighbor, NeighborSearch, Neighbors,
    OctreeSettings, Report, Result, TreeSearch, UniformGrid, Vec3,
};
#[cfg(feature = "gpu")]
use nearfield::{
    query::{ForEachOnDevice, Visitor as DeviceVisitor},
    structure::{GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuUniformGrid},
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
    build: fn(&Plan<'_>) -> Result<Box<dyn Built>>,
}

/// Where a subject runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Device {
    Cpu,
    #[cfg(feature = "gpu")]
    Gpu,
}

/// What an answer was made for: it decides which search and kernels must have run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asked {
    Count,
    List { sorted: bool, distances: bool },
    CappedList,
    Nearest,
    Knn,
    Boxes,
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
    /// The k nearest points; `None` where the structure has no such query.
    fn knn(&self, _: &Knn<'_>) -> Option<Result<NearestNeighbors>> {
        None
    }
    /// Count and list of the points in boxes; `None` where the structure has no such query.
    fn in_boxes(&self, _: &Boxes<'_>) -> Option<Result<(Counts, Neighbors)>> {
        None
    }
    /// Runs a caller's kernel on every neighbour; `None` where the structure has no such query.
    #[cfg(feature = "gpu")]
    fn run_visitor(&self, _: &FixedRadius<'_>, _: &DeviceVisitor<'_>) -> Option<Result<Report>> {
        None
    }
}

/// The k nearest points, for a structure that finds them.
macro_rules! knn {
    () => {
        fn knn(&self, question: &Knn<'_>) -> Option<Result<NearestNeighbors>> {
            Some(KnnSearch::knn(self, question))
        }
    };
}

/// The points in boxes, for a structure that finds them.
macro_rules! boxes {
    () => {
        fn in_boxes(&self, question: &Boxes<'_>) -> Option<Result<(Counts, Neighbors)>> {
            let counts = self.count_in_boxes(question);
            Some(counts.and_then(|counts| Ok((counts, self.list_in_boxes(question)?))))
        }
    };
}

macro_rules! on_cpu {
    ($structure:ty, $invariant:expr $(, $more:ident)*) => {
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

            $($more!();)*
        }
    };
}

on_cpu!(BruteForce, |_| None, knn, boxes);
on_cpu!(UniformGrid, UniformGrid::broken_invariant);
on_cpu!(LinearOctree, LinearOctree::broken_invariant, knn, boxes);
on_cpu!(AabbTree, AabbTree::broken_invariant, knn);

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
        let settings = GridSettings::for_radius(plan.radius);
        let quarter = &plan.points[..plan.points.len().div_ceil(4)];
        if quarter.is_empty() { settings } else { settings.bounds(Aabb::of_points(quarter)) }
    }),
];

/// Builds of the octree: as by default, with small leaves along Hilbert's curve, and with few large ones.
const OCTREES: &[(&str, OctreeSettings)] = &[
    ("leaves-of-32", OctreeSettings::DEFAULT),
    (
        "leaves-of-3-along-hilbert",
        OctreeSettings { leaf_capacity: 3, curve: Curve::Hilbert, ..OctreeSettings::DEFAULT },
    ),
    ("leaves-of-500-to-level-4", OctreeSettings { leaf_capacity: 500, max_level: 4, ..OctreeSettings::DEFAULT }),
];

/// Builds of the AABB-tree; the first word is the search.
const TREES: &[(&str, AabbTreeSettings)] = &[
    ("packed", AabbTreeSettings::DEFAULT),
    (
        "primary leaves-of-70",
        AabbTreeSettings { bucket_size: 70, search: TreeSearch::Primary, ..AabbTreeSettings::DEFAULT },
    ),
    ("coherent", AabbTreeSettings { search: TreeSearch::Coherent, ..AabbTreeSettings::DEFAULT }),
    (
        "packed along-hilbert-leaves-of-3",
        AabbTreeSettings { bucket_size: 3, order: BuildOrder::Hilbert, ..AabbTreeSettings::DEFAULT },
    ),
];

macro_rules! tree_on_cpu {
    ($number:literal) => {
        Subject {
            structure: "aabb-tree",
            device: Device::Cpu,
            variant: TREES[$number].0,
            build: |plan| {
                let settings = TREES[$number].1.periodic(plan.period);
                Ok(Box::new(AabbTree::build(plan.points, &settings)?))
            },
        }
    };
}

macro_rules! octree_on_cpu {
    ($number:literal) => {
        Subject {
            structure: "linear-octree",
            device: Device::Cpu,
            variant: OCTREES[$number].0,
            build: |plan| {
                let settings = OCTREES[$number].1.periodic(plan.period);
                Ok(Box::new(LinearOctree::build(plan.points, &settings)?))
            },
        }
    };
}

#[cfg(feature = "gpu")]
macro_rules! tree_on_gpu {
    ($number:literal) => {
        Subject {
            structure: "aabb-tree",
            device: Device::Gpu,
            variant: TREES[$number].0,
            build: |plan| {
                let settings = TREES[$number].1.periodic(plan.period);
                Ok(Box::new(GpuAabbTree::build(device(), plan.points, &settings)?))
            },
        }
    };
}

#[cfg(feature = "gpu")]
macro_rules! octree_on_gpu {
    ($number:literal) => {
        Subject {
            structure: "linear-octree",
            device: Device::Gpu,
            variant: OCTREES[$number].0,
            build: |plan| {
                let settings = OCTREES[$number].1.periodic(plan.period);
                Ok(Box::new(GpuLinearOctree::build(device(), plan.points, &settings)?))
            },
        }
    };
}

macro_rules! grid_on_cpu {
    ($number:literal) => {
        Subject {
            structure: "uniform-grid",
            device: Device::Cpu,
            variant: GRIDS[$number].0,
            build: |plan| {
                let settings = GRIDS[$number].1(plan).periodic(plan.period);
                Ok(Box::new(UniformGrid::build(plan.points, &settings)?))
            },
        }
    };
}

#[cfg(feature = "gpu")]
macro_rules! on_gpu {
    ($structure:ty, $invariant:expr $(, $more:ident)*) => {
        impl Built for $structure {
            fn visit(&self, _: &FixedRadius<'_>, _: &Visitor<'_>) -> Option<Result<()>> {
                None
            }

            fn visit_at(&self, _: Vec3, _: f32, _: &Visitor<'_>) -> Option<Result<()>> {
                None
            }

            fn broken_invariant(&self) -> Option<String> {
                $invariant(self)
            }

            fn run_visitor(&self, question: &FixedRadius<'_>, visitor: &DeviceVisitor<'_>) -> Option<Result<Report>> {
                Some(self.for_each_on_device(question, visitor))
            }

            $($more!();)*
        }
    };
}

#[cfg(feature = "gpu")]
on_gpu!(GpuBruteForce, |_| None, knn);
#[cfg(feature = "gpu")]
on_gpu!(GpuUniformGrid, |_| None);
#[cfg(feature = "gpu")]
on_gpu!(
    GpuAabbTree,
    |tree: &GpuAabbTree| match tree.read() {
        Ok(tree) => tree.broken_invariant(),
        Err(error) => Some(error.to_string()),
    },
    knn
);
#[cfg(feature = "gpu")]
on_gpu!(
    GpuLinearOctree,
    |tree: &GpuLinearOctree| match tree.read() {
        Ok(tree) => tree.broken_invariant(),
        Err(error) => Some(error.to_string()),
    },
    knn,
    boxes
);

#[cfg(feature = "gpu")]
macro_rules! grid_on_gpu {
    ($number:literal) => {
        Subject {
            structure: "uniform-grid",
            device: Device::Gpu,
            variant: GRIDS[$number].0,
            build: |plan| {
                let settings = GRIDS[$number].1(plan).periodic(plan.period);
                Ok(Box::new(GpuUniformGrid::build(device(), plan.points, &settings)?))
            },
        }
    };
}

/// The device of the process; trials that need it do not start without it.
#[cfg(feature = "gpu")]
pub(crate) fn device() -> &'static nearfield::gpu::Gpu {
    crate::support::gpu().expect("trials on the GPU should not start without one")
}

/// Every subject.
pub(crate) const SUBJECTS: &[Subject] = &[
    Subject {
        structure: "brute-force",
        device: Device::Cpu,
        variant: "plain",
        build: |plan| Ok(Box::new(BruteForce::build_periodic(plan.points, plan.period)?)),
    },
    grid_on_cpu!(0),
    grid_on_cpu!(1),
    grid_on_cpu!(2),
    grid_on_cpu!(3),
    grid_on_cpu!(4),
    grid_on_cpu!(5),
    octree_on_cpu!(0),
    octree_on_cpu!(1),
    octree_on_cpu!(2),
    tree_on_cpu!(0),
    tree_on_cpu!(1),
    tree_on_cpu!(2),
    tree_on_cpu!(3),
    #[cfg(feature = "gpu")]
    Subject {
        structure: "brute-force",
        device: Device::Gpu,
        variant: "plain",
        build: |plan| Ok(Box::new(GpuBruteForce::build_periodic(device(), plan.points, plan.period)?)),
    },
    #[cfg(feature = "gpu")]
    grid_on_gpu!(0),
    #[cfg(feature = "gpu")]
    grid_on_gpu!(1),
    #[cfg(feature = "gpu")]
    grid_on_gpu!(2),
    #[cfg(feature = "gpu")]
    grid_on_gpu!(3),
    #[cfg(feature = "gpu")]
    grid_on_gpu!(4),
    #[cfg(feature = "gpu")]
    grid_on_gpu!(5),
    #[cfg(feature = "gpu")]
    tree_on_gpu!(0),
    #[cfg(feature = "gpu")]
    tree_on_gpu!(1),
    #[cfg(feature = "gpu")]
    tree_on_gpu!(2),
    #[cfg(feature = "gpu")]
    tree_on_gpu!(3),
    #[cfg(feature = "gpu")]
    octree_on_gpu!(0),
    #[cfg(feature = "gpu")]
    octree_on_gpu!(1),
    #[cfg(feature = "gpu")]
    octree_on_gpu!(2),
];

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

    /// Checks that this subject with this search and these kernels, and nothing else, gave an answer.
    pub(crate) fn check_report(&self, report: &Report, asked: Asked) -> Verdict {
        let (device_is_right, search, kernels) = match self.device {
            Device::Cpu => {
                let search = match self.structure {
                    "brute-force" => "all-pairs",
                    "linear-octree" if asked == Asked::Knn => "nearest-octants",
                    "linear-octree" => "octants",
                    "aabb-tree" if asked == Asked::Knn => "nearest-boxes",
                    "aabb-tree" => self.variant.split(' ').next().expect("a variant should have a word"),
                    _ => "row-runs",
                };
                let kernel = match asked {
                    Asked::Count => "row_simd::count",
                    Asked::Boxes => "boxes",
                    _ => "row_simd::collect",
                };
                (report.device.starts_with("cpu ("), search, vec![kernel.to_owned()])
            }
            #[cfg(feature = "gpu")]
            Device::Gpu => {
                let (search, mut kernels) = self.on_gpu(asked);
                // Rows with more words than the masks hold need one kernel more.
                let overflowed = "package::query::fill_overflowed";
                if search == "row-masks" && report.kernels.iter().any(|k| k == overflowed) {
                    kernels.push(overflowed.to_owned());
                }
                (report.device == device().name(), search, kernels)
            }
        };
        let right = report.structure == self.structure
            && report.search == search
            && device_is_right
            && report.kernels == kernels;
        if right || self.is_by_the_host(report, asked) {
            return Ok(());
        }
        Err(format!("{} was asked, expected {search} by {kernels:?}, the report says {report:?}", self.name()))
    }

    /// Whether the host ordered or cut rows, which it does only for devices that end long loops, and says so.
    #[cfg(feature = "gpu")]
    fn is_by_the_host(&self, report: &Report, asked: Asked) -> bool {
        let asked = self.answered_as(asked);
        let is_ordered = matches!(asked, Asked::CappedList | Asked::List { sorted: true, .. });
        let said = report.notes.iter().any(|note| note.contains("the host"));
        // The device may still sort rows that the host only cuts.
        let (search, kernels) = self.on_gpu(Asked::List { sorted: false, distances: true });
        let (_, sorting) = self.on_gpu(Asked::List { sorted: true, distances: true });
        let is_sorted_on_device = asked == Asked::CappedList && report.kernels == sorting;
        self.device == Device::Gpu
            && device().limits().loop_rounds.is_some()
            && is_ordered
            && said
            && report.structure == self.structure
            && report.search == search
            && report.device == device().name()
            && (report.kernels == kernels || is_sorted_on_device)
    }

    #[cfg(not(feature = "gpu"))]
    fn is_by_the_host(&self, _: &Report, _: Asked) -> bool {
        false
    }

    /// Brute force on a device has no search of its own for the nearest: it cuts lists.
    #[cfg(feature = "gpu")]
    fn answered_as(&self, asked: Asked) -> Asked {
        if asked == Asked::Knn && self.structure == "brute-force" { Asked::CappedList } else { asked }
    }

    /// The search and the kernels that answer on a device.
    #[cfg(feature = "gpu")]
    fn on_gpu(&self, asked: Asked) -> (&'static str, Vec<String>) {
        let asked = self.answered_as(asked);
        match asked {
            Asked::Knn if self.structure == "aabb-tree" => {
                return ("nearest-boxes", vec!["package::query::knn_boxes".to_owned()]);
            }
            Asked::Knn => return ("nearest-octants", vec!["package::query::knn".to_owned()]),
            Asked::Boxes => return ("thread-a-box", vec!["package::query::boxes".to_owned()]),
            _ => {}
        }
        let plain = asked == (Asked::List { sorted: false, distances: false });
        let coherent = self.variant == "coherent";
        if coherent && plain {
            let kernel = |name: &str| format!("package::query::coherent::{name}");
            return ("coherent", ["pack", "back_traverse", "extract"].map(kernel).to_vec());
        }
        let by_masks = self.structure != "brute-force" && plain;
        let (search, visitors): (_, &[&str]) = match asked {
            Asked::Count => ("thread-a-query", &["count"]),
            Asked::List { .. } if by_masks => ("row-masks", &["row_masks"]),
            Asked::List { .. } => ("two-pass", &["count", "fill"]),
            Asked::CappedList => ("nearest-k", &["nearest_k"]),
            Asked::Nearest | Asked::Knn | Asked::Boxes => ("thread-a-query", &["nearest"]),
        };
        let mut traverse = format!("package::structure::{}::traverse", self.structure.replace('-', "_"));
        let (mut search, mut kernels) = (search, Vec::new());
        if coherent {
            (search, traverse) = ("coherent", "package::query::coherent::candidates".to_owned());
            kernels = ["pack", "back_traverse"].map(|name| format!("package::query::coherent::{name}")).to_vec();
        }
        let kernel = |v: &&str| format!("package::query::fixed_radius with {traverse} and package::query::{v}");
        kernels.extend(visitors.iter().map(kernel));
        match asked {
            Asked::List { .. } if by_masks => kernels.push("package::query::expand_masks".into()),
            Asked::List { sorted: true, .. } => kernels.push("package::query::sort_rows".into()),
            _ => {}
        }
        (search, kernels)
    }
}
