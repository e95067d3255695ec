//! Running a visitor over all queries or a window of them.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::answers::add_stages;
use super::loops::{self, Traversal, VisitorRounds};
use crate::Result;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, AdapterKind, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::query::coherent::{Asking, BACK_TRAVERSE, CANDIDATES, Candidates, PACK};
use crate::query::{FixedRadius, Queries, Radius, Report};
use crate::structure::{DevicePoint, GpuStructure, upload_points};

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
    /// Place of the first query of this dispatch.
    pub first: u32,
    /// End of the queries of this dispatch.
    pub end: u32,
    /// Invocations of a query, a power of two.
    pub sharers: u32,
    /// Unused.
    pub padding: [u32; 2],
}

/// What a kernel does with each neighbour.
#[derive(Debug, Clone, Copy)]
pub(super) struct VisitorCode<'a> {
    pub(super) source: Fill<'a>,
    pub(super) features: &'a [(&'a str, bool)],
    pub(super) accesses: &'a [Access],
    /// Of its own loops; those of a caller's code are the caller's concern.
    pub(super) rounds: VisitorRounds,
    /// Whether it has `fn combine(state: ptr<function, State>, other: State)`: invocations may then share a query.
    pub(super) combines: bool,
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
    /// Whether those side by side are near each other.
    are_near: bool,
    /// Where the structure is searched coherently.
    candidates: Option<Candidates>,
}

/// How queries are dealt out to workgroups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Dealing {
    /// Invocations of a workgroup.
    pub(super) workgroup: u32,
    /// Invocations of a query.
    pub(super) sharers: u32,
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
                let workgroup = largest.next_multiple_of(32);
                Self { workgroup, sharers: 1, in_parts: 1, level, workgroups: 1 << level }
            }
            None => Self::fixed(queries.len(), workgroup),
        }
    }

    /// By workgroups of one size.
    pub(super) fn fixed(n: usize, workgroup: u32) -> Self {
        Self::shared(n, workgroup, 1)
    }

    /// By workgroups of one size, so many invocations a query.
    fn shared(n: usize, workgroup: u32, sharers: u32) -> Self {
        let workgroups = (n as u64 * u64::from(sharers)).div_ceil(u64::from(workgroup));
        Self { workgroup, sharers, in_parts: 0, level: 0, workgroups }
    }

    /// The workgroups of a dispatch.
    pub(super) fn covering(&self) -> Workgroups {
        Workgroups::Covering(self.workgroups * u64::from(self.workgroup))
    }
}

impl QueryBuffers {
    /// Queries as they will be searched: in packs, with their candidates, where the structure is searched coherently.
    fn new<S: GpuStructure>(
        structure: &S,
        question: &FixedRadius<'_>,
        (queries, radii): (Buffer<DevicePoint>, Buffer<f32>),
        first_id: u32,
        own: bool,
    ) -> Result<Self> {
        let asking = Asking { queries: &queries, radii: &radii, first_id, own };
        let find = |tree| Candidates::find(tree, question, asking);
        let candidates = structure.coherent_tree().map(find).transpose()?;
        let packed = candidates.as_ref().and_then(Candidates::queries).cloned();
        let are_near = own || packed.is_some();
        Ok(Self { queries: packed.unwrap_or(queries), radii, first_id, are_points: own, are_near, candidates })
    }

    /// Queries that are on the device with their slots; they stay in their order, unless they are searched in packs. Those that are the very
    /// memory of the structure's points are dealt out as its points are.
    pub(super) fn on_device<S: GpuStructure>(
        structure: &S,
        question: &FixedRadius<'_>,
        queries: Buffer<DevicePoint>,
        radii: Buffer<f32>,
    ) -> Result<Self> {
        let own = queries.raw() == structure.points().raw() && queries.len() == structure.len();
        Self::new(structure, question, (queries, radii), 0, own)
    }

    /// The queries of the question in the structure's order: slots are the caller's indices.
    pub(super) fn in_search_order<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Self> {
        if structure.coherent_tree().is_none() {
            return Self::unpacked(structure, question);
        }
        let (queries, own) = match question.queries {
            Queries::Points => (structure.points().clone(), true),
            // Packs have an order of their own.
            Queries::Other(queries) => (upload_points(structure.gpu(), "queries", queries, 0)?, false),
        };
        let radii = radii(structure, question, 0..question.len(structure.len()))?;
        Self::new(structure, question, (queries, radii), 0, own)
    }

