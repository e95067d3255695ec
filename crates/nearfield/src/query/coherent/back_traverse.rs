//! Phases I and II on the device: the candidate list of every pack, in windows of packs where it is too long for one.

use std::ops::Range;
use std::sync::Arc;

use super::pack::{self, Packs};
use super::sweep::Sweep;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::query::FixedRadius;
use crate::query::gpu::batch::windows;
use crate::structure::{DevicePoint, GpuAabbTree, GpuStructure};
use crate::{Error, Result};

pub(in crate::query) const MODULE: &str = "package::query::coherent::back_traverse";

/// Invocations of a workgroup of the kernels of the coherent search.
pub(super) const WORKGROUP: u32 = 128;

/// Bytes of an entry: a span of a query, or a candidate and its pack.
const ENTRY_BYTES: u64 = 8;

/// A kernel of the coherent search, under the conditions of the tree.
pub(super) fn kernel(
    gpu: &Gpu,
    (module, entry): (&str, &str),
    accesses: &[Access],
    features: &[(&str, bool)],
) -> Result<Arc<Pipeline>> {
    let constants = [("WORKGROUP", f64::from(WORKGROUP))];
    gpu.prepare(&Kernel { features, constants: &constants, ..Kernel::new(module, entry, accesses, WORKGROUP) })
}

/// Packs whose candidates are in memory together.
#[derive(Debug, Clone)]
pub(in crate::query) struct Window {
    /// Places of its queries in the order of the packs.
    pub(in crate::query) queries: Range<u32>,
    pub(super) candidates: u32,
    pub(super) sweep: Buffer<Sweep>,
    packs: Range<u32>,
}

/// Queries in packs, and the candidates of each.
#[derive(Debug)]
pub(in crate::query) struct Candidates {
    gpu: Gpu,
    layout: Bind,
    nodes: Bind,
    pub(super) points: Bind,
    pub(super) features: Vec<(&'static str, bool)>,
    pub(super) radii: Buffer<f32>,
    pub(super) packs: Option<Packs>,
    starts: Buffer<u32>,
    /// `[n_queries + candidates of a window]`: see back_traverse.wesl.
    pub(super) entries: Buffer<[u32; 2]>,
    pub(in crate::query) windows: Vec<Window>,
    /// Candidates of all packs.
    pub(super) total: u64,
    /// Those of the pack that has most.
    pub(in crate::query) largest: u32,
    pub(super) n_queries: usize,
    pub(in crate::query) stages: Vec<StageTime>,
}

/// Queries on the device that are to be packed.
#[derive(Debug, Clone, Copy)]
pub(in crate::query) struct Asking<'a> {
    pub(in crate::query) queries: &'a Buffer<DevicePoint>,
    /// By slot, or one for all.
    pub(in crate::query) radii: &'a Buffer<f32>,
    /// The caller's index that has slot 0.
    pub(in crate::query) first_id: u32,
    /// Whether they are the tree's points in its order.
    pub(in crate::query) own: bool,
}

/// Nodes that each pack has looked at, where they are counted.
pub(super) type Visited = Option<Buffer<u32>>;

impl Candidates {
    /// Packs the queries and finds the candidates of each pack.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`; `Unsupported` where the device would end the loops of the traversal; `DeviceLost`.
    pub(in crate::query) fn find(tree: &GpuAabbTree, question: &FixedRadius<'_>, asking: Asking<'_>) -> Result<Self> {
        Ok(Self::find_counted(tree, question, asking, false)?.0)
    }

