//! Distance fields of triangle meshes: the exact closest point, with the sign of the mesh's pseudonormals or winding number.

use glam::DVec3;

use super::bricks::{Brick, Bricks, NodeValue, UNDEFINED};
use super::cpu::check_band;
use super::pseudonormals::{MeshClosure, Pseudonormals};
use super::{DistanceField, DistanceSettings, SignRule};
use crate::application::{Watch, WindingNumber};
#[cfg(feature = "gpu")]
use crate::geometry::closest_point::TriangleFeature;
use crate::geometry::closest_point::closest_point;
use crate::geometry::{RegularGrid, TriMesh};
use crate::query::{ClosestPoint, ClosestPointSearch};
use crate::structure::{BvhSettings, TriangleBvh};
use crate::{Error, Result};

/// A mesh ready for signed distances.
///
/// ```
/// use nearfield::application::MeshDistance;
/// use nearfield::geometry::generate::{MeshKind, mesh};
/// use nearfield::DVec3;
///
/// let cube = MeshDistance::new(&mesh(MeshKind::Cube, 12, 0))?;
/// assert!(cube.closure().is_closed());
/// let (inside, _) = cube.signed_distance(cube.mesh().bounds().center().as_dvec3(), f64::INFINITY).unwrap();
/// assert!(inside < 0.0);
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MeshDistance {
    mesh: TriMesh,
    bvh: TriangleBvh,
    normals: Pseudonormals,
}

impl MeshDistance {
    /// Builds the hierarchy over the triangles and their normals.
    ///
    /// # Errors
    /// As [`TriangleBvh::build`].
    pub fn new(mesh: &TriMesh) -> Result<Self> {
        let bvh = TriangleBvh::build(mesh, &BvhSettings::default())?;
        Ok(Self { mesh: mesh.clone(), bvh, normals: Pseudonormals::new(mesh) })
    }

    /// The mesh.
    pub fn mesh(&self) -> &TriMesh {
        &self.mesh
    }

    /// Its borders, and edges at which signs by pseudonormals may be wrong.
    pub fn closure(&self) -> MeshClosure {
        self.normals.closure
    }

    /// The rule of the sign where none is asked for: pseudonormals for closed meshes, winding numbers for others.
    pub fn usual_sign(&self) -> SignRule {
        if self.closure().is_closed() { SignRule::Pseudonormal } else { SignRule::WindingNumber }
    }

    /// The distance from the closest point within `radius`, negative inside by the pseudonormals, and that point.
    pub fn signed_distance(&self, place: DVec3, radius: f64) -> Option<(f64, ClosestPoint)> {
        let closest = self.bvh.closest_point(place, radius)?;
        Some((self.signed(place, &closest), closest))
    }

    /// The winding number of the mesh.
    ///
    /// # Errors
    /// As [`WindingNumber::of_triangles`].
    pub fn winding_number(&self) -> Result<WindingNumber<f64>> {
        let vertices: Vec<[f64; 3]> = self.mesh.vertices.iter().map(|v| v.as_dvec3().to_array()).collect();
        WindingNumber::of_triangles(&vertices, &self.mesh.triangles)
    }

    /// The field over a grid whose origin is that of the mesh. The mode has no meaning here.
    ///
    /// # Errors
    /// As [`DistanceSettings::validate`]; `InvalidSetting` where no node lies within the band, or for signs by normals of
    /// samples; `Interrupted`.
    pub fn distance_field(
        &self,
        grid: &RegularGrid,
        settings: &DistanceSettings,
        watch: &mut Watch<'_>,
    ) -> Result<DistanceField> {
        settings.validate(grid)?;
        let winding = (self.sign(settings)? == SignRule::WindingNumber).then(|| self.winding_number()).transpose()?;
        let radius = settings.radius(grid);
        let bricks = Bricks::new(grid);
        let field = bricks.compute("distances", watch, |brick| self.fill(&bricks, brick, radius, winding.as_ref()))?;
        check_band(&field, settings, grid, "triangles", self.mesh.triangles.len())?;
        Ok(field)
    }

    /// The rule of the sign.
    pub(super) fn sign(&self, settings: &DistanceSettings) -> Result<SignRule> {
        match settings.sign.unwrap_or_else(|| self.usual_sign()) {
            SignRule::Normal => Err(Error::InvalidSetting {
                setting: "sign",
                found: SignRule::Normal.to_string(),
                expected: "pseudonormal or winding-number for a mesh",
            }),
            rule => Ok(rule),
        }
    }

    fn fill(
        &self,
        bricks: &Bricks<f64>,
        brick: &Brick,
        radius: f64,
        winding: Option<&WindingNumber<f64>>,
    ) -> Option<Vec<NodeValue>> {
        let (middle, half) = bricks.ball(brick);
        let mut last = self.bvh.closest_point(middle.into(), radius + half)?;
        let mut values = vec![UNDEFINED; brick.len()];
        for node in brick.nodes() {
            let place = DVec3::from(bricks.position(node));
            // The triangle of the node before is a bound; a little beyond it, so that rounding leaves no node without.
            let known = self.offset(place, last.triangle).length() * (1.0 + 1e-12);
            let Some(closest) = self.bvh.closest_point(place, known.min(radius)) else { continue };
            last = closest;
            let value = match winding {
                Some(winding) if winding.is_inside(place.to_array()) => -closest.dist2.sqrt(),
                Some(_) => closest.dist2.sqrt(),
                None => self.signed(place, &closest),
            };
            values[brick.place(node)] = (value as f32, closest.triangle);
        }
        Some(values)
    }

    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.mesh.triangles[triangle as usize].map(|i| self.mesh.vertices[i as usize].as_dvec3())
    }

    #[cfg(feature = "gpu")]
    pub(super) fn bvh(&self) -> &TriangleBvh {
        &self.bvh
    }

    #[cfg(feature = "gpu")]
    pub(super) fn pseudonormal(&self, triangle: u32, feature: TriangleFeature) -> DVec3 {
        self.normals.normal(triangle, feature)
    }

    fn offset(&self, place: DVec3, triangle: u32) -> DVec3 {
        closest_point(self.corners(triangle).map(|corner| corner - place)).0
    }

    fn signed(&self, place: DVec3, closest: &ClosestPoint) -> f64 {
        let (offset, feature) = closest_point(self.corners(closest.triangle).map(|corner| corner - place));
        let distance = closest.dist2.sqrt();
        if offset.dot(self.normals.normal(closest.triangle, feature)) <= 0.0 { distance } else { -distance }
    }
}
