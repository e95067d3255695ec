//! Exclusive scan: the sum of all values before each place.
//!
//! Both sides cut the array into tiles, sum the tiles, scan those sums, and scan each tile from there. On the GPU that
//! is three dispatches whatever the length, or one up to a single tile.

use rayon::prelude::*;

use super::chunk_len;

/// Chunks below this length cost more to hand out than to scan.
const SMALLEST_CHUNK: usize = 16_384;

/// Sums modulo 2³² of the values before each place `[n]`, and the exact sum of all values.
///
/// The sums are exact where the total is below 2³².
pub fn exclusive(values: &[u32]) -> (Vec<u32>, u64) {
    let chunk = chunk_len(values.len(), SMALLEST_CHUNK);
    let sums: Vec<u64> = values.par_chunks(chunk).map(|c| c.iter().map(|&v| u64::from(v)).sum()).collect();
    let (before, total) = starts(&sums);
    let mut scanned = vec![0; values.len()];
    let chunks = scanned.par_chunks_mut(chunk).zip(values.par_chunks(chunk)).zip(before);
    chunks.for_each(|((out, values), before)| {
        let mut running = before as u32;
        for (out, &value) in out.iter_mut().zip(values) {
            *out = running;
            running = running.wrapping_add(value);
        }
    });
    (scanned, total)
}

/// CSR offsets of rows with these lengths: exact 64-bit sums of the values before each place, and of all `[n + 1]`.
pub fn exclusive_u64(values: &[u32]) -> Vec<u64> {
    let chunk = chunk_len(values.len(), SMALLEST_CHUNK);
    let sums: Vec<u64> = values.par_chunks(chunk).map(|c| c.iter().map(|&v| u64::from(v)).sum()).collect();
    let (before, total) = starts(&sums);
    let mut scanned = vec![0; values.len() + 1];
    scanned[values.len()] = total;
    let chunks = scanned[..values.len()].par_chunks_mut(chunk).zip(values.par_chunks(chunk)).zip(before);
    chunks.for_each(|((out, values), before)| {
        let mut running = before;
        for (out, &value) in out.iter_mut().zip(values) {
            *out = running;
            running += u64::from(value);
        }
    });
    scanned
}

/// Start of each chunk and the end of the last, from their sums.
fn starts(sums: &[u64]) -> (Vec<u64>, u64) {
    let mut total = 0;
    let starts = sums
        .iter()
        .map(|sum| {
            let start = total;
            total += sum;
            start
        })
        .collect();
    (starts, total)
}

#[cfg(feature = "gpu")]
pub use on_gpu::GpuScan;

#[cfg(feature = "gpu")]
mod on_gpu {
    use std::sync::Arc;

    use crate::Result;
    use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
    use crate::parallel::tile::{ParameterCache, RowScan, TILE, WORKGROUP, check_capacity, check_holds, check_len};

    /// A plan for exclusive scans of u32 arrays on the device.
    #[derive(Debug)]
    pub struct GpuScan {
        parameters: ParameterCache,
        capacity: usize,
        reduce_tiles: Arc<Pipeline>,
        scan_tiles: Arc<Pipeline>,
        rows: RowScan,
        tile_sums: Buffer<u32>,
        total: Buffer<u32>,
    }

    impl GpuScan {
        /// A plan for up to `capacity` values; its scratch memory is 4 bytes for 2,048 of them.
        ///
        /// # Errors
        /// `TooMany` beyond 2³¹ values, `OutOfDeviceMemory`, `KernelRejected`.
        pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self> {
            check_capacity("values to scan", capacity)?;
            let module = "package::parallel::scan";
            let reduce = [Access::Uniform, Access::Read, Access::ReadWrite];
            let scan = [Access::Uniform, Access::Read, Access::ReadWrite, Access::Read];
            Ok(Self {
                parameters: ParameterCache::new(gpu),
                capacity,
                reduce_tiles: gpu.prepare(&Kernel::new(module, "reduce_tiles", &reduce, WORKGROUP))?,
                scan_tiles: gpu.prepare(&Kernel::new(module, "scan_tiles", &scan, WORKGROUP))?,
                rows: RowScan::new(gpu)?,
                tile_sums: gpu.buffer("sums of scan tiles", (capacity + 1).div_ceil(TILE))?,
                total: gpu.buffer("sum of a scan", 1)?,
            })
        }

        /// Records `output[i] = input[0] + … + input[i - 1]` modulo 2³², for i below `len`.
        ///
        /// If `output` has more than `len` elements, `output[len]` becomes the sum of all `len` values; what stands
        /// behind it is left alone. `input` and `output` must be different buffers. Where the sum may pass 2³², check
        /// it with [`crate::parallel::reduce::GpuReduce::record_sum`].
        ///
        /// # Errors
        /// `TooMany` if `len` passes the capacity, `LengthMismatch` if a buffer is shorter, `OutOfDeviceMemory`.
        pub fn record(
            &self,
            commands: &mut Commands,
            input: &Buffer<u32>,
            output: &Buffer<u32>,
            len: usize,
        ) -> Result<()> {
            check_len("values to scan", len, self.capacity)?;
            check_holds(input, len)?;
            check_holds(output, len)?;
            let n_out = output.len().min(len + 1);
            let n_tiles = n_out.div_ceil(TILE);
            let has_prefixes = n_tiles > 1;
            let parameters =
                self.parameters.uniform([len as u32, n_out as u32, n_tiles as u32, u32::from(has_prefixes)])?;
            let workgroups = Workgroups::Count(n_tiles as u32);
            if has_prefixes {
                let bindings = [(&parameters).into(), input.into(), (&self.tile_sums).into()];
                commands.dispatch(&self.reduce_tiles, &bindings, workgroups.clone());
                self.rows.record(commands, &self.tile_sums, &self.total, 1, n_tiles)?;
            }
            let bindings = [(&parameters).into(), input.into(), output.into(), (&self.tile_sums).into()];
            commands.dispatch(&self.scan_tiles, &bindings, workgroups);
            Ok(())
        }
    }
}
