//! One chart by one method at one number of points, with its answer checked.

use std::time::Instant;

use nearfield::curve::{self, GpuCurve};
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{Buffer, Gpu};
use nearfield::parallel::radix_sort::GpuRadixSort;
use nearfield::parallel::reduce;
use nearfield::query::{Clock, NeighborSearch, Stage};
use nearfield::structure::{DevicePoint, GpuStructure, OctreeBuilder};
use nearfield::{
    Curve, DenseOctree, DenseOctreeSettings, Domain, FixedRadius, GpuDenseOctree, GpuLinearOctree, LinearOctree,
    OctreeNode, OctreeSettings, SearchOnDevice, Vec3,
};

use super::chart::Chart;
use crate::Result;
use crate::device::device_points;
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

/// Points with what the CPU answers.
pub(super) struct Case {
    pub(super) points: Vec<Vec3>,
    pub(super) tree: LinearOctree,
    pub(super) mean_neighbors: f64,
    radius: f32,
    domain: Domain,
    /// Points in the same box, to be located.
    probes: Vec<Vec3>,
    /// Of the dense octree: about a cell a point at the last level.
    levels: u32,
}

/// Beyond this only what the GPU does is measured, and neighbours are not counted.
const LARGEST_ON_CPU: usize = 10_000_000;

impl Case {
    pub(super) fn new(set: Set) -> Result<Self> {
        let (points, radius) = (set.points(), set.radius());
        let domain = Domain::of_bounds(&reduce::bounds(&points));
        let tree = LinearOctree::build(&points, &OctreeSettings::default().domain(domain))?;
        if let Some(broken) = (points.len() <= LARGEST_ON_CPU).then(|| tree.broken_invariant()).flatten() {
            return Err(format!("wrong answer: {broken}").into());
        }
        let counted = points.len() <= LARGEST_ON_CPU;
        let counts = if counted { tree.count(&FixedRadius::new(radius))?.into_vec() } else { Vec::new() };
        let sum: u64 = counts.iter().map(|&count| u64::from(count)).sum();
        let in_domain = |p: &Vec3| domain.origin() + *p * domain.edge() * 0.999;
        Ok(Self {
            mean_neighbors: sum as f64 / counts.len().max(1) as f64,
            probes: cloud(CloudKind::Uniform, points.len(), SEED + 1).points.iter().map(in_domain).collect(),
            levels: (points.len().ilog2() / 3).min(8),
            points,
            tree,
            radius,
            domain,
        })
    }

    fn settings(&self) -> OctreeSettings {
        OctreeSettings::default().domain(self.domain)
    }

    fn dense_settings(&self) -> DenseOctreeSettings {
        DenseOctreeSettings::with_levels(self.levels).domain(self.domain)
    }
}

/// Measures; `None` for the GPU where there is none.
pub(super) fn measure(
    gpu: Option<&Gpu>,
    case: &Case,
    chart: Chart,
    method: Method,
    effort: Effort,
) -> Result<Option<Measured>> {
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
            repeat(effort, ordered)?.1
        }
        Chart::Octree => {
            let built = || {
                let tree = LinearOctree::build(&case.points, &case.settings())?;
                let stages = NeighborSearch::build_stages(&tree);
                Ok((tree, stages))
            };
            let (tree, measured) = repeat(effort, built)?;
            same("nodes", tree.nodes(), case.tree.nodes())?;
            measured
        }
        Chart::PostOrder => {
            let tree = DenseOctree::build(&case.points, &case.dense_settings())?;
            repeat(effort, || Ok((tree.post_order_numbers(), nothing())))?.1
        }
        Chart::NearNeighbors => {
            let question = FixedRadius::new(case.radius);
            repeat(effort, || Ok((case.tree.count(&question)?.into_vec(), nothing())))?.1
        }
        Chart::Locations => {
            let (nodes, measured) = repeat(effort, || Ok((case.tree.locate(&case.probes), nothing())))?;
            check_locations(case, &nodes)?;
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
            let plan = CurveOrder::new(gpu, n)?;
            let ((), measured) = repeat(effort, || Ok(((), plan.run(gpu, case, &points)?)))?;
            let expected = curve::order_in(&case.points, Curve::Morton, &case.domain)?;
            same("order along the curve", &gpu.read(&plan.order)?, &expected)?;
            measured
        }
        Chart::Octree => {
            let mut builder = OctreeBuilder::new(gpu, n, &case.settings())?;
            let built = || {
                let tree = builder.build(&points)?;
                let stages = NeighborSearch::build_stages(&tree);
                Ok((tree, stages))
            };
            let (tree, measured) = repeat(effort, built)?;
            drop(points);
            check_tree(gpu, case, &tree)?;
            measured
        }
        Chart::PostOrder => {
            let tree = GpuDenseOctree::build(gpu, &case.points, &case.dense_settings())?;
            let numbered = || {
                let (numbers, stages) = tree.post_order_numbers_on_device()?;
                Ok((numbers, stages.iter().map(Stage::from).collect()))
            };
            let (numbers, measured) = repeat(effort, numbered)?;
            let expected = DenseOctree::build(&case.points, &case.dense_settings())?.post_order_numbers();
            same("post-order numbers", &gpu.read(&numbers)?, &expected)?;
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
            check_counts(case, &gpu.read(&counts)?)?;
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
            check_locations(case, &gpu.read(&nodes)?)?;
            measured
        }
    })
}

