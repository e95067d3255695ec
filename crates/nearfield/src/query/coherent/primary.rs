//! Counting by one traversal a query on the device, without and with balancing of the load.

use std::time::Instant;

use super::back_traverse::{WORKGROUP, kernel, most_rounds};
use super::sweep::Sweep;
use crate::gpu::{Access, Bind, Buffer, StageTime, Workgroups};
use crate::query::{Clock, Counts, FixedRadius, Queries, Radius, Report, Stage};
use crate::structure::{DevicePoint, GpuAabbTree, GpuStructure};
use crate::{Error, Result};

const MODULE: &str = "package::query::coherent::primary";

/// Queries of a question on the device, by the tree's order.
pub(super) struct Asked {
    pub(super) queries: Buffer<DevicePoint>,
    pub(super) radii: Buffer<f32>,
    pub(super) own: bool,
}

impl Asked {
    pub(super) fn upload(tree: &GpuAabbTree, question: &FixedRadius<'_>) -> Result<Self> {
        let gpu = GpuStructure::gpu(tree);
        let (queries, own) = match question.queries {
            Queries::Points => (GpuStructure::points(tree).clone(), true),
            Queries::Other(queries) => (tree.upload_queries(queries)?, false),
        };
        let radii = match question.radius {
            Radius::One(radius) => gpu.upload("radius", &[radius])?,
            Radius::Each(radii) => gpu.upload("radii", radii)?,
        };
        Ok(Self { queries, radii, own })
    }
}

/// Counts of one run, by slot, and the work of each invocation where it was counted.
pub(super) struct Counted {
    pub(super) counts: Buffer<u32>,
    pub(super) work: Option<Buffer<[u32; 4]>>,
    stages: Vec<StageTime>,
}

/// Runs the kernel: an invocation a query, or so many that take them one after another.
///
/// There must be a point and a query.
pub(super) fn run(
    tree: &GpuAabbTree,
    question: &FixedRadius<'_>,
    asked: &Asked,
    invocations: Option<u32>,
    counted: bool,
) -> Result<Counted> {
    use Access::{Read, ReadWrite, Uniform};
    let gpu = GpuStructure::gpu(tree);
    let n = asked.queries.len();
    let of_one = most_rounds(tree) + u64::from(tree.shape().depth()) + 2;
    let budget = gpu.limits().loop_rounds.unwrap_or(u32::MAX);
    if of_one > u64::from(budget) {
        return Err(Error::Unsupported {
            what: format!(
                "a primary search of {} points on {}, which ends the loops of a kernel after {budget} rounds,",
                GpuStructure::len(tree),
                gpu.name()
            ),
            advice: "use the search `packed`, larger leaves or the CPU",
        });
    }
    let (own_radius, radius) = question.radius.parameters();
    let flags = own_radius | u32::from(question.exclude_self) << 1;
    let sweep = Sweep { n_queries: n as u32, flags, radius, ..bytemuck::Zeroable::zeroed() };
    let sweep = gpu.uniform("queries", &sweep)?;
    let budget = gpu.uniform("rounds", &[budget, of_one as u32, 0, 0])?;
    let counts: Buffer<u32> = gpu.buffer("neighbour counts", n)?;
    let next: Buffer<u32> = gpu.upload("next query", &[0])?;
    let groups = match invocations {
        // More than there are queries have nothing to do, and a dispatch must not be folded: the surplus would take queries too.
        Some(invocations) => {
            u64::from((invocations.min(n as u32)).div_ceil(WORKGROUP).clamp(1, gpu.limits().workgroups))
        }
        None => n.div_ceil(WORKGROUP as usize) as u64,
    };
    let lanes = (groups * u64::from(WORKGROUP)) as usize;
    let work = counted.then(|| gpu.buffer("work of invocations", lanes)).transpose()?;
    let bindings = tree.bindings();
    let [(_, layout), (_, points), (_, nodes)] = &bindings[..] else {
        unreachable!("a tree should have three bindings")
    };
    let mut binds: Vec<Bind> = vec![
        (&sweep).into(),
        layout.clone(),
        nodes.clone(),
        (&asked.queries).into(),
        (&asked.radii).into(),
        points.clone(),
        (&counts).into(),
        (&budget).into(),
        (&next).into(),
    ];
    let mut accesses = vec![Uniform, Uniform, Read, Read, Read, Read, ReadWrite, Uniform, ReadWrite];
    if let Some(work) = &work {
        binds.push(work.into());
        accesses.push(ReadWrite);
    }
    let features = [&tree.features()[..], &[("balanced", invocations.is_some()), ("counted", counted)]].concat();
    let count_neighbors = kernel(gpu, (MODULE, "count_neighbors"), &accesses, &features)?;
    let mut stages = Vec::new();
    loop {
        let mut commands = gpu.commands("count neighbours");
        commands.stage("query").dispatch(&count_neighbors, &binds, Workgroups::Covering(lanes as u64));
        stages.extend(commands.run()?);
        // Where loops are ended, invocations stop in time and the rest is taken by the next run.
        let limited = invocations.is_some() && gpu.limits().loop_rounds.is_some();
        if !limited || gpu.read(&next)?[0] as usize >= n {
            return Ok(Counted { counts, work, stages });
        }
        if counted {
            let what = format!("counting the work of {lanes} invocations on {}, which ends long loops,", gpu.name());
            return Err(Error::Unsupported { what, advice: "use more invocations" });
        }
    }
}

impl GpuAabbTree {
    /// Number of neighbours of every query by one traversal a query, whatever search is set.
    ///
    /// - `invocations`: `None` for one a query; else so many, rounded up to whole workgroups of 128, which take queries one
    ///   after another: the balancing of the load of Xing2017, section 4.1. The counts are the same.
    ///
    /// The question's order, cap and distances do not matter.
    ///
    /// # Errors
    /// See [`FixedRadius::validate`]; `Unsupported` for trees too large for a device that ends long loops;
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn count_primary(&self, question: &FixedRadius<'_>, invocations: Option<u32>) -> Result<Counts> {
        question.validate(GpuStructure::len(self))?;
        let gpu = GpuStructure::gpu(self);
        let start = Instant::now();
        let mut report = Report {
            structure: <Self as GpuStructure>::NAME,
            search: if invocations.is_some() { "primary, balanced" } else { "primary" },
            device: gpu.name().to_owned(),
            kernels: vec![MODULE.to_owned()],
            batches: 1,
            ..Report::default()
        };
        let n = question.len(GpuStructure::len(self));
        let mut counts = vec![0; n];
        if n > 0 && !GpuStructure::is_empty(self) {
            let found = run(self, question, &Asked::upload(self, question)?, invocations, false)?;
            let timed = found.stages.iter().filter_map(|stage| Some((stage.name, stage.milliseconds?)));
            report.stages.extend(timed.map(|(name, milliseconds)| Stage { name, milliseconds, clock: Clock::Device }));
            let read = Instant::now();
            counts = gpu.read(&found.counts)?;
            report.host_stage("read back", read);
        }
        report.host_stage("total", start);
        Ok(Counts { counts, report })
    }
}
