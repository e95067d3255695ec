//! Phase III on the device: the plain list, the paper's way.

use super::back_traverse::{Candidates, Window, kernel};
use crate::gpu::{Access, Bind, Buffer, Gpu, StageTime, Workgroups};
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::{Error, Result};

pub(in crate::query) const MODULE: &str = "package::query::coherent::extract";

/// A list of which rows have no order of their own.
pub(in crate::query) struct Extracted {
    /// `[q + 1]` by slot.
    pub(in crate::query) offsets: Buffer<u32>,
    /// `[nnz]` the caller's indices of points.
    pub(in crate::query) indices: Buffer<u32>,
    pub(in crate::query) stages: Vec<StageTime>,
}

/// Accesses of what all kernels of phase III read.
const READS: &[Access] =
    &[Access::Uniform, Access::Uniform, Access::Read, Access::Read, Access::Read, Access::Read, Access::Read];

/// How many matches each candidate of a window has.
pub(super) struct Matches {
    pub(super) counts: Buffer<u32>,
    /// Their exact sum.
    pub(super) total: u64,
    /// Tests of each candidate, where they are counted.
    pub(super) tests: Option<Buffer<u32>>,
    pub(super) stages: Vec<StageTime>,
}

impl Candidates {
    /// What all kernels of phase III read.
    fn extraction_inputs(&self, window: &Window) -> Vec<Bind> {
        let packs = self.packs.as_ref().expect("there should be packs");
        let [queries, first] = [Bind::from(&packs.queries), (&packs.first).into()];
        let (points, radii) = (self.points.clone(), (&self.radii).into());
        vec![(&window.sweep).into(), self.layout().clone(), points, queries, radii, first, (&self.entries).into()]
    }

    /// Counts the matches of every candidate of a window, which must be in memory.
    pub(super) fn count_matches(&self, gpu: &Gpu, window: &Window, counted: bool) -> Result<Matches> {
        let n = window.candidates as usize;
        let counts = gpu.buffer("matches of candidates", n)?;
        let tests = counted.then(|| gpu.buffer("tests of candidates", n)).transpose()?;
        let sum: Buffer<u64> = gpu.buffer("number of matches", 1)?;
        let mut accesses = READS.to_vec();
        accesses.resize(READS.len() + 1 + usize::from(counted), Access::ReadWrite);
        let mut binds = self.extraction_inputs(window);
        binds.push((&counts).into());
        binds.extend(tests.as_ref().map(Bind::from));
        let count_matches = kernel(gpu, (MODULE, "count_matches"), &accesses, &self.features)?;
        let mut commands = gpu.commands("count matches");
        commands.stage("extract").dispatch(&count_matches, &binds, Workgroups::Covering(n as u64));
        GpuReduce::new(gpu)?.record_sum(&mut commands, &counts, n, &sum)?;
        let stages = commands.run()?;
        Ok(Matches { counts, total: gpu.read(&sum)?[0], tests, stages })
    }

    /// Whether the list can be extracted: all candidates are in memory at once.
    pub(in crate::query) fn can_extract(&self) -> bool {
        self.windows.len() == 1
    }

    /// The list of all matches. `accept` sees their number before memory is taken for them.
    ///
    /// Departure: matches are counted, and written where a scan says, in place of atomic appends; so rows are the same from
    /// run to run. A query without neighbours keeps an empty row, which the paper's compaction drops.
    ///
    /// # Errors
    /// What `accept` returns; `OutOfDeviceMemory`, `DeviceLost`.
    pub(in crate::query) fn extract(&self, gpu: &Gpu, accept: impl FnOnce(u64) -> Result<()>) -> Result<Extracted> {
        use Access::{Read, ReadWrite, Uniform};
        let (n_rows, window) = (self.n_queries, &self.windows[0]);
        let offsets: Buffer<u32> = gpu.buffer("row offsets", n_rows + 1)?;
        let find_rows = kernel(gpu, (MODULE, "find_rows"), &[Uniform, Read, ReadWrite], &self.features)?;
        let rows = |total: u64| gpu.uniform("rows", &[n_rows as u32, total as u32, 0, 0]);
        let covering_rows = Workgroups::Covering(n_rows as u64 + 1);
        if window.candidates == 0 {
            accept(0)?;
            let indices: Buffer<u32> = gpu.buffer("neighbour indices", 0)?;
            let mut commands = gpu.commands("extract nothing");
            let binds = [(&rows(0)?).into(), (&indices).into(), (&offsets).into()];
            commands.stage("sort").dispatch(&find_rows, &binds, covering_rows);
            return Ok(Extracted { offsets, indices, stages: commands.run()? });
        }
        let n = window.candidates as usize;
        let Matches { counts, total, mut stages, .. } = self.count_matches(gpu, window, false)?;
        accept(total)?;
        let available = gpu.limits().binding_bytes;
        if total * 4 > available {
            return Err(Error::OutOfDeviceMemory { what: "neighbour indices".into(), needed: total * 4, available });
        }
        let n_matches = total as usize;
        let starts = gpu.buffer("starts of matches", n)?;
        let ids: Buffer<u32> = gpu.buffer("matched points", n_matches)?;
        let slots: Buffer<u32> = gpu.buffer("matched queries", n_matches)?;
        let accesses = [READS, &[Read, ReadWrite, ReadWrite]].concat();
        let mut binds = self.extraction_inputs(window);
        binds.extend([(&starts).into(), (&ids).into(), (&slots).into()]);
        let write_matches = kernel(gpu, (MODULE, "write_matches"), &accesses, &self.features)?;
        let mut commands = gpu.commands("extract matches");
        commands.stage("extract");
        GpuScan::new(gpu, n)?.record(&mut commands, &counts, &starts, n)?;
        commands.dispatch(&write_matches, &binds, Workgroups::Covering(n as u64));
        commands.stage("sort");
        // Stable, so matches of a query stay in the order of its candidates.
        let bits = 0..(u32::BITS - (n_rows as u32).leading_zeros()).max(1);
        GpuRadixSort::new(gpu, n_matches)?.record(&mut commands, &slots, &ids, n_matches, bits)?;
        commands.dispatch(&find_rows, &[(&rows(total)?).into(), (&slots).into(), (&offsets).into()], covering_rows);
        stages.extend(commands.run()?);
        Ok(Extracted { offsets, indices: ids, stages })
    }
}