/// From host memory and back.
fn with_transfers(gpu: &Gpu, case: &Case, chart: Chart, effort: Effort) -> Result<Measured> {
    let nothing = Vec::new;
    Ok(match chart {
        Chart::Curve => {
            let plan = CurveOrder::new(gpu, case.points.len())?;
            let ordered = || {
                let points = gpu.upload("points", &device_points(&case.points))?;
                plan.run(gpu, case, &points)?;
                Ok((gpu.read(&plan.order)?, nothing()))
            };
            repeat(effort, ordered)?.1
        }
        Chart::Octree => {
            let built = || {
                let start = Instant::now();
                let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
                let milliseconds = start.elapsed().as_secs_f64() * 1e3;
                let build = Stage { name: "upload and build", milliseconds, clock: Clock::Host };
                Ok((tree.read()?, vec![build]))
            };
            repeat(effort, built)?.1
        }
        Chart::PostOrder => {
            let tree = GpuDenseOctree::build(gpu, &case.points, &case.dense_settings())?;
            repeat(effort, || Ok((tree.post_order_numbers()?, nothing())))?.1
        }
        Chart::NearNeighbors => {
            let question = FixedRadius::new(case.radius);
            let counted = || {
                let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
                Ok((tree.count(&question)?.into_vec(), nothing()))
            };
            repeat(effort, counted)?.1
        }
        Chart::Locations => {
            let tree = GpuLinearOctree::build(gpu, &case.points, &case.settings())?;
            repeat(effort, || Ok((tree.locate(&case.probes)?, nothing())))?.1
        }
    })
}

/// Keys and their sort on the device.
struct CurveOrder {
    curve: GpuCurve,
    sort: GpuRadixSort<u64>,
    keys: Buffer<u64>,
    sorted_keys: Buffer<u64>,
    order: Buffer<u32>,
}

impl CurveOrder {
    fn new(gpu: &Gpu, n: usize) -> Result<Self> {
        Ok(Self {
            curve: GpuCurve::new(gpu, Curve::Morton),
            sort: GpuRadixSort::new(gpu, n)?,
            keys: gpu.buffer("keys", n)?,
            sorted_keys: gpu.buffer("sorted keys", n)?,
            order: gpu.buffer("order", n)?,
        })
    }

    fn run(&self, gpu: &Gpu, case: &Case, points: &Buffer<DevicePoint>) -> Result<Vec<Stage>> {
        let n = points.len();
        let mut commands = gpu.commands("order along a curve");
        commands.stage("keys");
        self.curve.record_point_keys(&mut commands, &case.domain, points, &self.keys, n)?;
        commands.stage("sort");
        self.sort.record_from(&mut commands, &self.keys, None, &self.sorted_keys, &self.order, n, 0..63)?;
        let stage = |t: &nearfield::gpu::StageTime| {
            Some(Stage { name: t.name, milliseconds: t.milliseconds?, clock: Clock::Device })
        };
        Ok(commands.run()?.iter().filter_map(stage).collect())
    }
}

fn check_tree(gpu: &Gpu, case: &Case, tree: &GpuLinearOctree) -> Result<()> {
    same("nodes", &gpu.read::<OctreeNode>(tree.nodes())?, case.tree.nodes())?;
    same("numbers in pre-order", &gpu.read(tree.pre_order_numbers())?, case.tree.pre_order_numbers())?;
    same("numbers in post-order", &gpu.read(tree.post_order_numbers())?, case.tree.post_order_numbers())?;
    let ids = gpu.read(tree.ids().expect("the octree should keep indices"))?;
    same("order of the points", &ids, case.tree.ordered_points().ids())
}

/// Counts may differ by pairs at the very radius, where a device fuses operations: the radius a few ulp smaller and
/// larger bounds them.
fn check_counts(case: &Case, found: &[u32]) -> Result<()> {
    let ulps = case.radius * 4.0 * f32::EPSILON;
    let fewest = case.tree.count(&FixedRadius::new(case.radius - ulps))?.into_vec();
    let most = case.tree.count(&FixedRadius::new(case.radius + ulps))?.into_vec();
    let wrong = found.iter().enumerate().find(|(i, count)| !(fewest[*i]..=most[*i]).contains(count));
    match wrong {
        None => Ok(()),
        Some((i, count)) => {
            Err(format!("wrong answer: {count} neighbours of point {i}, expected {} to {}", fewest[i], most[i]).into())
        }
    }
}

/// Each node must hold its probe, and have no child that does.
fn check_locations(case: &Case, found: &[u32]) -> Result<()> {
    same("located nodes", found, &case.tree.locate(&case.probes))?;
    for (probe, &node) in case.probes.iter().zip(found).step_by(1009) {
        let key = nearfield::Octant::of_key(case.domain.key_of(Curve::Morton, *probe), curve::MAX_LEVEL);
        let node = &case.tree.nodes()[node as usize];
        let deeper = node.children().any(|child| case.tree.nodes()[child].octant.contains(key));
        if deeper || !node.octant.contains(key) {
            return Err(format!("wrong answer: {probe} is not in the node found for it").into());
        }
    }
    Ok(())
}

fn same<T: PartialEq + std::fmt::Debug>(what: &str, found: &[T], expected: &[T]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let first = found.iter().zip(expected).position(|(f, e)| f != e);
    let lengths = (found.len(), expected.len());
    Err(format!("wrong answer: {what} differ from the CPU's, first at {first:?}, lengths {lengths:?}").into())
}
