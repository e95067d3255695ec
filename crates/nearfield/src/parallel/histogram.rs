//! Histogram: how often each value occurs.

use rayon::prelude::*;

use super::chunk_len;
use crate::{Error, Result};

/// How often each value below `n_bins` occurs `[n_bins + 1]`; the last entry counts the values that are `n_bins` or
/// larger.
///
/// # Errors
/// `TooMany` beyond 2³² - 1 values.
pub fn count(values: &[u32], n_bins: usize) -> Result<Vec<u32>> {
    let (found, limit) = (values.len() as u64, u64::from(u32::MAX));
    if found > limit {
        return Err(Error::TooMany { what: "values to count", found, limit, advice: "count in parts" });
    }
    // Every chunk has counters of its own: it must be long enough to be worth their sum.
    let chunk = chunk_len(values.len(), (4 * n_bins).max(16_384));
    let of_chunk = |chunk: &[u32]| {
        let mut counts = vec![0u32; n_bins + 1];
        for &value in chunk {
            counts[(value as usize).min(n_bins)] += 1;
        }
        counts
    };
    let sum = |mut a: Vec<u32>, b: Vec<u32>| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    };
    Ok(values.par_chunks(chunk).map(of_chunk).reduce_with(sum).unwrap_or_else(|| vec![0; n_bins + 1]))
}

#[cfg(feature = "gpu")]
pub use on_gpu::GpuHistogram;

#[cfg(feature = "gpu")]
mod on_gpu {
    use std::sync::Arc;

    use crate::Result;
    use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
    use crate::parallel::tile::{MAX_LEN, ParameterCache, WORKGROUP, check_capacity, check_holds, check_len};

    /// Most bins that a workgroup counts in its own memory, 8 KiB.
    const FEW_BINS: usize = 2048;
    /// Workgroups of a count; each adds its counters to the result once.
    const MAX_PARTS: usize = 1024;
    /// Values of an invocation below which a part is not worth a workgroup.
    const ITEMS: usize = 16;

    /// A plan for histograms of device arrays of up to 2³¹ values.
    #[derive(Debug)]
    pub struct GpuHistogram {
        parameters: ParameterCache,
        n_bins: usize,
        clear: Arc<Pipeline>,
        count: Arc<Pipeline>,
    }

    impl GpuHistogram {
        /// A plan for counting the values below `n_bins`; no scratch memory.
        ///
        /// # Errors
        /// `TooMany` beyond 2³¹ bins, `KernelRejected`.
        pub fn new(gpu: &Gpu, n_bins: usize) -> Result<Self> {
            check_capacity("bins", n_bins)?;
            let bindings = [Access::Uniform, Access::ReadWrite, Access::Read];
            let pipeline = |entry, n_bindings: usize| {
                gpu.prepare(&Kernel {
                    features: &[("few_bins", n_bins <= FEW_BINS)],
                    ..Kernel::new("package::parallel::histogram", entry, &bindings[..n_bindings], WORKGROUP)
                })
            };
            Ok(Self {
                parameters: ParameterCache::new(gpu),
                n_bins,
                clear: pipeline("clear_counts", 2)?,
                count: pipeline("count_values", 3)?,
            })
        }

        /// Records how often each value below the number of bins occurs among the first `len` values into `counts`
        /// `[n_bins + 1]`; the last entry counts the other values.
        ///
        /// # Errors
        /// `TooMany` beyond 2³¹ values, `LengthMismatch` if a buffer is shorter, `OutOfDeviceMemory`.
        pub fn record(
            &self,
            commands: &mut Commands,
            input: &Buffer<u32>,
            counts: &Buffer<u32>,
            len: usize,
        ) -> Result<()> {
            check_len("values to count", len, MAX_LEN)?;
            check_holds(input, len)?;
            check_holds(counts, self.n_bins + 1)?;
            let n_parts = len.div_ceil(WORKGROUP as usize * ITEMS).min(MAX_PARTS);
            let parameters = self.parameters.uniform([len as u32, self.n_bins as u32, n_parts as u32, 0])?;
            let bindings = [(&parameters).into(), counts.into(), input.into()];
            commands.dispatch(&self.clear, &bindings[..2], Workgroups::Covering(self.n_bins as u64 + 1));
            commands.dispatch(&self.count, &bindings, Workgroups::Count(n_parts as u32));
            Ok(())
        }
    }
}
