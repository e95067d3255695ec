//! Running a visitor over a window of queries.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Pipeline, Workgroups};
use crate::query::{FixedRadius, Queries, Radius, Report};
use crate::structure::{DevicePoint, GpuStructure};

/// Invocations of a workgroup of the query kernel.
const WORKGROUP: u32 = 128;

/// `Batch` in fixed_radius.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(super) struct Batch {
    /// First query of the window.
    pub first: u32,
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
    /// Unused.
    pub padding: [u32; 2],
}

/// What a kernel does with each neighbour.
#[derive(Debug, Clone, Copy)]
pub(super) struct VisitorCode<'a> {
    pub(super) source: Fill<'a>,
    pub(super) features: &'a [(&'a str, bool)],
    pub(super) accesses: &'a [Access],
}

/// Queries and radii on the device.
#[derive(Debug)]
pub(super) struct QueryBuffers {
    pub(super) queries: Buffer<DevicePoint>,
    radii: Buffer<f32>,
}

/// A window of queries: places in the query buffer, and the caller's index that has slot 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) first: u32,
    pub(super) count: u32,
    pub(super) first_id: u32,
}

impl QueryBuffers {
    /// The queries of the question in the structure's order: slots are the caller's indices.
    pub(super) fn in_search_order<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Self> {
        let queries = match question.queries {
            Queries::Points => structure.points().clone(),
            Queries::Other(queries) => structure.upload_queries(queries)?,
        };
        Self::with_radii(structure, queries, question)
    }

    /// The queries of the question in the caller's order: any window of them has consecutive slots.
    pub(super) fn in_caller_order<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Self> {
        let gpu = structure.gpu();
        let queries = match question.queries {
            Queries::Other(queries) => gpu.upload("queries", &crate::structure::device_points(queries, 0))?,
            Queries::Points => {
                let restored = gpu.buffer("points in the caller's order", structure.len())?;
                let n = gpu.uniform("restore parameters", &[structure.len() as u32, 0, 0, 0])?;
                let bindings = [Access::Uniform, Access::Read, Access::ReadWrite];
                let constants = [("WORKGROUP", f64::from(WORKGROUP))];
                let kernel = Kernel {
                    constants: &constants,
                    ..Kernel::new("package::query::restore_order", "restore_order", &bindings, WORKGROUP)
                };
                let mut commands = gpu.commands("restore order");
                commands.dispatch(
                    &gpu.pipeline(&kernel)?,
                    &[(&n).into(), structure.points().into(), (&restored).into()],
                    Workgroups::Covering(structure.len() as u64),
                );
                commands.submit()?;
                restored
            }
        };
        Self::with_radii(structure, queries, question)
    }

    fn with_radii<S: GpuStructure>(
        structure: &S,
        queries: Buffer<DevicePoint>,
        question: &FixedRadius<'_>,
    ) -> Result<Self> {
        let radii = match question.radius {
            Radius::One(radius) => structure.gpu().upload("radius", &[radius])?,
            Radius::Each(radii) => structure.gpu().upload("radii", radii)?,
        };
        Ok(Self { queries, radii })
    }

    /// All queries.
    pub(super) fn whole(&self) -> Window {
        Window { first: 0, count: self.queries.len() as u32, first_id: 0 }
    }
}

/// The pipeline of the query kernel for this structure and visitor.
pub(super) fn pipeline<S: GpuStructure>(structure: &S, visitor: &VisitorCode<'_>) -> Result<Arc<Pipeline>> {
    let mut accesses = vec![Access::Uniform, Access::Read, Access::Read];
    accesses.extend(structure.bindings().iter().map(|(access, _)| *access));
    let mut features = structure.features();
    let mut all: Vec<(&str, bool)> =
        vec![("distances", false), ("by_index", false), ("hashed", false), ("masks", false)];
    all.extend(features.drain(..));
    all.extend_from_slice(visitor.features);
    let fills = [
        ("package::structure::selected", Fill::Module(structure.traverse_module())),
        ("package::structure::visitor", visitor.source),
    ];
    structure.gpu().pipeline(&Kernel {
        visitor_bindings: visitor.accesses,
        fills: &fills,
        features: &all,
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new("package::query::fixed_radius", "visit_neighbors", &accesses, WORKGROUP)
    })
}

/// Records one run of the query kernel over a window of queries.
pub(super) fn record<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    question: &FixedRadius<'_>,
    queries: &QueryBuffers,
    window: Window,
    visitor: &VisitorCode<'_>,
    visitor_binds: &[Bind],
) -> Result<()> {
    let pipeline = pipeline(structure, visitor)?;
    let (own_radius, radius) = match question.radius {
        Radius::One(radius) => (0, radius),
        Radius::Each(_) => (1, 0.0),
    };
    let batch = Batch {
        first: window.first,
        count: window.count,
        first_id: window.first_id,
        exclude_self: u32::from(question.exclude_self),
        own_radius,
        radius,
        padding: [0; 2],
    };
    let batch = structure.gpu().uniform("query batch", &batch)?;
    let mut binds: Vec<Bind> = vec![(&batch).into(), (&queries.queries).into(), (&queries.radii).into()];
    binds.extend(structure.bindings().into_iter().map(|(_, bind)| bind));
    commands.dispatch_with_visitor(&pipeline, &binds, visitor_binds, Workgroups::Covering(u64::from(window.count)));
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
