//! What other libraries need for the same sets, each measured in one go on one machine, and what we aim for there.
//!
//! GPU figures: one NVIDIA H200, CUDA 13.0, driver 580. CPU figures: two cores of an AMD EPYC with AVX-512, shared with
//! other work; TreeNSearch with points in random order.

use crate::sets::Set;

/// Milliseconds of another library.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peer {
    /// Library and what it did.
    pub(super) name: &'static str,
    /// Milliseconds; of a range the lower end.
    pub(super) milliseconds: f64,
}

/// Where the GPU figures were taken.
pub(super) const GPU_MACHINE: &str = "NVIDIA H200";
/// Where the CPU figures were taken.
pub(super) const CPU_MACHINE: &str = "two cores of an AMD EPYC (AVX-512)";

type Figures = (&'static str, &'static str, &'static [(&'static str, f64)]);

/// Structure, set, operation and milliseconds.
type Target = (&'static str, &'static str, &'static str, f64);

const ON_GPU: &[Figures] = &[
    ("uniform-1m", "build", &[("ArborX", 0.83), ("cuBQL", 1.9)]),
    ("uniform-1m", "count", &[("ArborX", 3.1), ("cuBQL, sorted queries", 1.6), ("CUDA probe", 0.264)]),
    ("uniform-1m", "list", &[("ArborX", 5.8)]),
    ("uniform-1m", "build + list", &[("ArborX", 5.5)]),
    ("uniform-10m", "build", &[("ArborX", 3.2), ("cuBQL", 14.8)]),
    ("uniform-10m", "count", &[("ArborX", 28.0), ("cuBQL, sorted queries", 16.6), ("CUDA probe", 2.604)]),
    ("uniform-10m", "list", &[("ArborX", 53.5)]),
    ("uniform-10m", "build + list", &[("ArborX", 56.0)]),
    ("shell-1m", "build", &[("ArborX", 0.83), ("cuBQL", 2.1)]),
    ("shell-1m", "count", &[("ArborX", 2.1), ("cuBQL, sorted queries", 0.67)]),
    ("shell-1m", "list", &[("ArborX", 3.4)]),
    ("shell-1m", "build + list", &[("ArborX", 4.7)]),
    ("clustered-1m", "build", &[("ArborX", 0.84), ("cuBQL", 3.3)]),
    ("clustered-1m", "count", &[("ArborX", 34.5), ("cuBQL, sorted queries", 14.6)]),
    ("clustered-1m", "list", &[("ArborX", 56.0)]),
    ("clustered-1m", "build + list", &[("ArborX", 49.0)]),
    ("uniform-1m", "kNN 16", &[("ArborX", 7.2), ("cuBQL", 5.8)]),
    ("uniform-10m", "kNN 16", &[("ArborX", 60.0), ("cuBQL", 62.5)]),
    ("shell-1m", "kNN 16", &[("ArborX", 5.7), ("cuBQL", 2.6)]),
    ("clustered-1m", "kNN 16", &[("ArborX", 7.3), ("cuBQL", 6.8)]),
];

const ON_CPU: &[Figures] = &[
    ("uniform-100k", "build", &[("kiddo", 9.0)]),
    ("uniform-100k", "list", &[("kiddo", 191.0)]),
    ("uniform-100k", "build + list", &[("TreeNSearch", 56.0), ("kiddo", 200.0), ("Open3D", 884.0), ("SciPy", 2600.0)]),
    ("uniform-100k", "count", &[("SciPy", 1000.0)]),
    ("uniform-1m", "build", &[("kiddo", 213.0)]),
    ("uniform-1m", "list", &[("kiddo", 4100.0)]),
    ("uniform-1m", "build + list", &[("TreeNSearch", 1100.0), ("kiddo", 4313.0), ("Open3D", 21100.0)]),
    ("uniform-1m", "count", &[("SciPy", 24300.0)]),
    ("uniform-100k", "kNN 16", &[("kiddo", 222.0), ("pykdtree", 508.0)]),
    ("uniform-1m", "kNN 16", &[("kiddo", 4600.0), ("pykdtree", 9400.0)]),
];

const TARGETS_ON_GPU: &[Target] = &[
    ("uniform-grid", "uniform-1m", "count", 0.24),
    ("uniform-grid", "uniform-1m", "build + list", 0.9),
    ("uniform-grid", "uniform-10m", "build + list", 10.0),
    ("uniform-grid", "shell-1m", "build + list", 1.0),
    ("aabb-tree", "uniform-1m", "refit", 0.05),
    ("aabb-tree", "uniform-10m", "refit", 0.2),
    ("aabb-tree", "uniform-1m", "refit + list", 1.0),
    ("aabb-tree", "uniform-1m", "build + list", 1.3),
    ("aabb-tree", "uniform-10m", "build + list", 12.0),
    ("aabb-tree", "clustered-1m", "count", 12.0),
    ("aabb-tree", "shell-1m", "count", 0.5),
    ("aabb-tree", "uniform-1m", "kNN 16", 2.5),
    ("aabb-tree", "shell-1m", "kNN 16", 1.5),
    ("aabb-tree", "uniform-10m", "kNN 16", 28.0),
];

const TARGETS_ON_CPU: &[Target] = &[
    ("uniform-grid", "uniform-1m", "build + list", 500.0),
    ("aabb-tree", "uniform-1m", "build + list", 500.0),
    ("aabb-tree", "uniform-1m", "kNN 16", 2500.0),
];

/// Figures of other libraries for that operation on a GPU or on the CPU.
pub(super) fn peers(set: &Set, operation: &str, on_gpu: bool) -> Vec<Peer> {
    let (name, figures) = (set.to_string(), if on_gpu { ON_GPU } else { ON_CPU });
    let found = figures.iter().find(|f| f.0 == name && f.1 == operation);
    found.map_or_else(Vec::new, |f| f.2.iter().map(|&(name, milliseconds)| Peer { name, milliseconds }).collect())
}

/// Milliseconds we aim for on the machine of the figures.
pub(super) fn target(structure: &str, set: &Set, operation: &str, on_gpu: bool) -> Option<f64> {
    let (name, targets) = (set.to_string(), if on_gpu { TARGETS_ON_GPU } else { TARGETS_ON_CPU });
    targets.iter().find(|t| t.0 == structure && t.1 == name && t.2 == operation).map(|t| t.3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_belongs_to_a_set_that_can_be_measured() {
        for (set, operation, figures) in ON_GPU.iter().chain(ON_CPU) {
            assert_eq!(set.parse::<Set>().expect("a set").to_string(), *set);
            assert!(["build", "count", "list", "build + list", "kNN 16"].contains(operation), "{operation}");
            assert!(figures.iter().all(|f| f.1 > 0.0));
        }
        for (i, (_, set, operation, target)) in TARGETS_ON_GPU.iter().chain(TARGETS_ON_CPU).enumerate() {
            let set: Set = set.parse().expect("a set");
            let on_gpu = i < TARGETS_ON_GPU.len();
            let best = peers(&set, operation, on_gpu).iter().map(|p| p.milliseconds).fold(f64::INFINITY, f64::min);
            assert!(*target < best, "{set} {operation}: the aim is to be faster than every peer");
        }
    }
}
