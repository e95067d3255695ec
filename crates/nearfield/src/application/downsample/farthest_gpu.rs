//! Farthest-point samples on the device: every sample is brought to all points there, and the next one is taken there too.

use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::farthest::{FarthestPoints, FarthestStart, STAGE, check_count, first_sample};
use crate::Result;
use crate::application::Watch;
use crate::application::finite_points::FinitePoints;
use crate::gpu::{Access, Bind, Gpu, Kernel, Pipeline, Workgroups};
use crate::structure::upload_points;

use Access::{Read, ReadWrite, Uniform};

/// Invocations of a workgroup. Twin of `WORKGROUP` in farthest.wesl.
const WORKGROUP: u32 = 256;
/// Points of a workgroup. Twin of `EACH` times `WORKGROUP` in farthest.wesl.
const PART: u32 = 4 * WORKGROUP;
/// Samples of the first submission, whose time tells how many come next.
const FIRST: usize = 8;
/// Most samples that are submitted together: what is recorded for them stays below a megabyte.
const TOGETHER: usize = 1024;
/// Milliseconds that a submission should take at most, for the sake of drivers' time limits and of those who wait.
const SUBMISSION: f64 = 200.0;

/// As [`super::farthest_points`] on the device, in f32: the same samples at the same distances, to the bit, but where a squared distance is
/// no normal number (below 1.2e-38), which a device may take for 0.
///
/// Every sample is compared with all points: n points give k samples in n k steps, side by side, and nothing is read back before the last.
///
/// # Errors
/// As [`super::farthest_points`], with `CoordinateTooLarge` for the points; `OutOfDeviceMemory`, `DeviceLost`.
pub fn farthest_points_on_gpu(
    gpu: &Gpu,
    points: &[Vec3],
    count: usize,
    start: FarthestStart,
    watch: &mut Watch<'_>,
) -> Result<FarthestPoints<f32>> {
    let finite = FinitePoints::of(points)?;
    let points = finite.points();
    crate::geometry::validate::points(points)?;
    check_count(count, points.len())?;
    if count == 0 {
        return Ok(FarthestPoints { invalid: finite.invalid(), ..FarthestPoints::default() });
    }
    let n = points.len() as u32;
    let n_parts = n.div_ceil(PART);
    let first = [first_sample(start, &finite)?, remoteness_of(f32::MAX)];
    let asked = gpu.uniform("samples asked for", &[n, n_parts, count as u32, 0])?;
    let candidates = gpu.buffer::<[u32; 2]>("farthest points of parts", n_parts as usize)?;
    let samples = gpu.buffer::<[u32; 2]>("samples", count)?;
    let progress = gpu.upload("number of samples", &[1u32])?;
    let uploaded = upload_points(gpu, "points", points, 0)?;
    let remoteness = gpu.upload("distances to samples", &vec![remoteness_of(f32::MAX); points.len()])?;
    gpu.write(&samples, 0, &[first])?;

    let taking: [Bind; 4] = [(&asked).into(), (&candidates).into(), (&samples).into(), (&progress).into()];
    let mut bringing = taking.to_vec();
    bringing.extend::<[Bind; 2]>([(&uploaded).into(), (&remoteness).into()]);
    let accesses = [Uniform, ReadWrite, ReadWrite, ReadWrite, Read, ReadWrite];
    let bring_sample = pipeline(gpu, "bring_sample", &accesses)?;
    let take_farthest = pipeline(gpu, "take_farthest", &accesses[..4])?;

    let (mut taken, mut together) = (1, FIRST);
    while taken < count {
        watch.report(STAGE, taken as u64 - 1, count as u64)?;
        let clock = Instant::now();
        let more = together.min(count - taken);
        let mut commands = gpu.commands(STAGE);
        for _ in 0..more {
            commands.dispatch(&bring_sample, &bringing, Workgroups::Count(n_parts));
            commands.dispatch(&take_farthest, &taking, Workgroups::Count(1));
        }
        commands.run()?;
        taken += more;
        let each = clock.elapsed().as_secs_f64() * 1e3 / more as f64;
        together = ((SUBMISSION / each.max(1e-6)) as usize).clamp(1, TOGETHER);
    }
    let samples = gpu.read(&samples)?;
    watch.report(STAGE, count as u64, count as u64)?;
    let distance = |(i, &[_, remoteness]): (usize, &[u32; 2])| {
        if i == 0 { f32::INFINITY } else { f32::from_bits(remoteness - 1).sqrt() }
    };
    Ok(FarthestPoints {
        distances: samples.iter().enumerate().map(distance).collect(),
        indices: finite.renamed(samples.iter().map(|&[index, _]| index).collect(), u32::MAX),
        invalid: finite.invalid(),
    })
}

/// What farthest.wesl keeps for a squared distance to the nearest sample.
fn remoteness_of(dist2: f32) -> u32 {
    1 + dist2.to_bits()
}

fn pipeline(gpu: &Gpu, entry: &'static str, bindings: &[Access]) -> Result<Arc<Pipeline>> {
    gpu.prepare(&Kernel::new("package::application::downsample::farthest", entry, bindings, WORKGROUP))
}
