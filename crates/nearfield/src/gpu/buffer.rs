//! Typed, named device buffers.

use std::marker::PhantomData;
use std::sync::{Arc, OnceLock};

use bytemuck::Pod;
use wgpu::BufferUsages;

use super::Gpu;
use crate::{Error, Result};

/// Bytes of a word, the unit of copies.
pub(super) const WORD: usize = 4;

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
    /// What is kept for later use; `None` while there is no buffer.
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

    /// Its first elements, at most as many as there are, in the same memory.
    pub(crate) fn first(&self, len: usize) -> Self {
        Self { len: len.min(self.len), ..self.clone() }
    }

    /// Checks that the buffer is one of this context, where that is known.
    pub(super) fn check_context(&self, gpu: &Gpu) -> Result<()> {
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
        let raw = match self.inner.pool.take(size, usage) {
            Some(kept) => kept,
            None => self.create_buffer(label, size, usage)?,
        };
        let _ = accounted.memory.set((raw.clone(), usage));
        Ok(Buffer { raw, len, label, accounted: Some(Arc::new(accounted)), element: PhantomData })
    }

    /// A new buffer; the memory that is kept makes way for it.
    pub(super) fn create_buffer(&self, label: &'static str, size: u64, usage: BufferUsages) -> Result<wgpu::Buffer> {
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
}
