//! The rows of the AABB-tree on a GPU: times are the device's timestamps.
//!
//! "build" is along the Hilbert curve, bounds included; "refit" fits the boxes to points that were moved where they
//! stand; "refit, caller's order" takes new positions in the caller's order, check and reordering included, and so does
//! "refit + list".

use nearfield::gpu::{Buffer, Gpu};
use nearfield::query::{Clock, NeighborSearch, Stage};
use nearfield::structure::{AabbTreeBuilder, BuildStage, DevicePoint};
use nearfield::{AabbTreeSettings, BuildOrder, FixedRadius, GpuAabbTree, Knn, SearchOnDevice, TreeSearch, Vec3};

use super::on_gpu::{checked, device_points, too_large};
use super::table::Row;
use crate::check::{Expected, check_nearest};
use crate::measure::{Effort, Measured, repeat};
use crate::sets::Set;
use crate::{Error, Result};

/// Neighbours of the rows on nearest points.
pub(super) const NEAREST: u32 = 16;

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
    add(row("build", "", Some(measured), String::new()));

    let ((), measured) = repeat(effort, || Ok(((), refit(&mut tree, &input)?)))?;
    add(row("refit, caller's order", "", Some(measured), String::new()));
    let ((), measured) = repeat(effort, || {
        let mut commands = gpu.commands("fit");
        commands.stage("fit");
        tree.record_fit(&mut commands);
        Ok(((), commands.run()?.iter().filter_map(device_stage).collect()))
    })?;
    add(row("refit", "", Some(measured), String::new()));

    for order in [BuildOrder::Hilbert, BuildOrder::Median] {
        if order == BuildOrder::Median {
            tree = GpuAabbTree::build(gpu, points, &AabbTreeSettings::default().bucket_size(bucket))?;
        }
        for search in [TreeSearch::Packed, TreeSearch::Primary] {
            tree.set_search(search);
            let name = name_of(order, search);
            let (counts, measured) = repeat(effort, || {
                let (counts, report) = tree.count_on_device(&question)?;
                Ok((counts, report.stages))
            })?;
            expected.check_counts(&gpu.read(&counts)?)?;
            add(row("count", name, Some(measured), String::new()));
        }
        tree.set_search(TreeSearch::Packed);
        let name = name_of(order, TreeSearch::Packed);
        let listed = repeat(effort, || {
            let stages = refit(&mut tree, &input)?;
            let list = tree.list_on_device(&question)?;
            let stages = [stages, list.report.stages.clone()].concat();
            Ok((list, stages))
        });
        add(match checked(gpu, &expected, listed)? {
            Ok((measured, _)) => row("refit + list", name, Some(measured), String::new()),
            Err(note) => row("refit + list", name, None, note),
        });
        let unordered = repeat(effort, || {
            let rows = tree.list_rows_on_device(&question)?;
            let stages = rows.report.stages.clone();
            Ok((rows, stages))
        });
        add(match unordered {
            Ok((rows, measured)) => {
                expected.check_counts(&gpu.read(&rows.lengths)?)?;
                row(super::on_gpu::UNORDERED, name, Some(measured), String::new())
            }
            Err(error) => row(super::on_gpu::UNORDERED, name, None, too_large(error)?),
        });
        let found = repeat(effort, || {
            let found = tree.knn_on_device(&Knn::new(NEAREST))?;
            let stages = found.report.stages.clone();
            Ok((found, stages))
        });
        let name = if order == BuildOrder::Hilbert { "along hilbert" } else { "median splits" };
        add(match found {
            Ok((found, measured)) => {
                check_nearest(points, NEAREST, &gpu.read(&found.indices)?)?;
                row("kNN 16", name, Some(measured), String::new())
            }
            Err(error) => row("kNN 16", name, None, refused(error)?),
        });
    }
    drop(tree);
    let listed = repeat(effort, || {
        let tree = builder.build(&input)?;
        let list = tree.list_on_device(&question)?;
        let stages = [NeighborSearch::build_stages(&tree), list.report.stages.clone()].concat();
        Ok((list, stages))
    });
    let name = name_of(BuildOrder::Hilbert, TreeSearch::Packed);
    add(match checked(gpu, &expected, listed)? {
        Ok((measured, _)) => row("build + list", name, Some(measured), String::new()),
        Err(note) => row("build + list", name, None, note),
    });
    Ok(())
}

fn device_stage(time: &nearfield::gpu::StageTime) -> Option<Stage> {
    Some(Stage { name: time.name, milliseconds: time.milliseconds?, clock: Clock::Device })
}

fn refit(tree: &mut GpuAabbTree, input: &Buffer<DevicePoint>) -> Result<Vec<Stage>> {
    let stages: Vec<BuildStage> = tree.refit(input)?;
    Ok(stages.iter().map(Stage::from).collect())
}

/// The note for a question that a software device cannot answer; other errors stay errors.
fn refused(error: Error) -> Result<String> {
    match error.downcast_ref::<nearfield::Error>() {
        Some(unsupported @ nearfield::Error::Unsupported { .. }) => Ok(unsupported.to_string()),
        _ => Err(error),
    }
}

fn name_of(order: BuildOrder, search: TreeSearch) -> &'static str {
    match (order, search) {
        (BuildOrder::Hilbert, TreeSearch::Packed) => "packed, along hilbert",
        (BuildOrder::Hilbert, _) => "primary, along hilbert",
        (BuildOrder::Median, TreeSearch::Packed) => "packed, median splits",
        (BuildOrder::Median, _) => "primary, median splits",
    }
}
