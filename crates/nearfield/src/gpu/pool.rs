//! Buffers that are not used any more, kept for the next ones of about their size: making and clearing device memory
//! takes longer than many kernels, and the first touch of staging memory longer than a copy through it.

use std::sync::{Mutex, MutexGuard, PoisonError};

use wgpu::{BufferUsages, SubmissionIndex};

/// Bytes kept at most, without staging memory.
const MOST_BYTES: u64 = 4 << 30;
/// Bytes of staging memory kept at most: what a read and a write of any length take, and some small ones.
const MOST_STAGING_BYTES: u64 = 96 << 20;

/// A kept buffer serves if it is at most a quarter larger than needed, or one page.
fn serves(kept: u64, needed: u64) -> bool {
    kept >= needed && kept - needed <= (needed / 4).max(4096)
}

/// Kept buffers.
#[derive(Debug, Default)]
pub(super) struct Pool {
    kept: Mutex<Vec<Kept>>,
    staging: Mutex<Vec<KeptStaging>>,
}

#[derive(Debug)]
struct Kept {
    usage: BufferUsages,
    buffer: wgpu::Buffer,
}

/// Staging memory, not mapped.
#[derive(Debug)]
struct KeptStaging {
    usage: BufferUsages,
    buffer: wgpu::Buffer,
    /// The last submission that uses it, which may still run.
    last_use: Option<SubmissionIndex>,
}

impl Pool {
    fn staging(&self) -> MutexGuard<'_, Vec<KeptStaging>> {
        self.staging.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn kept(&self) -> MutexGuard<'_, Vec<Kept>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A kept buffer of exactly these usages and about this size, the one kept last.
    pub(super) fn take(&self, size: u64, usage: BufferUsages) -> Option<wgpu::Buffer> {
        let mut kept = self.kept();
        let position = kept.iter().rposition(|k| k.usage == usage && serves(k.buffer.size(), size))?;
        Some(kept.remove(position).buffer)
    }

    /// Keeps a buffer that nothing refers to any more; the oldest ones make way.
    pub(super) fn keep(&self, buffer: wgpu::Buffer, usage: BufferUsages) {
        let mut kept = self.kept();
        kept.push(Kept { usage, buffer });
        let mut bytes: u64 = kept.iter().map(|k| k.buffer.size()).sum();
        let mut leaving = 0;
        while bytes > MOST_BYTES && leaving < kept.len() {
            bytes -= kept[leaving].buffer.size();
            leaving += 1;
        }
        kept.drain(..leaving);
    }

    /// Kept staging memory of exactly these usages and this size, with the last submission that uses it: of those kept, the one that
    /// was used first.
    pub(super) fn take_staging(
        &self,
        size: u64,
        usage: BufferUsages,
    ) -> Option<(wgpu::Buffer, Option<SubmissionIndex>)> {
        let mut staging = self.staging();
        let position = staging.iter().position(|k| k.usage == usage && k.buffer.size() == size)?;
        let KeptStaging { buffer, last_use, .. } = staging.remove(position);
        Some((buffer, last_use))
    }

    /// Keeps staging memory that is not mapped; the oldest makes way.
    pub(super) fn keep_staging(&self, buffer: wgpu::Buffer, usage: BufferUsages, last_use: Option<SubmissionIndex>) {
        if buffer.size() > MOST_STAGING_BYTES {
            return;
        }
        let mut staging = self.staging();
        staging.push(KeptStaging { usage, buffer, last_use });
        let mut bytes: u64 = staging.iter().map(|k| k.buffer.size()).sum();
        while bytes > MOST_STAGING_BYTES {
            bytes -= staging.remove(0).buffer.size();
        }
    }

    /// Bytes kept.
    pub(super) fn bytes(&self) -> u64 {
        let staging: u64 = self.staging().iter().map(|k| k.buffer.size()).sum();
        staging + self.kept().iter().map(|k| k.buffer.size()).sum::<u64>()
    }

    /// Gives all kept memory back to the device.
    pub(super) fn clear(&self) {
        self.kept().clear();
        self.staging().clear();
    }
}

#[cfg(test)]
mod tests {
    use super::serves;

    #[test]
    fn a_kept_buffer_is_large_enough_and_not_much_larger() {
        assert!(serves(1000, 1000) && serves(5096, 1000) && serves(1_250_000, 1_000_000));
        assert!(!serves(999, 1000) && !serves(5097, 1000) && !serves(1_250_001, 1_000_000));
    }
}
