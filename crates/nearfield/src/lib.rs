//! Exact spatial search on the CPU and on any GPU: what is near, and what a ray hits.
//!
//! Build a structure over points, then ask it:
//!
//! ```
//! use nearfield::{FixedRadius, GridSettings, NeighborSearch, UniformGrid, Vec3};
//!
//! let points = [Vec3::ZERO, Vec3::new(0.5, 0.0, 0.0), Vec3::new(9.0, 0.0, 0.0)];
//! let grid = UniformGrid::build(&points, &GridSettings::for_radius(0.5))?;
//! let neighbors = grid.list(&FixedRadius::new(0.5).exclude_self())?;
//! assert_eq!(neighbors.row(0), [1]); // a point at exactly the radius is inside
//! # Ok::<(), nearfield::Error>(())
//! ```
//!
//! The modules follow one direction: `io` → `geometry` → `curve` → `structure` → `query` → `application`, with the
//! services `parallel` and `gpu`.
//! The ball is closed everywhere: a neighbour has d² ≤ r².

pub mod application;
pub mod curve;
pub mod error;
pub mod geometry;
#[cfg(feature = "gpu")]
pub mod gpu;
mod host_memory;
#[cfg(feature = "io")]
pub mod io;
pub mod parallel;
pub mod query;
pub mod structure;

pub use application::{
    Camera, Environment, Film, Material, MlsMethod, MlsProjection, MlsSettings, MlsSmoothing, NormalMethod,
    NormalSettings, Normals, Partition, PathSettings, PathTracer, Scene, Surface, Wlop, WlopSettings, WlopVariant,
};
#[cfg(feature = "gpu")]
pub use application::{GpuMlsProjection, GpuMlsSmoothing, GpuPathTracer, GpuWlop};
pub use curve::{Curve, Domain, Octant};
pub use error::{Error, Result};
pub use geometry::{Aabb, DistanceGrid, PointCloud, Ray, RegularGrid, Scalar, Sphere, TriMesh, Triangle};
pub use glam::{DVec3, Vec3};
#[cfg(feature = "gpu")]
pub use gpu::{DeviceChoice, Gpu};
pub use query::{
    BoxSearch, Boxes, Counts, CountsN, FixedRadius, FixedRadiusN, ForEachNeighbor, HitCounts, HitLists, HitRecord,
    Hits, Knn, KnnN, KnnSearch, ListRows, Nearest, NearestN, NearestNeighbors, Neighbor, NeighborSearch, Neighbors,
    NeighborsN, Occlusion, Queries, QueriesN, Radius, RadiusN, RayHit, RaySearch, Report, RowOrder, SearchCounters,
    SearchWork,
};
#[cfg(feature = "gpu")]
pub use query::{
    DeviceQueries, DeviceRays, ForEachOnDevice, GpuListPlan, GpuNearestNeighbors, GpuNeighborRows, GpuNeighbors, Index,
    IndexSettings, RayIndex, RayIndexSettings, RayQuery, RayStructureChoice, RayTask, RaysOnDevice, SearchOnDevice,
    StructureChoice, Visitor,
};
pub use structure::{
    AabbTree, AabbTreeN, AabbTreeNSettings, AabbTreeSettings, BruteForce, BruteForceMesh, BuildOrder, BvhSettings,
    CellState, DenseOctree, DenseOctreeSettings, GridSettings, KdBuild, KdStats, KdTraversal, KdTree, KdTreeSettings,
    LinearOctree, MovingPoints, OctreeNode, OctreeSettings, PreparedTriangles, RayWork, RebuildPolicy, TreeSearch,
    TriangleBvh, UniformGrid, UpdateAction, UpdateReason, UpdateReport,
};
#[cfg(feature = "gpu")]
pub use structure::{
    GpuAabbTree, GpuAabbTreeN, GpuBruteForce, GpuBruteForceMesh, GpuDenseOctree, GpuKdTree, GpuLinearOctree,
    GpuMovingPoints, GpuTriangleBvh, GpuUniformGrid,
};