    pub(super) fn find_counted(
        tree: &GpuAabbTree,
        question: &FixedRadius<'_>,
        asking: Asking<'_>,
        counted: bool,
    ) -> Result<(Self, Visited)> {
        let gpu = GpuStructure::gpu(tree);
        let n = asking.queries.len();
        check_rounds(tree)?;
        let bindings = tree.bindings();
        let [(_, layout), (_, points), (_, nodes)] = &bindings[..] else {
            unreachable!("a tree should have three bindings")
        };
        let none = |packs, starts, entries| Self {
            gpu: gpu.clone(),
            layout: layout.clone(),
            nodes: nodes.clone(),
            points: points.clone(),
            features: [&tree.features()[..], &[("counted", counted)]].concat(),
            radii: asking.radii.clone(),
            packs,
            starts,
            entries,
            windows: Vec::new(),
            total: 0,
            largest: 0,
            n_queries: n,
            stages: Vec::new(),
        };
        if n == 0 || GpuStructure::is_empty(tree) {
            // Every span is empty.
            let mut found =
                none(None, gpu.buffer("starts of packs", 1)?, gpu.upload("no candidates", &vec![[0; 2]; n])?);
            let sweep = gpu.uniform("sweep", &Sweep { n_queries: n as u32, ..bytemuck::Zeroable::zeroed() })?;
            found.windows.push(Window { queries: 0..n as u32, candidates: 0, sweep, packs: 0..0 });
            return Ok((found, None));
        }
        let packs = pack::pack(tree, asking.queries, asking.own)?;
        let starts = gpu.buffer("starts of packs", packs.len + 1)?;
        // Until the number of candidates is known there is no place for them.
        let mut found = none(Some(packs), starts, gpu.buffer("no candidates", 0)?);
        let (own_radius, radius) = question.radius.parameters();
        let n_packs = found.n_packs() as u32;
        let sweep = Sweep {
            n_queries: n as u32,
            first_id: asking.first_id,
            flags: own_radius | u32::from(question.exclude_self) << 1,
            radius,
            n_packs,
            first_pack: 0,
            end_pack: n_packs,
            n_candidates: 0,
        };
        let visited = found.find_all(&sweep, counted)?;
        Ok((found, visited))
    }

    /// Number of packs.
    pub(super) fn n_packs(&self) -> usize {
        self.packs.as_ref().map_or(0, |packs| packs.len)
    }

    /// `[n]` the queries in the order of the packs; `None` where there is no query or no point.
    pub(in crate::query) fn queries(&self) -> Option<&Buffer<DevicePoint>> {
        self.packs.as_ref().map(|packs| &packs.queries)
    }

    /// The bindings of `package::query::coherent::candidates`.
    pub(in crate::query) fn bindings(&self) -> [Bind; 3] {
        [self.layout.clone(), self.points.clone(), (&self.entries).into()]
    }

    /// The uniform of the tree.
    pub(super) fn layout(&self) -> &Bind {
        &self.layout
    }

    /// Counts the candidates, cuts windows that fit, and writes the candidates where one window has all.
    fn find_all(&mut self, sweep: &Sweep, counted: bool) -> Result<Visited> {
        let gpu = self.gpu.clone();
        let n_packs = self.n_packs();
        let counts: Buffer<u32> = gpu.buffer("candidates of packs", n_packs)?;
        let visited = counted.then(|| gpu.buffer("nodes visited by packs", n_packs)).transpose()?;
        let (sum, largest) = (gpu.buffer("number of candidates", 1)?, gpu.buffer("most candidates of a pack", 1)?);
        let mut accesses = READS.to_vec();
        accesses.resize(READS.len() + 2 + usize::from(counted), Access::ReadWrite);
        let count_candidates = kernel(&gpu, (MODULE, "count_candidates"), &accesses, &self.features)?;
        let mut binds = self.inputs((&gpu.uniform("sweep", sweep)?).into());
        binds.extend([(&counts).into(), (&self.entries).into()]);
        binds.extend(visited.as_ref().map(Bind::from));
        let mut commands = gpu.commands("count candidates");
        commands.stage("traverse").dispatch(&count_candidates, &binds, Workgroups::Covering(n_packs as u64));
        GpuScan::new(&gpu, n_packs)?.record(&mut commands, &counts, &self.starts, n_packs)?;
        let reduce = GpuReduce::new(&gpu)?;
        reduce.record_sum(&mut commands, &counts, n_packs, &sum)?;
        reduce.record_largest(&mut commands, &counts, n_packs, &largest)?;
        let mut stages = commands.run()?;
        self.total = gpu.read(&sum)?[0];
        self.largest = gpu.read(&largest)?[0];
        let capacity = self.capacity()?;
        self.entries = gpu.buffer("candidates", self.n_queries + capacity as usize)?;
        let ranges: Vec<(Range<usize>, u64)> = if self.total <= capacity {
            vec![(0..n_packs, self.total)]
        } else {
            let counts = gpu.read(&counts)?;
            let sum = |range: &Range<usize>| counts[range.clone()].iter().map(|&c| u64::from(c)).sum();
            windows(&counts, capacity).into_iter().map(|range| (range.clone(), sum(&range))).collect()
        };
        self.cut_windows(sweep, ranges)?;
        if let [window] = &self.windows[..] {
            let mut commands = gpu.commands("write candidates");
            commands.stage("traverse");
            self.record_writing(&mut commands, window)?;
            stages.extend(commands.run()?);
        }
        self.stages = self.packs.as_ref().map_or(Vec::new(), |packs| packs.stages.clone());
        self.stages.extend(stages);
        Ok(visited)
    }

