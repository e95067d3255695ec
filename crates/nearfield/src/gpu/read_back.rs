//! Values that recorded work copies to the host: they come with the work itself, without a submission of their own.

use std::marker::PhantomData;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::staging::{Staging, Way};
use super::transfer::copy_in_blocks;
use super::{Buffer, DeviceElement, Gpu};
use crate::{Error, Result};

/// Elements of a buffer as they were when the work that copies them ran; see [`super::Commands::read_back`].
#[derive(Debug)]
pub struct ReadBack<T> {
    destination: Arc<Destination>,
    label: &'static str,
    len: usize,
    element: PhantomData<T>,
}

/// Where a copy goes.
#[derive(Debug)]
pub(super) struct Destination {
    /// Whole words.
    bytes: u64,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    staging: Staging,
    /// Whether the copy was submitted and its values were not taken.
    is_coming: bool,
}

impl Destination {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes it ready for the next submission, which must not find it mapped.
    pub(super) fn begin(&self) {
        let mut state = self.state();
        state.is_coming = false;
        state.staging.unmap();
    }

    /// Encodes the copy.
    pub(super) fn encode(&self, encoder: &mut wgpu::CommandEncoder, source: &wgpu::Buffer) {
        encoder.copy_buffer_to_buffer(source, 0, self.state().staging.raw(), 0, self.bytes);
    }

    /// Asks for the values, which come with this submission. Driver's errors go to the error scope.
    pub(super) fn submitted(&self, submission: &wgpu::SubmissionIndex) {
        let mut state = self.state();
        state.staging.used_by(submission);
        state.staging.ask_to_map(self.bytes);
        state.is_coming = true;
    }
}

impl<T: DeviceElement> ReadBack<T> {
    pub(super) fn new(gpu: &Gpu, buffer: &Buffer<T>) -> Result<Self> {
        let bytes = buffer.bytes().max(4).next_multiple_of(4);
        let state = State { staging: Staging::new(gpu, Way::Out, bytes)?, is_coming: false };
        let destination = Arc::new(Destination { bytes, state: Mutex::new(state) });
        Ok(Self { destination, label: buffer.label(), len: buffer.len(), element: PhantomData })
    }

    pub(super) fn destination(&self) -> &Arc<Destination> {
        &self.destination
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Waits for the last submission of the work and takes its values, once.
    ///
    /// # Errors
    /// `Device` where the work was not submitted since the last call; `DeviceLost`.
    pub fn values(&self) -> Result<Vec<T>> {
        let mut values = vec![T::zeroed(); self.len];
        self.take_into(&mut values)?;
        Ok(values)
    }

    /// The same for the first elements, as many as `values` has, without taking memory.
    ///
    /// # Errors
    /// As [`ReadBack::values`]; `LengthMismatch` where there are fewer.
    pub fn take_into(&self, values: &mut [T]) -> Result<()> {
        if values.len() > self.len {
            let (found, expected) = (self.len as u64, values.len() as u64);
            return Err(Error::LengthMismatch { what: self.label, found, expected });
        }
        let mut state = self.destination.state();
        if !std::mem::take(&mut state.is_coming) {
            let message = "nothing was submitted that reads it back".to_owned();
            return Err(Error::Device { operation: self.label.to_owned(), message });
        }
        state.staging.wait_until_mapped(self.label)?;
        let view = state.staging.view(self.label, self.destination.bytes)?;
        let to = bytemuck::cast_slice_mut::<T, u8>(values);
        copy_in_blocks(to, &view[..to.len()]);
        drop(view);
        state.staging.unmap();
        Ok(())
    }
}
