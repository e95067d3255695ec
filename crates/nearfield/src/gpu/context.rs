//! The open device: features and limits read once, memory accounting, waiting, and the lost flag.

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use super::pipeline::Pipeline;
use super::pipeline_cache::{self, DiskCache};
use super::pool::Pool;
use super::{Adapter, AdapterKind, DeviceChoice};
use crate::{Error, Result};

/// How long one submission may take before the device counts as hanging.
pub(super) const WAIT_LIMIT: Duration = Duration::from_secs(600);
/// How long a hardware GPU is asked again and again whether it is done, before the thread goes to sleep: waking up takes some 30 µs.
const SPIN: Duration = Duration::from_micros(200);

/// An open GPU. Cheap to clone; clones share the device.
#[derive(Clone)]
pub struct Gpu {
    pub(super) inner: Arc<Inner>,
}

pub(super) struct Inner {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) pipelines: Mutex<HashMap<String, Arc<Pipeline>>>,
    disk_cache: OnceLock<DiskCache>,
    pub(super) memory: Memory,
    pub(super) pool: Pool,
    name: String,
    kind: AdapterKind,
    limits: GpuLimits,
    lost: Arc<OnceLock<String>>,
}

/// What the device can do, as far as kernels depend on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpuLimits {
    /// Largest storage binding in bytes.
    pub binding_bytes: u64,
    /// Largest buffer in bytes.
    pub buffer_bytes: u64,
    /// Largest workgroup.
    pub workgroup_invocations: u32,
    /// Workgroup memory in bytes.
    pub workgroup_bytes: u32,
    /// Workgroups in one dimension of a dispatch.
    pub workgroups: u32,
    /// Smallest and largest subgroup, where subgroup operations can be used.
    pub subgroup: Option<(u32, u32)>,
    /// Whether workgroups that have started are known to go on while others wait for them.
    pub workgroups_progress: bool,
    /// Nanoseconds a timestamp tick, where stages can be timed on the device.
    pub timestamp_period: Option<f32>,
    /// Rounds that all loops of an invocation may take together, where the device ends them after a number: llvmpipe
    /// does after 65,535, silently, and other software renderers may.
    pub loop_rounds: Option<u32>,
}

/// PCI numbers of NVIDIA and AMD: their cards never take a workgroup off that has started.
const PROGRESSING_VENDORS: [u32; 2] = [0x10de, 0x1002];
/// Loop rounds that count as safe on software renderers.
pub const SOFTWARE_LOOP_ROUNDS: u32 = 60_000;

/// Bytes allocated and allowed.
#[derive(Default)]
pub(super) struct Memory {
    used: AtomicU64,
    peak: AtomicU64,
    limit: AtomicU64,
    /// Allocations until one is refused; negative for never.
    refuse_in: AtomicI64,
}

impl Gpu {
    /// Opens the GPU that `choice` means; `None` where that is the CPU.
    ///
    /// # Errors
    /// `NoDevice` where a GPU was asked for and none fits, or it cannot be opened.
    pub fn open(choice: &DeviceChoice) -> Result<Option<Self>> {
        choice.resolve()?.as_ref().map(Self::open_adapter).transpose()
    }

    /// Opens an adapter.
    ///
    /// Compiled pipelines are kept in a file of the user's cache folder, below `nearfield`, where the driver allows it; the environment variable
    /// `NEARFIELD_PIPELINE_CACHE` names another folder, or is `off`.
    ///
    /// # Errors
    /// `NoDevice` where the driver refuses to open it.
    pub fn open_adapter(adapter: &Adapter) -> Result<Self> {
        Self::open_adapter_with_cache(adapter, pipeline_cache::folder().as_deref())
    }

    /// Opens an adapter with its compiled pipelines kept in a file of this folder, or nowhere. A folder or file that cannot be used is as good as
    /// none. Nobody else should be able to write to the folder: drivers trust what stands there.
    ///
    /// # Errors
    /// As [`Gpu::open_adapter`].
    pub fn open_adapter_with_cache(adapter: &Adapter, folder: Option<&Path>) -> Result<Self> {
        let handle = &adapter.handle;
        let mut wanted = wgpu::Features::SUBGROUP | wgpu::Features::TIMESTAMP_QUERY;
        wanted.set(wgpu::Features::PIPELINE_CACHE, folder.is_some());
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("nearfield"),
            required_features: handle.features() & wanted,
            required_limits: handle.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(handle.request_device(&descriptor)).map_err(|e| Error::NoDevice {
            asked: adapter.name.clone(),
            found: vec![format!("{} (cannot be opened: {e})", adapter.name)],
        })?;
        // Only on a device of our own: a caller's handlers are never replaced.
        device.on_uncaptured_error(Arc::new(|error| eprintln!("nearfield: uncaptured device error: {error}")));
        let gpu = Self::assemble(device, queue, adapter.name.clone(), adapter.kind);
        let lost = Arc::clone(&gpu.inner.lost);
        gpu.inner.device.set_device_lost_callback(move |reason, message| {
            let _ = lost.set(format!("{reason:?}: {message}"));
        });
        if let Some(folder) = folder {
            match gpu.checked("pipeline cache", 0, || DiskCache::open(gpu.device(), folder)) {
                Ok(Some(cache)) => drop(gpu.inner.disk_cache.set(cache)),
                Ok(None) => {}
                Err(error) => log::debug!("there is no pipeline cache: {error}"),
            }
        }
        Ok(gpu)
    }