    /// Candidates that a window may have: all, or as many as fit a binding and half of the memory that is left; but the
    /// largest pack must fit.
    fn capacity(&self) -> Result<u64> {
        let (spans, largest) = (self.n_queries as u64 * ENTRY_BYTES, u64::from(self.largest));
        let available = self.gpu.limits().binding_bytes;
        let fitting = (self.gpu.memory_available() / 2).min(available).saturating_sub(spans) / ENTRY_BYTES;
        let needed = spans + largest * ENTRY_BYTES;
        if needed > available {
            return Err(Error::OutOfDeviceMemory { what: "candidates of a pack".into(), needed, available });
        }
        Ok(self.total.min(fitting.max(largest)).min(u64::from(u32::MAX)))
    }

    fn cut_windows(&mut self, sweep: &Sweep, ranges: Vec<(Range<usize>, u64)>) -> Result<()> {
        let n = self.n_queries as u32;
        let first = match (&self.packs, ranges.len()) {
            (Some(packs), 2..) => self.gpu.read_range(&packs.first, 0..packs.len)?,
            _ => Vec::new(),
        };
        for (range, candidates) in ranges {
            // A single window has all queries; `first` is then not read.
            let start = if range.start == 0 { 0 } else { first[range.start] };
            let end = first.get(range.end).copied().unwrap_or(n);
            let packs = range.start as u32..range.end as u32;
            let (first_pack, end_pack, n_candidates) = (packs.start, packs.end, candidates as u32);
            let sweep = self.gpu.uniform("sweep", &Sweep { first_pack, end_pack, n_candidates, ..*sweep })?;
            self.windows.push(Window { queries: start..end, candidates: n_candidates, sweep, packs });
        }
        Ok(())
    }

    /// What all kernels of phase II read.
    fn inputs(&self, sweep: Bind) -> Vec<Bind> {
        let packs = self.packs.as_ref().expect("there should be packs");
        let [queries, leaves, first] = [Bind::from(&packs.queries), (&packs.leaves).into(), (&packs.first).into()];
        vec![sweep, self.layout.clone(), self.nodes.clone(), queries, (&self.radii).into(), leaves, first]
    }

    fn record_writing(&self, commands: &mut Commands, window: &Window) -> Result<()> {
        let accesses = [READS, &[Access::Read, Access::ReadWrite]].concat();
        let mut binds = self.inputs((&window.sweep).into());
        binds.extend([(&self.starts).into(), (&self.entries).into()]);
        let made = |entry| kernel(&self.gpu, (MODULE, entry), &accesses, &self.features);
        let (n_packs, n_queries) = (window.packs.len() as u64, window.queries.len() as u64);
        commands.dispatch(&made("write_candidates")?, &binds, Workgroups::Covering(n_packs));
        commands.dispatch(&made("place_spans")?, &binds, Workgroups::Covering(n_queries));
        Ok(())
    }

    /// Records bringing the candidates of a window into memory, if they are not there.
    pub(in crate::query) fn record_window(&self, commands: &mut Commands, window: &Window) -> Result<()> {
        if self.windows.len() > 1 { self.record_writing(commands, window) } else { Ok(()) }
    }
}

/// Accesses of what all kernels of phase II read.
const READS: &[Access] =
    &[Access::Uniform, Access::Uniform, Access::Read, Access::Read, Access::Read, Access::Read, Access::Read];

/// Checks that the device does not end the loops of a traversal.
fn check_rounds(tree: &GpuAabbTree) -> Result<()> {
    let gpu = GpuStructure::gpu(tree);
    let rounds = most_rounds(tree) + u64::from(pack::MOST_QUERIES);
    let Some(limit) = gpu.limits().loop_rounds.filter(|&limit| rounds > u64::from(limit)) else { return Ok(()) };
    Err(Error::Unsupported {
        what: format!(
            "a coherent search of {} points on {}, which ends the loops of a kernel after {limit} rounds,",
            GpuStructure::len(tree),
            gpu.name()
        ),
        advice: "use the search `packed`, larger leaves or the CPU",
    })
}

/// The most rounds of a traversal from a leaf: a look at every node, and eight points a round.
pub(super) fn most_rounds(tree: &GpuAabbTree) -> u64 {
    let shape = tree.shape();
    let leaf = shape.n_points().div_ceil(shape.n_leaves().max(1)) as u64;
    shape.n_nodes() as u64 + shape.n_leaves() as u64 * leaf.div_ceil(8) + u64::from(shape.depth()) + 2
}
