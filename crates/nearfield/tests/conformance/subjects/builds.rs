//! Every way to build every structure on every device.

#[cfg(feature = "gpu")]
use nearfield::structure::{GpuAabbTree, GpuBruteForce, GpuLinearOctree, GpuUniformGrid};
use nearfield::{
    Aabb, AabbTree, AabbTreeSettings, BruteForce, BuildOrder, Curve, GridSettings, LinearOctree, OctreeSettings,
    TreeSearch, UniformGrid,
};

#[cfg(feature = "gpu")]
use super::device;
use super::{Device, Plan, Subject};

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
