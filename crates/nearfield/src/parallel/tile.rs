//! What the GPU primitives share: tile sizes, checked lengths, parameters, and the scan of short rows in place.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::gpu::{Access, Buffer, Commands, DeviceElement, Gpu, Kernel, Pipeline, Workgroups};
use crate::{Error, Result};

/// Elements that one workgroup scans; the twin of `TILE` in tile.wesl.
pub(super) const TILE: usize = 2048;
/// Invocations of a workgroup; the twin of `WORKGROUP` in tile.wesl.
pub(super) const WORKGROUP: u32 = 256;
/// Indices stay below 2³² even one round of a grid behind the last element.
pub(crate) const MAX_LEN: usize = 1 << 31;

/// Parameters of a kernel: four words, as uniforms are read in units of 16 bytes.
pub(crate) type Parameters = [u32; 4];

/// The uniform buffers of a plan. Parameters repeat from one recording to the next while lengths stay the same; a new
/// buffer costs more time on the host than the recording of its dispatch.
#[derive(Debug)]
pub(crate) struct ParameterCache {
    gpu: Gpu,
    known: Mutex<HashMap<Parameters, Buffer<Parameters>>>,
}

impl ParameterCache {
    /// Entries kept; lengths that keep changing must not pile up.
    const MOST: usize = 64;

    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self { gpu: gpu.clone(), known: Mutex::default() }
    }

    /// A uniform buffer that holds `parameters` and is never written again.
    pub(crate) fn uniform(&self, parameters: Parameters) -> Result<Buffer<Parameters>> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(buffer) = known.get(&parameters) {
            return Ok(buffer.clone());
        }
        let buffer = self.gpu.uniform("parameters of an array primitive", &parameters)?;
        if known.len() >= Self::MOST {
            known.clear();
        }
        known.insert(parameters, buffer.clone());
        Ok(buffer)
    }
}

/// Checks the length that a plan is made for.
pub(super) fn check_capacity(what: &'static str, capacity: usize) -> Result<()> {
    check_len(what, capacity, MAX_LEN)
}

/// Checks the length of a recording against what its plan was made for.
pub(crate) fn check_len(what: &'static str, len: usize, limit: usize) -> Result<()> {
    if len <= limit {
        return Ok(());
    }
    let advice = "make the plan for that length, or work in parts";
    Err(Error::TooMany { what, found: len as u64, limit: limit as u64, advice })
}

/// Checks that a buffer holds at least `len` elements.
pub(crate) fn check_holds<T: DeviceElement>(buffer: &Buffer<T>, len: usize) -> Result<()> {
    if buffer.len() >= len {
        return Ok(());
    }
    Err(Error::LengthMismatch { what: buffer.label(), found: buffer.len() as u64, expected: len as u64 })
}

/// Rows of at most this many values are scanned by one invocation each: a small sort has 256 rows of one value a tile, and
/// with a workgroup for each of them a sort of 200 u64 keys took 105 ms on llvmpipe, with this 2.5.
const SHORT_ROW: usize = 16;

/// Exclusive scans of the rows of a table in place, a workgroup a row, or an invocation where several rows are short.
#[derive(Debug)]
pub(super) struct RowScan {
    parameters: ParameterCache,
    pipeline: Arc<Pipeline>,
    short: Arc<Pipeline>,
}

impl RowScan {
    pub(super) fn new(gpu: &Gpu) -> Result<Self> {
        let bindings = [Access::Uniform, Access::ReadWrite, Access::ReadWrite];
        let kernel = |entry| Kernel::new("package::parallel::scan_rows", entry, &bindings, WORKGROUP);
        Ok(Self {
            parameters: ParameterCache::new(gpu),
            pipeline: gpu.prepare(&kernel("scan_rows"))?,
            short: gpu.prepare(&kernel("scan_short_rows"))?,
        })
    }

    /// Scans `n_rows` rows of `row_len` values of `table`; the sum of row i goes to `totals[i]`.
    pub(super) fn record(
        &self,
        commands: &mut Commands,
        table: &Buffer<u32>,
        totals: &Buffer<u32>,
        n_rows: usize,
        row_len: usize,
    ) -> Result<()> {
        let parameters = self.parameters.uniform([row_len as u32, n_rows as u32, 0, 0])?;
        let bindings = [(&parameters).into(), table.into(), totals.into()];
        if n_rows > 1 && row_len <= SHORT_ROW {
            commands.dispatch(&self.short, &bindings, Workgroups::Covering(n_rows as u64));
        } else {
            commands.dispatch(&self.pipeline, &bindings, Workgroups::Count(n_rows as u32));
        }
        Ok(())
    }
}
