//! The rows of the AABB-tree on a GPU: times are the device's timestamps.
//!
//! "build" is along the Hilbert curve, bounds included; "refit" fits the boxes to points that were moved where they
//! stand; "refit, caller's order" takes new positions in the caller's order, check and reordering included, and so does
//! "refit + list".

use nearfield::gpu::{Buffer, Gpu};
use nearfield::query::{Clock, NeighborSearch, Stage};
use nearfield::structure::{AabbTreeBuilder, BuildStage, DevicePoint, GpuStructure};
use nearfield::{AabbTreeSettings, BuildOrder, FixedRadius, GpuAabbTree, Knn, SearchOnDevice, TreeSearch, Vec3};

use super::table::Row;
use super::timed::{self, Attempt, device_points, device_stage};
use crate::Result;
use crate::check::Expected;
use crate::measure::{Effort, Measured, repeat};
use crate::sets::Set;

/// Neighbours of the rows on nearest points.
pub(crate) const NEAREST: u32 = 16;

/// Measures the set and hands over each row once its answer is checked.
pub(super) fn measure(
    gpu: &Gpu,
    set: &Set,
    points: &[Vec3],
    radius: f32,
    bucket: u32,
    effort: Effort,
    mut add: impl FnMut(Row),
) -> Result<()> {
    let expected = Expected::of(points, radius)?;
    let input = gpu.upload("points", &device_points(points))?;
    let question = FixedRadius::new(radius);
    let row = |operation, search, measured: Option<Measured>, note: String| Row {
        set: *set,
        radius,
        mean_neighbors: expected.mean(),
        operation,
        structure: "aabb-tree",
        search,
        clock: Clock::Device,
        measured,
        structure_bytes: 0,
        peak_bytes: 0,
        note,
    };
    let along_hilbert = AabbTreeSettings::default().bucket_size(bucket).order(BuildOrder::Hilbert);
    let mut builder = AabbTreeBuilder::new(gpu, points.len(), &along_hilbert)?;
    let (mut tree, measured) = repeat(effort, || {
        let tree = builder.build(&input)?;
        let stages = NeighborSearch::build_stages(&tree);
        Ok((tree, stages))
    })?;
    let structure_bytes = NeighborSearch::memory_bytes(&tree);
    let row = |operation, search, measured, note| Row { structure_bytes, ..row(operation, search, measured, note) };
    let attempted = |operation, search, attempt: Attempt| match attempt {
        Ok(timed) => {
            Row { peak_bytes: timed.peak_bytes, ..row(operation, search, Some(timed.measured), String::new()) }
        }
        Err(note) => row(operation, search, None, note),
    };
    add(row("build", "", Some(measured), String::new()));

    let ((), measured) = repeat(effort, || Ok(((), refit(&mut tree, &input)?)))?;
    add(row("refit, caller's order", "", Some(measured), String::new()));
    add(row("refit", "", Some(fit(&tree, effort)?), String::new()));

    for order in [BuildOrder::Hilbert, BuildOrder::Median] {
        if order == BuildOrder::Median {
            tree = GpuAabbTree::build(gpu, points, &AabbTreeSettings::default().bucket_size(bucket))?;
        }
        for search in [TreeSearch::Packed, TreeSearch::Primary] {
            tree.set_search(search);
            let counted = timed::counts(&tree, &question, &expected, effort)?;
            add(attempted("count", name_of(order, search), Ok(counted)));
        }
        tree.set_search(TreeSearch::Packed);
        let name = name_of(order, TreeSearch::Packed);
        let listed = timed::list(gpu, &expected, effort, || {
            let stages = refit(&mut tree, &input)?;
            let list = tree.list_on_device(&question)?;
            let stages = [stages, list.report.stages.clone()].concat();
            Ok((list, stages))
        })?;
        add(attempted("refit + list", name, listed));
        let unordered = timed::rows(gpu, &expected, effort, || {
            let rows = tree.list_rows_on_device(&question)?;
            let stages = rows.report.stages.clone();
            Ok((rows, stages))
        })?;
        add(attempted(super::on_gpu::UNORDERED, name, unordered));
        let found = timed::nearest(gpu, points, NEAREST, effort, || {
            let found = tree.knn_on_device(&Knn::new(NEAREST))?;
            let stages = found.report.stages.clone();
            Ok((found, stages))
        })?;
        let name = if order == BuildOrder::Hilbert { "along hilbert" } else { "median splits" };
        add(attempted("kNN 16", name, found));
    }
    drop(tree);
    let listed = timed::list(gpu, &expected, effort, || {
        let tree = builder.build(&input)?;
        let list = tree.list_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&tree), list.report.stages.clone()].concat();
        Ok((list, stages))
    })?;
    add(attempted("build + list", name_of(BuildOrder::Hilbert, TreeSearch::Packed), listed));
    Ok(())
}

/// Times of fitting the boxes to points where they stand.
pub(crate) fn fit(tree: &GpuAabbTree, effort: Effort) -> Result<Measured> {
    let ((), measured) = repeat(effort, || {
        let mut commands = GpuStructure::gpu(tree).commands("fit");
        commands.stage("fit");
        tree.record_fit(&mut commands);
        Ok(((), commands.run()?.iter().filter_map(device_stage).collect()))
    })?;
    Ok(measured)
}

fn refit(tree: &mut GpuAabbTree, input: &Buffer<DevicePoint>) -> Result<Vec<Stage>> {
    let stages: Vec<BuildStage> = tree.refit(input)?;
    Ok(stages.iter().map(Stage::from).collect())
}

fn name_of(order: BuildOrder, search: TreeSearch) -> &'static str {
    match (order, search) {
        (BuildOrder::Hilbert, TreeSearch::Packed) => "packed, along hilbert",
        (BuildOrder::Hilbert, _) => "primary, along hilbert",
        (BuildOrder::Median, TreeSearch::Packed) => "packed, median splits",
        (BuildOrder::Median, _) => "primary, median splits",
    }
}
