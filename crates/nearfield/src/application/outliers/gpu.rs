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
/// Points between two reports, enough to fill a device.
const DEVICE_BLOCK: usize = 1 << 18;
/// Passes over duplicates; what is open then goes on from one point to the next, and is decided on the host.
const MOST_PASSES: u32 = 16;
/// Passes after which the open points are counted.
const PASSES_TO_COUNT: u32 = 4;
/// Decisions on points; twins of those in decide_duplicates.wesl.
const OPEN: u32 = 0;
const STAYS: u32 = 1;
const DUPLICATE: u32 = 2;

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
    let tree = GpuAabbTree::build(gpu, finite.points(), &AabbTreeSettings::DEFAULT)?;
    let asked = gpu.uniform("what is not counted", &[settings.uncounted(), 0, 0, 0])?;
    let nearest = Knn::new(settings.searched().min(n as u32));
    let mut distances = Vec::with_capacity(n);
    for block in finite.points().chunks(DEVICE_BLOCK) {
        watch.report("nearest", distances.len() as u64, n as u64)?;
        let means: Buffer<f32> = gpu.buffer("mean distances", block.len())?;
        let bindings: [(Access, Bind); 2] = [(Uniform, (&asked).into()), (ReadWrite, (&means).into())];
        let module = "package::application::outliers::mean_distance";
        let visitor = VisitorModule { module, features: &[], bindings: &bindings, rounds: [0, 0], combines: false };
        // All points are searched for in the order of the tree. A point finds itself in either case.
        let question = if block.len() == n { nearest } else { nearest.queries(block) };
        visit_nearest(&tree, &question, &visitor)?;
        distances.extend(gpu.read(&means)?);
    }
    watch.report("nearest", n as u64, n as u64)?;
    Ok(statistical::decide(&finite, distances, settings))
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
/// chains of points that are within the tolerance one by one, whose points that are open after 16 passes are decided on the host.
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
        let visitor = VisitorModule { module, features: &[], bindings: &bindings, rounds: [0, 0], combines: false };
        let mut commands = gpu.commands("duplicates");
        commands.clear(&unfinished);
        record_module(&mut commands, &grid, &DeviceQueries::new(grid.points(), tolerance), &visitor)?;
        commands.submit()?;
        Ok(gpu.read(&unfinished)?[0] != 0)
    };
    // Every pass decides at least the first of those that are open.
    let (mut decided, mut n_open) = (Vec::new(), n);
    for done in 1..=MOST_PASSES {
        watch.report("duplicates", (n - n_open) as u64, n as u64)?;
        if !pass(0)? {
            n_open = 0;
            break;
        }
        if done % PASSES_TO_COUNT == 0 {
            decided = gpu.read(&decisions)?;
            n_open = decided.iter().filter(|decision| **decision == OPEN).count();
        }
    }
    if n_open > 0 {
        let places: &[[f32; 3]] = bytemuck::cast_slice(finite.points());
        if tolerance == 0.0 {
            let originals = duplicates::at_one_place(places);
            watch.report("duplicates", n as u64, n as u64)?;
            return Ok(Duplicates::of(&finite, originals));
        }
        decide_open(places, tolerance, &mut decided, watch)?;
        gpu.write(&decisions, 0, &decided)?;
    }
    pass(1)?;
    watch.report("duplicates", n as u64, n as u64)?;
    Ok(Duplicates::of(&finite, gpu.read(&originals)?))
}

/// Decides on the host what is open.
///
/// # Errors
/// `Interrupted`.
fn decide_open(points: &[[f32; 3]], tolerance: f32, decided: &mut [u32], watch: &mut Watch<'_>) -> Result<()> {
    let mut staying = duplicates::Staying::none(points, tolerance);
    let mut open = Vec::new();
    for (&decision, id) in decided.iter().zip(0..) {
        match decision {
            OPEN => open.push(id),
            STAYS => staying.add(id),
            _ => {}
        }
    }
    staying.decide(&open, watch, |id, original| {
        decided[id as usize] = if original == id { STAYS } else { DUPLICATE };
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn open_points_are_decided_by_those_that_stay() {
        // A row: 0 stays; 1 is its duplicate; 2, 3 and 4 are open; 5 stays, and stands behind 4.
        let points = [0.0, 0.5, 1.0, 1.5, 2.0, 2.75].map(|x| [x, 0.0, 0.0]);
        let mut decided = [STAYS, DUPLICATE, OPEN, OPEN, OPEN, STAYS];
        decide_open(&points, 0.5, &mut decided, &mut Watch::none()).unwrap();
        assert_eq!(decided, [STAYS, DUPLICATE, STAYS, DUPLICATE, STAYS, STAYS]);
    }
}
