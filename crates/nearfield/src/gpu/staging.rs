//! Staging memory: what both the host and the device can reach, mapped by the host while it copies and unmapped while the device does.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Instant;

use wgpu::{BufferUsages, BufferView, BufferViewMut, MapMode, SubmissionIndex};

use super::Gpu;
use super::context::WAIT_LIMIT;
use crate::{Error, Result};

/// Bytes of the smallest piece of staging memory.
const SMALLEST_BYTES: u64 = 256;

/// Which way data go through staging memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// From the host to the device.
    In,
    /// From the device to the host.
    Out,
}

impl Way {
    fn usage(self) -> BufferUsages {
        match self {
            Self::In => BufferUsages::MAP_WRITE | BufferUsages::COPY_SRC,
            Self::Out => BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        }
    }

    fn mode(self) -> MapMode {
        match self {
            Self::In => MapMode::Write,
            Self::Out => MapMode::Read,
        }
    }
}

/// States of a mapping that was asked for.
const PENDING: u8 = 0;
const MAPPED: u8 = 1;
const REFUSED: u8 = 2;

/// A piece of staging memory. It counts as used memory of the context for as long as it lives, and is kept for the next piece of its size
/// afterwards, unless something went wrong with it.
#[derive(Debug)]
pub(super) struct Staging {
    gpu: Gpu,
    raw: wgpu::Buffer,
    way: Way,
    /// The last submission that uses it.
    last_use: Option<SubmissionIndex>,
    mapping: Arc<AtomicU8>,
    /// Whether it is unmapped and sound.
    can_be_kept: bool,
}

impl Staging {
    /// A piece of at least so many bytes, rounded up to a power of two.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub(super) fn new(gpu: &Gpu, way: Way, bytes: u64) -> Result<Self> {
        let size = bytes.next_power_of_two().max(SMALLEST_BYTES);
        let (label, usage) = match way {
            Way::In => ("upload staging", way.usage()),
            Way::Out => ("read-back staging", way.usage()),
        };
        gpu.reserve(label, size)?;
        let made = match gpu.inner.pool.take_staging(size, usage) {
            Some(kept) => Ok(kept),
            None => gpu.create_buffer(label, size, usage).map(|raw| (raw, None)),
        };
        match made {
            Ok((raw, last_use)) => {
                Ok(Self { gpu: gpu.clone(), raw, way, last_use, mapping: Arc::default(), can_be_kept: true })
            }
            Err(error) => {
                gpu.release(size);
                Err(error)
            }
        }
    }

    /// The buffer.
    pub(super) fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    /// Bytes.
    pub(super) fn size(&self) -> usize {
        self.raw.size() as usize
    }

    /// Says which submission uses it: mapping waits for that.
    pub(super) fn used_by(&mut self, submission: &SubmissionIndex) {
        self.last_use = Some(submission.clone());
    }

    /// Asks for a mapping of the first `bytes`, to be had once the device is done with it. Driver's errors go to the error scope.
    pub(super) fn ask_to_map(&mut self, bytes: u64) {
        self.can_be_kept = false;
        self.mapping = Arc::new(AtomicU8::new(PENDING));
        let mapping = Arc::clone(&self.mapping);
        self.raw.map_async(self.way.mode(), ..bytes, move |result| {
            mapping.store(if result.is_ok() { MAPPED } else { REFUSED }, Ordering::Release);
        });
    }

    /// Waits until the mapping is there.
    ///
    /// # Errors
    /// `DeviceLost`; `Device` where the driver refuses it or the work before takes longer than ten minutes.
    pub(super) fn wait_until_mapped(&mut self, operation: &str) -> Result<()> {
        if let Some(submission) = self.last_use.take() {
            self.gpu.wait(operation, submission)?;
        }
        let start = Instant::now();
        loop {
            match self.mapping.load(Ordering::Acquire) {
                MAPPED => return Ok(()),
                PENDING if start.elapsed() < WAIT_LIMIT => {
                    // Memory that no submission uses is mapped by the next poll; another thread's may be at it.
                    let _ = self.gpu.device().poll(wgpu::PollType::Poll);
                    std::thread::yield_now();
                }
                _ => {
                    self.gpu.check_lost()?;
                    let message = "staging memory cannot be mapped".to_owned();
                    return Err(Error::Device { operation: operation.to_owned(), message });
                }
            }
            self.gpu.check_lost()?;
        }
    }

    /// What the device wrote into the first `bytes`, which must be mapped.
    ///
    /// # Errors
    /// `Device` where they are not.
    pub(super) fn view(&self, operation: &str, bytes: u64) -> Result<BufferView> {
        self.raw.get_mapped_range(..bytes).map_err(|e| not_mapped(operation, &e))
    }

    /// Where to write the first `bytes`, which must be mapped.
    ///
    /// # Errors
    /// `Device` where they are not.
    pub(super) fn view_mut(&self, operation: &str, bytes: u64) -> Result<BufferViewMut> {
        self.raw.get_mapped_range_mut(..bytes).map_err(|e| not_mapped(operation, &e))
    }

    /// Hands the memory to the device again, if it is mapped or about to be. There must be no view of it.
    pub(super) fn unmap(&mut self) {
        if !self.can_be_kept {
            // Taken back while another thread's poll is about to map it, it would stay mapped.
            let is_settled = self.wait_until_mapped("staging memory").is_ok();
            self.raw.unmap();
            self.can_be_kept = is_settled;
        }
    }
}

fn not_mapped(operation: &str, error: &wgpu::MapRangeError) -> Error {
    Error::Device { operation: operation.to_owned(), message: error.to_string() }
}

impl Drop for Staging {
    fn drop(&mut self) {
        self.gpu.release(self.raw.size());
        if self.can_be_kept {
            self.gpu.inner.pool.keep_staging(self.raw.clone(), self.way.usage(), self.last_use.take());
        }
    }
}
