//! Copies between host and device in chunks of which several are under way: while the device copies one, threads of the host copy another.

use std::collections::VecDeque;
use std::num::NonZeroU64;

use rayon::prelude::*;
use wgpu::WriteOnly;

use super::Gpu;
use super::buffer::WORD;
use super::staging::{Staging, Way};
use crate::{Error, Result};

/// Largest chunk. On the host of an H200 a submission takes 40 µs, in which 2 MB go over PCIe 5; four chunks of 8 MiB keep staging memory small beside
/// data for which it matters.
const LARGEST_CHUNK: usize = 8 << 20;
/// Smallest chunk of data that are more than one.
const SMALLEST_CHUNK: usize = 2 << 20;
/// Chunks that are under way at the same time.
const IN_FLIGHT: usize = 4;
/// Where staging memory is short, chunks that are read get no smaller than this; all but the last are a multiple of it.
const FEW_BYTES: usize = 4096;
/// Bytes that one thread copies at a time; what is less is not handed out to threads.
const BLOCK: usize = 256 << 10;
/// Writes of no more bytes go through the queue's own staging memory, which costs no submission.
const SMALL_WRITE: usize = 1 << 20;

/// Writes the bytes of some data from that byte on.
pub(super) type Fill<'a> = dyn Fn(usize, WriteOnly<'_, [u8]>) + Sync + 'a;

impl Gpu {
    /// Writes `bytes` bytes, whole words, into `buffer` from byte `offset` on, as `fill` makes them.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `Device`, `DeviceLost`.
    pub(super) fn write_chunks(
        &self,
        label: &str,
        (buffer, offset): (&wgpu::Buffer, u64),
        bytes: usize,
        fill: &Fill<'_>,
    ) -> Result<()> {
        if bytes <= SMALL_WRITE {
            return self.write_by_queue(label, (buffer, offset), 0..bytes, fill);
        }
        let mut ring = Ring::new(self, Way::In, bytes);
        let mut done = 0;
        while done < bytes {
            let mut staging = match ring.next() {
                Ok(staging) => staging,
                // The queue's own memory is not counted, and the driver has the last word.
                Err(Error::OutOfDeviceMemory { .. }) => {
                    let end = bytes.min(done + SMALL_WRITE);
                    self.write_by_queue(label, (buffer, offset), done..end, fill)?;
                    done = end;
                    continue;
                }
                Err(error) => return Err(error),
            };
            let len = chunk_len(done, bytes - done, staging.size());
            self.checked(label, len as u64, || staging.ask_to_map(len as u64))?;
            staging.wait_until_mapped(label)?;
            let mut view = staging.view_mut(label, len as u64)?;
            fill_in_blocks(view.slice(..), done, fill);
            drop(view);
            let submission = self.checked(label, len as u64, || {
                staging.unmap();
                let mut encoder = self.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                encoder.copy_buffer_to_buffer(staging.raw(), 0, buffer, offset + done as u64, len as u64);
                self.queue().submit([encoder.finish()])
            })?;
            staging.used_by(&submission);
            ring.put(staging);
            done += len;
        }
        Ok(())
    }

    fn write_by_queue(
        &self,
        label: &str,
        (buffer, offset): (&wgpu::Buffer, u64),
        range: std::ops::Range<usize>,
        fill: &Fill<'_>,
    ) -> Result<()> {
        let Some(size) = NonZeroU64::new(range.len() as u64) else { return Ok(()) };
        self.checked(label, size.get(), || {
            let view = self.queue().write_buffer_with(buffer, offset + range.start as u64, size);
            if let Some(mut view) = view {
                fill_in_blocks(view.slice(..), range.start, fill);
            }
        })
    }

    /// Reads `bytes` bytes, whole words, of `buffer` from byte `start` on, after everything submitted before: `take(first, chunk)` gets them one
    /// chunk after the other, `first` from `start` on.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `Device`, `DeviceLost`.
    pub(super) fn read_chunks(
        &self,
        label: &str,
        (buffer, start): (&wgpu::Buffer, u64),
        bytes: usize,
        mut take: impl FnMut(usize, &[u8]),
    ) -> Result<()> {
        let mut ring = Ring::new(self, Way::Out, bytes);
        let mut coming: VecDeque<(Staging, usize, usize)> = VecDeque::new();
        let mut asked = 0;
        loop {
            // As many chunks as there is memory for are under way before the first is waited for.
            while asked < bytes && coming.len() < IN_FLIGHT {
                let mut staging = match ring.next() {
                    Ok(staging) => staging,
                    Err(Error::OutOfDeviceMemory { .. }) if !coming.is_empty() => break,
                    Err(error) => return Err(error),
                };
                let len = chunk_len(asked, bytes - asked, staging.size());
                self.checked(label, len as u64, || {
                    let mut encoder = self.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                    encoder.copy_buffer_to_buffer(buffer, start + asked as u64, staging.raw(), 0, len as u64);
                    let submission = self.queue().submit([encoder.finish()]);
                    staging.used_by(&submission);
                    staging.ask_to_map(len as u64);
                })?;
                coming.push_back((staging, asked, len));
                asked += len;
            }
            let Some((mut staging, first, len)) = coming.pop_front() else { return Ok(()) };
            staging.wait_until_mapped(label)?;
            let view = staging.view(label, len as u64)?;
            take(first, &view);
            drop(view);
            staging.unmap();
            ring.put(staging);
        }
    }
}

