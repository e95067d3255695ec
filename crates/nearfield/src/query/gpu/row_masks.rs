//! The fast list: one walk that counts and keeps hits as masks, starts of rows, and an expansion with dense stores.
//!
//! A row's cost is in its stores: written one index at a time by the query's own invocation they scatter over memory.
//! Masks of 32 candidates a word are an eighth of the bytes, and many invocations write a row's neighbours side by side. Queries with more
//! words than the masks hold are filled by a second walk. Where points are searched in pairs, masks are those of pairs.

use super::loops::VisitorRounds;
use super::on_device::{GpuNeighborRows, GpuNeighbors, ListSize};
use super::pairs::{PairMasks, Pairs};
use super::visit::{self, QueryBuffers, VisitorCode};
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Workgroups};
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::query::{FixedRadius, Report, RowOrder};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Invocations of a workgroup that expands masks.
const EXPAND_WORKGROUP: u32 = 128;

/// Invocations that write a row from the masks of its query, and a pair of rows from theirs.
const EXPAND_TEAM: u64 = 32;
const EXPAND_PAIR_TEAM: u64 = 16;

/// Rows of a workgroup that reserves places.
const RESERVE_WORKGROUP: u32 = 256;

const FIND: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::row_masks"),
    features: &[("masks", true)],
    accesses: &[Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::ReadWrite, Access::Uniform],
    rounds: VisitorRounds { each: 0, finish: 0 },
    combines: false,
};

const FILL_OVERFLOWED: VisitorCode<'static> = VisitorCode {
    source: Fill::Module("package::query::fill_overflowed"),
    features: &[],
    accesses: &[Access::Read, Access::ReadWrite, Access::Read, Access::Uniform],
    rounds: VisitorRounds { each: 0, finish: 0 },
    combines: false,
};

/// The indices of the structure's points, where this question can be answered with masks: only indices, in the order
/// in which they are found, and masks of all queries within one binding. Candidate lists have no runs to make masks of.
pub(super) fn applies<'a, S: GpuStructure>(structure: &'a S, question: &FixedRadius<'_>) -> Option<&'a Buffer<u32>> {
    let plain = !question.distances && question.order == RowOrder::Unspecified;
    let mask_bytes = question.len(structure.len()) as u64 * u64::from(structure.mask_words()) * 8;
    let walks = structure.coherent_tree().is_none();
    structure.ids().filter(|_| walks && plain && mask_bytes <= structure.gpu().limits().binding_bytes)
}

/// The list by masks, rows in query order; `None` where the device has no memory for masks beside the list, which takes less by two passes. `accept` sees
/// the size before memory is taken for the entries; rows have no order within.
pub(super) fn list_on_device<S: GpuStructure>(
    structure: &S,
    ids: &Buffer<u32>,
    question: &FixedRadius<'_>,
    accept: impl FnOnce(ListSize) -> Result<RowOrder>,
) -> Result<Option<GpuNeighbors>> {
    let gpu = structure.gpu();
    let n = question.len(structure.len());
    let starts = RowStarts { by_query: gpu.buffer("row offsets", n + 1)?, by_place: None };
    let Some(mut search) = if_it_fits(MaskSearch::new(structure, ids, question))? else { return Ok(None) };
    let found = search.find(|search, commands, sum| {
        GpuScan::new(gpu, n)?.record(commands, &search.counts, &starts.by_query, n)?;
        GpuReduce::new(gpu)?.record_sum(commands, &search.counts, n, sum)
    });
    let Some(total) = if_it_fits(found)? else { return Ok(None) };
    accept(ListSize { entries: total, longest_row: 0 })?;
    let Some(indices) = if_it_fits(search.write_rows(&starts, total))? else { return Ok(None) };
    Ok(Some(GpuNeighbors { offsets: starts.by_query, indices, dist2: None, report: search.report }))
}

/// `None` for what the device has no memory for.
fn if_it_fits<T>(made: Result<T>) -> Result<Option<T>> {
    match made {
        Err(Error::OutOfDeviceMemory { .. }) => Ok(None),
        made => made.map(Some),
    }
}

/// The list by masks, rows in the order in which their workgroups reserve places.
pub(super) fn rows_on_device<S: GpuStructure>(
    structure: &S,
    ids: &Buffer<u32>,
    question: &FixedRadius<'_>,
) -> Result<GpuNeighborRows> {
    let gpu = structure.gpu();
    let n = question.len(structure.len());
    let mut search = MaskSearch::new(structure, ids, question)?;
    search.report.search = "row-masks, completion order";
    search.report.kernels.push("package::query::reserve_rows".to_owned());
    let by_place = search.masks.are_of_pairs().then(|| gpu.buffer("row starts in the order of the structure", n));
    let starts = RowStarts { by_query: gpu.buffer("row starts", n)?, by_place: by_place.transpose()? };
    let total = search.find(|search, commands, sum| {
        search.record_reservation(commands, &starts)?;
        GpuReduce::new(gpu)?.record_sum(commands, &search.counts, n, sum)
    })?;
    let indices = search.write_rows(&starts, total)?;
    Ok(GpuNeighborRows { starts: starts.by_query, lengths: search.counts, indices, report: search.report })
}

