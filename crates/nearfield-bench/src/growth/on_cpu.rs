//! Build and count on the CPU by all threads, wall clock.

use nearfield::query::NeighborSearch;
use nearfield::{
    AabbTree, AabbTreeSettings, BruteForce, FixedRadius, GridSettings, LinearOctree, OctreeSettings, UniformGrid,
};

use super::Task;
use super::rows::{Row, Table};
use crate::Result;
use crate::measure::{Effort, repeat};

/// Most pairs that brute force tests.
const MOST_PAIRS: f64 = 1e10;
const EFFORT: Effort = Effort { warm_up: 0.0, runs: 5, seconds: 1.0 };

/// Measures every structure on the cloud.
pub(super) fn measure(task: &Task<'_>, table: &mut Table) -> Result<()> {
    let (points, radius, kind) = (&task.cloud.points, task.cloud.radius, task.cloud.kind);
    let pairs = (points.len() as f64).powi(2);
    let mut total = None;
    by(task, table, "uniform-grid", &mut total, || Ok(UniformGrid::build(points, &GridSettings::for_radius(radius))?))?;
    by(task, table, "aabb-tree", &mut total, || Ok(AabbTree::build(points, &AabbTreeSettings::default())?))?;
    by(task, table, "linear-octree", &mut total, || Ok(LinearOctree::build(points, &OctreeSettings::default())?))?;
    if pairs > MOST_PAIRS {
        table.add(Row::missing(kind, points.len(), "brute-force", format!("left out: {pairs:.0e} pairs")));
        return Ok(());
    }
    by(task, table, "brute-force", &mut total, || Ok(BruteForce::build(points)?))
}

/// Adds the row of a structure.
fn by<S: NeighborSearch>(
    task: &Task<'_>,
    table: &mut Table,
    name: &'static str,
    total: &mut Option<u64>,
    mut build: impl FnMut() -> Result<S>,
) -> Result<()> {
    let cloud = task.cloud;
    if task.is_over() {
        table.add(Row::missing(cloud.kind, cloud.points.len(), name, "left out: the budget is spent"));
        return Ok(());
    }
    let (structure, built) = repeat(EFFORT, || Ok((build()?, Vec::new())))?;
    let question = FixedRadius::new(cloud.radius);
    let (counts, counted) = repeat(EFFORT, || Ok((structure.count(&question)?, Vec::new())))?;
    *total = Some(cloud.check(counts.as_slice(), *total)?);
    table.add(Row::of(cloud, name, [&built, &counted], [structure.memory_bytes(), 0], *total));
    Ok(())
}
