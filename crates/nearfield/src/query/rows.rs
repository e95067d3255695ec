//! Rows of neighbours on their way to an answer: order and cap within a row, and the memory that rows may take.

use super::{FixedRadius, RowOrder};
use crate::geometry::row_simd::Hits;
use crate::{Error, Result, host_memory};

/// What a list is called in errors.
pub(super) const LIST: &str = "the list of neighbours";

/// Makes rows out of hits, one after the other.
#[derive(Debug, Default)]
pub(super) struct RowMaker {
    keys: Vec<u64>,
}

impl RowMaker {
    /// Caps and orders the neighbours of a query.
    #[inline]
    pub(super) fn make_row<const DIST2: bool>(&mut self, hits: &mut Hits, question: &FixedRadius<'_>) {
        let found = hits.ids.len();
        let kept = question.max_neighbors.map_or(found, |cap| found.min(cap as usize));
        if DIST2 && (kept < found || question.order != RowOrder::Unspecified) {
            self.order_row(hits, kept, question.order);
        } else if question.order == RowOrder::Index {
            hits.ids.sort_unstable();
        }
    }

    /// Keeps the nearest `kept` hits, and orders them.
    fn order_row(&mut self, hits: &mut Hits, kept: usize, order: RowOrder) {
        // Squared distances are not negative, so their bits order like numbers; ties fall to the lower index.
        self.keys.clear();
        self.keys.extend(hits.iter().map(|(id, d2)| u64::from(d2.to_bits()) << 32 | u64::from(id)));
        if kept < self.keys.len() {
            if kept > 0 {
                self.keys.select_nth_unstable(kept - 1);
            }
            self.keys.truncate(kept);
        }
        match order {
            RowOrder::Index => self.keys.sort_unstable_by_key(|&key| key as u32),
            RowOrder::Distance | RowOrder::Unspecified => self.keys.sort_unstable(),
        }
        hits.clear();
        hits.ids.extend(self.keys.iter().map(|&key| key as u32));
        hits.dist2.extend(self.keys.iter().map(|&key| f32::from_bits((key >> 32) as u32)));
    }
}

/// Bytes that a list may take: by the caller's limit, and by what the host has left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Room {
    /// Bytes of an entry.
    entry: u64,
    offsets: u64,
    /// Bytes of all entries.
    by_caller: u64,
    /// Bytes of all entries, and of what stands beside them.
    by_host: u64,
}

impl Room {
    /// For the answer to a question about so many points.
    pub(super) fn of(question: &FixedRadius<'_>, n_points: usize) -> Self {
        let offsets = 8 * (question.len(n_points) as u64 + 1);
        Self {
            entry: if question.distances { 8 } else { 4 },
            offsets,
            by_caller: question.max_bytes.map_or(u64::MAX, |limit| limit.saturating_sub(offsets)),
            by_host: available_memory().saturating_sub(offsets),
        }
    }

    /// Bytes of so many entries.
    pub(super) fn bytes(&self, entries: u64) -> u64 {
        entries.saturating_mul(self.entry)
    }

    /// Whether so many entries fit, with so many bytes of other things beside them.
    pub(super) fn fits(&self, entries: u64, beside: u64) -> bool {
        let bytes = self.bytes(entries);
        bytes <= self.by_caller && bytes.saturating_add(beside) <= self.by_host
    }

    /// The error for so many entries that do not fit.
    pub(super) fn too_large(&self, entries: u64, beside: u64) -> Error {
        let available = self.by_caller.min(self.by_host.saturating_sub(beside));
        Error::OutOfMemory {
            what: LIST,
            needed: self.bytes(entries).saturating_add(self.offsets),
            available: available.saturating_add(self.offsets),
        }
    }
}

/// Bytes of memory the host has left; no limit where that is not known.
pub(crate) fn available_memory() -> u64 {
    let known = || {
        let info = std::fs::read_to_string("/proc/meminfo").ok()?;
        let line = info.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
        let kilobytes: u64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
        // A tenth is left to the rest of the machine.
        Some(kilobytes * 1024 / 10 * 9)
    };
    known().unwrap_or(u64::MAX)
}

/// Zeros that the machine's memory is only touched for where they are written first.
pub(super) fn zeroed<T: bytemuck::Zeroable>(len: usize) -> Result<Vec<T>> {
    host_memory::zeroed(LIST, len).map_err(|_| no_memory::<T>(len))
}

/// The error where there is no memory for so many values.
pub(super) fn no_memory<T>(len: usize) -> Error {
    Error::OutOfMemory { what: LIST, needed: (len * size_of::<T>()) as u64, available: available_memory() }
}
