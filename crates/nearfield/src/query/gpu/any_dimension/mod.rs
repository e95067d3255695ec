//! Fixed-radius questions to a tree of any dimension on the GPU: counts and lists by the searches `Primary` and `Coherent`.
//!
//! A search runs in parts, of queries or of packs: on all of them at once, or where device memory or a binding is too
//! small on halves, and halves of those. Each part counts the neighbours by the caller's index; a list then scans the
//! counts and writes every neighbour where its row stands. Parts have different queries, so their rows add up.

mod coherent;
mod primary;
mod queries;

use std::ops::Range;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};

use self::coherent::Coherent;
use self::primary::Primary;
pub use self::queries::{Asked, SearchN};
use super::answers::add_stages;
use super::batch::halving;
use crate::gpu::{Buffer, Gpu};
use crate::parallel::reduce::GpuReduce;
use crate::parallel::scan::GpuScan;
use crate::query::any_dimension::{entry_limit, order_rows, too_large};
use crate::query::{CountsN, FixedRadiusN, NeighborsN, Report, SearchWork, rows};
use crate::structure::{GpuAabbTreeN, TreeSearch};
use crate::{Error, Result};

/// `HitN` in queries.wesl.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct HitN {
    /// The caller's index of the point.
    pub index: u32,
    /// Squared distance.
    pub dist2: f32,
}

/// A search that finds neighbours part by part.
trait PartSearch {
    /// What the count leaves for the fill.
    type Counted;

    /// Number of parts that can be searched by themselves.
    fn n_parts(&self) -> usize;

    /// Kernels of a count and of a list.
    fn kernels(&self) -> &'static [&'static str];

    /// Adds the number of neighbours of the part's queries to `counts`, by the caller's index.
    fn count(&self, part: Range<usize>, counts: &Buffer<u32>, found: &mut Found) -> Result<Self::Counted>;

    /// Writes the neighbours of the part's queries where `offsets` say.
    fn fill(
        &self,
        part: Range<usize>,
        counted: Self::Counted,
        rows: (&Buffer<u32>, &Buffer<HitN>),
        report: &mut Report,
    ) -> Result<()>;
}

/// What the parts have found and done.
#[derive(Debug, Default)]
struct Found {
    work: SearchWork,
    report: Report,
}

/// Rows of one part, in the caller's order; empty for the queries of other parts.
struct PartRows {
    offsets: Vec<u32>,
    hits: Vec<HitN>,
}

impl GpuAabbTreeN {
    /// Number of neighbours of every query.
    ///
    /// It differs from the CPU at most where |distance − radius| is within (D + 3) / 2 ulp of the radius.
    ///
    /// # Errors
    /// See [`FixedRadiusN::validate`]; `InvalidSetting` for another dimension, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn count<const D: usize>(&self, question: &FixedRadiusN<'_, f32, D>) -> Result<CountsN> {
        self.check_dimension(D)?;
        question.validate(self.len())?;
        let mut found = self.begin();
        match self.settings().search {
            TreeSearch::Primary => count(self, &Primary::new(self, question, &mut found)?, question, found),
            _ => count(self, &Coherent::new(self, question, &mut found)?, question, found),
        }
    }

    /// Neighbours of every query.
    ///
    /// It differs from the CPU as [`GpuAabbTreeN::count`]; rows by `Coherent` stand in ascending order of index where the
    /// question asks for none, so that they are the same from run to run.
    ///
    /// # Errors
    /// As [`GpuAabbTreeN::count`]; `OutOfMemory` where the answer would pass the question's limit or the memory of the
    /// host.
    pub fn list<const D: usize>(&self, question: &FixedRadiusN<'_, f32, D>) -> Result<NeighborsN<f32>> {
        self.check_dimension(D)?;
        question.validate(self.len())?;
        let mut found = self.begin();
        match self.settings().search {
            TreeSearch::Primary => list(self, &Primary::new(self, question, &mut found)?, question, found),
            _ => {
                let by_index = crate::query::RowOrder::Index;
                let is_free = question.order == crate::query::RowOrder::Unspecified;
                let question = FixedRadiusN { order: if is_free { by_index } else { question.order }, ..*question };
                list(self, &Coherent::new(self, &question, &mut found)?, &question, found)
            }
        }
    }

    fn begin(&self) -> Found {
        let search = self.settings().search.name();
        let device = self.gpu().name().to_owned();
        Found { report: Report { structure: "aabb-tree-n", search, device, ..Report::default() }, ..Found::default() }
    }
}

/// Runs `ask` on all parts, in halves where device memory is short; undoes what a failed part has reported.
fn in_parts<S: PartSearch>(
    search: &S,
    found: &mut Found,
    mut ask: impl FnMut(Range<usize>, &mut Found) -> Result<()>,
) -> Result<()> {
    found.report.kernels.extend(search.kernels().iter().map(|&kernel| kernel.to_owned()));
    let batches = halving(search.n_parts(), 1, |part| {
        let (n_stages, work) = (found.report.stages.len(), found.work);
        let asked = ask(part, found);
        if asked.is_err() {
            found.report.stages.truncate(n_stages);
            found.work = work;
        }
        asked
    })?;
    found.report.batches = batches.max(1);
    Ok(())
}

