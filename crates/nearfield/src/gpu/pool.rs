//! Buffers that are not used any more, kept for the next ones of about their size: making and clearing device memory
//! takes longer than many kernels.

use std::sync::{Mutex, MutexGuard, PoisonError};

use wgpu::BufferUsages;

/// Bytes kept at most.
const MOST_BYTES: u64 = 4 << 30;

/// A kept buffer serves if it is at most a quarter larger than needed, or one page.
fn serves(kept: u64, needed: u64) -> bool {
    kept >= needed && kept - needed <= (needed / 4).max(4096)
}

/// Kept buffers.
#[derive(Debug, Default)]
pub(super) struct Pool {
    kept: Mutex<Vec<Kept>>,
}

#[derive(Debug)]
struct Kept {
    usage: BufferUsages,
    buffer: wgpu::Buffer,
}

impl Pool {
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

    /// Bytes kept.
    pub(super) fn bytes(&self) -> u64 {
        self.kept().iter().map(|k| k.buffer.size()).sum()
    }

    /// Gives all kept memory back to the device.
    pub(super) fn clear(&self) {
        self.kept().clear();
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
