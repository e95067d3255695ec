//! Running a visitor over all queries or a window of them.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::loops::{self, Traversal, VisitorRounds};
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Pipeline, Workgroups};
use crate::query::{FixedRadius, Queries, Radius, Report};
use crate::structure::{DevicePoint, GpuStructure, device_points};

/// Invocations of a workgroup of the query kernel.
const WORKGROUP: u32 = 128;

/// `Batch` in fixed_radius.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct Batch {
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
    /// 1 where 2^level workgroups share the queries evenly.
    pub in_parts: u32,
    /// See `in_parts`.
    pub level: u32,
    /// Unused.
    pub padding: u32,
}

/// What a kernel does with each neighbour.
#[derive(Debug, Clone, Copy)]
pub(super) struct VisitorCode<'a> {
    pub(super) source: Fill<'a>,
    pub(super) features: &'a [(&'a str, bool)],
    pub(super) accesses: &'a [Access],
    /// Of its own loops; those of a caller's code are the caller's concern.
    pub(super) rounds: VisitorRounds,
}

/// Queries on the device, and their radii from that of the query with slot 0 on.
#[derive(Debug)]
pub(super) struct QueryBuffers {
    queries: Buffer<DevicePoint>,
    radii: Buffer<f32>,
    /// The caller's index that has slot 0.
    first_id: u32,
    /// Whether they are the points of the structure in its order.
    are_points: bool,
}

/// How queries are dealt out to workgroups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Dealing {
    /// Invocations of a workgroup.
    pub(super) workgroup: u32,
    /// 1 where 2^level workgroups share the queries evenly.
    pub(super) in_parts: u32,
    pub(super) level: u32,
    pub(super) workgroups: u64,
}

impl Dealing {
    /// In parts that the structure wants to stay together, where the queries are its points; else by fixed workgroups.
    pub(super) fn of<S: GpuStructure>(structure: &S, queries: &QueryBuffers, workgroup: u32) -> Self {
        let n = queries.len() as u64;
        match structure.query_parts().filter(|_| queries.are_points && n > 0) {
            Some(level) => {
                let largest = n.div_ceil(1 << level) as u32;
                Self { workgroup: largest.next_multiple_of(32), in_parts: 1, level, workgroups: 1 << level }
            }
            None => Self { workgroup, in_parts: 0, level: 0, workgroups: n.div_ceil(u64::from(workgroup)) },
        }
    }

    /// The workgroups of a dispatch.
    pub(super) fn covering(&self) -> Workgroups {
        Workgroups::Covering(self.workgroups * u64::from(self.workgroup))
    }
}

impl QueryBuffers {
    /// The queries of the question in the structure's order: slots are the caller's indices.
    pub(super) fn in_search_order<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Self> {
        let queries = match question.queries {
            Queries::Points => structure.points().clone(),
            Queries::Other(queries) => structure.upload_queries(queries)?,
        };
        let radii = radii(structure, question, 0..question.len(structure.len()))?;
        let are_points = matches!(question.queries, Queries::Points);
        Ok(Self { queries, radii, first_id: 0, are_points })
    }

    /// Consecutive queries in the caller's order, with slots from 0 on. The memory is that of the window.
    pub(super) fn in_caller_order<S: GpuStructure>(
        structure: &S,
        question: &FixedRadius<'_>,
        window: Range<usize>,
    ) -> Result<Self> {
        let first_id = window.start as u32;
        let queries = match question.queries {
            Queries::Other(queries) => {
                structure.gpu().upload("queries", &device_points(&queries[window.clone()], first_id))?
            }
            Queries::Points => restored_points(structure, window.clone())?,
        };
        Ok(Self { queries, radii: radii(structure, question, window)?, first_id, are_points: false })
    }

    /// `[n]` the queries with the caller's indices.
    pub(super) fn points(&self) -> &Buffer<DevicePoint> {
        &self.queries
    }

    /// Radii by slot where each query has its own, else one.
    pub(super) fn radii(&self) -> &Buffer<f32> {
        &self.radii
    }

    /// Whether they are the points of the structure in its order.
    pub(super) fn are_points(&self) -> bool {
        self.are_points
    }

    /// Number of queries.
    pub(super) fn len(&self) -> usize {
        self.queries.len()
    }

    /// The caller's index that has slot 0.
    pub(super) fn first_id(&self) -> u32 {
        self.first_id
    }
}

