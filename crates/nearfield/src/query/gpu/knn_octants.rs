//! The nearest points from an octree on the device: one kernel, rows of any length in device memory.

use bytemuck::{Pod, Zeroable};

use super::knn::{NearestOnDevice, Rows};
use super::loops;
use super::visit::QueryBuffers;
use crate::Result;
use crate::gpu::{Access, Bind, Commands, Kernel, Workgroups};
use crate::query::{FixedRadius, Knn, Queries};
use crate::structure::{GpuLinearOctree, GpuStructure};

/// Invocations of a workgroup of the kernel.
const WORKGROUP: u32 = 64;

/// `KnnBatch` in knn.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct KnnBatch {
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
    /// Unused.
    pub padding: [u32; 2],
}

impl NearestOnDevice for GpuLinearOctree {
    const NEAREST: &'static str = "nearest-octants";
    const KERNEL: &'static str = "package::query::knn";

    fn record_nearest(
        &self,
        commands: &mut Commands,
        within: &FixedRadius<'_>,
        queries: &QueryBuffers,
        places: u32,
        rows: &Rows,
    ) -> Result<&'static [&'static str]> {
        use Access::{Read, ReadWrite, Uniform};
        let (own_radius, radius) = within.radius.parameters();
        let batch = KnnBatch {
            count: queries.len() as u32,
            first_id: queries.first_id(),
            exclude_self: u32::from(within.exclude_self),
            own_radius,
            radius,
            k: places,
            padding: [0; 2],
        };
        let batch = self.gpu().uniform("nearest batch", &batch)?;
        let mut features = self.features();
        features.push(("by_index", false));
        let kernel = Kernel {
            visitor_bindings: &[ReadWrite, ReadWrite],
            features: &features,
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new(Self::KERNEL, "find_nearest", &[Uniform, Read, Read, Uniform, Read, Read], WORKGROUP)
        };
        let binds: [Bind; 6] = [
            (&batch).into(),
            queries.points().into(),
            queries.radii().into(),
            self.layout().into(),
            self.points().into(),
            self.nodes().into(),
        ];
        let visitor: [Bind; 2] = [(&rows.ids).into(), (&rows.dist2).into()];
        let covering = Workgroups::Covering(queries.len() as u64);
        commands.dispatch_with_visitor(&self.gpu().prepare(&kernel)?, &binds, &visitor, covering);
        Ok(&[])
    }

    fn check_loops(&self, question: &Knn<'_>, places: usize) -> Result<()> {
        let Some(limit) = self.gpu().limits().loop_rounds else { return Ok(()) };
        if places == 0 {
            return Ok(());
        }
        let queries = match question.queries {
            Queries::Points => None,
            Queries::Other(queries) => Some(queries),
        };
        let within = question.as_fixed_radius();
        let steps = self.most_nearest_steps(queries, places, question.exclude_self, |i| within.radius_of(i))?;
        if loops::of_knn(steps, places as u32) <= u64::from(limit) {
            return Ok(());
        }
        Err(loops::too_long_for_nearest(self, places, limit, "use the CPU, fewer neighbours or fewer points"))
    }
}
