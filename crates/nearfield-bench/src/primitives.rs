//! Times of the array primitives: GPU scan, reduce and sort by device timestamps, CPU scan and sort by the clock.
//! Every result is checked in the same run.

use std::ops::Range;
use std::slice;
use std::time::{Duration, Instant};

use nearfield::gpu::{AdapterKind, Buffer, Commands, DeviceElement, Gpu};
use nearfield::parallel::radix_sort::{GpuRadixSort, RankMethod, SortKey, sort_pairs};
use nearfield::parallel::reduce::{self, GpuBounds, GpuReduce};
use nearfield::parallel::scan::{self, GpuScan};
use nearfield::{Result, Vec3};
use rayon::prelude::*;

use crate::clocks;

/// Timed runs of a row, after others for `WARM_UP`, as cards that were idle
/// raise their clocks only under load; fewer where they take longer than `LONGEST`.
const RUNS: usize = 20;
const WARM_UP: Duration = Duration::from_millis(400);
const LONGEST: Duration = Duration::from_secs(1);
const LENGTHS: [usize; 2] = [1_000_000, 10_000_000];
const SORT_LENGTHS: [usize; 5] = [1_000_000, 2_000_000, 5_000_000, 10_000_000, 100_000_000];
/// The longest sort on devices that are no hardware.
const LONGEST_SORT_IN_SOFTWARE: usize = 2_000_000;
const METHODS: [RankMethod; 4] =
    [RankMethod::SinglePass, RankMethod::Ballot, RankMethod::WideBallot, RankMethod::Counters];
const SEED: u64 = 1;

/// Prints the times of scan and reduce of 1 M and 10 M elements on the device, and of sorts of 1 M to 100 M pairs by
/// every method; the median of 20 runs.
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
    }
    for n in SORT_LENGTHS {
        time_sorts::<u32>(gpu, n, &[0..32, 0..30, 0..22])?;
        time_sorts::<u64>(gpu, n, slice::from_ref(&(0..64)))?;
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
        let keys = words::<u32>(n);
        report("scan", n, median(|| clocked(|| drop(scan::exclusive(&keys))))?);
        for bits in [17, 22, 32] {
            time_sort_on_cpu(&keys, 0..bits)?;
        }
        time_sort_on_cpu(&words::<u64>(n), 0..64)?;
    }
    Ok(())
}

fn time_sort_on_cpu<K: SortKey>(keys: &[K], bits: Range<u32>) -> Result<()> {
    let n = keys.len();
    let time = median(|| {
        let (mut keys, mut values) = (keys.to_vec(), (0..n as u32).collect());
        let start = Instant::now();
        sort_pairs(&mut keys, &mut values, bits.clone())?;
        Ok(start.elapsed().as_secs_f64() * 1e6)
    })?;
    report(&format!("sort u{} {} bits", K::BITS, bits.len()), n, time);
    Ok(())
}

