//! Distances of a field on their way to the host.
//!
//! A fresh 68 MB of host memory cost more time when they are first touched than the copy into them, so threads touch them while the
//! device computes. In a narrow band most nodes have no value: then only the bricks that were filled go to the host, one after the
//! other, and their rows are put to their places there.

use rayon::prelude::*;

use super::bricks::EDGE;
use super::gpu_run::{GpuDistanceField, pipeline};
use crate::Result;
use crate::geometry::{DistanceGrid, RegularGrid};
use crate::gpu::Access::{Read, ReadWrite, Uniform};
use crate::gpu::{Access, Workgroups};
use crate::host_memory;

/// Nodes of a brick, of a row of it, and bytes of a row.
const BRICK: usize = (EDGE * EDGE * EDGE) as usize;
const ROW: usize = EDGE as usize;
const ROW_BYTES: usize = ROW * size_of::<f32>();
/// Bricks are packed where that is so many times less to copy.
const WORTH: usize = 2;
/// Values that one thread sets at a time.
const TOGETHER: usize = 1 << 16;

const PACK: [Access; 4] = [Uniform, Read, Read, ReadWrite];

/// Distances that a device computes, read into memory that other threads make ready meanwhile.
///
/// # Errors
/// `OutOfMemory`; those of `compute` and of reading.
pub(super) fn with_memory(
    grid: &RegularGrid,
    compute: impl FnOnce() -> Result<GpuDistanceField> + Send,
) -> Result<DistanceGrid> {
    let mut values = memory(grid)?;
    let field = rayon::in_place_scope(|scope| {
        scope.spawn(|_| undefine(&mut values));
        compute()
    })?;
    field.read_into(values)
}

fn memory(grid: &RegularGrid) -> Result<Vec<f32>> {
    host_memory::zeroed("distances of nodes", grid.n_nodes())
}

fn undefine(values: &mut [f32]) {
    values.par_chunks_mut(TOGETHER).for_each(|values| values.fill(f32::NAN));
}

/// Infinite values are undefined.
#[inline(always)]
fn defined(value: f32) -> f32 {
    if value.is_finite() { value } else { f32::NAN }
}

impl GpuDistanceField {
    /// Reads the distances back, half of the field's bytes, and less where most nodes have none.
    ///
    /// # Errors
    /// As [`GpuDistanceField::read`].
    pub fn read_distances(&self) -> Result<DistanceGrid> {
        let mut values = memory(self.grid())?;
        if self.is_narrow() {
            undefine(&mut values);
        }
        self.read_into(values)
    }

    /// Whether most of the nodes are in bricks that were not filled.
    fn is_narrow(&self) -> bool {
        WORTH * BRICK * self.filled_bricks.len() <= self.grid().n_nodes()
    }

    /// The distances in this memory, one a node: undefined ones where most are.
    fn read_into(&self, mut values: Vec<f32>) -> Result<DistanceGrid> {
        if self.is_narrow() {
            self.read_packed(&mut values)?;
        } else {
            self.gpu.read_turned(self.values(), &mut values, |bits| defined(f32::from_bits(bits)))?;
        }
        Ok(DistanceGrid::of_checked(*self.grid(), values))
    }

    fn read_packed(&self, values: &mut [f32]) -> Result<()> {
        let (gpu, numbers) = (&self.gpu, &self.filled_bricks);
        let packed = gpu.buffer::<u32>("distances of bricks", BRICK * numbers.len())?;
        let pack = pipeline(gpu, "pack_bricks", "pack_bricks", &PACK, &[], &[])?;
        let binds = [(&self.parameters).into(), (&self.filled).into(), self.values().into(), (&packed).into()];
        let mut commands = gpu.commands("distances of bricks");
        commands.dispatch(&pack, &binds, Workgroups::Covering(packed.len() as u64));
        commands.submit()?;
        // Chunks hold whole bricks.
        gpu.read_by_chunks(&packed, |first, bytes| {
            let bricks = first / BRICK..(first + bytes.len() / size_of::<u32>()) / BRICK;
            scatter(self.grid(), &numbers[bricks], bytes, values);
        })
    }
}

/// Puts the rows of bricks, which stand one after the other by ascending number, to their places among the values of a grid.
fn scatter(grid: &RegularGrid, numbers: &[u32], bytes: &[u8], values: &mut [f32]) {
    let [nx, ny, nz] = grid.nodes().map(|n| n as usize);
    let [bricks_x, bricks_y] = [nx, ny].map(|n| n.div_ceil(ROW));
    let per_layer = bricks_x * bricks_y;
    let (Some(&first), Some(&last)) = (numbers.first(), numbers.last()) else { return };
    let layers = first as usize / per_layer..last as usize / per_layer + 1;
    let (low, high) = (layers.start * ROW, nz.min(layers.end * ROW));
    let planes = values[low * nx * ny..high * nx * ny].par_chunks_mut(nx * ny).enumerate();
    planes.for_each(|(i, plane)| {
        let z = low + i;
        let place_of = |layer: usize| numbers.partition_point(|&number| (number as usize) < layer * per_layer);
        for brick in place_of(z / ROW)..place_of(z / ROW + 1) {
            let number = numbers[brick] as usize;
            let (x, y) = (number % bricks_x * ROW, number / bricks_x % bricks_y * ROW);
            for row in 0..ROW.min(ny - y) {
                let from = &bytes[((brick * ROW + z % ROW) * ROW + row) * ROW_BYTES..][..ROW_BYTES];
                let to = &mut plane[(y + row) * nx + x..][..ROW.min(nx - x)];
                let values = from.chunks_exact(size_of::<f32>()).map(bytemuck::pod_read_unaligned::<f32>);
                to.iter_mut().zip(values).for_each(|(to, value)| *to = defined(value));
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};

    #[test]
    fn rows_of_bricks_come_to_their_places() {
        // Bricks at the far borders hang over.
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::ZERO, 1.0, [19, 8, 12]).unwrap();
        let numbers = [1u32, 2, 3, 5];
        let value = |[x, y, z]: [usize; 3]| (x + 100 * y + 10_000 * z) as f32;
        let mut packed = vec![];
        for number in numbers.map(|n| n as usize) {
            let corner = [number % 3 * ROW, 0, number / 3 * ROW];
            packed.extend((0..BRICK).map(|i| {
                let node = [corner[0] + i % ROW, corner[1] + i / ROW % ROW, corner[2] + i / ROW / ROW];
                if node[0] < 19 && node[2] < 12 { value(node) } else { f32::INFINITY }
            }));
        }
        packed[5] = f32::NEG_INFINITY;
        // All at once, and two by two.
        for together in [4, 2] {
            let mut values = vec![f32::NAN; grid.n_nodes()];
            for (numbers, bricks) in numbers.chunks(together).zip(packed.chunks(together * BRICK)) {
                scatter(&grid, numbers, bytemuck::cast_slice(bricks), &mut values);
            }
            for (i, found) in values.into_iter().enumerate() {
                let node = grid.node(i).unwrap().map(|i| i as usize);
                let number = node[2] / ROW * 3 + node[0] / ROW;
                let is_there = numbers.contains(&(number as u32)) && node != [13, 0, 0];
                assert!(if is_there { found == value(node) } else { found.is_nan() }, "{node:?}: {found}");
            }
        }
    }
}
