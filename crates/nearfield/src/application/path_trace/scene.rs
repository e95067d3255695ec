//! What is rendered: triangles with materials, lights and a camera, and the scenes that are built in.

use glam::Vec3;

use super::camera::Camera;
use super::light::{Environment, PointLight};
use super::material::{Material, Surface};
use crate::geometry::generate::{self, MeshKind};
use crate::geometry::{Aabb, TriMesh};
use crate::{Error, Result};

/// Everything that a picture depends on but its size and the number of samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The surfaces. Normals and colours of its vertices are not used: triangles are flat.
    pub mesh: TriMesh,
    /// `[triangles]` index into `materials`.
    pub material_of: Vec<u32>,
    /// The materials; triangles of those that emit are area lights.
    pub materials: Vec<Material>,
    /// Lights without an extent.
    pub lights: Vec<PointLight>,
    /// Light from far away.
    pub environment: Environment,
    /// From where it is seen.
    pub camera: Camera,
}

/// Angle of view of the cameras that are placed here, in degrees: that of the Cornell box.
pub(super) const FIELD_OF_VIEW: f32 = 39.307_65;

impl Scene {
    /// A mesh of one material in white light from everywhere, seen whole along −z.
    pub fn of_mesh(mesh: TriMesh, material: Material) -> Self {
        let camera = Camera::framing(&used_bounds(&mesh), Vec3::NEG_Z, FIELD_OF_VIEW, 1, 1);
        Self {
            material_of: vec![0; mesh.triangles.len()],
            mesh,
            materials: vec![material],
            lights: vec![],
            environment: Environment::Constant(Vec3::ONE),
            camera,
        }
    }

    /// The Cornell box (Goral1984): two white blocks in a room with a red and a green wall, lit by a lamp at the ceiling.
    ///
    /// Lengths are millimetres, y points up. Colours are the usual red, green and blue for the measured spectra.
    pub fn cornell_box() -> Self {
        let mesh = generate::mesh(MeshKind::Cornell, 32, 0);
        let white = Material::lambert(Vec3::new(0.725, 0.71, 0.68));
        let materials = vec![
            white,
            Material::lambert(Vec3::new(0.63, 0.065, 0.05)),
            Material::lambert(Vec3::new(0.14, 0.45, 0.091)),
            Material::lambert(Vec3::splat(0.78)).emitting(Vec3::new(17.0, 12.0, 4.0)),
        ];
        // The generated box stands in the order floor, lamp, ceiling, back, green, red, blocks: two triangles each.
        let of_wall = |wall: usize| match wall {
            1 => 3,
            4 => 2,
            5 => 1,
            _ => 0,
        };
        let material_of = (0..mesh.triangles.len()).map(|triangle| of_wall(triangle / 2)).collect();
        let camera = Camera {
            position: Vec3::new(278.0, 273.0, -800.0),
            target: Vec3::new(278.0, 273.0, 0.0),
            up: Vec3::Y,
            vertical_fov: FIELD_OF_VIEW,
        };
        Self { mesh, material_of, materials, lights: vec![], environment: Environment::NONE, camera }
    }

    /// Accel's scene: a room like the Cornell box around the mesh, which stands on its floor.
    ///
    /// The mesh keeps its coordinates, y points up, and the room is sized to it. See [`Scene::in_room`].
    ///
    /// # Errors
    /// `NoTriangles`; `TooMany`, `NonFinite`, `CoordinateTooLarge` for meshes that no structure takes either.
    pub fn room_around(mesh: TriMesh, material: Material) -> Result<Self> {
        Self { environment: Environment::NONE, ..Self::of_mesh(mesh, material) }.in_room()
    }