fn time_scan(gpu: &Gpu, n: usize) -> Result<()> {
    let values: Vec<u32> = words::<u32>(n).iter().map(|v| v % 100).collect();
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
    let values = words::<u32>(n);
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

/// A key made of random bits.
pub(crate) trait BenchKey: SortKey {
    fn of_bits(bits: u64) -> Self;
    fn wide(self) -> u64;
}

impl BenchKey for u32 {
    fn of_bits(bits: u64) -> Self {
        (bits >> 32) as u32
    }

    fn wide(self) -> u64 {
        self.into()
    }
}

impl BenchKey for u64 {
    fn of_bits(bits: u64) -> Self {
        bits
    }

    fn wide(self) -> u64 {
        self
    }
}

fn time_sorts<K: BenchKey>(gpu: &Gpu, n: usize, bit_ranges: &[Range<u32>]) -> Result<()> {
    if !SortCase::<K>::fits(gpu, n) {
        println!("{n} keys of {} bits do not fit into a binding of this device", K::BITS);
        return Ok(());
    }
    if gpu.kind() == AdapterKind::Software && n > LONGEST_SORT_IN_SOFTWARE {
        return Ok(());
    }
    let case = SortCase::<K>::new(gpu, n)?;
    for method in METHODS {
        // A device need not have every method.
        let Ok(plan) = GpuRadixSort::<K>::with_method(gpu, n, method) else { continue };
        for bits in bit_ranges {
            let time = median(|| timed(gpu, |commands| case.record(&plan, commands, bits)))?;
            case.check(gpu, bits)?;
            report(&format!("sort u{} {} bits, {method:?}", K::BITS, bits.len()), n, time);
        }
    }
    Ok(())
}

/// Pairs of random keys with u32 values on the device, and room for them sorted.
pub(crate) struct SortCase<K: BenchKey> {
    keys: Vec<K>,
    source: (Buffer<K>, Buffer<u32>),
    sorted: (Buffer<K>, Buffer<u32>),
}

impl<K: BenchKey> SortCase<K> {
    /// Whether the keys fit a binding of the device.
    pub(crate) fn fits(gpu: &Gpu, n: usize) -> bool {
        (n * size_of::<K>()) as u64 <= gpu.limits().binding_bytes
    }

    pub(crate) fn new(gpu: &Gpu, n: usize) -> Result<Self> {
        let keys = words::<K>(n);
        let values: Vec<u32> = (0..n as u32).map(value_at).collect();
        let source = (gpu.upload("keys", &keys)?, gpu.upload("values", &values)?);
        let sorted = (gpu.buffer("sorted keys", n)?, gpu.buffer("sorted values", n)?);
        Ok(Self { keys, source, sorted })
    }

    /// Records a sort by these bits of the keys.
    pub(crate) fn record(&self, plan: &GpuRadixSort<K>, commands: &mut Commands, bits: &Range<u32>) -> Result<()> {
        let ((keys, values), (sorted_keys, sorted_values)) = (&self.source, &self.sorted);
        plan.record_from(commands, keys, Some(values), sorted_keys, sorted_values, self.keys.len(), bits.clone())
    }

    /// Waits for what was submitted.
    pub(crate) fn wait(&self, gpu: &Gpu) -> Result<()> {
        gpu.read_range(&self.sorted.1, 0..1).map(drop)
    }

    /// Checks what the last sort by these bits left.
    pub(crate) fn check(&self, gpu: &Gpu, bits: &Range<u32>) -> Result<()> {
        check_sorted(&self.keys, bits, &gpu.read(&self.sorted.0)?, &gpu.read(&self.sorted.1)?)
    }
}

/// The value of the pair at place i; its own inverse.
fn value_at(i: u32) -> u32 {
    i ^ 0x5555
}

/// Checks that the pairs ascend by key and then by their former place, and that they are those of before. Places that
/// ascend among equal keys are all different, so that none is missing.
fn check_sorted<K: BenchKey>(keys: &[K], bits: &Range<u32>, sorted_keys: &[K], sorted_values: &[u32]) -> Result<()> {
    let mask = u64::MAX >> (u64::BITS - bits.len() as u32);
    let place = |i: usize| value_at(sorted_values[i]);
    let order = |i: usize| (sorted_keys[i].wide() >> bits.start & mask, place(i));
    let same = |i: usize| keys.get(place(i) as usize) == Some(&sorted_keys[i]);
    let right = |i: usize| same(i) && (i == 0 || order(i - 1) < order(i));
    if sorted_values.len() == keys.len() && (0..keys.len()).into_par_iter().all(right) {
        return Ok(());
    }
    Err(wrong_result("sort"))
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
    run()?;
    clocks::raise()?;
    let warming = Instant::now();
    while warming.elapsed() < WARM_UP {
        run()?;
    }
    let (start, mut times) = (Instant::now(), vec![]);
    while times.len() < RUNS && (times.is_empty() || start.elapsed() < LONGEST) {
        times.push(run()?);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}

pub(crate) fn check<T: DeviceElement + PartialEq>(what: &str, found: &[T], expected: &[T]) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(wrong_result(what))
}

fn wrong_result(what: &str) -> nearfield::Error {
    let message = "the result differs from that of the CPU".to_owned();
    nearfield::Error::Device { operation: what.to_owned(), message }
}

pub(crate) fn report(what: &str, n: usize, microseconds: f64) {
    println!("{what:30} {n:>11} {microseconds:>12.1} {:>9.2} G/s", n as f64 / microseconds * 1e-3);
}

/// Reproducible random words (SplitMix64).
pub(crate) fn words<K: BenchKey>(n: usize) -> Vec<K> {
    let word = |i: u64| {
        let mut z = SEED.wrapping_add(0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(i + 1));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        K::of_bits(z ^ (z >> 31))
    };
    (0..n as u64).into_par_iter().map(word).collect()
}
