//! The queries of a question on the device, and the leaves that they touch.

use bytemuck::{Pod, Zeroable};

use super::Found;
use crate::Result;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Workgroups};
use crate::parallel::radix_sort::GpuRadixSort;
use crate::query::gpu::answers::add_stages;
use crate::query::{FixedRadiusN, QueriesN};
use crate::structure::GpuAabbTreeN;
use crate::structure::aabb_tree::any_dimension::rows_of;

/// Invocations of a workgroup.
const WORKGROUP: u32 = 128;

/// The kernel that finds the leaf of a query.
pub(super) const LOCATE: &str = "package::query::gpu::any_dimension::locate";

/// `SearchN` in queries.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct SearchN {
    /// Number of points of the tree.
    pub n_points: u32,
    /// Level of its leaves.
    pub depth: u32,
    /// Queries, packs or candidates of this run.
    pub count: u32,
    /// Place of the first query.
    pub first: u32,
    /// 1 to leave out the query itself.
    pub exclude_self: u32,
    /// 1 where the queries are the points of the tree.
    pub own_points: u32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
}

/// `Asked` in queries.wesl: the caller's index of a query, and its radius.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct Asked {
    /// The caller's index.
    pub id: u32,
    /// Its radius.
    pub radius: f32,
}

/// The tree, and the queries in the order in which they are searched.
pub(super) struct Queries<'a> {
    pub(super) tree: &'a GpuAabbTreeN,
    /// `[q × row]`
    rows: Buffer<[f32; 4]>,
    /// `[q]`
    asked: Buffer<Asked>,
    n_queries: usize,
    exclude_self: bool,
    own_points: bool,
}

impl<'a> Queries<'a> {
    /// The points of the tree in its order, or other queries as the caller gave them, or in `order`.
    pub(super) fn new<const D: usize>(
        tree: &'a GpuAabbTreeN,
        question: &FixedRadiusN<'_, f32, D>,
        order: Option<&[u32]>,
    ) -> Result<Self> {
        let gpu = tree.gpu();
        let asked = |id: u32| Asked { id, radius: question.radius.of(id as usize) };
        let (rows, asked): (_, Vec<Asked>) = match (question.queries, order) {
            (QueriesN::Points, _) => (tree.points().clone(), tree.order().iter().map(|&id| asked(id)).collect()),
            (QueriesN::Other(queries), None) => {
                (gpu.upload("queries", &rows_of(queries))?, (0..queries.len() as u32).map(asked).collect())
            }
            (QueriesN::Other(queries), Some(order)) => {
                let ordered: Vec<[f32; D]> = order.iter().map(|&id| queries[id as usize]).collect();
                (gpu.upload("queries", &rows_of(&ordered))?, order.iter().map(|&id| asked(id)).collect())
            }
        };
        Ok(Self {
            tree,
            rows,
            n_queries: asked.len(),
            asked: gpu.upload("radii of the queries", &asked)?,
            exclude_self: question.exclude_self,
            own_points: matches!(question.queries, QueriesN::Points),
        })
    }

    pub(super) fn gpu(&self) -> &'a Gpu {
        self.tree.gpu()
    }

    /// Number of queries.
    pub(super) fn len(&self) -> usize {
        self.n_queries
    }

    /// Records a kernel of this folder: `first` and `count` are those of the parameters, `binds` follow the parameters, the
    /// rows and the radii of the queries.
    pub(super) fn record(
        &self,
        commands: &mut Commands,
        (module, entry, fill): (&str, &str, bool),
        (first, count): (usize, usize),
        binds: &[(Access, Bind)],
    ) -> Result<()> {
        let (gpu, shape) = (self.gpu(), self.tree.shape());
        let module = format!("package::query::gpu::any_dimension::{module}");
        let constants = [("WORKGROUP", f64::from(WORKGROUP)), ("DIMENSION", self.tree.dimension() as f64)];
        let mut accesses = vec![Access::Uniform, Access::Read, Access::Read];
        accesses.extend(binds.iter().map(|(access, _)| *access));
        let kernel = Kernel {
            constants: &constants,
            features: &[("fill", fill)],
            ..Kernel::new(&module, entry, &accesses, WORKGROUP)
        };
        let search = SearchN {
            n_points: shape.n_points() as u32,
            depth: shape.depth(),
            count: count as u32,
            first: first as u32,
            exclude_self: u32::from(self.exclude_self),
            own_points: u32::from(self.own_points),
            padding_0: 0,
            padding_1: 0,
        };
        let search = gpu.uniform("search parameters", &search)?;
        let own: [Bind; 3] = [(&search).into(), (&self.rows).into(), (&self.asked).into()];
        let binds: Vec<Bind> = own.into_iter().chain(binds.iter().map(|(_, bind)| bind.clone())).collect();
        commands.dispatch(&gpu.prepare(&kernel)?, &binds, Workgroups::Covering(count as u64));
        Ok(())
    }

    /// Records the search for the leaf that each query touches: its number, or the number of leaves where there is none.
    pub(super) fn record_locate(&self, commands: &mut Commands) -> Result<Buffer<u32>> {
        let leaves = self.gpu().buffer("leaves of the queries", self.len())?;
        let binds = [(Access::Read, self.tree.boxes().into()), (Access::ReadWrite, (&leaves).into())];
        commands.stage("locate");
        self.record(commands, ("locate", "locate_queries", false), (0, self.len()), &binds)?;
        Ok(leaves)
    }

    /// The leaf numbers of all queries in ascending order, and the queries in that order.
    pub(super) fn sorted_by_leaf(&self, found: &mut Found) -> Result<(Vec<u32>, Vec<u32>)> {
        let (gpu, n) = (self.gpu(), self.len());
        let (keys, order) = (gpu.buffer("sorted leaves", n)?, gpu.buffer("order of the queries", n)?);
        let mut commands = gpu.commands("pack queries");
        let leaves = self.record_locate(&mut commands)?;
        commands.stage("sort");
        let bits = 0..self.tree.shape().depth() + 1;
        GpuRadixSort::new(gpu, n)?.record_from(&mut commands, &leaves, None, &keys, &order, n, bits)?;
        add_stages(&mut found.report, &commands.run()?);
        found.report.kernels.push(LOCATE.to_owned());
        Ok((gpu.read(&keys)?, gpu.read(&order)?))
    }
}