/// Zeros, one for each query.
fn cleared_counts(gpu: &Gpu, n_queries: usize) -> Result<Buffer<u32>> {
    let counts = gpu.buffer("neighbour counts", n_queries)?;
    let mut commands = gpu.commands("clear counts");
    commands.clear(&counts);
    commands.submit()?;
    Ok(counts)
}

fn count<S: PartSearch, const D: usize>(
    tree: &GpuAabbTreeN,
    search: &S,
    question: &FixedRadiusN<'_, f32, D>,
    mut found: Found,
) -> Result<CountsN> {
    let (gpu, n_queries, start) = (tree.gpu(), question.queries.len(tree.len()), Instant::now());
    let mut counts = vec![0; n_queries];
    in_parts(search, &mut found, |part, found| {
        let buffer = cleared_counts(gpu, n_queries)?;
        search.count(part, &buffer, found)?;
        let read = Instant::now();
        counts.iter_mut().zip(gpu.read(&buffer)?).for_each(|(sum, count)| *sum += count);
        found.report.host_stage("read back", read);
        Ok(())
    })?;
    found.report.host_stage("total", start);
    Ok(CountsN { counts, work: found.work, report: found.report })
}

fn list<S: PartSearch, const D: usize>(
    tree: &GpuAabbTreeN,
    search: &S,
    question: &FixedRadiusN<'_, f32, D>,
    mut found: Found,
) -> Result<NeighborsN<f32>> {
    let (gpu, n_queries, start) = (tree.gpu(), question.queries.len(tree.len()), Instant::now());
    let limit = entry_limit(question, n_queries);
    let (mut parts, mut entries): (Vec<PartRows>, u64) = (Vec::new(), 0);
    in_parts(search, &mut found, |part, found| {
        let counts = cleared_counts(gpu, n_queries)?;
        let counted = search.count(part.clone(), &counts, found)?;
        let offsets = gpu.buffer("row offsets", n_queries + 1)?;
        let sum: Buffer<u64> = gpu.buffer("number of entries", 1)?;
        let mut commands = gpu.commands("scan counts");
        commands.stage("scan");
        GpuScan::new(gpu, n_queries)?.record(&mut commands, &counts, &offsets, n_queries)?;
        GpuReduce::new(gpu)?.record_sum(&mut commands, &counts, n_queries, &sum)?;
        add_stages(&mut found.report, &commands.run()?);
        let total = gpu.read(&sum)?[0];
        if entries + total > limit {
            let counted = tree.count(question)?;
            return Err(too_large(question, n_queries, counted.summary().total));
        }
        let hits = gpu.buffer("neighbours", total as usize)?;
        search.fill(part, counted, (&offsets, &hits), &mut found.report)?;
        let read = Instant::now();
        parts.push(PartRows { offsets: gpu.read(&offsets)?, hits: gpu.read(&hits)? });
        entries += total;
        found.report.host_stage("read back", read);
        Ok(())
    })?;
    let assemble = Instant::now();
    let mut neighbors = assemble_rows(&parts, n_queries)?;
    order_rows(&mut neighbors, question.order);
    found.report.host_stage("assemble", assemble);
    found.report.host_stage("total", start);
    (neighbors.work, neighbors.report) = (found.work, found.report);
    Ok(neighbors)
}

/// The rows of all parts, one after the other in query order.
fn assemble_rows(parts: &[PartRows], n_queries: usize) -> Result<NeighborsN<f32>> {
    let n_entries: usize = parts.iter().map(|part| part.hits.len()).sum();
    let (mut indices, mut dist2) = (rows::zeroed(n_entries)?, rows::zeroed(n_entries)?);
    let (mut offsets, mut end) = (Vec::with_capacity(n_queries + 1), 0);
    offsets.push(0);
    for query in 0..n_queries {
        for part in parts {
            for hit in &part.hits[part.offsets[query] as usize..part.offsets[query + 1] as usize] {
                (indices[end], dist2[end]) = (hit.index, hit.dist2);
                end += 1;
            }
        }
        offsets.push(end as u64);
    }
    Ok(NeighborsN { offsets, indices, dist2, ..NeighborsN::default() })
}

/// The error where a number does not fit a u32 of the device.
fn check_words(what: &str, elements: u64) -> Result<usize> {
    if elements < u64::from(u32::MAX) {
        return Ok(elements as usize);
    }
    let (needed, available) = (elements * 8, u64::from(u32::MAX) * 8);
    Err(Error::OutOfDeviceMemory { what: what.to_owned(), needed, available })
}
