//! Build and count on a GPU, points on the device, by its timestamps.

use nearfield::gpu::{AdapterKind, Buffer, Gpu};
use nearfield::parallel::reduce;
use nearfield::query::{NeighborSearch, Stage};
use nearfield::structure::{
    AabbTreeBuilder, DevicePoint, EntryOrder, GpuStructure, GridBuilder, LevelRule, MultiLevelGridBuilder,
    OctreeBuilder,
};
use nearfield::{
    AabbTreeSettings, BuildOrder, Domain, FixedRadius, GpuBruteForce, GridSettings, OctreeSettings, SearchOnDevice,
};

use super::Task;
use super::rows::{Row, Table};
use crate::Result;
use crate::device::device_points;
use crate::device::timed::{device_stage, not_possible, peaked};
use crate::measure::{Effort, Measured};

/// Most pairs that brute force tests: on a GPU in hardware, and elsewhere.
const MOST_PAIRS: [f64; 2] = [1e11, 1e9];

/// A built structure, its times, and the most bytes that were held while it was built.
type Built<S> = (S, Measured, u64);

/// Builds a structure over points on the device.
type Build<'a> = dyn Fn(&Buffer<DevicePoint>) -> Result<Box<dyn Counting>> + 'a;

/// Measures every structure on the cloud.
pub(super) fn measure(gpu: &Gpu, task: &Task<'_>, table: &mut Table) -> Result<()> {
    let (points, radius) = (&task.cloud.points, task.cloud.radius);
    let n = points.len();
    let needed = (n * size_of::<DevicePoint>()) as u64;
    if needed > gpu.limits().binding_bytes {
        let note = format!("does not fit: {needed} bytes of points, {} in a binding", gpu.limits().binding_bytes);
        table.add(Row::missing(task.cloud.kind, n, "all", note));
        return Ok(());
    }
    let input = gpu.upload("points", &device_points(points))?;
    let bounds = reduce::bounds(points);
    let effort = effort(gpu);
    let mut total = None;
    let mut by = |name, build: &Build<'_>| -> Result<()> {
        let row = if task.is_over() {
            Row::missing(task.cloud.kind, n, name, "left out: the budget is spent")
        } else {
            match build(&input).and_then(|built| built.row(gpu, task, name, effort, &mut total)) {
                Ok(row) => row,
                Err(error) => Row::missing(task.cloud.kind, n, name, not_possible(error)?),
            }
        };
        table.add(row);
        Ok(())
    };
    by("uniform-grid", &|input| {
        let mut builder = GridBuilder::new(gpu, n, &bounds, &GridSettings::for_radius(radius))?;
        boxed(own_stages(gpu, effort, || Ok(builder.build(input)?))?)
    })?;
    by("multi-level-grid", &|input| {
        let builder = MultiLevelGridBuilder::new(gpu, &[(n, radius)], LevelRule::Own, &bounds, EntryOrder::Any)?;
        let mut grid = builder.build(input)?;
        let ((), measured, peak) = peaked(gpu, effort, || {
            let mut commands = gpu.commands("grid of several levels");
            commands.stage("build");
            builder.record_rebuild(&mut commands, input, &mut grid)?;
            Ok(((), commands.run()?.iter().filter_map(device_stage).collect()))
        })?;
        boxed((grid, measured, peak))
    })?;
    by("aabb-tree", &|input| {
        let settings = AabbTreeSettings::default().order(BuildOrder::Hilbert);
        let mut builder = AabbTreeBuilder::new(gpu, n, &settings)?;
        boxed(own_stages(gpu, effort, || Ok(builder.build(input)?))?)
    })?;
    by("linear-octree", &|input| {
        let settings = OctreeSettings::default().domain(Domain::of_bounds(&bounds));
        let mut builder = OctreeBuilder::new(gpu, n, &settings)?;
        boxed(own_stages(gpu, effort, || Ok(builder.build(input)?))?)
    })?;
    let pairs = (n as f64).powi(2);
    if pairs > MOST_PAIRS[usize::from(gpu.kind() == AdapterKind::Software)] {
        table.add(Row::missing(task.cloud.kind, n, "brute-force", format!("left out: {pairs:.0e} pairs")));
        return Ok(());
    }
    by("brute-force", &|input| boxed(own_stages(gpu, effort, || Ok(GpuBruteForce::build_on_device(gpu, input)?))?))
}

fn effort(gpu: &Gpu) -> Effort {
    if gpu.kind() == AdapterKind::Software {
        Effort { warm_up: 0.0, runs: 1, seconds: 0.0 }
    } else {
        Effort { warm_up: 0.2, runs: 9, seconds: 0.5 }
    }
}

/// Repeats a build whose structure tells its stages.
fn own_stages<S: GpuStructure + NeighborSearch>(
    gpu: &Gpu,
    effort: Effort,
    mut build: impl FnMut() -> Result<S>,
) -> Result<Built<S>> {
    peaked(gpu, effort, || {
        let structure = build()?;
        let stages: Vec<Stage> = NeighborSearch::build_stages(&structure);
        Ok((structure, stages))
    })
}

fn boxed<S: SearchOnDevice + 'static>(built: Built<S>) -> Result<Box<dyn Counting>> {
    Ok(Box::new(built))
}

/// A built structure of any kind, to be counted by.
trait Counting {
    /// Counts, checks, and makes the row of both.
    fn row(
        &self,
        gpu: &Gpu,
        task: &Task<'_>,
        name: &'static str,
        effort: Effort,
        total: &mut Option<u64>,
    ) -> Result<Row>;
}

impl<S: SearchOnDevice> Counting for Built<S> {
    fn row(
        &self,
        gpu: &Gpu,
        task: &Task<'_>,
        name: &'static str,
        effort: Effort,
        total: &mut Option<u64>,
    ) -> Result<Row> {
        let (structure, build, build_peak) = self;
        let question = FixedRadius::new(task.cloud.radius);
        let (counts, count, count_peak) = peaked(gpu, effort, || {
            let (counts, report) = structure.count_on_device(&question)?;
            Ok((counts, report.stages))
        })?;
        *total = Some(task.cloud.check(&gpu.read(&counts)?, *total)?);
        let bytes = [GpuStructure::memory_bytes(structure), (*build_peak).max(count_peak)];
        Ok(Row::of(task.cloud, name, [build, &count], bytes, *total))
    }
}
