//! Searches of a structure's own points two at a time.
//!
//! Points next to each other in the structure's order have most of their candidates in common: an invocation that loads a candidate once and
//! tests it for both loads little more than for one. Single queries remain for the rest: other queries, radii of their own, structures and
//! devices that the kernel does not serve, and few points, which would leave the device idle.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::loops;
use super::visit::{self, QueryBuffers};
use crate::Result;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::query::{FixedRadius, Radius, Report};
use crate::structure::GpuStructure;

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 128;

/// Points of a structure whose places fit beside the number of a row: `PLACE_BITS` in expand_pairs.wesl.
const MOST_POINTS: usize = 1 << 28;

/// `PairSearch` in find_pairs.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct PairSearch {
    /// Most words of masks that are kept of a pair.
    pub capacity: u32,
    /// Number of pairs.
    pub n_pairs: u32,
    /// The radius of all.
    pub radius: f32,
    /// Unused.
    pub padding: u32,
}

/// What the kernel does with neighbours: conditions of find_pairs.wesl, of which one holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Task {
    Count,
    KeepMasks,
    Mark,
    Fill,
}

/// Buffers that masks of pairs are kept in.
#[derive(Debug)]
pub(super) struct PairMasks {
    /// `[pairs]` words that a pair has or would need.
    pub(super) words: Buffer<u32>,
    /// `[capacity · pairs]`.
    pub(super) masks: Buffer<[u32; 4]>,
    /// `[pairs]` the counts of both in the structure's order.
    pub(super) lengths: Buffer<[u32; 2]>,
}

/// A search of all points of a structure in pairs.
#[derive(Debug)]
pub(super) struct Pairs {
    gpu: Gpu,
    module: &'static str,
    features: Vec<(&'static str, bool)>,
    bindings: Vec<(Access, Bind)>,
    search: Buffer<PairSearch>,
    n_pairs: usize,
}

impl Pairs {
    /// Where this question about these queries can be answered in pairs, and should be.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `OutOfMemory`, `DeviceLost`.
    pub(super) fn of<S: GpuStructure>(
        structure: &S,
        question: &FixedRadius<'_>,
        queries: &QueryBuffers,
    ) -> Result<Option<Self>> {
        let gpu = structure.gpu();
        let Radius::One(radius) = question.radius else { return Ok(None) };
        let own = queries.are_points() && queries.candidates().is_none() && queries.len() <= MOST_POINTS;
        let are_many = queries.len() as u64 >= visit::invocations_at_once(gpu);
        let Some(module) = structure.pairs_module(radius).filter(|_| own && are_many) else { return Ok(None) };
        if !loops::can_search_in_pairs(structure, radius)? {
            return Ok(None);
        }
        let n_pairs = queries.len().div_ceil(2);
        let search = PairSearch { capacity: structure.mask_words(), n_pairs: n_pairs as u32, radius, padding: 0 };
        let mut features = structure.features();
        features.push(("excludes", question.exclude_self));
        Ok(Some(Self {
            gpu: gpu.clone(),
            module,
            features,
            bindings: structure.bindings(),
            search: gpu.uniform("pair search", &search)?,
            n_pairs,
        }))
    }

    /// Memory for the masks: 16 bytes a word and pair.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`.
    pub(super) fn masks(&self, capacity: u32) -> Result<PairMasks> {
        let (words, masks) = self.words_and_masks(capacity)?;
        let lengths = self.gpu.buffer("row lengths in the order of the structure", self.n_pairs)?;
        Ok(PairMasks { words, masks, lengths })
    }

    /// Memory for the masks without the lengths of rows: as [`PairMasks`] has them.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`.
    pub(super) fn words_and_masks(&self, capacity: u32) -> Result<(Buffer<u32>, Buffer<[u32; 4]>)> {
        let words = self.gpu.buffer("words of pairs", self.n_pairs)?;
        Ok((words, self.gpu.buffer("neighbour masks", self.n_pairs * capacity as usize)?))
    }

    /// Number of pairs.
    pub(super) fn len(&self) -> usize {
        self.n_pairs
    }

    /// The kernel's module.
    pub(super) fn module(&self) -> &'static str {
        self.module
    }

    /// Records the counts: `[n]` by the caller's index.
    ///
    /// # Errors
    /// `KernelRejected`, `OutOfDeviceMemory`.
    pub(super) fn record_counts(&self, commands: &mut Commands, counts: &Buffer<u32>) -> Result<()> {
        self.record(commands, Task::Count, &[(Access::ReadWrite, counts.into())])
    }

    /// Records the counts, and the masks of pairs that have not more words than fit; adds the number of the others to `overflowed`.
    ///
    /// # Errors
    /// As [`Pairs::record_counts`].
    pub(super) fn record_masks(
        &self,
        commands: &mut Commands,
        counts: &Buffer<u32>,
        masks: &PairMasks,
        overflowed: &Buffer<u32>,
    ) -> Result<()> {
        let outputs: [Bind; 5] =
            [counts.into(), (&masks.words).into(), (&masks.masks).into(), (&masks.lengths).into(), overflowed.into()];
        self.record(commands, Task::KeepMasks, &outputs.map(|bind| (Access::ReadWrite, bind)))
    }

    /// Records the masks alone: `[pairs]` the words that a pair has or would need, and `[capacity · pairs]`.
    ///
    /// # Errors
    /// As [`Pairs::record_counts`].
    pub(super) fn record_marks(
        &self,
        commands: &mut Commands,
        words: &Buffer<u32>,
        masks: &Buffer<[u32; 4]>,
    ) -> Result<()> {
        let outputs: [Bind; 2] = [words.into(), masks.into()];
        self.record(commands, Task::Mark, &outputs.map(|bind| (Access::ReadWrite, bind)))
    }

    /// Records a second walk that writes the rows of pairs with too many words: from `starts` on, by the caller's index.
    ///
    /// # Errors
    /// As [`Pairs::record_counts`].
    pub(super) fn record_fill(
        &self,
        commands: &mut Commands,
        masks: &PairMasks,
        starts: &Buffer<u32>,
        indices: &Buffer<u32>,
    ) -> Result<()> {
        let bindings =
            [(Access::Read, (&masks.words).into()), (Access::Read, starts.into()), (Access::ReadWrite, indices.into())];
        self.record(commands, Task::Fill, &bindings)
    }

    fn record(&self, commands: &mut Commands, task: Task, more: &[(Access, Bind)]) -> Result<()> {
        let first = [(Access::Uniform, (&self.search).into())];
        let (accesses, binds): (Vec<Access>, Vec<Bind>) =
            first.into_iter().chain(self.bindings.iter().cloned()).chain(more.iter().cloned()).unzip();
        let pipeline = self.pipeline(task, &accesses)?;
        commands.dispatch(&pipeline, &binds, Workgroups::Covering(self.n_pairs as u64));
        Ok(())
    }

    fn pipeline(&self, task: Task, accesses: &[Access]) -> Result<Arc<Pipeline>> {
        let mut features = self.features.clone();
        features.extend([
            ("counts", task == Task::Count),
            ("keeps_masks", task == Task::KeepMasks),
            ("marks", task == Task::Mark),
            ("fills", task == Task::Fill),
        ]);
        self.gpu.prepare(&Kernel {
            features: &features,
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new(self.module, "find_pairs", accesses, WORKGROUP)
        })
    }

    /// Says in the report of a count that it was made in pairs.
    pub(super) fn name_in(&self, report: &mut Report) {
        report.search = "thread-a-pair";
        report.kernels = vec![self.module.to_owned()];
    }
}
