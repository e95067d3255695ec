//! The rows of the AABB-tree on the CPU: wall clock, all threads.

use nearfield::query::{Clock, NeighborSearch};
use nearfield::{AabbTree, AabbTreeSettings, BuildOrder, FixedRadius, Knn, KnnSearch, TreeSearch, Vec3};

use super::table::Row;
use super::tree_on_gpu::NEAREST;
use crate::Result;
use crate::check::{Expected, check_nearest};
use crate::measure::{Effort, Measured, repeat};
use crate::sets::Set;

/// Measures the set and hands over each row once its answer is checked.
pub(super) fn measure(
    set: &Set,
    points: &[Vec3],
    radius: f32,
    bucket: u32,
    effort: Effort,
    mut add: impl FnMut(Row),
) -> Result<()> {
    let expected = Expected::of(points, radius)?;
    let question = FixedRadius::new(radius);
    let row = |operation, search, measured: Measured, structure_bytes| Row {
        set: *set,
        radius,
        mean_neighbors: expected.mean(),
        operation,
        structure: "aabb-tree",
        search,
        clock: Clock::Host,
        measured: Some(measured),
        structure_bytes,
        peak_bytes: 0,
        note: String::new(),
    };
    for (order, name) in [(BuildOrder::Median, "median splits"), (BuildOrder::Hilbert, "along hilbert")] {
        let settings = AabbTreeSettings::default().bucket_size(bucket).order(order);
        let (mut tree, measured) = repeat(effort, || {
            let tree = AabbTree::build(points, &settings)?;
            let stages = NeighborSearch::build_stages(&tree);
            Ok((tree, stages))
        })?;
        let bytes = NeighborSearch::memory_bytes(&tree);
        add(row("build", name, measured, bytes));

        let ((), measured) = repeat(effort, || Ok((tree.refit(points)?, Vec::new())))?;
        add(row("refit", name, measured, bytes));

        for search in TreeSearch::ALL {
            tree.set_search(search);
            let (counts, measured) = repeat(effort, || Ok((tree.count(&question)?, Vec::new())))?;
            expected.check_counts(counts.as_slice())?;
            add(row("count", counts.report.search, measured, bytes));
        }
        tree.set_search(TreeSearch::Packed);
        let (list, measured) = repeat(effort, || {
            let list = tree.list(&question)?;
            let stages = list.report.stages.clone();
            Ok((list, stages))
        })?;
        expected.check_list(list.offsets(), list.indices())?;
        add(row("list", name, measured, bytes));
        drop(list);

        let (found, measured) = repeat(effort, || {
            let found = tree.knn(&Knn::new(NEAREST))?;
            let stages = found.report.stages.clone();
            Ok((found, stages))
        })?;
        check_nearest(points, NEAREST, found.indices())?;
        add(row("kNN 16", name, measured, bytes));
        drop((found, tree));

        let (list, measured) = repeat(effort, || {
            let list = AabbTree::build(points, &settings)?.list(&question)?;
            let stages = list.report.stages.clone();
            Ok((list, stages))
        })?;
        expected.check_list(list.offsets(), list.indices())?;
        add(row("build + list", name, measured, bytes));
    }
    Ok(())
}
