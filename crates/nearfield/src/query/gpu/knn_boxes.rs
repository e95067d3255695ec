//! The nearest points from a tree of boxes on the device: a run of the kernel for each 32 places of a row.

use bytemuck::{Pod, Zeroable};

use super::knn::{NearestOnDevice, Rows};
use super::visit::{Dealing, QueryBuffers};
use crate::gpu::{Access, Bind, Commands, Kernel};
use crate::query::{FixedRadius, Knn};
use crate::structure::{GpuAabbTree, GpuStructure};
use crate::{Error, Result};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;

/// Places of a row that one run fills at most, and the sizes that the kernel is made for.
const MOST_PLACES: u32 = 32;
const SIZES: [(&str, u32); 4] = [("few", 4), ("some", 8), ("many", 16), ("most", MOST_PLACES)];

/// `KnnRun` in knn_boxes.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct KnnRun {
    /// Number of queries.
    pub count: u32,
    /// The caller's index that has slot 0.
    pub first_id: u32,
    /// 1 to leave out the query itself.
    pub exclude_self: u32,
    /// 1 where each query has its own radius.
    pub own_radius: u32,
    /// The radius where all have one.
    pub radius: f32,
    /// Places of a row, at least 1.
    pub k: u32,
    /// First place of this run.
    pub first: u32,
    /// 1 where 2^level workgroups share the queries evenly.
    pub in_parts: u32,
    /// See `in_parts`.
    pub level: u32,
    /// 1 where queries are the points in the tree's order.
    pub are_points: u32,
    /// Unused.
    pub padding: [u32; 2],
}

impl NearestOnDevice for GpuAabbTree {
    const NEAREST: &'static str = "nearest-boxes";
    const KERNEL: &'static str = "package::query::knn_boxes";

    fn record_nearest(
        &self,
        commands: &mut Commands,
        within: &FixedRadius<'_>,
        queries: &QueryBuffers,
        places: u32,
        rows: &Rows,
    ) -> Result<()> {
        use Access::{Read, ReadWrite, Uniform};
        let gpu = self.gpu();
        let (own_radius, radius) = within.radius.parameters();
        let mut binds: Vec<Bind> = vec![queries.points().into(), queries.radii().into()];
        binds.extend(self.bindings().into_iter().map(|(_, bind)| bind));
        binds.extend([Bind::from(&rows.ids), Bind::from(&rows.dist2)]);
        // Only those that go together gain from staying within a node.
        let together = self.rounds_in_step() == 1;
        let dealing = match together {
            true => Dealing::of(self, queries, WORKGROUP),
            false => Dealing::fixed(queries.len(), WORKGROUP),
        };
        for first in (0..places).step_by(MOST_PLACES as usize) {
            let run = KnnRun {
                count: queries.len() as u32,
                first_id: queries.first_id(),
                exclude_self: u32::from(within.exclude_self),
                own_radius,
                radius,
                k: places,
                first,
                in_parts: dealing.in_parts,
                level: dealing.level,
                are_points: u32::from(queries.are_points()),
                padding: [0; 2],
            };
            let left = (places - first).min(MOST_PLACES);
            let size = SIZES.iter().position(|&(_, size)| left <= size).expect("the largest size should hold a run");
            let mut features = vec![("periodic", self.settings().period.is_periodic()), ("packed", together)];
            features.extend(SIZES.iter().enumerate().map(|(i, &(name, _))| (name, i == size)));
            features.extend([("fours", places.is_multiple_of(4)), ("excludes", within.exclude_self)]);
            let kernel = Kernel {
                features: &features,
                constants: &[("WORKGROUP", f64::from(dealing.workgroup))],
                ..Kernel::new(
                    Self::KERNEL,
                    "find_nearest",
                    &[Uniform, Read, Read, Uniform, Read, Read, ReadWrite, ReadWrite],
                    dealing.workgroup,
                )
            };
            let run = gpu.uniform("nearest run", &run)?;
            let binds = [&[(&run).into()], &binds[..]].concat();
            commands.dispatch(&gpu.pipeline(&kernel)?, &binds, dealing.covering());
        }
        Ok(())
    }

    fn check_loops(&self, _: &Knn<'_>, places: usize) -> Result<()> {
        let Some(limit) = self.gpu().limits().loop_rounds.filter(|_| places > 0) else { return Ok(()) };
        // Two steps a leaf; in it the looks that end three loops, and rounds that are not full; every point as one of eight, as
        // one of 32 and as one in reach; a query's leaf and its row.
        let rounds = (8 * self.shape().n_leaves() + self.len() + self.len() / 8 + self.len() / 32) as u64 + 128;
        let in_step = self.rounds_in_step();
        if rounds * in_step <= u64::from(limit) {
            return Ok(());
        }
        let (n, gpu) = (self.len(), self.gpu().name());
        Err(Error::Unsupported {
            what: format!(
                "finding the nearest {places} of {n} points on {gpu}, which ends the loops of a kernel after {limit} rounds,"
            ),
            advice: "use the CPU or fewer points",
        })
    }
}