    /// The same for kernels that find their own way through the structure: never in packs.
    pub(super) fn unpacked<S: GpuStructure>(structure: &S, question: &FixedRadius<'_>) -> Result<Self> {
        let queries = match question.queries {
            Queries::Points => structure.points().clone(),
            Queries::Other(queries) => structure.upload_queries(queries)?,
        };
        let radii = radii(structure, question, 0..question.len(structure.len()))?;
        let are_points = matches!(question.queries, Queries::Points);
        Ok(Self { queries, radii, first_id: 0, are_points, are_near: true, candidates: None })
    }

    /// Consecutive queries in the caller's order, with slots from 0 on. The memory is that of the window.
    pub(super) fn in_caller_order<S: GpuStructure>(
        structure: &S,
        question: &FixedRadius<'_>,
        window: Range<usize>,
    ) -> Result<Self> {
        let first_id = window.start as u32;
        let queries = match question.queries {
            Queries::Other(queries) => upload_points(structure.gpu(), "queries", &queries[window.clone()], first_id)?,
            Queries::Points => restored_points(structure, window.clone())?,
        };
        let radii = radii(structure, question, window)?;
        Self::new(structure, question, (queries, radii), first_id, false)
    }

    /// What a coherent search has found for them.
    pub(super) fn candidates(&self) -> Option<&Candidates> {
        self.candidates.as_ref()
    }

