//! The sixteen nearest of all points of a set by the tree of boxes and by the grid, and the refit of the tree.

use nearfield::parallel::reduce;
use nearfield::query::NeighborSearch;
use nearfield::structure::{AabbTreeBuilder, GridBuilder};
use nearfield::{AabbTreeSettings, BuildOrder, FixedRadius, GpuAabbTree, GridSettings, Knn};

use super::bench::Bench;
use super::row::{Figure, Outcome};
use crate::Result;
use crate::device::{NEAREST, fit, timed};

/// Build along the Hilbert curve on the device and query, and rebuild of a grid and query: the target is for the faster one. Beside them
/// the query alone in the order of median splits, which the CPU makes.
pub(super) fn knn(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.effort());
    let (n, question) = (points.points.len(), Knn::new(NEAREST));
    let input = points.upload(&gpu)?;
    let along_hilbert = AabbTreeSettings::default().order(BuildOrder::Hilbert);
    let mut builder = AabbTreeBuilder::new(&gpu, n, &along_hilbert)?;
    let structure = NeighborSearch::memory_bytes(&builder.build(&input)?);
    let attempt = timed::nearest(&gpu, &points.points, NEAREST, effort, || {
        let tree = builder.build(&input)?;
        let found = tree.knn_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&tree), found.report.stages.clone()].concat();
        Ok((found, stages))
    })?;
    let mut built = Figure::attempted("build and query, along hilbert", &attempt, n, structure);
    drop((builder, input));
    let mut by_grid = grid(bench, set)?;
    match by_grid.median() < built.median() || built.median().is_nan() {
        true => built.is_judged = false,
        false => by_grid.is_judged = false,
    }
    let tree = GpuAabbTree::build(&gpu, &points.points, &AabbTreeSettings::default())?;
    let attempt = timed::nearest(&gpu, &points.points, NEAREST, effort, || {
        let found = tree.knn_on_device(&question)?;
        let stages = found.report.stages.clone();
        Ok((found, stages))
    })?;
    let structure = NeighborSearch::memory_bytes(&tree);
    let beside = Figure::attempted("query alone, median splits of the CPU", &attempt, n, structure).beside();
    Ok(Outcome::without_neighbors(vec![built, by_grid, beside]))
}

/// Rebuild of a grid and query, points on the device and bounds known; its cells are made for the question once, on the host.
fn grid(bench: &mut Bench, set: &str) -> Result<Figure> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.effort());
    let (n, question) = (points.points.len(), Knn::new(NEAREST));
    let settings = GridSettings::for_nearest(&points.points, NEAREST);
    let bounds = reduce::bounds(&points.points);
    let input = points.upload(&gpu)?;
    let mut builder = GridBuilder::new(&gpu, n, &bounds, &settings)?;
    let structure = NeighborSearch::memory_bytes(&builder.build(&input)?);
    let attempt = timed::nearest(&gpu, &points.points, NEAREST, effort, || {
        let grid = builder.build(&input)?;
        let found = grid.knn_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&grid), found.report.stages.clone()].concat();
        Ok((found, stages))
    })?;
    let figure = Figure::attempted("rebuild of the grid and query", &attempt, n, structure);
    Ok(figure.note(format!("cells of {:.5}", settings.cell_size)))
}

/// Boxes fitted to points that were moved where they stand; checked by a count afterwards.
pub(super) fn refit(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.effort());
    let input = points.upload(&gpu)?;
    let n = input.len();
    let along_hilbert = AabbTreeSettings::default().order(BuildOrder::Hilbert);
    let tree = AabbTreeBuilder::new(&gpu, n, &along_hilbert)?.build(&input)?;
    let measured = fit(&tree, effort)?;
    let once = crate::measure::Effort { warm_up: 0.0, runs: 1, seconds: 0.0 };
    timed::counts(&tree, &FixedRadius::new(points.radius), points.expected()?, once)?;
    Ok(Outcome::without_neighbors(vec![Figure::by_device("", &measured)]))
}
