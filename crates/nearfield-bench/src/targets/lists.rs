//! Counts and lists of the neighbours of all points of a set, by the grid and by the tree of boxes.

use nearfield::parallel::reduce;
use nearfield::query::NeighborSearch;
use nearfield::structure::{AabbTreeBuilder, GridBuilder};
use nearfield::{AabbTreeSettings, BuildOrder, FixedRadius, GridSettings, SearchOnDevice, TreeSearch};

use super::bench::Bench;
use super::row::{Figure, Outcome};
use crate::Result;
use crate::device::timed;

/// In which order rows stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rows {
    /// As the queries: compressed sparse rows.
    InQueryOrder,
    /// As they were finished.
    InCompletionOrder,
}

/// Rebuild of the grid and list of all neighbours, points on the device and bounds known.
pub(super) fn grid_list(bench: &mut Bench, set: &str, rows: Rows) -> Result<Outcome> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.effort());
    let (expected, question) = (points.expected()?, FixedRadius::new(points.radius));
    let input = points.upload(&gpu)?;
    let bounds = reduce::bounds(&points.points);
    let mut builder = GridBuilder::new(&gpu, input.len(), &bounds, &GridSettings::for_radius(points.radius))?;
    let structure = NeighborSearch::memory_bytes(&builder.build(&input)?);
    let attempt = match rows {
        Rows::InQueryOrder => timed::list(&gpu, expected, effort, || {
            let grid = builder.build(&input)?;
            let list = grid.list_on_device(&question)?;
            let stages = [NeighborSearch::build_stages(&grid), list.report.stages.clone()].concat();
            Ok((list, stages))
        }),
        Rows::InCompletionOrder => timed::rows(&gpu, expected, effort, || {
            let grid = builder.build(&input)?;
            let rows = grid.list_rows_on_device(&question)?;
            let stages = [NeighborSearch::build_stages(&grid), rows.report.stages.clone()].concat();
            Ok((rows, stages))
        }),
    }?;
    let figure = Figure::attempted("grid", &attempt, points.points.len(), structure);
    Ok(Outcome::of(expected.mean(), vec![figure]))
}

/// Counts of all points, the query alone, by the grid; where asked for also by the tree along the Hilbert curve.
pub(super) fn count(bench: &mut Bench, set: &str, also_by_tree: bool) -> Result<Outcome> {
    let (points, gpu, effort) = (bench.set(set)?, bench.gpu.clone(), bench.effort());
    let (expected, question, n) = (points.expected()?, FixedRadius::new(points.radius), points.points.len());
    let input = points.upload(&gpu)?;
    let bounds = reduce::bounds(&points.points);
    let settings = GridSettings::for_radius(points.radius);
    let grid = GridBuilder::new(&gpu, n, &bounds, &settings)?.build(&input)?;
    let counted = timed::counts(&grid, &question, expected, effort)?;
    let mut figures = vec![Figure::timed("grid", &counted, n, NeighborSearch::memory_bytes(&grid))];
    drop(grid);
    if also_by_tree {
        let settings = AabbTreeSettings::default().order(BuildOrder::Hilbert);
        let mut tree = AabbTreeBuilder::new(&gpu, n, &settings)?.build(&input)?;
        tree.set_search(TreeSearch::Packed);
        let counted = timed::counts(&tree, &question, expected, effort)?;
        figures.push(Figure::timed("tree along hilbert", &counted, n, NeighborSearch::memory_bytes(&tree)));
        // The target is for the best of them.
        let slower = usize::from(figures[1].median() > figures[0].median());
        figures[slower].is_judged = false;
    }
    Ok(Outcome::of(expected.mean(), figures))
}
