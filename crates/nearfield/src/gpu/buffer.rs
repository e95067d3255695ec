//! Typed, named device buffers.

use std::marker::PhantomData;
use std::sync::Arc;

use bytemuck::Pod;
use wgpu::BufferUsages;

use super::Gpu;
use crate::{Error, Result};

/// Bytes of a word, the unit of copies.
const WORD: usize = 4;
/// Largest part that is read back at once: keeps the staging memory small beside the buffer itself.
const PART_BYTES: usize = 256 << 20;
/// Where staging memory is short, parts get no smaller than this.
const SMALLEST_PART_BYTES: usize = 4096;

/// Elements whose bytes are the same on both sides.
pub trait DeviceElement: Pod {}
impl<T: Pod> DeviceElement for T {}

/// A device array of `len` elements with a name that errors use. Clones share the memory.
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
}

impl Drop for Accounted {
    fn drop(&mut self) {
        self.gpu.release(self.bytes);
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

    /// What keeps its memory counted.
    pub(super) fn accounted(&self) -> Option<Arc<Accounted>> {
        self.accounted.clone()
    }

    /// The wgpu buffer; it may be a little larger than the elements.
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
        // Bindings need at least one element, of at most 16 bytes in kernels; copies need whole words.
        let size = (len as u64 * size_of::<T>() as u64).max(16).next_multiple_of(WORD as u64);
        self.reserve(label, size)?;
        let descriptor = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        let accounted = Some(Arc::new(Accounted { gpu: self.clone(), bytes: size }));
        let raw = self.checked(label, size, || self.device().create_buffer(&descriptor))?;
        Ok(Buffer { raw, len, label, accounted, element: PhantomData })
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
    /// `LengthMismatch` if it does not fit; `Unsupported` for parts of words; `OutOfDeviceMemory`, `DeviceLost`.
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
            if !words.is_empty() {
                self.queue().write_buffer(buffer.raw(), offset, words);
            }
            if !rest.is_empty() {
                self.queue().write_buffer(buffer.raw(), offset + words.len() as u64, &last);
            }
        })
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
    /// `LengthMismatch` if the range passes the end; `OutOfDeviceMemory` for the staging memory, `OutOfMemory`,
    /// `DeviceLost`.
    pub fn read_range<T: DeviceElement>(&self, buffer: &Buffer<T>, range: std::ops::Range<usize>) -> Result<Vec<T>> {
        if range.end > buffer.len() {
            let (found, expected) = (range.end as u64, buffer.len() as u64);
            return Err(Error::LengthMismatch { what: buffer.label(), found, expected });
        }
        let mut values = Vec::new();
        values.try_reserve_exact(range.len()).map_err(|_| Error::OutOfMemory {
            what: buffer.label(),
            needed: (range.len() * size_of::<T>()) as u64,
            available: 0,
        })?;
        self.check_lost()?;
        let mut part = (PART_BYTES / size_of::<T>().max(1)).max(1);
        let mut start = range.start;
        while start < range.end {
            let end = range.end.min(start.saturating_add(part));
            match self.read_part(buffer, start..end, &mut values) {
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
        values: &mut Vec<T>,
    ) -> Result<()> {
        let label = buffer.label();
        // Copies take whole words.
        let first = range.start * size_of::<T>();
        let skipped = first % WORD;
        let start = (first - skipped) as u64;
        let size = (skipped + range.len() * size_of::<T>()).next_multiple_of(WORD) as u64;
        let staging =
            self.allocate::<u8>("read-back staging", size as usize, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        let submission = self.checked(label, size, || {
            let mut encoder = self.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(buffer.raw(), start, staging.raw(), 0, size);
            let submission = self.queue().submit([encoder.finish()]);
            staging.raw().map_async(wgpu::MapMode::Read, .., |_| {});
            submission
        })?;
        self.wait(label, submission)?;
        let view = staging
            .raw()
            .get_mapped_range(..)
            .map_err(|e| Error::Device { operation: format!("read back {label}"), message: e.to_string() })?;
        let bytes = &view[skipped..skipped + range.len() * size_of::<T>()];
        match bytemuck::try_cast_slice(bytes) {
            Ok(elements) => values.extend_from_slice(elements),
            Err(_) => values.extend(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>)),
        }
        Ok(())
    }
}