    /// Adds what was done to them before they can be searched: its times, and in how many windows they are searched.
    pub(super) fn add_stages_to(&self, report: &mut Report) {
        if let Some(candidates) = &self.candidates {
            add_stages(report, &candidates.stages);
            report.batches = report.batches.max(candidates.windows.len() as u32);
        }
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

    /// Whether those side by side are near each other: they are the structure's points or were sorted.
    pub(super) fn are_near(&self) -> bool {
        self.are_near
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
pub(super) fn restored_points<S: GpuStructure>(structure: &S, window: Range<usize>) -> Result<Buffer<DevicePoint>> {
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
        &gpu.prepare(&kernel)?,
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

/// The module that visits what is near a query.
fn traverse_module<S: GpuStructure>(structure: &S) -> &'static str {
    if structure.coherent_tree().is_some() { CANDIDATES } else { structure.traverse_module() }
}

/// Most invocations that share a query.
const MOST_SHARERS: u32 = 8;

/// Invocations that are at work at the same time: of a large card, of one that shares the host's memory, of a few cores.
pub(super) fn invocations_at_once(gpu: &Gpu) -> u64 {
    match gpu.kind() {
        AdapterKind::Discrete | AdapterKind::Other => 1 << 18,
        AdapterKind::Integrated | AdapterKind::Virtual => 1 << 14,
        AdapterKind::Software => 1 << 11,
    }
}

/// How many invocations should share each of so many queries: a few where one each would leave most of the device idle.
fn sharers(gpu: &Gpu, n: usize) -> u32 {
    let fits = |&sharers: &u32| n as u64 * u64::from(sharers) <= invocations_at_once(gpu);
    std::iter::successors(Some(MOST_SHARERS), |&sharers| (sharers > 1).then_some(sharers / 2)).find(fits).unwrap_or(1)
}

/// The pipeline of the query kernel for this structure and visitor.
fn pipeline<S: GpuStructure>(
    structure: &S,
    question: &FixedRadius<'_>,
    visitor: &VisitorCode<'_>,
    traversal: Traversal,
    Dealing { workgroup, sharers, .. }: Dealing,
) -> Result<Arc<Pipeline>> {
    let mut accesses = vec![Access::Uniform, Access::Read, Access::Read];
    accesses.extend(structure.bindings().iter().map(|(access, _)| *access));
    // The bindings of `candidates` are those of the tree, with the candidates in place of the nodes.
    let mut all: Vec<(&str, bool)> =
        vec![("distances", false), ("by_index", false), ("hashed", false), ("masks", false)];
    all.push(("excludes", question.exclude_self));
    all.extend([("short_loops", traversal.short_loops), ("all_points", traversal.all_points)]);
    all.push(("shared_queries", sharers > 1));
    all.extend(structure.features());
    all.extend_from_slice(visitor.features);
    let fills = [
        ("package::structure::selected", Fill::Module(traverse_module(structure))),
        ("package::structure::visitor", visitor.source),
    ];
    // Invocations that share queries stand in workgroups of a size that the kernel knows.
    let constants = [("WORKGROUP", f64::from(workgroup))];
    structure.gpu().prepare(&Kernel {
        visitor_bindings: visitor.accesses,
        fills: &fills,
        features: &all,
        constants: if sharers > 1 { &[] } else { &constants },
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
    let traversal = match &queries.candidates {
        Some(found) => loops::through_candidates(structure, found.largest, visitor.rounds)?,
        None => loops::traversal(structure, question, visitor.rounds)?,
    };
    let can_share = visitor.combines && structure.shares_queries() && queries.candidates.is_none();
    let dealing = match sharers(structure.gpu(), queries.len()) {
        sharers if can_share && sharers > 1 => Dealing::shared(queries.len(), WORKGROUP, sharers),
        _ if queries.candidates.is_some() => Dealing::fixed(queries.len(), WORKGROUP),
        _ => Dealing::of(structure, queries, WORKGROUP),
    };
    let pipeline = pipeline(structure, question, visitor, traversal, dealing)?;
    let part = Part { gpu: structure.gpu(), question, queries, pipeline: &pipeline, visitor_binds };
    let Some(found) = &queries.candidates else {
        let binds: Vec<Bind> = structure.bindings().into_iter().map(|(_, bind)| bind).collect();
        return part.record(commands, 0..queries.len() as u32, dealing, &binds);
    };
    for window in &found.windows {
        found.record_window(commands, window)?;
        let dealing = Dealing::fixed(window.queries.len(), WORKGROUP);
        part.record(commands, window.queries.clone(), dealing, &found.bindings())?;
    }
    Ok(())
}

/// What runs over the same queries have in common.
struct Part<'a> {
    gpu: &'a Gpu,
    question: &'a FixedRadius<'a>,
    queries: &'a QueryBuffers,
    pipeline: &'a Arc<Pipeline>,
    visitor_binds: &'a [Bind],
}

impl Part<'_> {
    /// Records one run over the queries at some places.
    fn record(&self, commands: &mut Commands, places: Range<u32>, dealing: Dealing, binds: &[Bind]) -> Result<()> {
        let queries = self.queries;
        let (own_radius, radius) = self.question.radius.parameters();
        let batch = Batch {
            count: queries.len() as u32,
            first_id: queries.first_id,
            exclude_self: u32::from(self.question.exclude_self),
            own_radius,
            radius,
            in_parts: dealing.in_parts,
            level: dealing.level,
            first: places.start,
            end: places.end,
            sharers: dealing.sharers,
            padding: [0; 2],
        };
        let batch = self.gpu.uniform("query batch", &batch)?;
        let mut all: Vec<Bind> = vec![(&batch).into(), (&queries.queries).into(), (&queries.radii).into()];
        all.extend_from_slice(binds);
        commands.dispatch_with_visitor(self.pipeline, &all, self.visitor_binds, dealing.covering());
        Ok(())
    }
}

/// A report that names the structure, the device and the kernel with its parts.
pub(super) fn report<S: GpuStructure>(structure: &S, search: &'static str, visitors: &[&str]) -> Report {
    let traverse = traverse_module(structure);
    let kernel = |visitor: &&str| format!("package::query::fixed_radius with {traverse} and {visitor}");
    let (search, before) = match structure.coherent_tree() {
        Some(_) => ("coherent", &[PACK, BACK_TRAVERSE][..]),
        None => (search, &[][..]),
    };
    Report {
        structure: S::NAME,
        search,
        device: structure.gpu().name().to_owned(),
        kernels: before.iter().map(|&kernel| kernel.to_owned()).chain(visitors.iter().map(kernel)).collect(),
        batches: 1,
        ..Report::default()
    }
}
