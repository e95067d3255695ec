//! Times of the array primitives: GPU scan, reduce and sort by device timestamps, CPU scan and sort by the clock.
//! Every result is checked in the same run.

use std::time::Instant;

use nearfield::gpu::{Commands, DeviceElement, Gpu};
use nearfield::parallel::radix_sort::{GpuRadixSort, RankMethod, sort_pairs};
use nearfield::parallel::reduce::{self, GpuBounds, GpuReduce};
use nearfield::parallel::scan::{self, GpuScan};
use nearfield::{Result, Vec3};

/// Timed runs of a row, after `WARM_UPS` others.
const RUNS: usize = 20;
const WARM_UPS: usize = 3;
const LENGTHS: [usize; 2] = [1_000_000, 10_000_000];
const SEED: u64 = 1;

/// Prints the times of scan, reduce and sort of 1 M and 10 M elements on the device; the median of 20 runs.
///
/// # Errors
/// What the device refuses; the first wrong result as `Device`.
pub fn run(gpu: &Gpu) -> Result<()> {
    println!("primitives on {}, median of {RUNS} runs, microseconds on the device", gpu.name());
    for n in LENGTHS {
        if (n * size_of::<[f32; 4]>()) as u64 > gpu.limits().binding_bytes {
            println!("{n} elements do not fit into a binding of this device");
            continue;
        }
        time_scan(gpu, n)?;
        time_reductions(gpu, n)?;
        for method in [RankMethod::Ballot, RankMethod::WideBallot, RankMethod::Counters] {
            // A device need not have every method.
            if let Ok(plan) = GpuRadixSort::with_method(gpu, n, method) {
                time_sort(gpu, &plan, n, 0..32)?;
                time_sort(gpu, &plan, n, 0..22)?;
            }
        }
    }
    Ok(())
}

/// Prints the times of scan and sort on the CPU, all threads; the median of 20 runs.
///
/// # Errors
/// Never with right code: what sorting refuses.
pub fn run_on_cpu() -> Result<()> {
    println!("primitives on the CPU, {} threads, median of {RUNS} runs, microseconds", rayon::current_num_threads());
    for n in LENGTHS {
        let keys = words(n);
        report("scan", n, median(|| clocked(|| drop(scan::exclusive(&keys))))?);
        for bits in [17, 22, 32] {
            let time = median(|| {
                let (mut keys, mut values) = (keys.clone(), (0..n as u32).collect());
                let start = Instant::now();
                sort_pairs(&mut keys, &mut values, 0..bits)?;
                Ok(start.elapsed().as_secs_f64() * 1e6)
            })?;
            report(&format!("sort {bits} bits"), n, time);
        }
    }
    Ok(())
}

fn time_scan(gpu: &Gpu, n: usize) -> Result<()> {
    let values: Vec<u32> = words(n).iter().map(|v| v % 100).collect();
    let (input, output) = (gpu.upload("values", &values)?, gpu.buffer("sums", n + 1)?);
    let plan = GpuScan::new(gpu, n)?;
    let time = median(|| timed(gpu, |commands| plan.record(commands, &input, &output, n)))?;
    let (mut expected, total) = scan::exclusive(&values);
    expected.push(total as u32);
    check("scan", &gpu.read(&output)?, &expected)?;
    report("scan", n, time);
    Ok(())
}

fn time_reductions(gpu: &Gpu, n: usize) -> Result<()> {
    let plan = GpuReduce::new(gpu)?;
    let values = words(n);
    let (input, sum) = (gpu.upload("values", &values)?, gpu.buffer::<u64>("sum", 1)?);
    let time = median(|| timed(gpu, |commands| plan.record_sum(commands, &input, n, &sum)))?;
    check("sum", &gpu.read(&sum)?, &[reduce::sum(&values)])?;
    report("sum", n, time);

    let coordinate = |i: usize| values[i % n] as f32;
    let points: Vec<[f32; 4]> = (0..n).map(|i| [coordinate(i), coordinate(i + 1), coordinate(i + 2), 0.0]).collect();
    let (input, bounds) = (gpu.upload("points", &points)?, gpu.buffer::<GpuBounds>("bounds", 1)?);
    let time = median(|| timed(gpu, |commands| plan.record_bounds(commands, &input, n, &bounds)))?;
    let expected = reduce::bounds(&points.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect::<Vec<_>>());
    let found = gpu.read(&bounds)?[0];
    let corners = |min: [f32; 3], max: [f32; 3]| [min, max].concat();
    let first_three = |v: [f32; 4]| [v[0], v[1], v[2]];
    check(
        "bounds",
        &corners(first_three(found.min), first_three(found.max)),
        &corners(expected.min.to_array(), expected.max.to_array()),
    )?;
    report("bounds", n, time);
    Ok(())
}

fn time_sort(gpu: &Gpu, plan: &GpuRadixSort, n: usize, bits: std::ops::Range<u32>) -> Result<()> {
    let (mut keys, mut values) = (words(n), (0..n as u32).map(|i| i ^ 0x5555).collect::<Vec<_>>());
    let source = [gpu.upload("keys", &keys)?, gpu.upload("values", &values)?];
    let sorted = [gpu.buffer("sorted keys", n)?, gpu.buffer("sorted values", n)?];
    let record = |commands: &mut Commands| {
        plan.record_from(commands, &source[0], Some(&source[1]), &sorted[0], &sorted[1], n, bits.clone())
    };
    let time = median(|| timed(gpu, record))?;
    sort_pairs(&mut keys, &mut values, bits.clone())?;
    check("sort, keys", &gpu.read(&sorted[0])?, &keys)?;
    check("sort, values", &gpu.read(&sorted[1])?, &values)?;
    report(&format!("sort {} bits, {:?}", bits.len(), plan.method()), n, time);
    Ok(())
}

/// Microseconds of one recording; by the clock of the host where the device has none.
pub(crate) fn timed(gpu: &Gpu, record: impl Fn(&mut Commands) -> Result<()>) -> Result<f64> {
    let mut commands = gpu.commands("primitive");
    commands.stage("primitive");
    record(&mut commands)?;
    let start = Instant::now();
    let stages = commands.run()?;
    let on_host = start.elapsed().as_secs_f64() * 1e3;
    Ok(stages.first().and_then(|stage| stage.milliseconds).unwrap_or(on_host) * 1e3)
}

pub(crate) fn clocked(work: impl FnOnce()) -> Result<f64> {
    let start = Instant::now();
    work();
    Ok(start.elapsed().as_secs_f64() * 1e6)
}

pub(crate) fn median(mut run: impl FnMut() -> Result<f64>) -> Result<f64> {
    for _ in 0..WARM_UPS {
        run()?;
    }
    let mut times = (0..RUNS).map(|_| run()).collect::<Result<Vec<f64>>>()?;
    times.sort_by(f64::total_cmp);
    Ok(times[RUNS / 2])
}

pub(crate) fn check<T: DeviceElement + PartialEq>(what: &str, found: &[T], expected: &[T]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    let message = "the result differs from that of the CPU".to_owned();
    Err(nearfield::Error::Device { operation: what.to_owned(), message })
}

pub(crate) fn report(what: &str, n: usize, microseconds: f64) {
    println!("{what:28} {n:>11} {microseconds:>12.1} {:>9.2} G/s", n as f64 / microseconds * 1e-3);
}

/// Reproducible random words (SplitMix64).
pub(crate) fn words(n: usize) -> Vec<u32> {
    let mut state = SEED;
    let mut next = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z >> 32) as u32
    };
    (0..n).map(|_| next()).collect()
}