/// Points of the structure with the caller's indices in `window`, in the caller's order.
fn restored_points<S: GpuStructure>(structure: &S, window: Range<usize>) -> Result<Buffer<DevicePoint>> {
    let gpu = structure.gpu();
    let restored = gpu.buffer("points in the caller's order", window.len())?;
    let parameters = [structure.len() as u32, window.start as u32, window.len() as u32, 0];
    let parameters = gpu.uniform("restore parameters", &parameters)?;
    let kernel = Kernel {
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new(
            "package::query::restore_order",
            "restore_order",
            &[Access::Uniform, Access::Read, Access::ReadWrite],
            WORKGROUP,
        )
    };
    let mut commands = gpu.commands("restore order");
    commands.dispatch(
        &gpu.pipeline(&kernel)?,
        &[(&parameters).into(), structure.points().into(), (&restored).into()],
        Workgroups::Covering(structure.len() as u64),
    );
    commands.submit()?;
    Ok(restored)
}

fn radii<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>, window: Range<usize>) -> Result<Buffer<f32>> {
    match question.radius {
        Radius::One(radius) => structure.gpu().upload("radius", &[radius]),
        Radius::Each(radii) => structure.gpu().upload("radii", &radii[window]),
    }
}

/// The pipeline of the query kernel for this structure and visitor.
fn pipeline<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    visitor: &VisitorCode<'_>,
    traversal: Traversal,
    workgroup: u32,
) -> Result<Arc<Pipeline>> {
    let mut accesses = vec![Access::Uniform, Access::Read, Access::Read];
    accesses.extend(structure.bindings().iter().map(|(access, _)| *access));
    let mut all: Vec<(&str, bool)> =
        vec![("distances", false), ("by_index", false), ("hashed", false), ("masks", false)];
    all.push(("excludes", question.exclude_self));
    all.extend([("short_loops", traversal.short_loops), ("all_points", traversal.all_points)]);
    all.extend(structure.features());
    all.extend_from_slice(visitor.features);
    let fills = [
        ("package::structure::selected", Fill::Module(structure.traverse_module())),
        ("package::structure::visitor", visitor.source),
    ];
    structure.gpu().pipeline(&Kernel {
        visitor_bindings: visitor.accesses,
        fills: &fills,
        features: &all,
        constants: &[("WORKGROUP", f64::from(workgroup))],
        ..Kernel::new("package::query::fixed_radius", "visit_neighbors", &accesses, workgroup)
    })
}

/// Records one run of the query kernel over these queries.
///
/// # Errors
/// `Unsupported` where the device would end the kernel's loops early; as making pipelines and buffers.
pub(super) fn record<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    question: &FixedRadius<'_>,
    queries: &QueryBuffers,
    visitor: &VisitorCode<'_>,
    visitor_binds: &[Bind],
) -> Result<()> {
    let traversal = loops::traversal(structure, question, visitor.rounds)?;
    let dealing = Dealing::of(structure, queries, WORKGROUP);
    let pipeline = pipeline(structure, question, visitor, traversal, dealing.workgroup)?;
    let (own_radius, radius) = match question.radius {
        Radius::One(radius) => (0, radius),
        Radius::Each(_) => (1, 0.0),
    };
    let batch = Batch {
        count: queries.len() as u32,
        first_id: queries.first_id,
        exclude_self: u32::from(question.exclude_self),
        own_radius,
        radius,
        in_parts: dealing.in_parts,
        level: dealing.level,
        padding: 0,
    };
    let batch = structure.gpu().uniform("query batch", &batch)?;
    let mut binds: Vec<Bind> = vec![(&batch).into(), (&queries.queries).into(), (&queries.radii).into()];
    binds.extend(structure.bindings().into_iter().map(|(_, bind)| bind));
    commands.dispatch_with_visitor(&pipeline, &binds, visitor_binds, dealing.covering());
    Ok(())
}

/// A report that names the structure, the device and the kernel with its parts.
pub(super) fn report<S: GpuStructure>(structure: &S, search: &'static str, visitors: &[&str]) -> Report {
    let traverse = structure.traverse_module();
    let kernel = |visitor: &&str| format!("package::query::fixed_radius with {traverse} and {visitor}");
    Report {
        structure: S::NAME,
        search,
        device: structure.gpu().name().to_owned(),
        kernels: visitors.iter().map(kernel).collect(),
        batches: 1,
        ..Report::default()
    }
}