/// Where rows begin.
struct RowStarts {
    by_query: Buffer<u32>,
    /// The same in the order of the structure, in which the rows then follow each other.
    by_place: Option<Buffer<u32>>,
}

/// Where the neighbours are, 32 candidates a word.
enum Masks {
    /// Of each query its own, with the capacity and the number of queries.
    OfQueries { words: Buffer<u32>, masks: Buffer<[u32; 4]>, batch: Buffer<[u32; 4]> },
    /// Of pairs, with the capacity and the numbers of pairs and points.
    OfPairs { pairs: Box<Pairs>, masks: PairMasks, batch: Buffer<[u32; 4]> },
}

impl Masks {
    fn new<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, queries: &QueryBuffers) -> Result<Self> {
        let (gpu, n, capacity) = (structure.gpu(), queries.len(), structure.mask_words());
        if let Some(pairs) = Pairs::of(structure, question, queries)? {
            let batch = gpu.uniform("mask capacity", &[capacity, pairs.len() as u32, n as u32, 0])?;
            return Ok(Self::OfPairs { masks: pairs.masks(capacity)?, batch, pairs: Box::new(pairs) });
        }
        Ok(Self::OfQueries {
            words: gpu.buffer("words of queries", n)?,
            // Two words an element.
            masks: gpu.buffer("neighbour masks", n * capacity as usize / 2)?,
            batch: gpu.uniform("mask capacity", &[capacity, n as u32, 0, 0])?,
        })
    }

    fn are_of_pairs(&self) -> bool {
        matches!(self, Self::OfPairs { .. })
    }
}

/// One search by masks: its buffers and its report.
struct MaskSearch<'a, S> {
    structure: &'a S,
    ids: &'a Buffer<u32>,
    question: &'a FixedRadius<'a>,
    queries: QueryBuffers,
    counts: Buffer<u32>,
    masks: Masks,
    /// How many queries or pairs have more words than fit.
    overflowed: Buffer<u32>,
    /// The same on the host, once the neighbours are found.
    n_overflowed: u32,
    report: Report,
}

impl<'a, S: GpuStructure> MaskSearch<'a, S> {
    fn new(structure: &'a S, ids: &'a Buffer<u32>, question: &'a FixedRadius<'a>) -> Result<Self> {
        let gpu = structure.gpu();
        let queries = QueryBuffers::in_search_order(structure, question)?;
        let masks = Masks::new(structure, question, &queries)?;
        let mut report = visit::report(structure, "row-masks", &["package::query::row_masks"]);
        if let Masks::OfPairs { pairs, .. } = &masks {
            report.kernels = vec![pairs.module().to_owned()];
        }
        Ok(Self {
            structure,
            ids,
            question,
            counts: gpu.buffer("neighbour counts", queries.len())?,
            queries,
            masks,
            overflowed: gpu.buffer("overflowed queries", 1)?,
            n_overflowed: 0,
            report,
        })
    }

    /// Counts, keeps masks, and places rows with `place(search, commands, sum)`, which also records the sum of the
    /// counts. Returns the sum.
    fn find(&mut self, place: impl FnOnce(&Self, &mut Commands, &Buffer<u64>) -> Result<()>) -> Result<u64> {
        let gpu = self.structure.gpu();
        let sum: Buffer<u64> = gpu.buffer("number of entries", 1)?;
        let mut commands = gpu.commands("find neighbours");
        commands.stage("count").clear(&self.overflowed);
        match &self.masks {
            Masks::OfQueries { words, masks, batch } => {
                let binds: [Bind; 5] =
                    [(&self.counts).into(), words.into(), masks.into(), (&self.overflowed).into(), batch.into()];
                visit::record(&mut commands, self.structure, self.question, &self.queries, &FIND, &binds)?;
            }
            Masks::OfPairs { pairs, masks, .. } => {
                pairs.record_masks(&mut commands, &self.counts, masks, &self.overflowed)?;
            }
        }
        commands.stage("scan");
        place(self, &mut commands, &sum)?;
        let (sum, overflowed) = (commands.read_back(&sum)?, commands.read_back(&self.overflowed)?);
        super::answers::add_stages(&mut self.report, &commands.run()?);
        let total = sum.values()?[0];
        self.n_overflowed = overflowed.values()?[0];
        let available = gpu.limits().binding_bytes;
        if total * 4 > available {
            let what = format!("neighbour indices ({} rows)", self.counts.len());
            return Err(Error::OutOfDeviceMemory { what, needed: total * 4, available });
        }
        Ok(total)
    }