    /// Works on the caller's own device and queue.
    ///
    /// Timestamps and subgroup operations are used where the device was opened with them. The caller's error and
    /// lost handlers stay in place; tell this context of a loss with [`Gpu::mark_lost`].
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let info = device.adapter_info();
        let kind = match info.device_type {
            wgpu::DeviceType::Cpu => AdapterKind::Software,
            wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
            wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
            wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
            wgpu::DeviceType::Other => AdapterKind::Other,
        };
        Self::assemble(device, queue, info.name, kind)
    }

    fn assemble(device: wgpu::Device, queue: wgpu::Queue, name: String, kind: AdapterKind) -> Self {
        let (limits, features, info) = (device.limits(), device.features(), device.adapter_info());
        let limits = GpuLimits {
            binding_bytes: limits.max_storage_buffer_binding_size,
            buffer_bytes: limits.max_buffer_size,
            workgroup_invocations: limits.max_compute_invocations_per_workgroup,
            workgroup_bytes: limits.max_compute_workgroup_storage_size,
            workgroups: limits.max_compute_workgroups_per_dimension,
            subgroup: features
                .contains(wgpu::Features::SUBGROUP)
                .then_some((info.subgroup_min_size, info.subgroup_max_size)),
            workgroups_progress: kind == AdapterKind::Discrete && PROGRESSING_VENDORS.contains(&info.vendor),
            timestamp_period: features.contains(wgpu::Features::TIMESTAMP_QUERY).then(|| queue.get_timestamp_period()),
            loop_rounds: (kind == AdapterKind::Software).then_some(SOFTWARE_LOOP_ROUNDS),
        };
        let memory = Memory { refuse_in: AtomicI64::new(-1), limit: AtomicU64::new(u64::MAX), ..Memory::default() };
        let (pipelines, lost) = (Mutex::default(), Arc::new(OnceLock::new()));
        Self {
            inner: Arc::new(Inner {
                device,
                queue,
                pipelines,
                disk_cache: OnceLock::new(),
                memory,
                pool: Pool::default(),
                name,
                kind,
                limits,
                lost,
            }),
        }
    }

    /// Name of the adapter.
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// What the adapter is.
    pub fn kind(&self) -> AdapterKind {
        self.inner.kind
    }

    /// Limits and features that kernels depend on.
    pub fn limits(&self) -> &GpuLimits {
        &self.inner.limits
    }

    /// The wgpu device.
    pub fn device(&self) -> &wgpu::Device {
        &self.inner.device
    }

    /// The wgpu queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.inner.queue
    }

    /// Limits the device memory that buffers of this context may take together.
    pub fn set_memory_limit(&self, bytes: u64) {
        self.inner.memory.limit.store(bytes, Ordering::Relaxed);
    }

    /// Bytes in buffers of this context now.
    pub fn memory_used(&self) -> u64 {
        self.inner.memory.used.load(Ordering::Relaxed)
    }

    /// Bytes that buffers of this context may still take together, as far as its limit says; the device may have less.
    pub fn memory_available(&self) -> u64 {
        self.inner.memory.limit.load(Ordering::Relaxed).saturating_sub(self.memory_used())
    }

    /// Largest number of bytes that buffers of this context held at once since the last call.
    pub fn take_memory_peak(&self) -> u64 {
        self.inner.memory.peak.swap(self.memory_used(), Ordering::Relaxed)
    }

    /// Makes the `n`-th allocation from now (0 is the next) fail as if the device were full, once. For tests: software
    /// adapters never report a full device by themselves. Returns whether the refusal asked for before is still to come.
    #[doc(hidden)]
    pub fn refuse_allocation(&self, n: Option<u32>) -> bool {
        self.inner.memory.refuse_in.swap(n.map_or(-1, i64::from), Ordering::Relaxed) >= 0
    }

    /// Marks the device as lost: every later wait returns `DeviceLost`.
    pub fn mark_lost(&self, reason: &str) {
        let _ = self.inner.lost.set(reason.to_owned());
    }

    /// Accounts for an allocation, or refuses it.
    pub(super) fn reserve(&self, what: &str, bytes: u64) -> Result<()> {
        let memory = &self.inner.memory;
        let limit = memory.limit.load(Ordering::Relaxed);
        // Counts down to the refused allocation and stops below it.
        let countdown = |n: i64| (n >= 0).then(|| n - 1);
        let refused = memory.refuse_in.fetch_update(Ordering::Relaxed, Ordering::Relaxed, countdown) == Ok(0);
        let available = |used: u64| limit.saturating_sub(used).min(self.inner.limits.buffer_bytes);
        let add = |used: u64| (!refused && bytes <= available(used)).then(|| used + bytes);
        match memory.used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add) {
            Ok(before) => {
                memory.peak.fetch_max(before + bytes, Ordering::Relaxed);
                // Kept buffers count against the limit too, but are the first to go.
                if before + bytes > limit.saturating_sub(self.inner.pool.bytes()) {
                    self.inner.pool.clear();
                }
                Ok(())
            }
            Err(used) => {
                let available = if refused { 0 } else { available(used) };
                Err(Error::OutOfDeviceMemory { what: what.to_owned(), needed: bytes, available })
            }
        }
    }

    pub(super) fn release(&self, bytes: u64) {
        self.inner.memory.used.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Runs `work` with the driver's errors caught; they come back as values.
    pub(super) fn checked<T>(&self, operation: &str, needed: u64, work: impl FnOnce() -> T) -> Result<T> {
        use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
        let device = &self.inner.device;
        let scopes = [Validation, Internal, OutOfMemory].map(|filter| device.push_error_scope(filter));
        let value = work();
        // Scopes are popped in reverse order of pushing; the first error found is the one told.
        let mut error = None;
        for scope in scopes.into_iter().rev() {
            let popped = pollster::block_on(scope.pop());
            error = error.or(popped);
        }
        if error.is_some() {
            // A lost device first shows as objects that are not valid; its callback comes with a poll.
            let _ = device.poll(wgpu::PollType::Poll);
        }
        self.check_lost()?;
        match error {
            None => Ok(value),
            Some(wgpu::Error::OutOfMemory { .. }) => {
                Err(Error::OutOfDeviceMemory { what: operation.to_owned(), needed, available: 0 })
            }
            Some(other) => Err(Error::Device { operation: operation.to_owned(), message: other.to_string() }),
        }
    }

    /// The one place that waits: until `submission` is done.
    ///
    /// # Errors
    /// `DeviceLost`; `Device` where the submission takes longer than ten minutes.
    pub(super) fn wait(&self, operation: &str, submission: wgpu::SubmissionIndex) -> Result<()> {
        let device = &self.inner.device;
        // A software renderer needs the core for itself. Polls ask about the queue and not about the submission: with a time limit, wgpu takes what another
        // thread has cleared away meanwhile for a fault of its own.
        let spin = if self.inner.kind == AdapterKind::Software { Duration::ZERO } else { SPIN };
        let start = Instant::now();
        let mut outcome = None;
        while outcome.is_none() && start.elapsed() < spin {
            outcome = device.poll(wgpu::PollType::Poll).ok().filter(wgpu::PollStatus::is_queue_empty).map(Ok);
        }
        let outcome = outcome.unwrap_or_else(|| {
            device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(WAIT_LIMIT) })
        });
        if outcome.is_err() {
            // The news of a loss come with a poll.
            let _ = device.poll(wgpu::PollType::Poll);
        }
        self.check_lost()?;
        if let Some(cache) = self.disk_cache() {
            cache.save_if_quiet();
        }
        outcome
            .map(drop)
            .map_err(|e| Error::Device { operation: operation.to_owned(), message: format!("waiting failed: {e}") })
    }

    pub(super) fn check_lost(&self) -> Result<()> {
        match self.inner.lost.get() {
            None => Ok(()),
            Some(reason) => Err(Error::DeviceLost { device: self.inner.name.clone(), reason: reason.clone() }),
        }
    }

    pub(super) fn disk_cache(&self) -> Option<&DiskCache> {
        self.inner.disk_cache.get()
    }

    pub(super) fn pipelines(&self) -> MutexGuard<'_, HashMap<String, Arc<Pipeline>>> {
        self.inner.pipelines.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gpu").field("name", &self.inner.name).field("limits", &self.inner.limits).finish()
    }
}
