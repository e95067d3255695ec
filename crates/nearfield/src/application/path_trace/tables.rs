//! A scene as the stages read it: flat arrays, the same bytes on CPU and GPU. Twin of `tables.wesl`.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::light::LightTables;
use super::material::MaterialRecord;
use super::sampling::luminance;
use super::scene::Scene;
use crate::geometry::{PreparedTriangle, RaySpace};

/// A triangle as it is shaded: 64 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(super) struct ShadingTriangle {
    pub(super) a: Vec3,
    pub(super) material: u32,
    pub(super) b: Vec3,
    /// The density per area with which a light sample picks a place on it; zero where it does not emit.
    pub(super) light_density: f32,
    pub(super) c: Vec3,
    pub(super) padding_0: u32,
    /// Unit length.
    pub(super) normal: Vec3,
    pub(super) padding_1: u32,
}

impl ShadingTriangle {
    /// The place with these weights of the second and third corner: within 2⁻²¹ of the largest coordinate.
    pub(super) fn at(&self, weights: [f32; 2]) -> Vec3 {
        self.a * (1.0 - weights[0] - weights[1]) + self.b * weights[0] + self.c * weights[1]
    }
}

/// The scene in arrays.
#[derive(Debug, Clone, Default)]
pub(super) struct SceneTables {
    pub(super) triangles: Vec<ShadingTriangle>,
    pub(super) materials: Vec<MaterialRecord>,
    pub(super) lights: LightTables,
    /// How far from a triangle a ray must start so that it does not meet it, without the rounding of its place.
    pub(super) margin: f32,
}

/// Rounding of a place that is computed from corners and weights, and moved off its triangle, in sizes of its
/// coordinates: eight roundings and the move.
pub(super) const PLACE_ROUNDING: f32 = 1.0 / (1u32 << 20) as f32;

impl SceneTables {
    /// The tables of a scene without faults.
    pub(super) fn new(scene: &Scene, triangles: &[PreparedTriangle], space: &RaySpace) -> Self {
        let materials: Vec<MaterialRecord> = scene.materials.iter().map(MaterialRecord::from).collect();
        let mut emitters = vec![];
        let mut shading: Vec<ShadingTriangle> = Vec::with_capacity(triangles.len());
        let mut areas = vec![];
        for (i, (prepared, &material)) in triangles.iter().zip(&scene.material_of).enumerate() {
            let [a, b, c] = prepared.callers_corners();
            let emission = luminance(materials[material as usize].emission);
            let area = {
                let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
                0.5 * (b - a).cross(c - a).length()
            };
            if emission > 0.0 && area > 0.0 {
                emitters.push((i as u32, f64::from(emission) * area));
                areas.push(area);
            }
            let normal = prepared.normal();
            shading.push(ShadingTriangle { a, material, b, c, normal, ..ShadingTriangle::zeroed() });
        }
        let (lights, shares) = LightTables::new(&emitters, &scene.lights, &scene.environment);
        for (((triangle, _), area), share) in emitters.iter().zip(areas).zip(shares) {
            shading[*triangle as usize].light_density = (f64::from(share) / area) as f32;
        }
        Self { triangles: shading, materials, lights, margin: space.margin }
    }

    /// How far to move a place off its triangle before a ray starts there.
    ///
    /// No absolute number: the point of a hit lies within the margin of the ray ([`RaySpace::margin`]), so a ray that
    /// starts farther than that from a plane and leads away from it cannot hit a triangle in it; and the place itself
    /// is off by the rounding of its coordinates.
    pub(super) fn clearance(&self, place: Vec3) -> f32 {
        let size = place.abs();
        self.margin + size.x.max(size.y).max(size.z) * PLACE_ROUNDING
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> u64 {
        let lights = &self.lights;
        let words = lights.emitters.len()
            + lights.emitter_sums.len()
            + lights.point_sums.len()
            + lights.texel_sums.len()
            + lights.row_cosines.len();
        (size_of_val(&*self.triangles)
            + size_of_val(&*self.materials)
            + size_of_val(&*lights.points)
            + size_of_val(&*lights.texels)
            + 4 * words) as u64
    }
}
