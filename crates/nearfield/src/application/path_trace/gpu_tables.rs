//! A scene in the memory of a device: its layout and two buffers. `SceneLayout` in tables.wesl, byte for byte.

use bytemuck::{Pod, Zeroable};

use super::tables::SceneTables;
use crate::Result;
use crate::gpu::{Buffer, Gpu};

/// Where what stands.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SceneLayout {
    /// How far from a triangle rays start, without the rounding of their place.
    pub margin: f32,
    /// How often a light sample picks an emitting triangle.
    pub emitter_share: f32,
    /// How often it picks the environment.
    pub environment_share: f32,
    /// Columns of the environment.
    pub columns: u32,
    /// Rows of the environment.
    pub rows: u32,
    /// Emitting triangles to pick from.
    pub n_emitters: u32,
    /// Point lights to pick from.
    pub n_points: u32,
    /// Texels to pick from.
    pub n_texels: u32,
    /// Words before the sums of the emitters' shares.
    pub emitter_sums: u32,
    /// Words before the sums of the point lights' shares.
    pub point_sums: u32,
    /// Words before the sums of the texels' shares.
    pub texel_sums: u32,
    /// Words before the cosines of the rows.
    pub row_cosines: u32,
    /// Quads before the materials.
    pub materials: u32,
    /// Quads before the point lights.
    pub points: u32,
    /// Quads before the texels.
    pub texels: u32,
    /// Unused.
    pub padding: u32,
}

/// The scene on the device.
#[derive(Debug)]
pub(super) struct GpuTables {
    pub(super) layout: Buffer<SceneLayout>,
    pub(super) quads: Buffer<[f32; 4]>,
    pub(super) words: Buffer<u32>,
}

impl GpuTables {
    pub(super) fn upload(gpu: &Gpu, tables: &SceneTables) -> Result<Self> {
        let lights = &tables.lights;
        let mut quads: Vec<[f32; 4]> = Vec::new();
        quads.extend_from_slice(bytemuck::cast_slice(&tables.triangles));
        let materials = quads.len() as u32;
        quads.extend_from_slice(bytemuck::cast_slice(&tables.materials));
        let points = quads.len() as u32;
        quads.extend_from_slice(bytemuck::cast_slice(&lights.points));
        let texels = quads.len() as u32;
        quads.extend_from_slice(&lights.texels);

        let mut words = lights.emitters.clone();
        let mut place = |sums: &[u32]| {
            let first = words.len() as u32;
            words.extend_from_slice(sums);
            first
        };
        let emitter_sums = place(&lights.emitter_sums);
        let point_sums = place(&lights.point_sums);
        let texel_sums = place(&lights.texel_sums);
        let row_cosines = place(&lights.row_cosines.iter().map(|c| c.to_bits()).collect::<Vec<u32>>());
        let elements = |sums: &[u32]| sums.len().saturating_sub(1) as u32;
        let layout = SceneLayout {
            margin: tables.margin,
            emitter_share: lights.emitter_share,
            environment_share: lights.environment_share,
            columns: lights.columns,
            rows: lights.row_cosines.len() as u32 - 1,
            n_emitters: elements(&lights.emitter_sums),
            n_points: elements(&lights.point_sums),
            n_texels: elements(&lights.texel_sums),
            emitter_sums,
            point_sums,
            texel_sums,
            row_cosines,
            materials,
            points,
            texels,
            padding: 0,
        };
        Ok(Self {
            layout: gpu.uniform("scene layout", &layout)?,
            quads: gpu.upload("scene", &quads)?,
            words: gpu.upload("lights", &words)?,
        })
    }
}
