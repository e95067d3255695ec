//! The voxel grid on the device: its radix sort by 63-bit numbers of cells, and an invocation a cell. The numbers are computed on the host in
//! f64, so that the cells are those of the CPU, to the last point.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::voxel::{Lattice, VoxelPoint, VoxelSettings, Voxels};
use crate::application::Watch;
use crate::application::finite_points::FinitePoints;
use crate::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::scan::GpuScan;
use crate::structure::upload_points;
use crate::{Error, Result};

/// Invocations of a workgroup of the kernels.
const WORKGROUP: u32 = 128;
/// Points of a task on the host.
const TASK: usize = 1 << 12;
/// Most points of a cell, which one invocation goes through.
const MOST_IN_CELL: u32 = 1 << 20;

use Access::{Read, ReadWrite, Uniform};

/// As [`super::voxel_downsample`] on the device: the same cells; means are summed in f32 relative to the first point of each cell, in blocks of
/// 256 points. Of a cell of c points each coordinate of a mean is within (260 + c / 256) · 2⁻²⁴ of the cell's size, beside the rounding of the
/// coordinate itself; roundings mostly cancel, and leave far less. The nearest of nearly equals may be another.
///
/// # Errors
/// As [`super::voxel_downsample`], with `CoordinateTooLarge` for the points; `Unsupported` for cells of more than 2²⁰ points, or where the
/// device would end the kernel's loops, but not for the first points of cells, which need none; `OutOfDeviceMemory`, `DeviceLost`.
pub fn voxel_downsample_on_gpu(
    gpu: &Gpu,
    points: &[Vec3],
    settings: &VoxelSettings,
    watch: &mut Watch<'_>,
) -> Result<Voxels<f32>> {
    settings.validate()?;
    let finite = FinitePoints::of(points)?;
    let points = finite.points();
    crate::geometry::validate::points(points)?;
    let n = points.len();
    if n == 0 {
        let cells = finite.spread(Vec::new(), Voxels::<f32>::NONE);
        return Ok(Voxels { cells, invalid: finite.invalid(), ..Voxels::default() });
    }
    watch.report("cells", 0, 3)?;
    let arrays: &[[f32; 3]] = bytemuck::cast_slice(points);
    let lattice = Lattice::around(arrays, settings)?;
    let keys: Vec<u64> = arrays.par_iter().with_min_len(TASK).map(|point| lattice.key(point)).collect();
    let keys = gpu.upload("cells of points", &keys)?;
    let sorted_keys: Buffer<u64> = gpu.buffer("sorted cells of points", n)?;
    let order: Buffer<u32> = gpu.buffer("points by cell", n)?;
    let heads: Buffer<u32> = gpu.buffer("where cells begin", n)?;
    let ranks: Buffer<u32> = gpu.buffer("numbers of cells", n + 1)?;
    let all = Workgroups::Covering(n as u64);

    let mut commands = gpu.commands("cells");
    // A sort by no bits would write nothing.
    let bits = lattice.bits.iter().sum::<u32>().max(1);
    GpuRadixSort::<u64>::new(gpu, n)?.record_from(&mut commands, &keys, None, &sorted_keys, &order, n, 0..bits)?;
    let asked = gpu.uniform("points in cells", &[n as u32, 0, 0, 0])?;
    let mark_cells = pipeline(gpu, "mark_cells", &[Uniform, Read, ReadWrite])?;
    commands.dispatch(&mark_cells, &[(&asked).into(), (&sorted_keys).into(), (&heads).into()], all.clone());
    GpuScan::new(gpu, n)?.record(&mut commands, &heads, &ranks, n)?;
    commands.submit()?;
    let m = gpu.read_range(&ranks, n..n + 1)?[0] as usize;

    watch.report("cells", 1, 3)?;
    let starts: Buffer<[u32; 2]> = gpu.buffer("starts of cells", m)?;
    let cells: Buffer<u32> = gpu.buffer("cells by point", n)?;
    let write_starts = pipeline(gpu, "write_starts", &[Uniform, Read, Read, Read, ReadWrite, ReadWrite])?;
    let binds = [(&asked).into(), (&heads).into(), (&ranks).into(), (&order).into(), (&starts).into(), (&cells).into()];
    let mut commands = gpu.commands("starts of cells");
    commands.dispatch(&write_starts, &binds, all);
    commands.submit()?;
    let begins = gpu.read(&starts)?;
    let end = |cell: usize| begins.get(cell + 1).map_or(n as u32, |next| next[0]);
    let counts: Vec<u32> = (0..m).map(|cell| end(cell) - begins[cell][0]).collect();
    // The first of a cell is known without going through it.
    if settings.point != VoxelPoint::First {
        check_loops(gpu.name(), gpu.limits().loop_rounds, counts.iter().copied().max().unwrap_or(0))?;
    }

    watch.report("cells", 2, 3)?;
    let taken: Buffer<[f32; 4]> = gpu.buffer("points of cells", m)?;
    let uploaded = upload_points(gpu, "points", points, 0)?;
    let which = match settings.point {
        VoxelPoint::Centroid => 0,
        VoxelPoint::Nearest => 1,
        VoxelPoint::First => 2,
    };
    let asked = gpu.uniform("points of cells asked for", &[n as u32, m as u32, which, 0])?;
    let write_points = pipeline(gpu, "write_points", &[Uniform, Read, Read, Read, ReadWrite])?;
    let binds = [(&asked).into(), (&uploaded).into(), (&starts).into(), (&order).into(), (&taken).into()];
    let mut commands = gpu.commands("points of cells");
    commands.dispatch(&write_points, &binds, Workgroups::Covering(m as u64));
    commands.submit()?;
    let taken = gpu.read(&taken)?;

    // Cells stand in the order of their numbers; the answer has them by the smallest index in each.
    let mut by_first: Vec<u32> = (0..m as u32).collect();
    by_first.par_sort_unstable_by_key(|&cell| begins[cell as usize][1]);
    let mut places = vec![0; m];
    by_first.iter().zip(0..).for_each(|(&cell, place)| places[cell as usize] = place);
    let cells = gpu.read(&cells)?.par_iter().with_min_len(TASK).map(|&cell| places[cell as usize]).collect();
    let in_order = || by_first.iter().map(|&cell| taken[cell as usize]);
    let representatives = in_order().map(|[.., index]| index.to_bits()).collect();
    watch.report("cells", 3, 3)?;
    Ok(Voxels {
        points: in_order().map(|[x, y, z, _]| [x, y, z]).collect(),
        representatives: finite.renamed(representatives, u32::MAX),
        counts: by_first.iter().map(|&cell| counts[cell as usize]).collect(),
        cells: finite.spread(cells, Voxels::<f32>::NONE),
        invalid: finite.invalid(),
    })
}

