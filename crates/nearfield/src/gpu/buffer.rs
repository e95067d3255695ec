//! Typed, named device buffers.

use std::marker::PhantomData;
use std::num::NonZeroU64;
use std::sync::{Arc, OnceLock};

use bytemuck::Pod;
use rayon::prelude::*;
use wgpu::BufferUsages;

use super::Gpu;
use crate::{Error, Result};

/// Bytes of a word, the unit of copies.
const WORD: usize = 4;
/// Largest part that is read back at once: keeps the staging memory small beside the buffer itself.
const PART_BYTES: usize = 256 << 20;
/// Bytes that one thread copies from staging memory at a time.
const COPY_BYTES: usize = 1 << 20;
/// Copies of that size that are worth handing out to threads.
const SHARED_COPIES: usize = 4;
/// Usages of staging memory.
const STAGING: BufferUsages = BufferUsages::MAP_READ.union(BufferUsages::COPY_DST);
/// Where staging memory is short, parts get no smaller than this.
const SMALLEST_PART_BYTES: usize = 4096;

/// Elements whose bytes are the same on both sides.
pub trait DeviceElement: Pod {}
impl<T: Pod> DeviceElement for T {}

/// A device array of `len` elements with a name that errors use, for use with the [`Gpu`] that made it and its clones.
/// Clones share the memory.
pub struct Buffer<T> {
    raw: wgpu::Buffer,
    len: usize,
    label: &'static str,
    accounted: Option<Arc<Accounted>>,
    element: PhantomData<T>,
}

/// Bytes that count as used for as long as a buffer, or recorded work that names it, lives.
#[derive(Debug)]
pub(super) struct Accounted {
    gpu: Gpu,
    bytes: u64,
    /// What is kept for later use; `None` while there is no buffer, and where it must not be used again.
    memory: OnceLock<(wgpu::Buffer, BufferUsages)>,
}

impl Accounted {
    /// Checks that the buffer was made by this context. The driver's layer cannot: it numbers the objects of each
    /// instance by themselves, and takes a foreign object for one of its own or panics.
    pub(super) fn check_context(&self, gpu: &Gpu, operation: &str) -> Result<()> {
        if Arc::ptr_eq(&self.gpu.inner, &gpu.inner) {
            return Ok(());
        }
        let message = format!("a buffer on {} was used with another context, on {}", self.gpu.name(), gpu.name());
        Err(Error::Device { operation: operation.to_owned(), message })
    }
}

impl Drop for Accounted {
    fn drop(&mut self) {
        self.gpu.release(self.bytes);
        if let Some((buffer, usage)) = self.memory.take() {
            self.gpu.inner.pool.keep(buffer, usage);
        }
    }
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self {
            raw: self.raw.clone(),
            len: self.len,
            label: self.label,
            accounted: self.accounted.clone(),
            element: PhantomData,
        }
    }
}

impl<T> std::fmt::Debug for Buffer<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Buffer({}, {} elements)", self.label, self.len)
    }
}

impl<T: DeviceElement> Buffer<T> {
    /// Takes a buffer of the caller's as an array of `len` elements. It needs the usages STORAGE, COPY_SRC and
    /// COPY_DST, and must belong to the device of the context it is used with.
    ///
    /// # Errors
    /// `LengthMismatch` if the buffer is smaller than `len` elements.
    pub fn from_wgpu(label: &'static str, raw: wgpu::Buffer, len: usize) -> Result<Self> {
        let possible = raw.size() / size_of::<T>().max(1) as u64;
        if (len as u64) > possible {
            return Err(Error::LengthMismatch { what: label, found: possible, expected: len as u64 });
        }
        Ok(Self { raw, len, label, accounted: None, element: PhantomData })
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Bytes of the elements.
    pub fn bytes(&self) -> u64 {
        (self.len * size_of::<T>()) as u64
    }

    /// The name.
    pub fn label(&self) -> &'static str {
        self.label
    }

    /// Checks that the buffer is one of this context, where that is known.
    fn check_context(&self, gpu: &Gpu) -> Result<()> {
        self.accounted.as_ref().map_or(Ok(()), |accounted| accounted.check_context(gpu, self.label))
    }

    /// What keeps its memory counted.
    pub(super) fn accounted(&self) -> Option<Arc<Accounted>> {
        self.accounted.clone()
    }

