//! One traversal a leaf with queries on the device, candidates kept and then tested: algorithm 2 of Xing2017.
//!
//! It differs in four points. Queries beyond a number are split among several packs, so that no invocation of the
//! extraction takes long. A query's own radius counts for the swept box, not the largest of the pack. Places in the list
//! of candidates come from a count and a scan, where the paper adds with atomics. A query without neighbours keeps an
//! empty row, which the paper's compaction drops.

use std::ops::Range;

use super::queries::Queries;
use super::{Found, HitN, PartSearch, check_words};
use crate::Result;
use crate::gpu::{Access, Bind, Buffer, Commands};
use crate::parallel::scan::GpuScan;
use crate::query::gpu::answers::add_stages;
use crate::query::{FixedRadiusN, QueriesN, Report, SearchWork};
use crate::structure::GpuAabbTreeN;

/// Most queries of a pack.
const PACK: usize = 256;

/// A pack as the device sees it, `PackN` in packs.wesl: leaf, first query, end, nothing.
type Pack = [u32; 4];
/// A candidate as the device sees it, `Candidate` in packs.wesl: place of the point, number of the pack.
type Candidate = [u32; 2];

/// Queries by leaf; a part is a pack.
pub(super) struct Coherent<'a> {
    queries: Queries<'a>,
    packs: Vec<Pack>,
}

/// The candidates of a part.
pub(super) struct Candidates {
    packs: Buffer<Pack>,
    candidates: Buffer<Candidate>,
}

impl<'a> Coherent<'a> {
    /// Packs the queries: phase I, skipped for the points of the tree.
    pub(super) fn new<const D: usize>(
        tree: &'a GpuAabbTreeN,
        question: &FixedRadiusN<'_, f32, D>,
        found: &mut Found,
    ) -> Result<Self> {
        let (shape, first_leaf) = (tree.shape(), tree.shape().leaves().start as u32);
        let queries = Queries::new(tree, question, None)?;
        let mut packs = Vec::new();
        match question.queries {
            _ if tree.is_empty() || queries.len() == 0 => Ok(Self { queries, packs }),
            QueriesN::Points => {
                shape.leaves().for_each(|leaf| push_packs(&mut packs, leaf as u32, shape.points(leaf)));
                Ok(Self { queries, packs })
            }
            QueriesN::Other(_) => {
                let (leaves, order) = queries.sorted_by_leaf(found)?;
                let mut start = 0;
                for run in leaves.chunk_by(|a, b| a == b) {
                    if run[0] < shape.n_leaves() as u32 {
                        push_packs(&mut packs, first_leaf + run[0], start..start + run.len());
                    }
                    start += run.len();
                }
                Ok(Self { queries: Queries::new(tree, question, Some(&order))?, packs })
            }
        }
    }

    fn record_traverse(
        &self,
        commands: &mut Commands,
        fill: bool,
        (packs, reaches): (&Buffer<Pack>, &Buffer<f32>),
        last: [(Access, Bind); 2],
    ) -> Result<()> {
        let own = [
            (Access::Read, self.queries.tree.boxes().into()),
            (Access::Read, packs.into()),
            (Access::ReadWrite, reaches.into()),
        ];
        let binds: Vec<_> = own.into_iter().chain(last).collect();
        self.queries.record(commands, ("traverse", "traverse_packs", fill), (0, packs.len()), &binds)
    }

    fn record_extract(
        &self,
        commands: &mut Commands,
        found: &Candidates,
        counters: &Buffer<u32>,
        hits: Option<&Buffer<HitN>>,
    ) -> Result<()> {
        let tree = self.queries.tree;
        let read: [Bind; 4] =
            [(&found.packs).into(), tree.points().into(), tree.ids().into(), (&found.candidates).into()];
        let written = std::iter::once(counters.into()).chain(hits.map(Bind::from));
        let binds: Vec<_> = read
            .into_iter()
            .map(|bind| (Access::Read, bind))
            .chain(written.map(|bind| (Access::ReadWrite, bind)))
            .collect();
        let entry = ("extract", "extract_neighbors", hits.is_some());
        self.queries.record(commands, entry, (0, found.candidates.len()), &binds)
    }
}

/// Adds the packs of the queries at these places, which touch one leaf.
fn push_packs(packs: &mut Vec<Pack>, leaf: u32, places: Range<usize>) {
    for first in places.clone().step_by(PACK) {
        packs.push([leaf, first as u32, places.end.min(first + PACK) as u32, 0]);
    }
}

impl PartSearch for Coherent<'_> {
    type Counted = Candidates;

    fn n_parts(&self) -> usize {
        self.packs.len()
    }

    fn kernels(&self) -> &'static [&'static str] {
        &["package::query::gpu::any_dimension::traverse", "package::query::gpu::any_dimension::extract"]
    }

    /// Phases II and III up to the counts.
    fn count(&self, part: Range<usize>, counts: &Buffer<u32>, found: &mut Found) -> Result<Candidates> {
        let (gpu, n) = (self.queries.gpu(), part.len());
        let packs = gpu.upload("packs", &self.packs[part.clone()])?;
        let reaches: Buffer<f32> = gpu.buffer("reaches of packs", n)?;
        let [lengths, nodes] = [gpu.buffer("candidates of packs", n)?, gpu.buffer("nodes of packs", n)?];
        let mut commands = gpu.commands("traverse packs");
        commands.stage("traverse");
        let last = [(Access::ReadWrite, (&lengths).into()), (Access::ReadWrite, (&nodes).into())];
        self.record_traverse(&mut commands, false, (&packs, &reaches), last)?;
        add_stages(&mut found.report, &commands.run()?);
        let mut work = SearchWork { traversals: n as u64, ..SearchWork::default() };
        for (pack, length) in self.packs[part].iter().zip(gpu.read::<u32>(&lengths)?) {
            work.candidates += u64::from(length);
            work.tests += u64::from(length) * u64::from(pack[2] - pack[1]);
        }
        work.nodes = gpu.read::<u32>(&nodes)?.into_iter().map(u64::from).sum();

        let n_candidates = check_words("candidates of packs", work.candidates)?;
        let made = Candidates { packs, candidates: gpu.buffer("candidates", n_candidates)? };
        let offsets = gpu.buffer("candidate offsets", n + 1)?;
        let mut commands = gpu.commands("extract neighbours");
        commands.stage("scan candidates");
        GpuScan::new(gpu, n)?.record(&mut commands, &lengths, &offsets, n)?;
        commands.stage("write candidates");
        let last = [(Access::Read, (&offsets).into()), (Access::ReadWrite, (&made.candidates).into())];
        self.record_traverse(&mut commands, true, (&made.packs, &reaches), last)?;
        commands.stage("count");
        self.record_extract(&mut commands, &made, counts, None)?;
        add_stages(&mut found.report, &commands.run()?);
        found.work += work;
        Ok(made)
    }

    fn fill(
        &self,
        _: Range<usize>,
        counted: Candidates,
        (offsets, hits): (&Buffer<u32>, &Buffer<HitN>),
        report: &mut Report,
    ) -> Result<()> {
        let gpu = self.queries.gpu();
        // Where the next neighbour of each query goes.
        let next = gpu.buffer("places in rows", offsets.len())?;
        let mut commands = gpu.commands("fill rows");
        commands.stage("fill");
        commands.copy(offsets, &next);
        self.record_extract(&mut commands, &counted, &next, Some(hits))?;
        add_stages(report, &commands.run()?);
        Ok(())
    }
}
