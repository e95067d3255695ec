//! Orders of points and of triangles that make searching them cheap.
//!
//! A structure on the CPU is points in some order, cut into packs of neighbours, and one method: which runs of that
//! order can hold anything near a box. Every query is written once on top of that ([`CpuStructure`]). The
//! [`dense_octree`] is a tree to compare with and answers questions of its own. Over triangles the method is a walk along
//! a ray ([`RayStructure`]).

use std::ops::Range;
use std::time::Instant;

use glam::Vec3;

use crate::geometry::{Aabb, OrderedPoints, Period};

pub mod aabb_tree;
pub mod brute_force;
#[cfg(feature = "gpu")]
pub mod cell_sort;
pub mod dense_octree;
pub mod kd_tree;
pub mod linear_octree;
pub mod moving_points;
#[cfg(feature = "gpu")]
pub mod multi_level_grid;
#[cfg(feature = "gpu")]
mod on_gpu;
#[cfg(feature = "gpu")]
mod on_gpu_rays;
mod packing;
mod ray_structure;
pub mod triangle_bvh;
pub mod uniform_grid;

pub use aabb_tree::{AabbTree, AabbTreeN, AabbTreeNSettings, AabbTreeSettings, BuildOrder, TreeSearch, TreeShape};
#[cfg(feature = "gpu")]
pub use aabb_tree::{AabbTreeBuilder, GpuAabbTree, GpuAabbTreeN};
pub use brute_force::{BruteForce, BruteForceMesh};
#[cfg(feature = "gpu")]
pub use brute_force::{GpuBruteForce, GpuBruteForceMesh};
#[cfg(feature = "gpu")]
pub use cell_sort::EntryOrder;
#[cfg(feature = "gpu")]
pub use dense_octree::GpuDenseOctree;
pub use dense_octree::{CellState, DenseOctree, DenseOctreeSettings};
#[cfg(feature = "gpu")]
pub use kd_tree::GpuKdTree;
pub use kd_tree::{KdBuild, KdStats, KdTraversal, KdTree, KdTreeSettings};
pub use linear_octree::{Contact, LeafNeighbors, LinearOctree, OctreeNode, OctreeSettings};
#[cfg(feature = "gpu")]
pub use linear_octree::{GpuLeafNeighbors, GpuLinearOctree, OctreeBuilder};
#[cfg(feature = "gpu")]
pub use moving_points::GpuMovingPoints;
pub use moving_points::{MovingPoints, RebuildPolicy, UpdateAction, UpdateReason, UpdateReport};
#[cfg(feature = "gpu")]
pub use multi_level_grid::{GpuMultiLevelGrid, LevelRule, MultiLevelGridBuilder};
#[cfg(feature = "gpu")]
pub use on_gpu::{DevicePoint, Effort, GpuStructure};
#[cfg(feature = "gpu")]
pub(crate) use on_gpu::{device_point, upload_points};
#[cfg(feature = "gpu")]
pub use on_gpu_rays::GpuRayStructure;
pub use ray_structure::{CountRayWork, HitVisitor, PreparedTriangles, RayStructure, RayWork};
#[cfg(feature = "gpu")]
pub use triangle_bvh::GpuTriangleBvh;
pub use triangle_bvh::{BvhSettings, TriangleBvh};
#[cfg(feature = "gpu")]
pub use uniform_grid::{GpuUniformGrid, GridBuilder};
pub use uniform_grid::{GridSettings, UniformGrid};

/// Time of a stage of a build, in milliseconds of the host's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BuildStage {
    /// "sort", "gather" …
    pub name: &'static str,
    /// Milliseconds.
    pub milliseconds: f64,
    /// Whether the device's clock measured it.
    pub on_device: bool,
}

impl BuildStage {
    /// A stage that began at `start`, by the host's clock.
    pub(crate) fn on_host(name: &'static str, start: Instant) -> Self {
        Self { name, milliseconds: start.elapsed().as_secs_f64() * 1e3, on_device: false }
    }

    /// A stage by the device's clock; `None` where it has none.
    #[cfg(feature = "gpu")]
    pub(crate) fn on_device(time: &crate::gpu::StageTime) -> Option<Self> {
        Some(Self { name: time.name, milliseconds: time.milliseconds?, on_device: true })
    }
}

/// What a structure gives the queries on the CPU.
pub trait CpuStructure: Sync {
    /// Name of the structure, in lower case with hyphens.
    const NAME: &'static str;

    /// Name of the way it is searched.
    fn search(&self) -> &'static str;

    /// The points in the structure's order.
    fn points(&self) -> &OrderedPoints;

    /// Period of the domain.
    fn period(&self) -> Period;

    /// The points' packs: ascending offsets into the order, from 0 to the number of points. Points of a pack lie
    /// close together and are searched with one set of spans.
    fn packs(&self) -> &[u32];

    /// An order and packs of other query points, by the same rule.
    ///
    /// # Errors
    /// `OutOfMemory`.
    fn pack_queries(&self, queries: &[Vec3]) -> crate::Result<Packed>;

    /// Appends spans of the order that together hold every point within `radius` of any point of `region`, each place
    /// at most once.
    fn spans_near(&self, region: &Aabb, radius: f32, spans: &mut Vec<Range<usize>>);

    /// The tree, where questions are to be answered by its coherent search, with phases of their own.
    fn coherent_tree(&self) -> Option<&AabbTree> {
        None
    }

    /// Times of the build.
    fn build_stages(&self) -> &[BuildStage];

    /// Bytes held, points included.
    fn memory_bytes(&self) -> u64;
}

/// Query points in a searching order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Packed {
    /// `[q]` the caller's index of the query at each place.
    pub order: Vec<u32>,
    /// Ascending offsets into `order`, from 0 to q.
    pub packs: Vec<u32>,
}

/// Merges spans that touch or overlap, so that each place stands in one span only.
pub(crate) fn merge_spans(spans: &mut Vec<Range<usize>>) {
    spans.retain(|s| !s.is_empty());
    if spans.is_sorted_by(|a, b| a.end < b.start) {
        return;
    }
    spans.sort_unstable_by_key(|s| s.start);
    spans.dedup_by(|next, last| {
        let touches = next.start <= last.end;
        if touches {
            last.end = last.end.max(next.end);
        }
        touches
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merged_spans_hold_each_place_once() {
        let mut spans = vec![5..9, 0..3, 8..12, 3..3, 2..4, 20..21];
        merge_spans(&mut spans);
        assert_eq!(spans, [0..4, 5..12, 20..21]);
    }
}