    /// The wgpu buffer; it may be a little larger than the elements. Keep this `Buffer` for as long as it is used: the
    /// memory goes to other buffers of the context afterwards.
    pub fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }
}

impl Gpu {
    /// A buffer of `len` elements with undefined contents (zero on most devices, never to be relied on).
    ///
    /// # Errors
    /// `OutOfDeviceMemory` if it passes the largest storage binding, the memory limit, or what the device has.
    pub fn buffer<T: DeviceElement>(&self, label: &'static str, len: usize) -> Result<Buffer<T>> {
        let bytes = (len as u64).saturating_mul(size_of::<T>() as u64);
        let limit = self.limits().binding_bytes;
        if bytes > limit {
            return Err(Error::OutOfDeviceMemory { what: label.to_owned(), needed: bytes, available: limit });
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST | BufferUsages::INDIRECT;
        self.allocate(label, len, usage)
    }

    /// A small buffer of kernel parameters.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn uniform<T: DeviceElement>(&self, label: &'static str, value: &T) -> Result<Buffer<T>> {
        let buffer = self.allocate(label, 1, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        self.write(&buffer, 0, std::slice::from_ref(value))?;
        Ok(buffer)
    }

    /// A buffer that timestamps are resolved into.
    pub(super) fn query_buffer(&self, label: &'static str, len: usize) -> Result<Buffer<u64>> {
        self.allocate(label, len, BufferUsages::QUERY_RESOLVE | BufferUsages::COPY_SRC)
    }

    fn allocate<T>(&self, label: &'static str, len: usize, usage: BufferUsages) -> Result<Buffer<T>> {
        // Bindings need at least one element, copies whole words.
        let size = (len.max(1) as u64 * size_of::<T>() as u64).max(WORD as u64).next_multiple_of(WORD as u64);
        self.reserve(label, size)?;
        let accounted = Accounted { gpu: self.clone(), bytes: size, memory: OnceLock::new() };
        let raw = self.take_or_create(label, size, usage)?;
        if !usage.contains(BufferUsages::MAP_READ) {
            let _ = accounted.memory.set((raw.clone(), usage));
        }
        Ok(Buffer { raw, len, label, accounted: Some(Arc::new(accounted)), element: PhantomData })
    }

    fn take_or_create(&self, label: &'static str, size: u64, usage: BufferUsages) -> Result<wgpu::Buffer> {
        if let Some(kept) = self.inner.pool.take(size, usage) {
            return Ok(kept);
        }
        let descriptor = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        let create = || self.checked(label, size, || self.device().create_buffer(&descriptor));
        match create() {
            Err(Error::OutOfDeviceMemory { .. }) if self.inner.pool.bytes() > 0 => {
                self.inner.pool.clear();
                create()
            }
            made => made,
        }
    }

    /// A buffer with a copy of `data`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn upload<T: DeviceElement>(&self, label: &'static str, data: &[T]) -> Result<Buffer<T>> {
        let buffer = self.buffer(label, data.len())?;
        self.write(&buffer, 0, data)?;
        Ok(buffer)
    }

    /// Copies `data` into `buffer` from element `start` on.
    ///
    /// Devices write whole words of 4 bytes: with smaller elements, the first byte must be one of a word, and so must
    /// the last but at the end of the buffer.
    ///
    /// # Errors
    /// `LengthMismatch` if it does not fit; `Unsupported` for parts of words; `Device` for a buffer of another context;
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn write<T: DeviceElement>(&self, buffer: &Buffer<T>, start: usize, data: &[T]) -> Result<()> {
        let end = start.saturating_add(data.len());
        if end > buffer.len() {
            return Err(Error::LengthMismatch {
                what: buffer.label(),
                found: end as u64,
                expected: buffer.len() as u64,
            });
        }
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
        let mut last = [0; WORD];
        last[..rest.len()].copy_from_slice(rest);
        self.checked(buffer.label(), bytes.len() as u64, || {
            self.write_words(buffer.raw(), offset, words);
            if !rest.is_empty() {
                self.queue().write_buffer(buffer.raw(), offset + words.len() as u64, &last);
            }
        })
    }

