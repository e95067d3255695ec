//! Rays against triangles: the closest hit, whether there is any, all of them in order, how many.
//!
//! [`RaySearch`] is what every structure over triangles on every device answers. All of them use one triangle test
//! ([`crate::geometry::PreparedTriangle`]) and break ties by the lowest triangle, so on one device all name the same
//! triangle; between the CPU and a device, t differs by rounding, and the triangle where two are as near within that,
//! or the ray passes within it of an edge.
//!
//! ```
//! use nearfield::{BvhSettings, Ray, RaySearch, TriMesh, TriangleBvh, Vec3};
//!
//! let corners = vec![Vec3::ZERO, Vec3::new(4.0, 0.0, 0.0), Vec3::new(0.0, 4.0, 0.0)];
//! let bvh = TriangleBvh::build(&TriMesh::new(corners, vec![[0, 1, 2]])?, &BvhSettings::default())?;
//! let hit = bvh.closest_hit(&Ray::new(Vec3::new(1.0, 1.0, 5.0), -Vec3::Z))?.expect("the ray should hit");
//! assert_eq!((hit.triangle, hit.t, hit.normal), (0, 5.0, Vec3::Z));
//! # Ok::<(), nearfield::Error>(())
//! ```
//!
//! Positions are relative to the origin of the mesh. A triangle is hit from both sides; edges and corners belong to it;
//! a triangle without an area is never hit. Triangles with edges below 1e-16 may be missed, and below 1e-23 are
//! ([`PreparedTriangle::hit`](crate::geometry::PreparedTriangle::hit)): scale such meshes up.

mod cpu;
#[cfg(feature = "gpu")]
mod gpu;
mod hits;
#[cfg(feature = "gpu")]
mod on_device;
mod visitors;

#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use gpu::SortBatch;
pub use hits::{HitCounts, HitLists, HitRecord, Hits, Occlusion, RayHit};
#[cfg(feature = "gpu")]
#[doc(hidden)]
pub use on_device::RayBatch;
#[cfg(feature = "gpu")]
pub use on_device::{DeviceRays, RaysOnDevice};

use crate::Result;
use crate::geometry::Ray;
use crate::structure::{PreparedTriangles, RayWork};

use super::Stage;

/// Ray casting into a mesh, whatever the structure and the device.
///
/// The calls for many rays take any number. In them a ray that cannot be cast (see [`Ray::fault`]) does not stop the
/// others: it hits nothing, and the answer says that it is invalid.
pub trait RaySearch: Sync {
    /// Name of the structure: "brute-force", "kd-tree", "triangle-bvh".
    fn structure(&self) -> &'static str;

    /// The device: "cpu (…)" or the adapter's name.
    fn device(&self) -> String;

    /// The triangles, prepared.
    fn prepared(&self) -> &PreparedTriangles;

    /// Bytes the structure holds, triangles included.
    fn memory_bytes(&self) -> u64;

    /// Times of the stages of the build.
    fn build_stages(&self) -> Vec<Stage>;

    /// The first hit within the range of t of each ray `[rays]`, ties by lowest triangle.
    ///
    /// # Errors
    /// `OutOfMemory`, `OutOfDeviceMemory`, `DeviceLost`; on software renderers `Unsupported` where a kernel would need
    /// more loop rounds than they take.
    fn closest_hits(&self, rays: &[Ray]) -> Result<Hits>;

    /// As [`RaySearch::closest_hits`], with the work that each ray took `[rays]`.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hits`].
    fn closest_hits_with_work(&self, rays: &[Ray]) -> Result<(Hits, Vec<RayWork>)>;

    /// Whether each ray hits anything within its range of t `[rays]`.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hits`].
    fn any_hits(&self, rays: &[Ray]) -> Result<Occlusion>;

    /// All hits within the range of t of each ray, ascending by t, ties by lowest triangle.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hits`].
    fn all_hits(&self, rays: &[Ray]) -> Result<HitLists>;

    /// How many hits each ray has within its range of t `[rays]`.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hits`].
    fn count_hits(&self, rays: &[Ray]) -> Result<HitCounts>;

    /// The first hit of one ray.
    ///
    /// # Errors
    /// `InvalidRay`, and as [`RaySearch::closest_hits`].
    fn closest_hit(&self, ray: &Ray) -> Result<Option<RayHit>> {
        hits::check(ray)?;
        Ok(self.closest_hits(std::slice::from_ref(ray))?.hit(0))
    }

    /// Whether one ray hits anything.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hit`].
    fn any_hit(&self, ray: &Ray) -> Result<bool> {
        hits::check(ray)?;
        Ok(self.any_hits(std::slice::from_ref(ray))?.is_hit(0))
    }

    /// All hits of one ray, ascending by t.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hit`].
    fn all_hits_of(&self, ray: &Ray) -> Result<Vec<RayHit>> {
        hits::check(ray)?;
        let lists = self.all_hits(std::slice::from_ref(ray))?;
        Ok(lists.hits_of(0).collect())
    }

    /// How many hits one ray has.
    ///
    /// # Errors
    /// As [`RaySearch::closest_hit`].
    fn count_hits_of(&self, ray: &Ray) -> Result<u32> {
        hits::check(ray)?;
        Ok(self.count_hits(std::slice::from_ref(ray))?.as_slice()[0])
    }
}
