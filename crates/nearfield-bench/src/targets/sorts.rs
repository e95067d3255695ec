//! Sorts of pairs, and octrees, which are sorts for the most part.

use nearfield::gpu::Commands;
use nearfield::parallel::radix_sort::GpuRadixSort;

use super::bench::Bench;
use super::row::{Figure, Memory, Outcome};
use crate::Result;
use crate::device::device_points;
use crate::device::timed::device_stage;
use crate::measure::repeat;
use crate::octree::method::{Case, build_on_gpu};
use crate::primitives::{BenchKey, SortCase};
use crate::sets::Set;

/// Stable sort of random keys of all their bits with u32 values, by the method that the library takes on the device.
pub(super) fn sort<K: BenchKey>(bench: &mut Bench, n: usize) -> Result<Outcome> {
    let (gpu, n, bits) = (bench.gpu.clone(), bench.scaled(n), 0..K::BITS);
    if !SortCase::<K>::fits(&gpu, n) {
        return Ok(Outcome::missing(format!("{n} keys of {} bits do not fit a binding of this device", K::BITS)));
    }
    let case = SortCase::<K>::new(&gpu, n)?;
    let plan = GpuRadixSort::<K>::new(&gpu, n)?;
    let ((), measured) = repeat(bench.effort(), || {
        let mut commands: Commands = gpu.commands("sort");
        commands.stage("sort");
        case.record(&plan, &mut commands, &bits)?;
        Ok(((), commands.run()?.iter().filter_map(device_stage).collect()))
    })?;
    case.check(&gpu, &bits)?;
    let rate = n as f64 / measured.device.unwrap_or(measured.wall).median * 1e-6;
    Ok(Outcome::without_neighbors(vec![Figure::by_device("", &measured).note(format!("{n} pairs, {rate:.1} G/s"))]))
}

/// Points on the device to linked nodes with their numbers, leaves of up to 32.
pub(super) fn octree(bench: &mut Bench, set: &str) -> Result<Outcome> {
    let gpu = bench.gpu.clone();
    let whole: Set = set.parse()?;
    let set = Set { n: bench.scaled(whole.n), ..whole };
    let needed = (set.n * size_of::<[f32; 4]>()) as u64;
    if needed > gpu.limits().binding_bytes {
        return Ok(Outcome::missing(format!("{} points do not fit a binding of this device", set.n)));
    }
    let case = Case::for_builds(set)?;
    let input = gpu.upload("points", &device_points(&case.points))?;
    let (measured, structure, peak) = build_on_gpu(&gpu, &case, input, bench.effort())?;
    let memory = Memory { points: set.n, structure, peak, answer: structure };
    let nodes = case.nodes();
    let figure = Figure { memory, ..Figure::by_device("", &measured) };
    Ok(Outcome::without_neighbors(vec![figure.note(format!("{nodes} nodes"))]))
}
