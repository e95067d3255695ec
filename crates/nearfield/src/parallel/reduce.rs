//! Reduce: the sum, smallest, largest or bounding box of an array.

use glam::Vec3;
use rayon::prelude::*;

use super::chunk_len;
use crate::Aabb;

#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
pub use gpu::{GpuBounds, GpuReduce};

/// Chunks below this length cost more to hand out than to reduce.
const SMALLEST_CHUNK: usize = 16_384;

/// The exact sum of all values.
pub fn sum(values: &[u32]) -> u64 {
    let of_chunk = |chunk: &[u32]| chunk.iter().map(|&v| u64::from(v)).sum::<u64>();
    values.par_chunks(chunk_len(values.len(), SMALLEST_CHUNK)).map(of_chunk).sum()
}

/// The smallest value; `None` for no values.
pub fn smallest(values: &[u32]) -> Option<u32> {
    let of_chunk = |chunk: &[u32]| chunk.iter().copied().min();
    values.par_chunks(chunk_len(values.len(), SMALLEST_CHUNK)).filter_map(of_chunk).min()
}

/// The largest value; `None` for no values.
pub fn largest(values: &[u32]) -> Option<u32> {
    let of_chunk = |chunk: &[u32]| chunk.iter().copied().max();
    values.par_chunks(chunk_len(values.len(), SMALLEST_CHUNK)).filter_map(of_chunk).max()
}

/// The smallest value that is not NaN; infinity for none.
pub fn smallest_f32(values: &[f32]) -> f32 {
    let of_chunk = |chunk: &[f32]| chunk.iter().copied().fold(f32::INFINITY, f32::min);
    let chunks = values.par_chunks(chunk_len(values.len(), SMALLEST_CHUNK));
    chunks.map(of_chunk).reduce(|| f32::INFINITY, f32::min)
}

/// The largest value that is not NaN; minus infinity for none.
pub fn largest_f32(values: &[f32]) -> f32 {
    let of_chunk = |chunk: &[f32]| chunk.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let chunks = values.par_chunks(chunk_len(values.len(), SMALLEST_CHUNK));
    chunks.map(of_chunk).reduce(|| f32::NEG_INFINITY, f32::max)
}

/// The bounding box of all points, [`Aabb::EMPTY`] for none. The points should be finite.
pub fn bounds(points: &[Vec3]) -> Aabb {
    let chunks = points.par_chunks(chunk_len(points.len(), SMALLEST_CHUNK));
    chunks.map(Aabb::of_points).reduce(|| Aabb::EMPTY, Aabb::union)
}
