//! The table: every row with its target, the best peer, the floor, and who measures it.
//!
//! **Peers**: ArborX, cuBQL and CUB were measured on one NVIDIA H200, CUDA 13.0, driver 580, each on the same work; `device/peers.rs` has
//! more of their figures. Figures of papers are of their own cards.
//!
//! **Floors** are for that H200: 4.26 TB/s copied, 33.5 T lane operations a second (132 multiprocessors × 128 lanes × 1.98 GHz), a
//! dispatch that waits for the one before 4 µs, PCIe 5.0 × 16 at 63 GB/s. Reckoned, not measured:
//!
//! - *lists* of some 49 neighbours a query: 200 MB of indices a million points, 47 µs; 120 to 180 distance tests of some eight operations,
//!   30 to 40 µs; sort, gather and tables, 60 µs at a million, which wait for each other: 0.15 ms in all, 1.2 at ten million;
//! - *counts*: the tests alone, 180 × 8 operations. Clustered: at least the 715 neighbours themselves, 8 operations each;
//! - *sixteen nearest*: 6 to 8 thousand lane operations a query, 0.2 ms a million, and a build of 0.06 (0.4 at ten million);
//! - *refit*: 17 bytes a point;
//! - *sort*: u32 keys in four passes of 16 bytes and a reading for the digits, 68 bytes a pair; u64 keys in eight passes of 24 and a
//!   reading, 200 bytes. A million pairs fit into the L2, which is faster;
//! - *octree*: 193 bytes a point, keys sorted by 24 to 32 bits; at two million 48 MB, inside the L2;
//! - *small calls*: one submission that is waited for takes 80 µs by the host's clock (measured);
//! - *rays*: some 480 operations a ray by ropes in a scene of 283,000 triangles. Divergent walks reach 5 to 10 % of that;
//! - *grains*: 172 bytes a grain and step, and 36 µs of tests a million;
//! - *fluids*: a sum over neighbours tests 75 candidates and adds up 30, 1,200 operations; PBF has eight sums a step with three
//!   iterations, WCSPH two, each 100 bytes a particle;
//! - *grains of three radii*: ten dispatches a step that wait for each other;
//! - *smoothing*: an iteration has 1,330 operations a point and moves 100 bytes; the points come and go by PCIe;
//! - *resampling*: an iteration has four dispatches that wait for each other, some 5 µs each;
//! - *fields*: 23 MB of samples and 68 MB of values by PCIe. *Contours* on the device read 68 MB and write 9, and to the host those 9 by PCIe
//!   and the values there;
//! - *clusters*: 160 MB of points and 40 of labels by PCIe, and a count of ten million points.

use nearfield::application::particles::FluidModel;

use super::lists::Rows;
use super::memory::Kind;
use super::rays::Shots;
use super::row::Unit::{BytesAPoint, GigaRays, Milliseconds, Steps, Times};
use super::row::{Floor, Peer, Row, Unit};
use super::{calls, clusters, lists, memory, nearest, particles, rays, sorts, surfaces};
use crate::rays::method::Method;

/// A row with a target, and nothing else yet but who measures it.
const fn row(name: &'static str, work: &'static str, unit: Unit, target: f64, measure: Measure) -> Row {
    Row { name, work, unit, target: Some(target), then: None, peer: None, floor: None, measure }
}

type Measure = fn(&mut super::bench::Bench) -> crate::Result<super::row::Outcome>;

impl Row {
    /// What is asked after the target.
    const fn then(self, then: f64) -> Self {
        Self { then: Some(then), ..self }
    }

    const fn peer(self, value: f64, who: &'static str) -> Self {
        Self { peer: Some(Peer { value, who }), ..self }
    }

    const fn floor(self, value: f64, how: &'static str) -> Self {
        Self { floor: Some(Floor { value, how }), ..self }
    }

    /// Without a target, or with one that the run itself measures.
    const fn no_target(self) -> Self {
        Self { target: None, ..self }
    }
}

const LIST: &str = "rebuild and list, rows in query order";
const KNN: &str = "16 nearest, build included";
const U32: &str = "stable sort of u32 keys and values";
const U64: &str = "stable sort of u64 keys and u32 values";
const OCTREE: &str = "points to linked octree, pre- and post-order";
const RAYS: &str = "first hits, Stanford bunny";
const MEMORY: &str = "memory on the device, the caller's points included";
const BY_OUTPUT: &str = "output, tests and rebuild";
const BY_SORT: &str = "bytes of the passes";

