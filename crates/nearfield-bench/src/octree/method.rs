//! One chart by one method at one number of points, with its answer checked.

use std::time::Instant;

use nearfield::curve::{self, GpuCurveOrder};
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{Buffer, Gpu, StageTime};
use nearfield::parallel::reduce;
use nearfield::query::{Clock, NeighborSearch, Stage};
use nearfield::structure::{DevicePoint, OctreeBuilder};
use nearfield::{
    Curve, DenseOctree, DenseOctreeSettings, Domain, FixedRadius, GpuDenseOctree, GpuLinearOctree, LinearOctree,
    OctreeSettings, SearchOnDevice, Vec3,
};

use super::answers;
use super::chart::Chart;
use crate::Result;
use crate::check::Expected;
use crate::device::device_points;
use crate::device::timed::peaked;
use crate::measure::{Effort, Measured, repeat};
use crate::sets::{SEED, Set};

/// Who does the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Method {
    OneCore,
    AllCores,
    Gpu,
    GpuWithTransfers,
}

impl Method {
    pub(super) const ALL: [Self; 4] = [Self::OneCore, Self::AllCores, Self::Gpu, Self::GpuWithTransfers];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::OneCore => "one core",
            Self::AllCores => "all cores",
            Self::Gpu => "GPU",
            Self::GpuWithTransfers => "GPU with transfers",
        }
    }

    pub(super) fn on_gpu(self) -> bool {
        matches!(self, Self::Gpu | Self::GpuWithTransfers)
    }
}

/// Points with what the answers are checked against.
pub(crate) struct Case {
    pub(crate) points: Vec<Vec3>,
    pub(super) tree: LinearOctree,
    /// Of the neighbours; `None` where they are not counted.
    pub(super) expected: Option<Expected>,
    pub(super) domain: Domain,
    /// Points in the same box, to be located.
    pub(super) probes: Vec<Vec3>,
    radius: f32,
    /// Of the dense octree: about a cell a point at the last level.
    levels: u32,
}

/// Beyond this neighbours are not counted, and the invariants of the tree are not checked.
const LARGEST_ON_CPU: usize = 10_000_000;

impl Case {
    /// For all charts.
    pub(super) fn new(set: Set) -> Result<Self> {
        let case = Self::for_builds(set)?;
        let (points, domain) = (&case.points, case.domain);
        let counted = points.len() <= LARGEST_ON_CPU;
        let in_domain = |p: &Vec3| domain.origin() + *p * domain.edge() * 0.999;
        Ok(Self {
            expected: if counted { Some(Expected::of(points, case.radius)?) } else { None },
            probes: cloud(CloudKind::Uniform, points.len(), SEED + 1).points.iter().map(in_domain).collect(),
            ..case
        })
    }

    /// For construction alone: without neighbours and probes.
    pub(crate) fn for_builds(set: Set) -> Result<Self> {
        let (points, radius) = (set.points(), set.radius());
        let domain = Domain::of_bounds(&reduce::bounds(&points));
        let tree = LinearOctree::build(&points, &OctreeSettings::default().domain(domain))?;
        if let Some(broken) = (points.len() <= LARGEST_ON_CPU).then(|| tree.broken_invariant()).flatten() {
            return Err(format!("wrong answer: {broken}").into());
        }
        let levels = (points.len().ilog2() / 3).min(8);
        Ok(Self { points, tree, expected: None, domain, probes: Vec::new(), radius, levels })
    }

    /// Neighbours of a point, itself included; 0 where they are not counted.
    pub(super) fn mean_neighbors(&self) -> f64 {
        self.expected.as_ref().map_or(0.0, Expected::mean)
    }

    /// Nodes of the tree.
    pub(crate) fn nodes(&self) -> usize {
        self.tree.nodes().len()
    }

    fn settings(&self) -> OctreeSettings {
        OctreeSettings::default().domain(self.domain)
    }

    pub(super) fn dense_settings(&self) -> DenseOctreeSettings {
        DenseOctreeSettings::with_levels(self.levels).domain(self.domain)
    }
}

