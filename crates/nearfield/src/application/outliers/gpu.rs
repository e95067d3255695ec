//! Outliers on the device: mean distances by a visitor on the nearest, neighbours by counts, duplicates by passes that decide what follows
//! from what is decided.

use glam::Vec3;

use super::{
    Duplicates, RadiusOutlierSettings, RadiusOutliers, StatisticalOutlierSettings, StatisticalOutliers, duplicates,
    radius, statistical,
};
use crate::Result;
use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, positive};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::parallel::reduce;
use crate::query::{DeviceQueries, FixedRadius, Knn, NeighborSearch, VisitorModule, record_module, visit_nearest};
use crate::structure::{AabbTreeSettings, GpuAabbTree, GpuStructure, GpuUniformGrid, GridSettings};

use Access::{ReadWrite, Uniform};

/// Size of the smallest cells that duplicates are looked for in, by the longest side of the points.
const SMALLEST_CELL: f32 = 1.0 / 65_536.0;

/// As [`super::statistical_outliers`] by the nearest of a tree on the device. Distances are summed in f32 there: means differ by a few ulp.
///
/// # Errors
/// `InvalidSetting`; `CoordinateTooLarge`, `TooMany` for the points; `Unsupported` where the device would end the kernel's loops;
/// `OutOfDeviceMemory`, `DeviceLost`; `Interrupted`.
pub fn statistical_outliers_on_gpu(
    gpu: &Gpu,
    points: &[Vec3],
    settings: &StatisticalOutlierSettings,
    watch: &mut Watch<'_>,
) -> Result<StatisticalOutliers<f32>> {
    settings.validate()?;
    let finite = FinitePoints::of(points)?;
    let n = finite.points().len();
    if n == 0 {
        return Ok(statistical::decide(&finite, Vec::new(), settings));
    }
    watch.report("nearest", 0, n as u64)?;
    let tree = GpuAabbTree::build(gpu, finite.points(), &AabbTreeSettings::DEFAULT)?;
    let means: Buffer<f32> = gpu.buffer("mean distances", n)?;
    let asked = gpu.uniform("what is not counted", &[settings.uncounted(), 0, 0, 0])?;
    let bindings: [(Access, Bind); 2] = [(Uniform, (&asked).into()), (ReadWrite, (&means).into())];
    let module = "package::application::outliers::mean_distance";
    let visitor = VisitorModule { module, features: &[], bindings: &bindings, rounds: [0, 0] };
    visit_nearest(&tree, &Knn::new(settings.searched().min(n as u32)), &visitor)?;
    watch.report("nearest", n as u64, n as u64)?;
    Ok(statistical::decide(&finite, gpu.read(&means)?, settings))
}

/// As [`super::radius_outliers`] by counts of a uniform grid on the device.
///
/// # Errors
/// As [`statistical_outliers_on_gpu`].
pub fn radius_outliers_on_gpu(
    gpu: &Gpu,
    points: &[Vec3],
    settings: &RadiusOutlierSettings,
    watch: &mut Watch<'_>,
) -> Result<RadiusOutliers> {
    let within: f32 = positive("radius", settings.radius)?;
    let finite = FinitePoints::of(points)?;
    if finite.points().is_empty() {
        return Ok(radius::decide(&finite, Vec::new(), settings));
    }
    watch.report("neighbours", 0, 2)?;
    let grid = GpuUniformGrid::build(gpu, finite.points(), &GridSettings::for_radius(within))?;
    watch.report("neighbours", 1, 2)?;
    let counts = grid.count(&FixedRadius::new(within).exclude_self())?;
    watch.report("neighbours", 2, 2)?;
    Ok(radius::decide(&finite, counts.into_vec(), settings))
}

/// As [`super::duplicates`] over a uniform grid on the device, in as many passes as decisions depend on each other: two or three but for long
/// chains of points that are within the tolerance one by one.
///
/// # Errors
/// As [`statistical_outliers_on_gpu`].
pub fn duplicates_on_gpu(gpu: &Gpu, points: &[Vec3], tolerance: f64, watch: &mut Watch<'_>) -> Result<Duplicates> {
    let tolerance: f32 = duplicates::radius(tolerance)?;
    let finite = FinitePoints::of(points)?;
    let n = finite.points().len();
    if n == 0 {
        return Ok(Duplicates::of(&finite, Vec::new()));
    }
    // Cells of no size there are none: those for a tolerance of 0 are small, so that each holds hardly more than one place.
    let extent = reduce::bounds(finite.points()).extent().max_element();
    let smallest = if extent > 0.0 { extent * SMALLEST_CELL } else { 1.0 };
    let grid = GpuUniformGrid::build(gpu, finite.points(), &GridSettings::for_radius(tolerance.max(smallest)))?;
    let exact = u32::from(tolerance == 0.0);
    let decisions: Buffer<u32> = gpu.buffer("decisions on points", n)?;
    let originals: Buffer<u32> = gpu.buffer("originals of points", n)?;
    let unfinished: Buffer<u32> = gpu.buffer("what is unfinished", 1)?;
    let mut cleared = gpu.commands("no decisions");
    cleared.clear(&decisions);
    cleared.submit()?;
    let pass = |is_last: u32| -> Result<bool> {
        let asked = gpu.uniform("pass over duplicates", &[is_last, exact, 0, 0])?;
        let bindings: [(Access, Bind); 4] = [
            (Uniform, (&asked).into()),
            (ReadWrite, (&decisions).into()),
            (ReadWrite, (&originals).into()),
            (ReadWrite, (&unfinished).into()),
        ];
        let module = "package::application::outliers::decide_duplicates";
        let visitor = VisitorModule { module, features: &[], bindings: &bindings, rounds: [0, 0] };
        let mut commands = gpu.commands("duplicates");
        commands.clear(&unfinished);
        record_module(&mut commands, &grid, &DeviceQueries::new(grid.points(), tolerance), &visitor)?;
        commands.submit()?;
        Ok(gpu.read(&unfinished)?[0] != 0)
    };
    loop {
        watch.report("duplicates", 0, n as u64)?;
        // Every pass decides at least the first of those that are open.
        if !pass(0)? {
            break;
        }
    }
    pass(1)?;
    watch.report("duplicates", n as u64, n as u64)?;
    Ok(Duplicates::of(&finite, gpu.read(&originals)?))
}
