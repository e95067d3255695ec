//! Array primitives on the CPU and on the GPU: scan, reduce, histogram, compaction and sorting.
//!
//! The CPU functions use all threads of the current rayon pool. The GPU types are plans: made once for a largest
//! length, they hold their scratch memory and pipelines and record their dispatches into `gpu::Commands`
//! without waiting, so that whole builds are one submission. A plan may be recorded any number of times, but its
//! scratch memory is shared: recordings take effect in the order in which they are submitted.
//!
//! GPU scans and sorts are of the reduce-then-scan kind: no workgroup ever waits for another, so they are right on any
//! device (a waiting workgroup need not make progress on software and mobile devices). An element is read twice. On
//! discrete cards of NVIDIA and AMD a sort reads it once: workgroups wait for earlier ones, for a limited time.
//! Lengths go from 0 to 2³¹.

pub mod compact;
pub mod histogram;
pub mod radix_sort;
pub mod reduce;
pub(crate) mod rows_to_fill;
pub mod scan;
#[cfg(feature = "gpu")]
pub(crate) mod tile;

/// Length of chunks that give every thread of the pool about two, but at least `smallest`.
pub(crate) fn chunk_len(len: usize, smallest: usize) -> usize {
    len.div_ceil(2 * rayon::current_num_threads()).max(smallest).max(1)
}