/// Measures; `None` for the GPU where there is none, and for neighbours of too many points to be checked.
pub(super) fn measure(
    gpu: Option<&Gpu>,
    case: &Case,
    chart: Chart,
    method: Method,
    effort: Effort,
) -> Result<Option<Measured>> {
    if chart == Chart::NearNeighbors && case.expected.is_none() {
        return Ok(None);
    }
    match (method, gpu) {
        (Method::OneCore, _) => {
            let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
            one.install(|| on_cpu(case, chart, effort)).map(Some)
        }
        (Method::AllCores, _) => on_cpu(case, chart, effort).map(Some),
        (Method::Gpu, Some(gpu)) => on_gpu(gpu, case, chart, effort).map(Some),
        (Method::GpuWithTransfers, Some(gpu)) => with_transfers(gpu, case, chart, effort).map(Some),
        (_, None) => Ok(None),
    }
}

fn on_cpu(case: &Case, chart: Chart, effort: Effort) -> Result<Measured> {
    let nothing = Vec::new;
    Ok(match chart {
        Chart::Curve => {
            let ordered = || Ok((curve::order_in(&case.points, Curve::Morton, &case.domain)?, nothing()));
            let (order, measured) = repeat(effort, ordered)?;
            answers::check_order(case, &order)?;
            measured
        }
        Chart::Octree => {
            let built = || {
                let tree = LinearOctree::build(&case.points, &case.settings())?;
                let stages = NeighborSearch::build_stages(&tree);
                Ok((tree, stages))
            };
            let (tree, measured) = repeat(effort, built)?;
            answers::check_tree(case, &tree)?;
            measured
        }
        Chart::PostOrder => {
            let tree = DenseOctree::build(&case.points, &case.dense_settings())?;
            let (numbers, measured) = repeat(effort, || Ok((tree.post_order_numbers(), nothing())))?;
            answers::check_post_order(&tree, &numbers)?;
            measured
        }
        Chart::NearNeighbors => {
            let question = FixedRadius::new(case.radius);
            let (counts, measured) = repeat(effort, || Ok((case.tree.count(&question)?.into_vec(), nothing())))?;
            answers::check_counts(case, &counts)?;
            measured
        }
        Chart::Locations => {
            let (nodes, measured) = repeat(effort, || Ok((case.tree.locate(&case.probes), nothing())))?;
            answers::check_locations(case, &nodes)?;
            measured
        }
    })
}

/// Points and answer on the device.
fn on_gpu(gpu: &Gpu, case: &Case, chart: Chart, effort: Effort) -> Result<Measured> {
    let n = case.points.len();
    let points = gpu.upload("points", &device_points(&case.points))?;
    Ok(match chart {
        Chart::Curve => {
            let plan = GpuCurveOrder::new(gpu, Curve::Morton, n)?;
            let order = gpu.buffer("order", n)?;
            let ((), measured) = repeat(effort, || Ok(((), run_order(gpu, &plan, case, &points, &order)?)))?;
            answers::check_order(case, &gpu.read(&order)?)?;
            measured
        }
        Chart::Octree => build_on_gpu(gpu, case, points, effort)?.0,
        Chart::PostOrder => {
            let tree = GpuDenseOctree::build(gpu, &case.points, &case.dense_settings())?;
            let numbered = || {
                let (numbers, stages) = tree.post_order_numbers_on_device()?;
                Ok((numbers, stages.iter().map(Stage::from).collect()))
            };
            let (numbers, measured) = repeat(effort, numbered)?;
            let on_cpu = DenseOctree::build(&case.points, &case.dense_settings())?;
            answers::check_post_order(&on_cpu, &gpu.read(&numbers)?)?;
            measured
        }
        Chart::NearNeighbors => {
            let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
            let question = FixedRadius::new(case.radius);
            let counted = || {
                let (counts, report) = tree.count_on_device(&question)?;
                Ok((counts, report.stages))
            };
            let (counts, measured) = repeat(effort, counted)?;
            answers::check_counts(case, &gpu.read(&counts)?)?;
            measured
        }
        Chart::Locations => {
            drop(points);
            let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
            let probes = gpu.upload("probes", &device_points(&case.probes))?;
            let located = || {
                let (nodes, stages) = tree.locate_on_device(&probes)?;
                Ok((nodes, stages.iter().map(Stage::from).collect()))
            };
            let (nodes, measured) = repeat(effort, located)?;
            answers::check_locations(case, &gpu.read(&nodes)?)?;
            measured
        }
    })
}