/// Calls `fill` for the blocks of what begins at byte `first`, by all threads if there are several.
fn fill_in_blocks(to: WriteOnly<'_, [u8]>, first: usize, fill: &Fill<'_>) {
    let (blocks, rest) = to.into_chunks::<BLOCK>();
    let blocks: Vec<WriteOnly<'_, [u8; BLOCK]>> = blocks.into_iter().collect();
    let end = first + blocks.len() * BLOCK;
    blocks.into_par_iter().enumerate().for_each(|(i, block)| fill(first + i * BLOCK, block.into()));
    if !rest.is_empty() {
        fill(end, rest);
    }
}

/// Copies by all threads, which share the first touch of pages: it costs more than the copy.
pub(super) fn copy_in_blocks(to: &mut [u8], from: &[u8]) {
    if to.len() <= BLOCK {
        return to.copy_from_slice(from);
    }
    to.par_chunks_mut(BLOCK).zip(from.par_chunks(BLOCK)).for_each(|(to, from)| to.copy_from_slice(from));
}

/// Pieces of staging memory of one transfer: some in use, some free again.
struct Ring<'a> {
    gpu: &'a Gpu,
    way: Way,
    /// Bytes of a piece.
    size: usize,
    /// Bytes of a piece that is not halved any more where memory is short.
    fewest: usize,
    /// Pieces that were made.
    made: usize,
    free: VecDeque<Staging>,
}

impl<'a> Ring<'a> {
    fn new(gpu: &'a Gpu, way: Way, bytes: usize) -> Self {
        let fewest = if way == Way::In { SMALL_WRITE } else { FEW_BYTES };
        Self { gpu, way, size: piece_len(bytes), fewest, made: 0, free: VecDeque::new() }
    }

    /// A new piece while few are in use, else the one that has been free for longest; smaller ones where memory is short.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` where not even a small one can be had, and none is free.
    fn next(&mut self) -> Result<Staging> {
        loop {
            if self.made < IN_FLIGHT {
                match Staging::new(self.gpu, self.way, self.size as u64) {
                    Ok(staging) => {
                        self.made += 1;
                        return Ok(staging);
                    }
                    Err(Error::OutOfDeviceMemory { .. }) if !self.free.is_empty() => self.made = IN_FLIGHT,
                    // Smaller chunks are slower, but need less memory beside the data.
                    Err(Error::OutOfDeviceMemory { .. }) if self.made == 0 && self.size > self.fewest => {
                        self.size = self.size.div_ceil(2);
                        continue;
                    }
                    Err(error) => return Err(error),
                }
            }
            return self.free.pop_front().ok_or_else(|| Error::OutOfDeviceMemory {
                what: "staging".to_owned(),
                needed: self.size as u64,
                available: 0,
            });
        }
    }

    fn put(&mut self, staging: Staging) {
        self.free.push_back(staging);
    }
}

/// Bytes of a piece for a transfer of so many.
fn piece_len(bytes: usize) -> usize {
    match bytes {
        0..=SMALLEST_CHUNK => bytes,
        _ => (bytes / IN_FLIGHT).next_power_of_two().clamp(SMALLEST_CHUNK, LARGEST_CHUNK),
    }
}

/// Bytes of the next chunk, at most `most`, where so many are under way and so many are left. The first chunks and the last are small: one side has
/// nothing to do while the first and the last are copied.
fn chunk_len(done: usize, left: usize, most: usize) -> usize {
    let ramp = done.min(left / 2).max(SMALLEST_CHUNK).next_multiple_of(FEW_BYTES);
    ramp.min(most / WORD * WORD).min(left)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_grow_and_shrink_and_cover_everything() {
        for bytes in [4, 4096, SMALLEST_CHUNK, SMALLEST_CHUNK + 4, 5 << 20, (200 << 20) + 12] {
            let size = piece_len(bytes);
            let (mut lengths, mut done) = (Vec::new(), 0);
            while done < bytes {
                let len = chunk_len(done, bytes - done, size);
                assert!(len > 0 && len.is_multiple_of(WORD) && len <= size && len <= bytes - done, "{bytes}: {len}");
                assert!(len == bytes - done || len.is_multiple_of(FEW_BYTES), "{bytes}: {len}");
                lengths.push(len);
                done += len;
            }
            assert_eq!(done, bytes);
            assert!(lengths[0] <= SMALLEST_CHUNK && lengths[lengths.len() - 1] <= SMALLEST_CHUNK, "{lengths:?}");
        }
    }
}