/// All rows, in the order in which they are measured.
pub(super) const ROWS: [Row; 43] = [
    row("uniform-1m-list", LIST, Milliseconds, 0.5, |b| lists::grid_list(b, "uniform-1m", Rows::InQueryOrder))
        .then(0.35)
        .peer(5.5, "ArborX")
        .floor(0.15, BY_OUTPUT),
    row("uniform-1m-rows", "rebuild and list, rows in completion order", Milliseconds, 0.4, |b| {
        lists::grid_list(b, "uniform-1m", Rows::InCompletionOrder)
    })
    .peer(5.5, "ArborX, in query order")
    .floor(0.15, BY_OUTPUT),
    row("uniform-10m-list", LIST, Milliseconds, 4.5, |b| lists::grid_list(b, "uniform-10m", Rows::InQueryOrder))
        .then(3.0)
        .peer(56.0, "ArborX")
        .floor(1.2, BY_OUTPUT),
    row("uniform-1m-count", "count, query alone", Milliseconds, 0.15, |b| lists::count(b, "uniform-1m", false))
        .peer(1.6, "cuBQL, sorted queries")
        .floor(0.043, "180 tests a query"),
    row("shell-1m-list", LIST, Milliseconds, 0.45, |b| lists::grid_list(b, "shell-1m", Rows::InQueryOrder))
        .peer(4.2, "ArborX, build and list apart")
        .floor(0.15, BY_OUTPUT),
    row("clustered-1m-count", "count, query alone", Milliseconds, 4.0, |b| lists::count(b, "clustered-1m", true))
        .peer(14.6, "cuBQL, sorted queries, 734.5 neighbours")
        .floor(0.17, "a test a neighbour"),
    row("uniform-1m-knn", KNN, Milliseconds, 1.0, |b| nearest::knn(b, "uniform-1m"))
        .peer(7.7, "cuBQL")
        .floor(0.26, "tests, insertions and build"),
    row("shell-1m-knn", KNN, Milliseconds, 0.8, |b| nearest::knn(b, "shell-1m"))
        .peer(4.7, "cuBQL")
        .floor(0.26, "tests, insertions and build"),
    row("clustered-1m-knn", KNN, Milliseconds, 1.2, |b| nearest::knn(b, "clustered-1m"))
        .peer(8.1, "ArborX")
        .floor(0.26, "tests, insertions and build"),
    row("uniform-10m-knn", KNN, Milliseconds, 10.0, |b| nearest::knn(b, "uniform-10m"))
        .peer(63.0, "ArborX")
        .floor(2.4, "tests, insertions and build"),
    row("refit-1m", "boxes fitted to points that moved", Milliseconds, 0.02, |b| nearest::refit(b, "uniform-1m"))
        .floor(0.004, "17 bytes a point"),
    row("refit-10m", "boxes fitted to points that moved", Milliseconds, 0.08, |b| nearest::refit(b, "uniform-10m"))
        .floor(0.04, "17 bytes a point"),
    row("sort-u32-1m", U32, Milliseconds, 0.06, |b| sorts::sort::<u32>(b, 1_000_000))
        .peer(0.084, "CUB")
        .floor(0.016, BY_SORT),
    row("sort-u32-10m", U32, Milliseconds, 0.37, |b| sorts::sort::<u32>(b, 10_000_000))
        .peer(0.37, "CUB")
        .floor(0.16, BY_SORT),
    row("sort-u32-100m", U32, Milliseconds, 2.9, |b| sorts::sort::<u32>(b, 100_000_000))
        .peer(2.81, "CUB")
        .floor(1.6, BY_SORT),
    row("sort-u64-1m", U64, Milliseconds, 0.14, |b| sorts::sort::<u64>(b, 1_000_000))
        .peer(0.182, "CUB")
        .floor(0.047, BY_SORT),
    row("sort-u64-10m", U64, Milliseconds, 0.9, |b| sorts::sort::<u64>(b, 10_000_000))
        .peer(0.907, "CUB")
        .floor(0.47, BY_SORT),
    row("sort-u64-100m", U64, Milliseconds, 7.6, |b| sorts::sort::<u64>(b, 100_000_000))
        .peer(7.6, "CUB")
        .floor(4.7, BY_SORT),
    row("octree-2m", OCTREE, Milliseconds, 0.15, |b| sorts::octree(b, "uniform-2m")).floor(0.09, "193 bytes a point"),
    row("octree-5m", OCTREE, Milliseconds, 0.35, |b| sorts::octree(b, "uniform-5m")).floor(0.224, "193 bytes a point"),
    row("octree-100m", OCTREE, Milliseconds, 8.0, |b| sorts::octree(b, "uniform-100m")).floor(4.5, "193 bytes a point"),
    row("small-8k-list", "a call: rebuild and list, buffers reused", Milliseconds, 0.12, |b| {
        calls::small(b, "uniform-8k")
    })
    .peer(0.28, "GPU libraries, published")
    .floor(0.08, "a submission that is waited for"),
    row("uniform-1m-host", "points in host memory, list in host memory", Milliseconds, 0.0, |b| {
        calls::from_host(b, "uniform-1m")
    })
    .no_target(),
    row("ropes-primary", RAYS, GigaRays, 2.0, |b| rays::cast(b, Method::GpuRopes, Shots::Primary))
        .peer(1.51, "tray_racing, RTX 4070 Ti, published")
        .floor(70.0, "issue of 480 operations a ray"),
    row("ropes-diffuse", RAYS, GigaRays, 0.8, |b| rays::cast(b, Method::GpuRopes, Shots::Diffuse))
        .floor(70.0, "issue of 480 operations a ray"),
    row("bvh-primary", RAYS, GigaRays, 2.5, |b| rays::cast(b, Method::GpuBvh, Shots::Primary))
        .peer(1.51, "tray_racing, RTX 4070 Ti, published")
        .floor(70.0, "issue of 480 operations a ray"),
    row("dem-1m", "grains, uniform grid", Steps, 1500.0, particles::dem)
        .peer(1830.0, "the CUDA sample's method")
        .floor(13_000.0, "172 bytes and the tests of a grain"),
    row("pbf-1m", "dam break, PBF, three iterations", Steps, 300.0, |b| particles::fluid(b, FluidModel::Pbf))
        .floor(2_900.0, "eight sums over neighbours"),
    row("wcsph-1m", "dam break, WCSPH", Steps, 500.0, |b| particles::fluid(b, FluidModel::Wcsph))
        .floor(8_400.0, "two sums over neighbours"),
    row("dfsph-1m", "dam break, DFSPH", Steps, 0.0, |b| particles::fluid(b, FluidModel::Dfsph)).no_target(),
    row("three-radii-30k", "grains of three radii, uniform grid", Steps, 5000.0, particles::three_radii)
        .peer(66.0, "Xing2017, GTX 660 Ti")
        .floor(25_000.0, "ten dispatches"),
    row("smoothing-889k", "30 iterations of moving least squares", Milliseconds, 120.0, surfaces::smoothing)
        .peer(9980.0, "Xing2017, GTX 660 Ti")
        .floor(2.1, "operations, bytes and PCIe"),
    row("wlop-137k", "20,000 samples, 100 iterations", Milliseconds, 100.0, surfaces::resampling)
        .peer(13_700.0, "Xing2017, GTX 660 Ti")
        .floor(2.0, "four dispatches an iteration"),
    row("field-257", "distances of 257³ nodes, four widths", Milliseconds, 10.0, surfaces::field)
        .peer(880.0, "Xing2017, GTX 660 Ti")
        .floor(1.45, "91 MB by PCIe"),
    row("offset-field-257", "distances of 257³ nodes, a fifth of the diagonal", Milliseconds, 25.0, |b| {
        surfaces::offset_field(b)
    })
    .peer(1990.0, "Xing2017, GTX 660 Ti")
    .floor(1.45, "91 MB by PCIe"),
    row("contour-257", "dual contouring of the field", Milliseconds, 10.0, surfaces::contour)
        .floor(0.018, "77 MB on the device"),
    row("dbscan-10m", "clusters, copies included", Milliseconds, 50.0, |b| clusters::dbscan_of(b, "uniform-10m"))
        .floor(4.4, "200 MB by PCIe and a count"),
    row("memory-list-1m", "peak of a list beyond points and structure, by the list", Times, 1.25, |b| {
        memory::of_list(b, "uniform-1m")
    })
    .floor(1.0, "the list"),
    row("memory-grid-1m", MEMORY, BytesAPoint, 0.0, |b| memory::on_device(b, "uniform-1m", Kind::Grid)).no_target(),
    row("memory-octree-1m", MEMORY, BytesAPoint, 0.0, |b| memory::on_device(b, "uniform-1m", Kind::Octree)).no_target(),
    row("memory-aabb-tree-1m", MEMORY, BytesAPoint, 0.0, |b| memory::on_device(b, "uniform-1m", Kind::AabbTree))
        .no_target(),
    row("memory-brute-force-100k", MEMORY, BytesAPoint, 0.0, |b| {
        memory::on_device(b, "uniform-100k", Kind::BruteForce)
    })
    .no_target(),
    row("memory-cpu-1m", "memory of structures of the CPU", BytesAPoint, 0.0, |b| memory::on_cpu(b, "uniform-1m"))
        .no_target(),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_differ_and_floors_are_below_targets_and_peers_where_that_is_claimed() {
        for (i, row) in ROWS.iter().enumerate() {
            assert!(ROWS[..i].iter().all(|other| other.name != row.name), "{} twice", row.name);
            let best = |value: f64| row.floor.is_none_or(|floor| row.unit.missed_by(value, floor.value) > 1.0);
            assert!(row.target.is_none_or(best), "{}: the target is beyond the floor", row.name);
            assert!(row.then.is_none_or(best), "{}: the next target is beyond the floor", row.name);
            assert!(row.peer.is_none_or(|peer| best(peer.value)), "{}: the peer is beyond the floor", row.name);
            if let (Some(target), Some(then)) = (row.target, row.then) {
                assert!(row.unit.missed_by(target, then) > 1.0, "{}: the next target is harder", row.name);
            }
        }
    }
}