/// Construction of the octree of points on the device, with its bytes and the largest number of bytes held there meanwhile.
pub(crate) fn build_on_gpu(
    gpu: &Gpu,
    case: &Case,
    points: Buffer<DevicePoint>,
    effort: Effort,
) -> Result<(Measured, u64, u64)> {
    let mut builder = OctreeBuilder::new(gpu, points.len(), &case.settings())?;
    let (tree, measured, peak_bytes) = peaked(gpu, effort, || {
        let tree = builder.build(&points)?;
        let stages = NeighborSearch::build_stages(&tree);
        Ok((tree, stages))
    })?;
    // Reading back needs the memory.
    drop((builder, points));
    answers::check_tree(case, &tree.read()?)?;
    Ok((measured, NeighborSearch::memory_bytes(&tree), peak_bytes))
}

/// From host memory and back.
fn with_transfers(gpu: &Gpu, case: &Case, chart: Chart, effort: Effort) -> Result<Measured> {
    let nothing = Vec::new;
    Ok(match chart {
        Chart::Curve => {
            let plan = GpuCurveOrder::new(gpu, Curve::Morton, case.points.len())?;
            let on_device = gpu.buffer("order", case.points.len())?;
            let ordered = || {
                let points = gpu.upload("points", &device_points(&case.points))?;
                run_order(gpu, &plan, case, &points, &on_device)?;
                Ok((gpu.read(&on_device)?, nothing()))
            };
            let (order, measured) = repeat(effort, ordered)?;
            answers::check_order(case, &order)?;
            measured
        }
        Chart::Octree => {
            let built = || {
                let start = Instant::now();
                let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
                let milliseconds = start.elapsed().as_secs_f64() * 1e3;
                let build = Stage { name: "upload and build", milliseconds, clock: Clock::Host };
                Ok((tree.read()?, vec![build]))
            };
            let (tree, measured) = repeat(effort, built)?;
            answers::check_tree(case, &tree)?;
            measured
        }
        Chart::PostOrder => {
            let tree = GpuDenseOctree::build(gpu, &case.points, &case.dense_settings())?;
            let (numbers, measured) = repeat(effort, || Ok((tree.post_order_numbers()?, nothing())))?;
            let on_cpu = DenseOctree::build(&case.points, &case.dense_settings())?;
            answers::check_post_order(&on_cpu, &numbers)?;
            measured
        }
        Chart::NearNeighbors => {
            let question = FixedRadius::new(case.radius);
            let counted = || {
                let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
                Ok((tree.count(&question)?.into_vec(), nothing()))
            };
            let (counts, measured) = repeat(effort, counted)?;
            answers::check_counts(case, &counts)?;
            measured
        }
        Chart::Locations => {
            let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
            let (nodes, measured) = repeat(effort, || Ok((tree.locate(&case.probes)?, nothing())))?;
            answers::check_locations(case, &nodes)?;
            measured
        }
    })
}

/// Orders the points along the curve on the device; its stages.
fn run_order(
    gpu: &Gpu,
    plan: &GpuCurveOrder,
    case: &Case,
    points: &Buffer<DevicePoint>,
    order: &Buffer<u32>,
) -> Result<Vec<Stage>> {
    let mut commands = gpu.commands("order along a curve");
    plan.record(&mut commands, &case.domain, points, order, points.len())?;
    let stage = |t: &StageTime| Some(Stage { name: t.name, milliseconds: t.milliseconds?, clock: Clock::Device });
    Ok(commands.run()?.iter().filter_map(stage).collect())
}
