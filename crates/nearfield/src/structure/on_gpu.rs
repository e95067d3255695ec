//! What a structure gives the queries on the GPU.

use glam::Vec3;

use super::{BuildStage, GpuAabbTree};
use crate::Result;
use crate::geometry::Aabb;
use crate::gpu::{Access, Bind, Buffer, Gpu};

/// A point on the device: xyz, and the caller's index as bits.
pub type DevicePoint = [f32; 4];

/// Upper bounds of what a traversal does on behalf of invocations that run in step, each with a query of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Points tested.
    pub candidates: u64,
    /// Rounds of all loops, apart from those over candidates.
    pub rounds: u64,
}

/// A structure on the device: points in some order, and a WESL module that visits those near a query.
pub trait GpuStructure: Sync {
    /// Name of the structure, in lower case with hyphens.
    const NAME: &'static str;

    /// The device it lives on.
    fn gpu(&self) -> &Gpu;

    /// Number of points.
    fn len(&self) -> usize;

    /// Whether there is no point.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `[n]` the points in the structure's order.
    fn points(&self) -> &Buffer<DevicePoint>;

    /// `[n]` the caller's indices in the structure's order, where the traversal can hand over masks of 32 candidates
    /// (feature `masks`, visitors with `visit_mask`).
    fn ids(&self) -> Option<&Buffer<u32>> {
        None
    }

    /// A level such that the points of each of 2^level parts of the order, as even as whole numbers can be, should be
    /// searched by one workgroup, where the structure prefers that to workgroups of one size.
    fn query_parts(&self) -> Option<u32> {
        None
    }

    /// Whether neighbours are counted by masks; see `ids`.
    fn counts_by_masks(&self) -> bool {
        false
    }

    /// Most words of 32 candidates that the masks of a query should hold, an even number.
    fn mask_words(&self) -> u32 {
        16
    }

    /// Module that holds `fn traverse(query: Query, state: ptr<function, State>)`.
    fn traverse_module(&self) -> &'static str;

    /// Whether the module lets several invocations share a query (`own_share` in question.wesl).
    fn shares_queries(&self) -> bool {
        false
    }

    /// Module of the kernel `find_pairs`, which searches the structure's own points two at a time, where it has one that serves for
    /// this radius: see find_pairs.wesl of the grid. Its bindings in `@group(0)` are its parameters, [`GpuStructure::bindings`] numbered from 1,
    /// and what it produces.
    fn pairs_module(&self, radius: f32) -> Option<&'static str> {
        let _ = radius;
        None
    }

    /// The most that a traversal of the module does for queries of at most this radius, that lie within `queries` or
    /// are the points themselves. Asked only on devices that end long loops ([`crate::gpu::GpuLimits::loop_rounds`]); there the module's loops must test eight candidates a round
    /// under the feature `short_loops`, and do nothing but test every point under `all_points`.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `OutOfMemory`, `DeviceLost`.
    fn most_effort(&self, radius: f32, queries: Option<&Aabb>) -> Result<Effort>;

    /// Conditions that the module is compiled with.
    fn features(&self) -> Vec<(&'static str, bool)>;

    /// The module's bindings in `@group(0)`, numbered from 3.
    fn bindings(&self) -> Vec<(Access, Bind)>;

    /// Other query points on the device, in a good order to search them.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    fn upload_queries(&self, queries: &[Vec3]) -> Result<Buffer<DevicePoint>>;

    /// The tree, where questions are to be answered by its coherent search: its queries are then packed first, and the
    /// traversal goes through the candidates of a pack.
    fn coherent_tree(&self) -> Option<&GpuAabbTree> {
        None
    }

    /// Times of the build.
    fn build_stages(&self) -> &[BuildStage];

    /// Bytes of device memory held, points included.
    fn memory_bytes(&self) -> u64;
}

/// Points on the device as the kernels take them, in the caller's order, numbered from `first`.
///
/// # Errors
/// As [`Gpu::upload`].
pub(crate) fn upload_points(
    gpu: &Gpu,
    label: &'static str,
    points: &[Vec3],
    first: u32,
) -> Result<Buffer<DevicePoint>> {
    gpu.upload_with(label, points.len(), device_point(points, first))
}

/// Point i as the kernels take it, numbered from `first`.
pub(crate) fn device_point(points: &[Vec3], first: u32) -> impl Fn(usize) -> DevicePoint + Sync {
    move |i| [points[i].x, points[i].y, points[i].z, f32::from_bits(first + i as u32)]
}
