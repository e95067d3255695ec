//! What a structure over triangles gives the ray queries on the GPU.

use std::sync::Arc;

use super::{BuildStage, PreparedTriangles};
use crate::gpu::{Access, AdapterKind, Bind, Gpu};

/// Tests of triangles or boxes that one submission is made for, so that no driver's time limit ends it: 4 ms on an H200,
/// where a test takes 3.6 ps, and a fifth of a second on a device fifty times as slow. Limits are around two seconds.
const TESTS_A_SUBMISSION: u64 = 1 << 30;
/// Rays that every submission takes, whatever they test: an invocation casts one ray, and fewer leave lanes of a large card
/// idle and take no less time.
const FEWEST_RAYS: u64 = 1 << 16;
/// The same on a software renderer, which has few lanes.
const FEWEST_RAYS_ON_SOFTWARE: u64 = 1 << 10;
/// Tests of a ray in a tree: the hierarchy of boxes tests some 40 boxes for a bounced ray into the Stanford bunny.
const TESTS_IN_A_TREE: u64 = 64;

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

    /// How many triangles or boxes a ray is tested against, about.
    fn expected_tests(&self) -> u64 {
        TESTS_IN_A_TREE
    }

    /// Most rays of a submission: such that rays times [`GpuRayStructure::expected_tests`] is at most 2³⁰, but 65,536 in any
    /// case, or 1,024 on a software renderer: brute force over more triangles than 2¹⁴ tests more. [`crate::RaySearch`] cuts its batches by it; whoever records casts into commands of their own can too.
    fn rays_a_submission(&self) -> usize {
        let on_software = self.gpu().kind() == AdapterKind::Software;
        let fewest = if on_software { FEWEST_RAYS_ON_SOFTWARE } else { FEWEST_RAYS };
        let rays = (TESTS_A_SUBMISSION / self.expected_tests().max(1)).max(fewest);
        usize::try_from(rays).unwrap_or(usize::MAX)
    }

    /// Times of the build.
    fn build_stages(&self) -> &[BuildStage];

    /// Bytes of device memory held, triangles included.
    fn memory_bytes(&self) -> u64;
}
