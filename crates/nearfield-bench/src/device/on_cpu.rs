//! The rows of the CPU: wall clock, all threads.

use std::time::Instant;

use nearfield::query::{Clock, NeighborSearch, Stage};
use nearfield::{FixedRadius, GridSettings, UniformGrid, Vec3};

use super::table::Row;
use crate::Result;
use crate::check::Expected;
use crate::measure::{Effort, Measured, repeat};
use crate::sets::Set;

/// Measures the set and hands over each row once its answer is checked.
pub(super) fn measure(set: &Set, points: &[Vec3], radius: f32, effort: Effort, mut add: impl FnMut(Row)) -> Result<()> {
    let expected = Expected::of(points, radius)?;
    let (settings, question) = (GridSettings::for_radius(radius), FixedRadius::new(radius));
    let row = |operation, search, measured: Measured, structure_bytes| Row {
        set: *set,
        radius,
        mean_neighbors: expected.mean(),
        operation,
        structure: "uniform-grid",
        search,
        clock: Clock::Host,
        measured: Some(measured),
        structure_bytes,
        peak_bytes: 0,
        note: String::new(),
    };

    let (grid, measured) = repeat(effort, || {
        let grid = UniformGrid::build(points, &settings)?;
        let stages = NeighborSearch::build_stages(&grid);
        Ok((grid, stages))
    })?;
    let bytes = NeighborSearch::memory_bytes(&grid);
    add(row("build", "", measured, bytes));

    let (counts, measured) = repeat(effort, || Ok((grid.count(&question)?, Vec::new())))?;
    expected.check_counts(counts.as_slice())?;
    add(row("count", counts.report.search, measured, bytes));

    let (list, measured) = repeat(effort, || {
        let list = grid.list(&question)?;
        let stages = list.report.stages.clone();
        Ok((list, stages))
    })?;
    expected.check_list(list.offsets(), list.indices())?;
    add(row("list", list.report.search, measured, bytes));
    drop(list);
    drop(grid);

    let (list, measured) = repeat(effort, || {
        let start = Instant::now();
        let grid = UniformGrid::build(points, &settings)?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let list = grid.list(&question)?;
        let mut stages = vec![Stage { name: "build", milliseconds, clock: Clock::Host }];
        stages.extend(list.report.stages.iter().cloned());
        Ok((list, stages))
    })?;
    expected.check_list(list.offsets(), list.indices())?;
    add(row("build + list", list.report.search, measured, bytes));
    Ok(())
}