fn pipeline(gpu: &Gpu, entry: &'static str, bindings: &[Access]) -> Result<Arc<Pipeline>> {
    let constants = &[("WORKGROUP", f64::from(WORKGROUP))];
    gpu.prepare(&Kernel {
        constants,
        ..Kernel::new("package::application::downsample::voxel", entry, bindings, WORKGROUP)
    })
}

/// Checks that an invocation can go twice through so many points, where the device ends loops after `loop_rounds` if it does.
///
/// # Errors
/// `Unsupported`.
fn check_loops(device: &str, loop_rounds: Option<u32>, longest: u32) -> Result<()> {
    let rounds = 2 * u64::from(longest) + 2;
    let limit = loop_rounds.map_or(2 * u64::from(MOST_IN_CELL) + 2, u64::from);
    if rounds <= limit {
        return Ok(());
    }
    Err(Error::Unsupported {
        what: format!("a cell of {longest} points on {device}"),
        advice: "use the CPU or smaller cells",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_take_too_many_rounds_are_refused() {
        let check = |loop_rounds, longest| check_loops("a device", loop_rounds, longest);
        assert!(check(None, 0).is_ok() && check(None, MOST_IN_CELL).is_ok());
        assert!(matches!(check(None, MOST_IN_CELL + 1), Err(Error::Unsupported { .. })));
        assert!(check(Some(100), 49).is_ok());
        let error = check(Some(100), 50).unwrap_err();
        assert!(matches!(error, Error::Unsupported { .. }) && error.to_string().contains("50 points on a device"));
        assert!(check(Some(u32::MAX), u32::MAX).is_err());
    }
}