    /// Records a place for every row, in the order in which workgroups come by.
    fn record_reservation(&self, commands: &mut Commands, starts: &RowStarts) -> Result<()> {
        let gpu = self.structure.gpu();
        let n = self.counts.len();
        let n_rows = gpu.uniform("reservation parameters", &[n as u32, 0, 0, 0])?;
        let taken: Buffer<u32> = gpu.buffer("reserved places", 1)?;
        let mut accesses = vec![Access::Uniform, Access::Read, Access::ReadWrite, Access::ReadWrite];
        let mut binds: Vec<Bind> =
            vec![(&n_rows).into(), (&self.counts).into(), (&starts.by_query).into(), (&taken).into()];
        if let (Masks::OfPairs { masks, .. }, Some(by_place)) = (&self.masks, &starts.by_place) {
            binds[1] = (&masks.lengths).into();
            accesses.extend([Access::Read, Access::ReadWrite]);
            binds.extend([self.ids.into(), by_place.into()]);
        }
        let kernel = Kernel {
            features: &[("by_place", starts.by_place.is_some())],
            constants: &[("WORKGROUP", f64::from(RESERVE_WORKGROUP))],
            ..Kernel::new("package::query::reserve_rows", "reserve_rows", &accesses, RESERVE_WORKGROUP)
        };
        commands.clear(&taken).dispatch(&gpu.prepare(&kernel)?, &binds, Workgroups::Covering(n as u64));
        Ok(())
    }

    /// Writes all rows where `starts` says.
    fn write_rows(&mut self, starts: &RowStarts, total: u64) -> Result<Buffer<u32>> {
        let gpu = self.structure.gpu();
        let indices: Buffer<u32> = gpu.buffer("neighbour indices", total as usize)?;
        let mut commands = gpu.commands("write rows");
        commands.stage("fill");
        self.record_expansion(&mut commands, starts, &indices)?;
        if self.n_overflowed > 0 {
            commands.stage("fill long rows");
            self.record_long_rows(&mut commands, &starts.by_query, &indices)?;
        }
        super::answers::add_stages(&mut self.report, &commands.run()?);
        Ok(indices)
    }

    /// Records the rows whose masks are whole.
    fn record_expansion(&mut self, commands: &mut Commands, starts: &RowStarts, indices: &Buffer<u32>) -> Result<()> {
        let (module, entry, invocations, mut binds): (_, _, _, Vec<Bind>) = match &self.masks {
            Masks::OfQueries { words, masks, batch } => (
                "package::query::expand_masks",
                "expand_masks",
                EXPAND_TEAM * self.counts.len() as u64,
                vec![batch.into(), words.into(), masks.into(), (&starts.by_query).into(), (&self.counts).into()],
            ),
            Masks::OfPairs { pairs, masks, batch } => (
                "package::query::expand_pairs",
                "expand_pairs",
                EXPAND_PAIR_TEAM * pairs.len() as u64,
                vec![
                    batch.into(),
                    (&masks.words).into(),
                    (&masks.masks).into(),
                    starts.by_place.as_ref().unwrap_or(&starts.by_query).into(),
                    (&masks.lengths).into(),
                ],
            ),
        };
        binds.extend([self.ids.into(), indices.into()]);
        self.report.kernels.push(module.to_owned());
        if indices.is_empty() {
            return Ok(());
        }
        let accesses = [vec![Access::Uniform], vec![Access::Read; 5], vec![Access::ReadWrite]].concat();
        let kernel = Kernel {
            features: &[("in_order", starts.by_place.is_some())],
            constants: &[("WORKGROUP", f64::from(EXPAND_WORKGROUP))],
            ..Kernel::new(module, entry, &accesses, EXPAND_WORKGROUP)
        };
        let pipeline = self.structure.gpu().prepare(&kernel)?;
        commands.dispatch(&pipeline, &binds, Workgroups::Covering(invocations));
        Ok(())
    }

    /// Records the rows with more words than the masks hold, by a second walk.
    fn record_long_rows(&mut self, commands: &mut Commands, starts: &Buffer<u32>, indices: &Buffer<u32>) -> Result<()> {
        match &self.masks {
            Masks::OfQueries { words, batch, .. } => {
                self.report.kernels.push("package::query::fill_overflowed".to_owned());
                let binds: [Bind; 4] = [starts.into(), indices.into(), words.into(), batch.into()];
                visit::record(commands, self.structure, self.question, &self.queries, &FILL_OVERFLOWED, &binds)
            }
            Masks::OfPairs { pairs, masks, .. } => {
                self.report.kernels.push(format!("{} for long rows", pairs.module()));
                pairs.record_fill(commands, masks, starts, indices)
            }
        }
    }
}
