//! Plumbing to any GPU that wgpu reaches: adapters, buffers, pipelines made from WESL, command recording with stage
//! times, and read-back. Knows nothing of geometry.
//!
//! Everything that can fail returns an [`crate::Error`]; validation, out-of-memory and device-lost messages of the
//! driver never panic.

mod adapter;
mod buffer;
mod commands;
mod context;
mod copies;
mod encode;
pub(crate) mod host_memory;
mod kernel;
mod pipeline;
mod pipeline_cache;
mod pool;
mod read_back;
pub mod shader;
mod staging;
mod transfer;

pub use adapter::{Adapter, AdapterKind, DeviceChoice, adapters};
pub use buffer::{Buffer, DeviceElement};
pub use commands::{Bind, Commands, Recorded, StageTime, Workgroups};
#[doc(hidden)]
pub use context::SOFTWARE_LOOP_ROUNDS;
pub use context::{Gpu, GpuLimits};
pub use kernel::{Access, Kernel};
pub use pipeline::Pipeline;
pub use read_back::ReadBack;
pub use wgpu;
