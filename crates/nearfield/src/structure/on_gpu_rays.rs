//! What a structure over triangles gives the ray queries on the GPU.

use std::sync::Arc;

use super::{BuildStage, PreparedTriangles};
use crate::gpu::{Access, Bind, Gpu};

/// A structure over triangles on the device, and a WESL module that walks along a ray.
///
/// The module holds `fn trace(ray: PreparedRay, state: ptr<function, HitState>, work: ptr<function, RayWork>) -> bool`. It
/// offers what it hits to `package::structure::hit_visitor`, by the rules of [`crate::structure::RayStructure`], and
/// counts its work under the feature `count_work`. On devices that end long loops it counts its own rounds, and is false
/// where they do not suffice.
pub trait GpuRayStructure: Sync {
    /// Name of the structure, in lower case with hyphens.
    const NAME: &'static str;

    /// Name of the way it is searched.
    fn search(&self) -> &'static str;

    /// The device it lives on.
    fn gpu(&self) -> &Gpu;

    /// The triangles on the host, in the caller's order.
    fn triangles(&self) -> &Arc<PreparedTriangles>;

    /// Module that holds `trace`.
    fn trace_module(&self) -> &'static str;

    /// Conditions that the module is compiled with, apart from `count_work`.
    fn features(&self) -> Vec<(&'static str, bool)>;

    /// The module's bindings in `@group(0)`, numbered from 3.
    fn bindings(&self) -> Vec<(Access, Bind)>;

    /// Rounds that the loops of every walk take together at least. Asked only on devices that end long loops
    /// ([`crate::gpu::GpuLimits::loop_rounds`]), so that a cast that cannot succeed is not begun.
    fn fewest_rounds(&self) -> u64 {
        0
    }

    /// Times of the build.
    fn build_stages(&self) -> &[BuildStage];

    /// Bytes of device memory held, triangles included.
    fn memory_bytes(&self) -> u64;
}
