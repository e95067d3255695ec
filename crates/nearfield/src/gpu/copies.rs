//! Data of the host into buffers, and back: slices, elements made one by one, whole buffers and ranges, memory used again.

use std::ops::Range;

use rayon::prelude::*;

use super::buffer::WORD;
use super::transfer::copy_in_blocks;
use super::{Buffer, DeviceElement, Gpu};
use crate::{Error, Result, host_memory};

/// Bytes of elements that are made at a time, in the cache of one core.
const MADE_BYTES: usize = 4096;
/// Elements that one thread turns at a time.
const TURNED: usize = 1 << 14;

impl Gpu {
    /// A buffer with a copy of `data`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn upload<T: DeviceElement>(&self, label: &'static str, data: &[T]) -> Result<Buffer<T>> {
        let buffer = self.buffer(label, data.len())?;
        self.write(&buffer, 0, data)?;
        Ok(buffer)
    }

    /// A buffer of `len` elements, made by many threads at once where the device can reach them: `make(i)` is element i.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn upload_with<T: DeviceElement + Send>(
        &self,
        label: &'static str,
        len: usize,
        make: impl Fn(usize) -> T + Sync,
    ) -> Result<Buffer<T>> {
        let buffer = self.buffer(label, len)?;
        self.write_with(&buffer, make)?;
        Ok(buffer)
    }

    /// Writes all elements of `buffer`, made by many threads at once where the device can reach them: `make(i)` is element i.
    ///
    /// # Errors
    /// As [`Gpu::write`].
    pub fn write_with<T: DeviceElement + Send>(
        &self,
        buffer: &Buffer<T>,
        make: impl Fn(usize) -> T + Sync,
    ) -> Result<()> {
        let size = size_of::<T>();
        // Blocks of bytes hold whole elements then.
        if size == 0 || !size.is_multiple_of(WORD) || !MADE_BYTES.is_multiple_of(size) {
            let made: Vec<T> = (0..buffer.len()).into_par_iter().with_min_len(1 << 12).map(&make).collect();
            return self.write(buffer, 0, &made);
        }
        self.check_lost()?;
        buffer.check_context(self)?;
        self.write_chunks(buffer.label(), (buffer.raw(), 0), buffer.bytes() as usize, &|first, mut to| {
            let mut block = vec![T::zeroed(); MADE_BYTES / size];
            for start in (0..to.len()).step_by(MADE_BYTES) {
                let bytes = MADE_BYTES.min(to.len() - start);
                let elements = &mut block[..bytes / size];
                for (i, element) in elements.iter_mut().enumerate() {
                    *element = make((first + start) / size + i);
                }
                to.slice(start..start + bytes).copy_from_slice(bytemuck::cast_slice(elements));
            }
        })
    }

    /// Copies `data` into `buffer` from element `start` on.
    ///
    /// Devices write whole words of 4 bytes: with smaller elements, the first byte must be one of a word, and so must
    /// the last but at the end of the buffer. Much data is copied by many threads through staging memory that the context keeps; where all of that is in
    /// use, this waits until the device is done with some.
    ///
    /// # Errors
    /// `LengthMismatch` if it does not fit; `Unsupported` for parts of words; `Device` for a buffer of another context;
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn write<T: DeviceElement>(&self, buffer: &Buffer<T>, start: usize, data: &[T]) -> Result<()> {
        let end = start.saturating_add(data.len());
        check_range(buffer, &(start..end))?;
        self.check_lost()?;
        buffer.check_context(self)?;
        if data.is_empty() {
            return Ok(());
        }
        let (offset, bytes) = ((start * size_of::<T>()) as u64, bytemuck::cast_slice::<T, u8>(data));
        let (words, rest) = bytes.split_at(bytes.len() / WORD * WORD);
        let padded = offset + bytes.len().next_multiple_of(WORD) as u64;
        let padding_is_free = end == buffer.len() && padded <= buffer.raw().size();
        if !offset.is_multiple_of(WORD as u64) || !(rest.is_empty() || padding_is_free) {
            return Err(Error::Unsupported {
                what: format!("writing {} bytes at byte {offset} of {}", bytes.len(), buffer.label()),
                advice: "write whole words of 4 bytes",
            });
        }
        self.write_chunks(buffer.label(), (buffer.raw(), offset), words.len(), &|first, mut to| {
            let len = to.len();
            to.copy_from_slice(&words[first..first + len]);
        })?;
        if rest.is_empty() {
            return Ok(());
        }
        let mut last = [0; WORD];
        last[..rest.len()].copy_from_slice(rest);
        self.checked(buffer.label(), WORD as u64, || {
            self.queue().write_buffer(buffer.raw(), offset + words.len() as u64, &last);
        })
    }

    /// Reads the whole buffer back, after everything submitted before.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `DeviceLost`.
    pub fn read<T: DeviceElement>(&self, buffer: &Buffer<T>) -> Result<Vec<T>> {
        self.read_range(buffer, 0..buffer.len())
    }

    /// Reads elements `range` of the buffer back, in smaller parts where staging memory is short.
    ///
    /// # Errors
    /// `LengthMismatch` if the range passes the end; `Device` for a buffer of another context; `OutOfDeviceMemory` for
    /// the staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read_range<T: DeviceElement>(&self, buffer: &Buffer<T>, range: Range<usize>) -> Result<Vec<T>> {
        check_range(buffer, &range)?;
        let mut values = host_memory::zeroed(buffer.label(), range.len())?;
        self.read_into(buffer, range.start, &mut values)?;
        Ok(values)
    }

    /// Reads as many elements as `values` has, from element `start` on: into memory that the caller uses again and again, whose pages are there
    /// already.
    ///
    /// # Errors
    /// As [`Gpu::read_range`]; after one, `values` may hold some of the elements.
    pub fn read_into<T: DeviceElement>(&self, buffer: &Buffer<T>, start: usize, values: &mut [T]) -> Result<()> {
        check_range(buffer, &(start..start.saturating_add(values.len())))?;
        self.check_lost()?;
        buffer.check_context(self)?;
        // Copies take whole words.
        let first = start * size_of::<T>();
        let skipped = first % WORD;
        let to = bytemuck::cast_slice_mut::<T, u8>(values);
        if to.is_empty() {
            return Ok(());
        }
        let bytes = (skipped + to.len()).next_multiple_of(WORD);
        let source = (buffer.raw(), (first - skipped) as u64);
        self.read_chunks(buffer.label(), source, bytes, |first, chunk| {
            let begin = first.saturating_sub(skipped);
            let end = to.len().min(first + chunk.len() - skipped);
            let from = begin + skipped - first;
            copy_in_blocks(&mut to[begin..end], &chunk[from..from + end - begin]);
        })
    }

    /// Reads the whole buffer back with each element turned into another while it is copied.
    ///
    /// # Errors
    /// As [`Gpu::read`], `OutOfMemory`.
    pub(crate) fn read_as<T: DeviceElement, U: DeviceElement + Send>(
        &self,
        buffer: &Buffer<T>,
        turn: impl Fn(T) -> U + Sync,
    ) -> Result<Vec<U>> {
        let mut values = host_memory::zeroed::<U>(buffer.label(), buffer.len())?;
        self.read_turned(buffer, &mut values, turn)?;
        Ok(values)
    }

    /// As [`Gpu::read_into`], with each of the first elements, as many as `values` has, turned into another while it is copied.
    ///
    /// # Errors
    /// As [`Gpu::read_into`].
    pub(crate) fn read_turned<T: DeviceElement, U: DeviceElement + Send>(
        &self,
        buffer: &Buffer<T>,
        values: &mut [U],
        turn: impl Fn(T) -> U + Sync,
    ) -> Result<()> {
        const { assert!(size_of::<T>() == WORD, "chunks hold whole words") };
        check_range(buffer, &(0..values.len()))?;
        self.check_lost()?;
        buffer.check_context(self)?;
        self.read_chunks(buffer.label(), (buffer.raw(), 0), values.len() * WORD, |first, chunk| {
            let to = values[first / WORD..][..chunk.len() / WORD].par_chunks_mut(TURNED);
            to.zip(chunk.par_chunks(TURNED * WORD)).for_each(|(to, from)| {
                let from = from.chunks_exact(WORD).map(bytemuck::pod_read_unaligned);
                to.iter_mut().zip(from).for_each(|(to, from)| *to = turn(from));
            });
        })
    }

    /// Reads the whole buffer back in chunks, one after the other: `take(first, bytes)` gets the elements from `first` on. All chunks but
    /// the last are multiples of 4,096 bytes.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub(crate) fn read_by_chunks<T: DeviceElement>(
        &self,
        buffer: &Buffer<T>,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<()> {
        const { assert!(size_of::<T>() == WORD, "chunks hold whole words") };
        self.check_lost()?;
        buffer.check_context(self)?;
        self.read_chunks(buffer.label(), (buffer.raw(), 0), buffer.bytes() as usize, |first, bytes| {
            take(first / WORD, bytes);
        })
    }
}

/// Checks that the buffer has these elements.
fn check_range<T: DeviceElement>(buffer: &Buffer<T>, range: &Range<usize>) -> Result<()> {
    if range.end > buffer.len() {
        let (found, expected) = (range.end as u64, buffer.len() as u64);
        return Err(Error::LengthMismatch { what: buffer.label(), found, expected });
    }
    Ok(())
}
