//! One traversal a query on the device: algorithm 1 of Xing2017.

use std::ops::Range;

use super::queries::{LOCATE, Queries};
use super::{Found, HitN, PartSearch};
use crate::Result;
use crate::gpu::{Access, Bind, Buffer};
use crate::query::gpu::answers::add_stages;
use crate::query::{FixedRadiusN, QueriesN, Report, SearchWork};
use crate::structure::GpuAabbTreeN;

/// Queries and the leaves that they touch; a part is a query.
pub(super) struct Primary<'a> {
    queries: Queries<'a>,
    /// Not read for the points of the tree, whose leaves follow from their places.
    leaves: Buffer<u32>,
}

impl<'a> Primary<'a> {
    pub(super) fn new<const D: usize>(
        tree: &'a GpuAabbTreeN,
        question: &FixedRadiusN<'_, f32, D>,
        found: &mut Found,
    ) -> Result<Self> {
        let queries = Queries::new(tree, question, None)?;
        let leaves = match question.queries {
            QueriesN::Other(_) if !tree.is_empty() => {
                let mut commands = tree.gpu().commands("locate queries");
                let leaves = queries.record_locate(&mut commands)?;
                add_stages(&mut found.report, &commands.run()?);
                found.report.kernels.push(LOCATE.to_owned());
                leaves
            }
            _ => tree.ids().clone(),
        };
        Ok(Self { queries, leaves })
    }

    fn binds(&self, last: [(Access, Bind); 2]) -> Vec<(Access, Bind)> {
        let tree = self.queries.tree;
        let read: [Bind; 4] = [tree.boxes().into(), tree.points().into(), tree.ids().into(), (&self.leaves).into()];
        read.into_iter().map(|bind| (Access::Read, bind)).chain(last).collect()
    }
}

impl PartSearch for Primary<'_> {
    type Counted = ();

    fn n_parts(&self) -> usize {
        if self.queries.tree.is_empty() { 0 } else { self.queries.len() }
    }

    fn kernels(&self) -> &'static [&'static str] {
        &["package::query::gpu::any_dimension::primary"]
    }

    fn count(&self, part: Range<usize>, counts: &Buffer<u32>, found: &mut Found) -> Result<()> {
        let gpu = self.queries.gpu();
        let work: Buffer<[u32; 2]> = gpu.buffer("work of the queries", part.len())?;
        let mut commands = gpu.commands("count neighbours");
        commands.stage("count");
        let binds = self.binds([(Access::ReadWrite, counts.into()), (Access::ReadWrite, (&work).into())]);
        self.queries.record(&mut commands, ("primary", "search_queries", false), (part.start, part.len()), &binds)?;
        add_stages(&mut found.report, &commands.run()?);
        for [nodes, tests] in gpu.read(&work)? {
            let traversals = u64::from(nodes > 0);
            found.work += SearchWork { traversals, nodes: u64::from(nodes), candidates: 0, tests: u64::from(tests) };
        }
        Ok(())
    }

    fn fill(
        &self,
        part: Range<usize>,
        (): (),
        (offsets, hits): (&Buffer<u32>, &Buffer<HitN>),
        report: &mut Report,
    ) -> Result<()> {
        let mut commands = self.queries.gpu().commands("fill rows");
        commands.stage("fill");
        let binds = self.binds([(Access::ReadWrite, hits.into()), (Access::Read, offsets.into())]);
        self.queries.record(&mut commands, ("primary", "search_queries", true), (part.start, part.len()), &binds)?;
        add_stages(report, &commands.run()?);
        Ok(())
    }
}