    /// The scene with a room around its mesh and a camera that looks into it along −z, in place of its own camera.
    ///
    /// The room is twice as wide and deep as the longest side of the mesh, and as high as it needs; its floor lies at
    /// the lowest vertex. The left wall is red, the right one green, the front is open, and a lamp hangs at the
    /// ceiling. Materials and lights of the scene stay.
    ///
    /// # Errors
    /// As [`Scene::room_around`].
    pub fn in_room(mut self) -> Result<Self> {
        if self.mesh.triangles.is_empty() {
            return Err(Error::NoTriangles { vertices: self.mesh.vertices.len() as u64 });
        }
        self.mesh.check_indices()?;
        crate::geometry::validate::coordinates("vertices", &self.mesh.vertices)?;
        let bounds = used_bounds(&self.mesh);
        let longest = bounds.extent().max_element();
        let half = if longest > 0.0 { longest } else { 1.0 };
        let height = (1.2 * bounds.extent().y).max(1.6 * half);
        let floor = Vec3::new(bounds.center().x, bounds.min.y, bounds.center().z);
        let at = |x: f32, y: f32, z: f32| floor + Vec3::new(half * x, height * y, half * z);
        let [white, red, green, lamp] = [0, 1, 2, 3].map(|i| self.materials.len() as u32 + i);
        self.materials.extend([
            Material::lambert(Vec3::splat(0.73)),
            Material::lambert(Vec3::new(0.63, 0.065, 0.05)),
            Material::lambert(Vec3::new(0.14, 0.45, 0.091)),
            Material::lambert(Vec3::splat(0.78)).emitting(Vec3::new(9.0, 8.2, 6.8)),
        ]);
        let walls = [
            (white, [at(-1.0, 0.0, 1.0), at(1.0, 0.0, 1.0), at(1.0, 0.0, -1.0), at(-1.0, 0.0, -1.0)]),
            (white, [at(-1.0, 1.0, -1.0), at(1.0, 1.0, -1.0), at(1.0, 1.0, 1.0), at(-1.0, 1.0, 1.0)]),
            (white, [at(-1.0, 0.0, -1.0), at(1.0, 0.0, -1.0), at(1.0, 1.0, -1.0), at(-1.0, 1.0, -1.0)]),
            (red, [at(-1.0, 0.0, 1.0), at(-1.0, 0.0, -1.0), at(-1.0, 1.0, -1.0), at(-1.0, 1.0, 1.0)]),
            (green, [at(1.0, 0.0, -1.0), at(1.0, 0.0, 1.0), at(1.0, 1.0, 1.0), at(1.0, 1.0, -1.0)]),
            // A thousandth of the room below the ceiling: lamps must not lie in another surface.
            (lamp, [at(-0.3, 0.999, -0.3), at(0.3, 0.999, -0.3), at(0.3, 0.999, 0.3), at(-0.3, 0.999, 0.3)]),
        ];
        for (material, corners) in walls {
            let first = self.mesh.vertices.len() as u32;
            self.mesh.vertices.extend(corners);
            self.mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            self.material_of.extend([material; 2]);
        }
        (self.mesh.normals, self.mesh.colors) = (None, None);
        // The open front just fills the picture.
        let reach = (0.5 * FIELD_OF_VIEW).to_radians().tan();
        let middle = at(0.0, 0.5, 1.0);
        let away = half.max(0.5 * height) / reach;
        let position = middle + Vec3::new(0.0, 0.0, away);
        self.camera = Camera { position, target: middle, up: Vec3::Y, vertical_fov: FIELD_OF_VIEW };
        Ok(self)
    }

    /// Bounds of the triangles, relative to the origin of the mesh.
    pub fn bounds(&self) -> Aabb {
        used_bounds(&self.mesh)
    }

    /// Checks everything but the coordinates of the mesh, which the structures check.
    ///
    /// # Errors
    /// `NoTriangles`, `LengthMismatch` (materials of triangles), `TooMany` (a material that is not there, a vertex that
    /// is not there), `InvalidSetting` (materials, lights, environment, camera).
    pub fn check(&self) -> Result<()> {
        if self.mesh.triangles.is_empty() {
            return Err(Error::NoTriangles { vertices: self.mesh.vertices.len() as u64 });
        }
        self.mesh.check_indices()?;
        let (found, expected) = (self.material_of.len() as u64, self.mesh.triangles.len() as u64);
        if found != expected {
            return Err(Error::LengthMismatch { what: "materials of triangles", found, expected });
        }
        if let Some(&index) = self.material_of.iter().find(|&&i| i as usize >= self.materials.len()) {
            return Err(Error::TooMany {
                what: "material index of a triangle",
                found: u64::from(index),
                limit: (self.materials.len() as u64).saturating_sub(1),
                advice: "indices count from 0 and must be below the number of materials",
            });
        }
        self.materials.iter().enumerate().try_for_each(|(i, material)| material.check(i))?;
        self.lights.iter().enumerate().try_for_each(|(i, light)| light.check(i))?;
        self.environment.check()?;
        self.camera.check()
    }
}

impl Default for Material {
    /// Light grey and matte.
    fn default() -> Self {
        Self::new(Surface::Lambert { albedo: Vec3::splat(0.7) })
    }
}

/// Bounds of the vertices that triangles use; those of a mesh with wrong indices leave them out.
fn used_bounds(mesh: &TriMesh) -> Aabb {
    let used = mesh.triangles.iter().flatten().filter_map(|&v| mesh.vertices.get(v as usize));
    let bounds = used.fold(Aabb::EMPTY, |bounds, &vertex| bounds.grown_to(vertex));
    if bounds.is_empty() { Aabb::new(Vec3::ZERO, Vec3::ZERO) } else { bounds }
}
