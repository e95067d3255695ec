//! Compaction: the indices of the elements to keep, in ascending order.

use rayon::prelude::*;

use super::chunk_len;
use crate::{Error, Result};

/// The indices below `n` for which `keep` holds, ascending.
///
/// # Errors
/// `TooMany` if an index below `n` does not fit into 32 bits.
pub fn indices_where(n: usize, keep: impl Fn(usize) -> bool + Sync) -> Result<Vec<u32>> {
    let (found, limit) = (n as u64, 1 << 32);
    if found > limit {
        return Err(Error::TooMany { what: "elements to choose from", found, limit, advice: "choose in parts" });
    }
    let chunk = chunk_len(n, 16_384);
    let chunks: Vec<Vec<u32>> = (0..n.div_ceil(chunk))
        .into_par_iter()
        .map(|c| (c * chunk..n.min((c + 1) * chunk)).filter(|&i| keep(i)).map(|i| i as u32).collect())
        .collect();
    Ok(chunks.concat())
}

#[cfg(feature = "gpu")]
pub use on_gpu::GpuCompact;

#[cfg(feature = "gpu")]
mod on_gpu {
    use std::sync::Arc;

    use crate::Result;
    use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
    use crate::parallel::tile::{ParameterCache, RowScan, TILE, WORKGROUP, check_capacity, check_holds, check_len};

    /// A plan for compactions on the device.
    #[derive(Debug)]
    pub struct GpuCompact {
        parameters: ParameterCache,
        capacity: usize,
        count_flags: Arc<Pipeline>,
        write_indices: Arc<Pipeline>,
        rows: RowScan,
        tile_counts: Buffer<u32>,
    }

    impl GpuCompact {
        /// A plan for up to `capacity` flags; its scratch memory is 4 bytes for 2,048 of them.
        ///
        /// # Errors
        /// `TooMany` beyond 2³¹ flags, `OutOfDeviceMemory`, `KernelRejected`.
        pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self> {
            check_capacity("flags to compact", capacity)?;
            let module = "package::parallel::compact";
            let count = [Access::Uniform, Access::Read, Access::ReadWrite];
            let write = [Access::Uniform, Access::Read, Access::ReadWrite, Access::Read];
            Ok(Self {
                parameters: ParameterCache::new(gpu),
                capacity,
                count_flags: gpu.prepare(&Kernel::new(module, "count_flags", &count, WORKGROUP))?,
                write_indices: gpu.prepare(&Kernel::new(module, "write_indices", &write, WORKGROUP))?,
                rows: RowScan::new(gpu)?,
                tile_counts: gpu.buffer("flags set in tiles", capacity.div_ceil(TILE))?,
            })
        }

        /// Records the indices below `len` whose flag is not zero, ascending, into `indices`, and their number into
        /// `count[0]`. What stands in `indices` behind that number is left alone.
        ///
        /// # Errors
        /// `TooMany` if `len` passes the capacity, `LengthMismatch` if `flags` or `indices` have less than `len`
        /// elements (all flags may be set), `OutOfDeviceMemory`.
        pub fn record(
            &self,
            commands: &mut Commands,
            flags: &Buffer<u32>,
            indices: &Buffer<u32>,
            count: &Buffer<u32>,
            len: usize,
        ) -> Result<()> {
            check_len("flags to compact", len, self.capacity)?;
            check_holds(flags, len)?;
            check_holds(indices, len)?;
            check_holds(count, 1)?;
            let n_tiles = len.div_ceil(TILE);
            let parameters = self.parameters.uniform([len as u32, n_tiles as u32, 0, 0])?;
            let workgroups = Workgroups::Count(n_tiles as u32);
            let bindings = [(&parameters).into(), flags.into(), (&self.tile_counts).into()];
            commands.dispatch(&self.count_flags, &bindings, workgroups.clone());
            self.rows.record(commands, &self.tile_counts, count, 1, n_tiles)?;
            let bindings = [(&parameters).into(), flags.into(), indices.into(), (&self.tile_counts).into()];
            commands.dispatch(&self.write_indices, &bindings, workgroups);
            Ok(())
        }
    }
}