    /// Copies whole words, much by all threads: the first touch of staging memory costs more than the copy. What the driver has against
    /// it goes to the error scope.
    fn write_words(&self, buffer: &wgpu::Buffer, offset: u64, words: &[u8]) {
        let Some(size) = NonZeroU64::new(words.len() as u64) else { return };
        if words.len() < SHARED_COPIES * COPY_BYTES {
            return self.queue().write_buffer(buffer, offset, words);
        }
        let Some(mut view) = self.queue().write_buffer_with(buffer, offset, size) else { return };
        let (chunks, mut rest) = view.slice(..).into_chunks::<COPY_BYTES>();
        let (whole, left) = words.split_at(words.len() - rest.len());
        let chunks: Vec<wgpu::WriteOnly<'_, [u8; COPY_BYTES]>> = chunks.into_iter().collect();
        chunks.into_par_iter().zip(whole.par_chunks(COPY_BYTES)).for_each(|(to, from)| {
            let mut to: wgpu::WriteOnly<'_, [u8]> = to.into();
            to.copy_from_slice(from);
        });
        rest.copy_from_slice(left);
    }

    /// Reads the whole buffer back, after everything submitted before.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `DeviceLost`.
    pub fn read<T: DeviceElement>(&self, buffer: &Buffer<T>) -> Result<Vec<T>> {
        self.read_range(buffer, 0..buffer.len())
    }

    /// Reads elements `range` of the buffer back, in parts where staging memory is short.
    ///
    /// # Errors
    /// `LengthMismatch` if the range passes the end; `Device` for a buffer of another context; `OutOfDeviceMemory` for
    /// the staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read_range<T: DeviceElement>(&self, buffer: &Buffer<T>, range: std::ops::Range<usize>) -> Result<Vec<T>> {
        if range.end > buffer.len() {
            let (found, expected) = (range.end as u64, buffer.len() as u64);
            return Err(Error::LengthMismatch { what: buffer.label(), found, expected });
        }
        let mut values = bytemuck::allocation::try_zeroed_vec(range.len()).map_err(|()| Error::OutOfMemory {
            what: buffer.label(),
            needed: (range.len() * size_of::<T>()) as u64,
            available: 0,
        })?;
        self.check_lost()?;
        buffer.check_context(self)?;
        let mut part = (PART_BYTES / size_of::<T>().max(1)).max(1);
        let mut start = range.start;
        while start < range.end {
            let end = range.end.min(start.saturating_add(part));
            match self.read_part(buffer, start..end, &mut values[start - range.start..end - range.start]) {
                Ok(()) => start = end,
                // Smaller parts are slower, but need less memory beside the buffer.
                Err(Error::OutOfDeviceMemory { .. }) if (end - start) * size_of::<T>() > SMALLEST_PART_BYTES => {
                    part = (end - start).div_ceil(2);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(values)
    }

    fn read_part<T: DeviceElement>(
        &self,
        buffer: &Buffer<T>,
        range: std::ops::Range<usize>,
        values: &mut [T],
    ) -> Result<()> {
        let label = buffer.label();
        // Copies take whole words.
        let first = range.start * size_of::<T>();
        let skipped = first % WORD;
        let start = (first - skipped) as u64;
        let size = (skipped + range.len() * size_of::<T>()).next_multiple_of(WORD) as u64;
        let staging = self.allocate::<u8>("read-back staging", size as usize, STAGING)?;
        let submission = self.checked(label, size, || {
            let mut encoder = self.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(buffer.raw(), start, staging.raw(), 0, size);
            let submission = self.queue().submit([encoder.finish()]);
            staging.raw().map_async(wgpu::MapMode::Read, ..size, |_| {});
            submission
        })?;
        self.wait(label, submission)?;
        let view = staging
            .raw()
            .get_mapped_range(..size)
            .map_err(|e| Error::Device { operation: format!("read back {label}"), message: e.to_string() })?;
        let bytes = &view[skipped..skipped + range.len() * size_of::<T>()];
        // Many threads share the first touch of the pages, which costs more than the copy.
        let parts =
            bytemuck::cast_slice_mut::<T, u8>(values).par_chunks_mut(COPY_BYTES).zip(bytes.par_chunks(COPY_BYTES));
        parts.for_each(|(to, from)| to.copy_from_slice(from));
        // Unmapped, it can serve again; after an error above it is never kept.
        drop(view);
        staging.raw().unmap();
        if let Some(accounted) = &staging.accounted {
            let _ = accounted.memory.set((staging.raw().clone(), STAGING));
        }
        Ok(())
    }
}
