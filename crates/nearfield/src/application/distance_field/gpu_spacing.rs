//! The spacing of samples on a device: how many are in balls of several radii around some of them, counted at once.
//!
//! Radii grow until balls hold enough, so they could be asked about one after the other; each question would be several
//! submissions that are waited for. Those that are nearly always enough are one.

use std::collections::VecDeque;

use super::gpu_run::pipeline;
use super::samples::{measured_spacing, places};
use crate::gpu::Access::{Read, ReadWrite, Uniform};
use crate::gpu::{Access, Bind, Buffer, Gpu, Workgroups};
use crate::{Error, Result};

/// Radii that are counted with at once: the tenth is a 180th of the diagonal, enough for samples in their hundred thousands.
const TOGETHER: usize = 10;
/// The count of a ball where the device would have ended the loop.
const UNFINISHED: u32 = u32::MAX;

const COUNT: [Access; 8] = [Uniform, Read, Read, Uniform, Read, Read, Read, ReadWrite];

/// The spacing of samples, as [`measured_spacing`] has it.
///
/// - `samples`: `[2n]` position and normal by index
/// - `tree`: layout, points and nodes of the tree over them
/// - `diagonal`: of their box
///
/// # Errors
/// `OutOfDeviceMemory`, `Unsupported` on software devices that would end loops, `KernelRejected`, `DeviceLost`.
pub(super) fn spacing(gpu: &Gpu, samples: &Buffer<[f32; 4]>, tree: &[Bind; 3], diagonal: f64) -> Result<f64> {
    let middles: Vec<u32> = places(samples.len() / 2).map(|place| place as u32).collect();
    let mut counted = VecDeque::new();
    measured_spacing(diagonal, middles.len(), |radius| {
        if counted.is_empty() {
            let next = |radius: &f64| Some(radius * std::f64::consts::SQRT_2);
            let radii: Vec<f64> = std::iter::successors(Some(radius), next).take(TOGETHER).collect();
            counted.extend(count_around(gpu, samples, tree, &middles, &radii)?);
        }
        Ok(counted.pop_front().expect("a radius should be among those counted with"))
    })
}

/// How many samples are in balls around some of them, those themselves included: the sum for each radius.
fn count_around(
    gpu: &Gpu,
    samples: &Buffer<[f32; 4]>,
    [layout, points, nodes]: &[Bind; 3],
    middles: &[u32],
    radii: &[f64],
) -> Result<Vec<u64>> {
    let n = middles.len() * radii.len();
    let parameters = gpu.uniform("balls to count in", &[middles.len() as u32, radii.len() as u32, 0, 0])?;
    let places = gpu.upload("middles of balls", middles)?;
    let radii2: Vec<f32> = radii.iter().map(|&radius| radius as f32 * radius as f32).collect();
    let radii2 = gpu.upload("squared radii of balls", &radii2)?;
    let counts = gpu.buffer::<u32>("samples in balls", n)?;
    let count = pipeline(gpu, "count_around", "count_around", &COUNT, &[], &[])?;
    let binds = [
        (&parameters).into(),
        samples.into(),
        (&places).into(),
        layout.clone(),
        points.clone(),
        nodes.clone(),
        (&radii2).into(),
        (&counts).into(),
    ];
    let mut commands = gpu.commands("spacing of samples");
    commands.dispatch(&count, &binds, Workgroups::Covering(n as u64));
    let read = commands.read_back(&counts)?;
    commands.submit()?;
    let counts = read.values()?;
    if counts.contains(&UNFINISHED) {
        return Err(Error::Unsupported {
            what: format!(
                "the spacing of {} samples on {}, which would have ended loops,",
                samples.len() / 2,
                gpu.name()
            ),
            advice: "use the CPU",
        });
    }
    let sum = |counts: &[u32]| counts.iter().map(|&n| u64::from(n)).sum();
    Ok(counts.chunks_exact(middles.len()).map(sum).collect())
}
