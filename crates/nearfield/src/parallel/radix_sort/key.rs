//! What can be sorted by.

use bytemuck::Pod;

use super::cpu::CpuKey;

/// A key of the radix sort: `u32` or `u64`.
///
/// On the device a `u64` is two words, the low one first: 64-bit integers are not needed.
#[allow(private_bounds, reason = "sealed: the kernels know these two")]
pub trait SortKey: Pod + Ord + Send + Sync + CpuKey {
    /// Bits of a key.
    const BITS: u32;
}

impl SortKey for u32 {
    const BITS: u32 = u32::BITS;
}

impl SortKey for u64 {
    const BITS: u32 = u64::BITS;
}
