//! Array primitives, on the CPU and on the GPU.
pub mod radix_sort;
pub mod reduce;
