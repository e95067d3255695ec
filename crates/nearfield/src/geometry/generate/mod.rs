//! Synthetic clouds and meshes: the same kind, size and seed give the same bytes on every machine.
//!
//! Only IEEE basic operations, square roots and the portable `libm` functions are used, all in f64, and each result is
//! rounded to f32 once. Every point draws from its own random stream, so the work runs on all cores and, for the kinds
//! without a scan order, the first m points of a cloud of n are the cloud of m.

mod boxes;
mod clouds;
mod kinds;
mod lidar;
mod meshes;
mod noise;
pub(crate) mod random;
mod terrain;

#[cfg(test)]
mod tests;

pub use clouds::LATTICE_SPACING;
pub use kinds::{CloudKind, MeshKind};
pub use noise::{add_noise, surface_samples};

use super::{PointCloud, TriMesh};

/// `n` points of a kind; `seed` picks one of the equally likely clouds.
///
/// The shapes and units are those of [`CloudKind`]. Takes 12 bytes a point; the caller checks that they are there.
///
/// ```
/// use nearfield::geometry::generate::{CloudKind, cloud, radius_for};
///
/// let points = cloud(CloudKind::Uniform, 1_000_000, 1);
/// assert_eq!(points.len(), 1_000_000);
/// let radius = radius_for(CloudKind::Uniform, points.len()); // about 49 neighbours within it
/// assert!(radius.is_some_and(|r| (r - 0.0227).abs() < 1e-4));
/// ```
pub fn cloud(kind: CloudKind, n: usize, seed: u64) -> PointCloud {
    let points = match kind {
        CloudKind::Uniform => clouds::uniform(n, seed),
        CloudKind::Shell => clouds::shell(n, seed),
        CloudKind::Clustered => clouds::clustered(n, seed),
        CloudKind::Plummer => clouds::plummer(n, seed),
        CloudKind::Lidar => lidar::scan(n, seed),
        CloudKind::Torus => clouds::torus(n, seed),
        CloudKind::Terrain => return terrain::scan(n, seed),
        CloudKind::AllEqual => clouds::all_equal(n),
        CloudKind::Line => clouds::line(n, seed),
        CloudKind::Lattice => clouds::lattice(n),
    };
    PointCloud::new(points)
}

/// A mesh of a kind with about `n` triangles; only [`MeshKind::Soup`] depends on `seed`.
///
/// The shapes, and how near the count comes to `n`, are those of [`MeshKind`].
pub fn mesh(kind: MeshKind, n: usize, seed: u64) -> TriMesh {
    match kind {
        MeshKind::Icosphere => meshes::icosphere(n),
        MeshKind::Cube => boxes::cube(n),
        MeshKind::Torus => meshes::torus(n),
        MeshKind::Cornell => boxes::cornell(n),
        MeshKind::Soup => meshes::soup(n, seed),
    }
}

/// The search radius that goes with a cloud of `n` points, for the kinds used to compare speed; else `None`.
///
/// It shrinks with n so that the mean number of neighbours stays:
/// - uniform: (49/n · 3/4π)^(1/3), 49 neighbours beside the point itself away from the border;
/// - shell: 0.014 for a million points, 49 neighbours beside the point itself;
/// - clustered: 0.002 for a million points, several hundred on average and very uneven: 715 for seed 7, 580 to 1,000
///   for most others.
pub fn radius_for(kind: CloudKind, n: usize) -> Option<f32> {
    let n = n.max(1) as f64;
    let radius = match kind {
        CloudKind::Uniform => libm::cbrt(49.0 / n * 3.0 / (4.0 * std::f64::consts::PI)),
        CloudKind::Shell => 0.014 * (1e6 / n).sqrt(),
        CloudKind::Clustered => 0.002 * libm::cbrt(1e6 / n),
        _ => return None,
    };
    Some(radius as f32)
}
