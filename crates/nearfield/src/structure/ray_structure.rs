//! What a structure over triangles gives the ray queries on the CPU: the prepared triangles, and a walk along a ray.

use std::ops::ControlFlow;
use std::sync::Arc;

use rayon::prelude::*;

use super::BuildStage;
use crate::geometry::{Aabb, LocalHit, PreparedRay, PreparedTriangle, RaySpace, TriMesh, validate};
use crate::host_memory::zeroed;
use crate::{Error, Result};

/// The triangles of a mesh, prepared once and shared by every structure over them.
#[derive(Debug, Clone, PartialEq)]
pub struct PreparedTriangles {
    triangles: Vec<PreparedTriangle>,
    space: RaySpace,
}

/// Most triangles: three numbers of the 32 bits stand for rays without a hit.
const MOST_TRIANGLES: u64 = u32::MAX as u64 - 3;

/// Triangles that a thread prepares at once.
const CHUNK: usize = 1 << 12;

impl PreparedTriangles {
    /// Prepares every triangle of the mesh, relative to its origin.
    ///
    /// Edges should be 1e-16 or longer, in whatever unit; see [`PreparedTriangle::hit`] for what becomes of shorter ones,
    /// which are no error.
    ///
    /// # Errors
    /// `NoTriangles`; `TooMany` (an index of a triangle without a vertex, or more than 2³² − 4 triangles); `NonFinite`,
    /// `CoordinateTooLarge` (vertices); `OutOfMemory`.
    pub fn new(mesh: &TriMesh) -> Result<Arc<Self>> {
        if mesh.triangles.is_empty() {
            return Err(Error::NoTriangles { vertices: mesh.vertices.len() as u64 });
        }
        if mesh.triangles.len() as u64 > MOST_TRIANGLES {
            return Err(Error::TooMany {
                what: "triangles",
                found: mesh.triangles.len() as u64,
                limit: MOST_TRIANGLES,
                advice: "indices are 32 bits wide; split the mesh",
            });
        }
        mesh.check_indices()?;
        validate::coordinates("vertices", &mesh.vertices)?;
        let mut triangles: Vec<PreparedTriangle> = zeroed("prepared triangles", mesh.triangles.len())?;
        // Vertices that no triangle uses must not widen the space.
        let bounds = triangles.par_chunks_mut(CHUNK).enumerate().map(|(chunk, prepared)| {
            let mut bounds = Aabb::EMPTY;
            for (i, prepared) in prepared.iter_mut().enumerate() {
                let (triangle, index) = (mesh.triangle(chunk * CHUNK + i), chunk * CHUNK + i);
                *prepared = PreparedTriangle::new(&triangle, index as u32);
                bounds = bounds.union(triangle.bounds());
            }
            bounds
        });
        let bounds = bounds.reduce(|| Aabb::EMPTY, Aabb::union);
        Ok(Arc::new(Self { triangles, space: RaySpace::new(&bounds) }))
    }

    /// Checks that a mesh whose vertices have moved has as many triangles as this one.
    ///
    /// # Errors
    /// `LengthMismatch` where it has not.
    pub(crate) fn check_moved(&self, moved: &TriMesh) -> Result<()> {
        let (found, expected) = (moved.triangles.len() as u64, self.triangles.len() as u64);
        if found != expected {
            return Err(Error::LengthMismatch { what: "triangles of the moved mesh", found, expected });
        }
        Ok(())
    }

    /// `[triangles]` in the caller's order.
    pub fn as_slice(&self) -> &[PreparedTriangle] {
        &self.triangles
    }

    /// Number of triangles, those without an area included.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Always false: there is no mesh without triangles to prepare.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Where rays are cast.
    pub fn space(&self) -> &RaySpace {
        &self.space
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> u64 {
        (self.triangles.len() * size_of::<PreparedTriangle>()) as u64
    }
}

/// What a walk does with the hits that it meets.
pub trait HitVisitor {
    /// The largest t of interest. A walk may leave out what begins beyond it, but nothing that begins at it.
    fn limit(&self) -> f32;

    /// A triangle that the ray hits, within the ray's range of t or not. `leave` is where the ray leaves the part of
    /// space for which the triangle was tested: a hit at `leave` or beyond is offered again by a later part.
    /// [`ControlFlow::Break`] ends the walk.
    fn offer(&mut self, hit: &LocalHit, leave: f32) -> ControlFlow<()>;
}

/// What counts the work of a walk. `()` counts nothing, and costs nothing.
pub trait CountRayWork {
    /// Triangles tested.
    fn triangle_tests(&mut self, n: u32);
    /// Inner nodes looked at, of a tree; boxes tested, of a hierarchy of boxes.
    fn node_visits(&mut self, n: u32);
    /// Leaves whose triangles were tested, or that were passed empty.
    fn leaf_visits(&mut self, n: u32);
    /// Ropes followed.
    fn rope_steps(&mut self, n: u32);
}

impl CountRayWork for () {
    fn triangle_tests(&mut self, _: u32) {}
    fn node_visits(&mut self, _: u32) {}
    fn leaf_visits(&mut self, _: u32) {}
    fn rope_steps(&mut self, _: u32) {}
}

/// The work of one ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct RayWork {
    /// Triangles tested.
    pub triangle_tests: u32,
    /// Inner nodes looked at, of a tree; boxes tested, of a hierarchy of boxes.
    pub node_visits: u32,
    /// Leaves entered.
    pub leaf_visits: u32,
    /// Ropes followed.
    pub rope_steps: u32,
}

impl CountRayWork for RayWork {
    fn triangle_tests(&mut self, n: u32) {
        self.triangle_tests += n;
    }

    fn node_visits(&mut self, n: u32) {
        self.node_visits += n;
    }

    fn leaf_visits(&mut self, n: u32) {
        self.leaf_visits += n;
    }

    fn rope_steps(&mut self, n: u32) {
        self.rope_steps += n;
    }
}

/// What a structure over triangles gives the ray queries on the CPU.
///
/// All structures name the same triangle: a walk offers every triangle that [`PreparedTriangle::hit`] says is hit
/// within the ray's range of t and before the visitor's limit, in any order, each at least once with `t < leave`.
pub trait RayStructure: Sync {
    /// Name of the structure, in lower case with hyphens.
    const NAME: &'static str;

    /// Name of the way it is searched.
    fn search(&self) -> &'static str;

    /// The triangles, in the caller's order.
    fn triangles(&self) -> &Arc<PreparedTriangles>;

    /// Walks along the ray.
    fn walk<V: HitVisitor, W: CountRayWork>(&self, ray: &PreparedRay, visitor: &mut V, work: &mut W);

    /// Times of the build.
    fn build_stages(&self) -> &[BuildStage];

    /// Bytes held, prepared triangles included.
    fn memory_bytes(&self) -> u64;
}
