//! First stage: the rays of the camera. Twin of `generate.wesl`.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::camera::CameraFrame;
use super::sampling::{combined, unit_pair};
use crate::geometry::Ray;

/// What all paths of a dispatch share: 128 bytes, the same on CPU and GPU.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PathParameters {
    /// The camera.
    pub camera: CameraFrame,
    /// Columns of the picture.
    pub width: u32,
    /// Rows of the picture.
    pub height: u32,
    /// The first pixel of the tile, row by row from the upper left.
    pub first_pixel: u32,
    /// Pixels in the tile.
    pub n_paths: u32,
    /// Number of the sample.
    pub sample: u32,
    /// The picture's seed.
    pub seed: u32,
    /// Times that the paths have been scattered.
    pub depth: u32,
    /// Times that a path is scattered at most.
    pub most_depth: u32,
    /// From how many times on paths may end by chance.
    pub roulette_depth: u32,
    /// 1 where lights are sampled.
    pub next_event: u32,
    /// Unused.
    pub padding: [u32; 6],
}

/// A path under way: 48 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PathState {
    /// Where the ray starts.
    pub origin: Vec3,
    /// Its place in the tile.
    pub slot: u32,
    /// Unit direction of the ray.
    pub direction: Vec3,
    /// Density with which the direction was picked; zero where it was the only one.
    pub density: f32,
    /// What a radiance that comes in along the ray is multiplied by; zero where the path has ended.
    pub throughput: Vec3,
    /// Square of the refractive index around the ray over that around the camera.
    pub eta_scale: f32,
}

impl PathState {
    /// Whether it goes on.
    pub(super) fn is_alive(&self) -> bool {
        self.throughput != Vec3::ZERO
    }

    /// Its ray.
    pub(super) fn ray(&self) -> Ray {
        Ray::new(self.origin, self.direction)
    }
}

/// Pairs of numbers that a path takes: one in the pixel, then [`PAIRS_A_DEPTH`] for each scattering.
pub(super) const PAIRS_A_DEPTH: u32 = 4;

/// The seed of one pair of dimensions of a path.
pub(super) fn pair_seed(parameters: &PathParameters, slot: u32, dimension: u32) -> u32 {
    combined(combined(parameters.seed, parameters.first_pixel + slot), dimension)
}

/// The ray through a place in the pixel of `slot`.
pub(super) fn generate(parameters: &PathParameters, slot: u32) -> PathState {
    let pixel = parameters.first_pixel + slot;
    let (column, row) = (pixel % parameters.width, pixel / parameters.width);
    let [u, v] = unit_pair(pair_seed(parameters, slot, 0), parameters.sample);
    let x = (column as f32 + u) / parameters.width as f32;
    let y = (row as f32 + v) / parameters.height as f32;
    PathState {
        origin: parameters.camera.position,
        slot,
        direction: parameters.camera.direction(x, y),
        density: 0.0,
        throughput: Vec3::ONE,
        eta_scale: 1.0,
    }
}
