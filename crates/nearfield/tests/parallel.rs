//! The array primitives on the CPU and on the GPU against the obvious loop, at all lengths around tile sizes.

mod support;

use std::fmt::Display;
use std::ops::Range;
use std::slice;

use libtest_mimic::{Arguments, Trial};
use nearfield::gpu::{Buffer, DeviceElement, Gpu};
use nearfield::parallel::compact::{self, GpuCompact};
use nearfield::parallel::histogram::{self, GpuHistogram};
use nearfield::parallel::radix_sort::{self, GpuRadixSort, RankMethod, SortKey};
use nearfield::parallel::reduce::{self, GpuBounds, GpuReduce};
use nearfield::parallel::scan::{self, GpuScan};
use nearfield::{Aabb, Error, Vec3};
use support::{Random, gpu_trial, long_cases, trial};

const SEED: u64 = 20_261_118;
/// What stands in every output before a kernel runs.
const POISON: u32 = 0xdead_beef;
/// Elements behind an output that must keep the poison.
const MARGIN: usize = 3;

/// Lengths around the tiles of scan, reduce and sort (512, 1,024, 2,048, 4,096), around one and two rounds of the scan
/// of tile sums (2,048 tiles) where that is cheap enough.
fn lengths() -> Vec<usize> {
    let mut lengths = vec![0, 1, 2, 31, 32, 33, 255, 256, 257];
    for tile in [512, 1024, 2048, 4096] {
        lengths.extend([tile - 1, tile, tile + 1]);
    }
    lengths.extend([3 * 2048 - 1, 3 * 2048, 3 * 2048 + 1, 7 * 4096 - 1, 7 * 4096 + 1, 100_003]);
    lengths
}

fn random_words(n: usize, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..n).map(|_| random.word()).collect()
}

fn poisoned<T: DeviceElement>(gpu: &Gpu, len: usize) -> Buffer<T> {
    gpu.upload("poisoned output", &poison(len)).unwrap()
}

fn poison<T: DeviceElement>(len: usize) -> Vec<T> {
    bytemuck::pod_collect_to_vec(&vec![POISON; len * size_of::<T>() / 4])
}

/// Fails with the first place where the two differ.
fn assert_same<T: PartialEq + Display>(found: &[T], expected: &[T], case: &str) {
    if let Some(difference) = first_difference(found, expected) {
        panic!("{case}: {difference}");
    }
}

fn first_difference<T: PartialEq + Display>(found: &[T], expected: &[T]) -> Option<String> {
    if found.len() != expected.len() {
        return Some(format!("{} elements, expected {}", found.len(), expected.len()));
    }
    let i = found.iter().zip(expected).position(|(f, e)| f != e)?;
    Some(format!("element {i} of {} is {}, expected {}", found.len(), found[i], expected[i]))
}

// ---- scan ----

fn scanned_by_loop(values: &[u32]) -> (Vec<u32>, u64) {
    let (mut sums, mut total) = (vec![], 0u64);
    for &value in values {
        sums.push(total as u32);
        total += u64::from(value);
    }
    (sums, total)
}

fn cpu_scan_equals_the_loop() {
    for n in lengths() {
        let values = random_words(n, SEED);
        let (sums, total) = scanned_by_loop(&values);
        let (found, found_total) = scan::exclusive(&values);
        assert_same(&found, &sums, &format!("scan of {n}"));
        assert_eq!(found_total, total, "sum of {n}");
        let wide = scan::exclusive_u64(&values);
        assert_eq!(wide.len(), n + 1);
        assert_eq!(wide[n], total);
        assert!(wide.windows(2).zip(&values).all(|(pair, &value)| pair[1] - pair[0] == u64::from(value)), "{n}");
    }
}

fn check_gpu_scan(gpu: &Gpu, plan: &GpuScan, values: &[u32], with_total: bool) {
    let n = values.len();
    let n_out = n + usize::from(with_total);
    let input = gpu.upload("values", values).unwrap();
    // Exactly as long as the call may write to: a longer output asks for the total.
    let output = poisoned::<u32>(gpu, n_out);
    let mut commands = gpu.commands("scan");
    plan.record(&mut commands, &input, &output, n).unwrap();
    commands.submit().unwrap();
    let (mut expected, total) = scanned_by_loop(values);
    if with_total {
        expected.push(total as u32);
    }
    assert_same(&gpu.read(&output).unwrap(), &expected, &format!("scan of {n}, total {with_total}"));
}

fn gpu_scan_equals_the_loop(gpu: &Gpu) {
    let plan = GpuScan::new(gpu, 100_003).unwrap();
    for n in lengths() {
        for with_total in [false, true] {
            check_gpu_scan(gpu, &plan, &random_words(n, SEED), with_total);
        }
    }
}

/// 2,048 tile sums are one round of their scan; 2,049 tiles take two.
fn gpu_scan_of_more_tiles_than_a_tile_equals_the_loop(gpu: &Gpu) {
    let one_round = 2048 * 2048;
    let lengths: &[usize] =
        if long_cases(gpu) { &[one_round - 1, one_round, one_round + 1, 3 * one_round + 5] } else { &[one_round + 1] };
    let plan = GpuScan::new(gpu, 3 * one_round + 5).unwrap();
    for &n in lengths {
        check_gpu_scan(gpu, &plan, &random_words(n, SEED), true);
    }
}

fn gpu_scan_leaves_what_stands_behind(gpu: &Gpu) {
    let plan = GpuScan::new(gpu, 5000).unwrap();
    let input = gpu.upload("values", &vec![1u32; 5000]).unwrap();
    let output = poisoned::<u32>(gpu, 5000);
    let mut commands = gpu.commands("scan");
    plan.record(&mut commands, &input, &output, 4095).unwrap();
    commands.submit().unwrap();
    let found = gpu.read(&output).unwrap();
    assert!(found[..=4095].iter().enumerate().all(|(i, &v)| v == i as u32));
    assert!(found[4096..].iter().all(|&v| v == POISON));
}

fn gpu_scan_refuses_what_does_not_fit(gpu: &Gpu) {
    let plan = GpuScan::new(gpu, 10).unwrap();
    let (short, long) = (poisoned::<u32>(gpu, 5), poisoned::<u32>(gpu, 20));
    let mut commands = gpu.commands("scan");
    assert!(matches!(plan.record(&mut commands, &long, &long.clone(), 11), Err(Error::TooMany { found: 11, .. })));
    assert!(matches!(plan.record(&mut commands, &short, &long, 6), Err(Error::LengthMismatch { found: 5, .. })));
    assert!(matches!(plan.record(&mut commands, &long, &short, 6), Err(Error::LengthMismatch { expected: 6, .. })));
    assert!(matches!(GpuScan::new(gpu, usize::MAX), Err(Error::TooMany { .. })));
}

// ---- radix sort ----

/// What the tests need of a key.
trait TestKey: SortKey + std::fmt::Display {
    /// Bits in use, from a word with all of them.
    fn of_bits(bits: u64) -> Self;
    fn bit(self, bit: u32) -> u64;
}

impl TestKey for u32 {
    fn of_bits(bits: u64) -> Self {
        (bits >> 32) as u32
    }

    fn bit(self, bit: u32) -> u64 {
        u64::from(self >> bit & 1)
    }
}

impl TestKey for u64 {
    fn of_bits(bits: u64) -> Self {
        bits
    }

    fn bit(self, bit: u32) -> u64 {
        self >> bit & 1
    }
}

/// Keys made of their number; `u32` keys take the upper half.
type KeyPattern = fn(usize) -> Vec<u64>;

fn random_bits(n: usize) -> Vec<u64> {
    let mut random = Random(SEED);
    (0..n).map(|_| random.bits()).collect()
}

const KEY_PATTERNS: [(&str, KeyPattern); 10] = [
    ("random", random_bits),
    ("few distinct", |n| {
        random_bits(n).into_iter().map(|k| [7 << 32 | 9, 7 << 45, u64::MAX][k as usize % 3]).collect()
    }),
    ("sorted", |n| (0..n as u64).map(|i| (i * 40_000) << 32 | i).collect()),
    ("reversed", |n| (0..n as u64).rev().map(|i| (i * 17) << 32 | i).collect()),
    ("all equal", |n| vec![0x8040_2010_0804_0201; n]),
    ("all largest", |n| vec![u64::MAX; n]),
    ("one constant digit", |n| random_bits(n).into_iter().map(|k| k & !(0xff << 48) | 0x55 << 48).collect()),
    // One varying digit of 8 bits: an odd number of passes with an even number of digits.
    ("one varying digit", |n| random_bits(n).into_iter().map(|k| k & 0xff << 40 | 0x1234 << 48).collect()),
    ("two varying digits", |n| random_bits(n).into_iter().map(|k| k & 0xff00_ff00_0000_0000).collect()),
    ("a constant low half", |n| random_bits(n).into_iter().map(|k| k & !0xffff_0000_ffff | 5 << 32).collect()),
];

/// Ranges of bits; those of wider keys are left out for `u32`. Some cross the border between the words of a `u64`.
const BIT_RANGES: [Range<u32>; 17] = [
    0..32,
    0..8,
    0..17,
    3..4,
    5..27,
    8..8,
    24..32,
    31..32,
    0..30,
    0..64,
    5..37,
    30..34,
    31..33,
    32..40,
    33..64,
    63..64,
    64..64,
];

fn bit_ranges<K: TestKey>() -> Vec<Range<u32>> {
    BIT_RANGES.into_iter().filter(|bits| bits.end <= K::BITS).collect()
}

fn keys_of<K: TestKey>(pattern: KeyPattern, n: usize) -> Vec<K> {
    pattern(n).into_iter().map(K::of_bits).collect()
}

/// Equal keys tell their former order by these values.
fn values_of(n: usize) -> Vec<u32> {
    (0..n as u32).map(|i| i ^ 0x5000_0000).collect()
}

fn sorted_by_loop<K: TestKey>(keys: &[K], values: &[u32], bits: &Range<u32>) -> (Vec<K>, Vec<u32>) {
    let mut pairs: Vec<(K, u32)> = keys.iter().copied().zip(values.iter().copied()).collect();
    let digits = |key: K| bits.clone().fold(0u64, |d, bit| d | key.bit(bit) << (bit - bits.start));
    pairs.sort_by_cached_key(|pair| digits(pair.0));
    pairs.into_iter().unzip()
}

fn cpu_sort_equals_the_library_sort<K: TestKey>() {
    for n in lengths() {
        for (name, pattern) in KEY_PATTERNS {
            let all_ranges = bit_ranges::<K>();
            let bit_ranges = if n < 10_000 { &all_ranges[..] } else { &all_ranges[all_ranges.len() - 3..] };
            for bits in bit_ranges.iter().chain([&(0..K::BITS)]) {
                let (keys, values) = (keys_of::<K>(pattern, n), values_of(n));
                let (expected_keys, expected_values) = sorted_by_loop(&keys, &values, bits);
                let (mut found_keys, mut found_values) = (keys, values);
                radix_sort::sort_pairs(&mut found_keys, &mut found_values, bits.clone()).unwrap();
                let case = format!("{n} {name} keys of {} bits by bits {bits:?}", K::BITS);
                assert_same(&found_keys, &expected_keys, &case);
                assert_same(&found_values, &expected_values, &case);
            }
        }
    }
}

fn cpu_sort_refuses_what_does_not_fit() {
    let (mut keys, mut values) = (vec![1u32, 2], vec![1]);
    let found = radix_sort::sort_pairs(&mut keys, &mut values, 0..32);
    assert!(matches!(found, Err(Error::LengthMismatch { found: 1, expected: 2, .. })));
    let found = radix_sort::sort_pairs(&mut keys, &mut vec![1, 2], 0..33);
    assert!(matches!(found, Err(Error::InvalidSetting { setting: "bits", .. })));
    assert!(matches!(radix_sort::counting_sort(&[0, 3], 3), Err(Error::TooMany { found: 3, limit: 2, .. })));
}

fn counting_sort_groups_indices_in_order() {
    let mut random = Random(SEED);
    for n in lengths() {
        for n_keys in [1, 5, 1000] {
            let keys: Vec<u32> = (0..n).map(|_| random.below(n_keys)).collect();
            let (offsets, order) = radix_sort::counting_sort(&keys, n_keys as usize).unwrap();
            let mut groups = vec![vec![]; n_keys as usize];
            keys.iter().zip(0u32..).for_each(|(&key, i)| groups[key as usize].push(i));
            assert_same(&order, &groups.concat(), &format!("{n} keys below {n_keys}"));
            assert_eq!(offsets.len(), groups.len() + 1);
            assert!(offsets.windows(2).zip(&groups).all(|(pair, group)| (pair[1] - pair[0]) as usize == group.len()));
        }
    }
}

fn check_gpu_sort<K: TestKey>(gpu: &Gpu, plan: &GpuRadixSort<K>, keys: &[K], bits: &Range<u32>, case: &str) {
    let (n, values) = (keys.len(), values_of(keys.len()));
    let keys_with_margin = |keys: &[K]| [keys, &poison(MARGIN)].concat();
    let with_margin = |words: &[u32]| [words, &[POISON; MARGIN]].concat();
    let (expected_keys, expected_values) = sorted_by_loop(keys, &values, bits);
    let (expected_keys, expected_values) = (keys_with_margin(&expected_keys), with_margin(&expected_values));

    let source_keys = gpu.upload("keys", &keys_with_margin(keys)).unwrap();
    let source_values = gpu.upload("values", &with_margin(&values)).unwrap();
    let (found_keys, found_values) = (poisoned(gpu, n + MARGIN), poisoned(gpu, n + MARGIN));
    let mut commands = gpu.commands("sort");
    plan.record_from(&mut commands, &source_keys, Some(&source_values), &found_keys, &found_values, n, bits.clone())
        .unwrap();
    commands.submit().unwrap();
    assert_same(&gpu.read(&found_keys).unwrap(), &expected_keys, &format!("{case}: keys from others"));
    assert_same(&gpu.read(&found_values).unwrap(), &expected_values, &format!("{case}: values from others"));
    assert_same(&gpu.read(&source_keys).unwrap(), &keys_with_margin(keys), &format!("{case}: source keys"));

    let order = poisoned(gpu, n);
    let mut commands = gpu.commands("sort");
    plan.record_from(&mut commands, &source_keys, None, &found_keys, &order, n, bits.clone()).unwrap();
    plan.record(&mut commands, &source_keys, &source_values, n, bits.clone()).unwrap();
    commands.submit().unwrap();
    let expected_order: Vec<u32> = expected_values[..n].iter().map(|v| v ^ 0x5000_0000).collect();
    assert_same(&gpu.read(&order).unwrap(), &expected_order, &format!("{case}: order"));
    assert_same(&gpu.read(&source_keys).unwrap(), &expected_keys, &format!("{case}: keys in place"));
    assert_same(&gpu.read(&source_values).unwrap(), &expected_values, &format!("{case}: values in place"));
}

/// The plan for a method; `None` where the device cannot rank by ballots.
fn sort_plan<K: TestKey>(gpu: &Gpu, method: RankMethod, capacity: usize) -> Option<GpuRadixSort<K>> {
    match GpuRadixSort::with_method(gpu, capacity, method) {
        Ok(plan) => {
            assert_eq!(plan.method(), method);
            Some(plan)
        }
        Err(Error::Unsupported { .. }) if gpu.limits().subgroup.is_none_or(|(_, largest)| largest > 32) => None,
        Err(error) => panic!("{error}"),
    }
}

fn gpu_sort_equals_the_library_sort<K: TestKey>(gpu: &Gpu, method: RankMethod) {
    let Some(plan) = sort_plan::<K>(gpu, method, 100_003) else { return };
    let (all_ranges, all_bits, odd) = (bit_ranges::<K>(), 0..K::BITS, 5..27);
    for n in lengths() {
        // All ranges around one tile; elsewhere one with an odd number of digits, and all bits on one length of many tiles.
        let bits = match n {
            1 | 1025 | 2047 => &all_ranges[..],
            100_003 => slice::from_ref(&all_bits),
            _ => slice::from_ref(&odd),
        };
        // Wide ballots differ in one function only.
        if method == RankMethod::WideBallot && bits.len() == 1 {
            continue;
        }
        for bits in bits {
            check_gpu_sort(gpu, &plan, &keys_of(random_bits, n), bits, &format!("{n} random keys by bits {bits:?}"));
        }
    }
    if long_cases(gpu) {
        let n = (1 << 22) + 1;
        let plan = sort_plan::<K>(gpu, method, n).unwrap();
        for bits in [0..K::BITS, 0..22] {
            check_gpu_sort(gpu, &plan, &keys_of(random_bits, n), &bits, &format!("{n} random keys by bits {bits:?}"));
        }
    }
}

fn gpu_sort_takes_any_pattern<K: TestKey>(gpu: &Gpu, method: RankMethod) {
    let Some(plan) = sort_plan::<K>(gpu, method, 20_000) else { return };
    for (name, pattern) in KEY_PATTERNS {
        for (n, bits) in [(1000, 0..K::BITS), (4097, 0..K::BITS), (4097, 8..32)] {
            check_gpu_sort(gpu, &plan, &keys_of(pattern, n), &bits, &format!("{n} {name} keys by bits {bits:?}"));
        }
    }
}

fn gpu_sort_refuses_what_does_not_fit(gpu: &Gpu) {
    let plan = GpuRadixSort::<u32>::new(gpu, 10).unwrap();
    let (short, long) = (poisoned::<u32>(gpu, 5), poisoned::<u32>(gpu, 20));
    let mut commands = gpu.commands("sort");
    let mut record = |keys, values, n, bits| plan.record(&mut commands, keys, values, n, bits);
    assert!(matches!(record(&long, &long, 11, 0..32), Err(Error::TooMany { found: 11, .. })));
    assert!(matches!(record(&short, &long, 6, 0..32), Err(Error::LengthMismatch { .. })));
    assert!(matches!(record(&long, &short, 6, 0..32), Err(Error::LengthMismatch { .. })));
    assert!(matches!(record(&long, &short, 5, 0..33), Err(Error::InvalidSetting { .. })));
}

// ---- reduce ----

fn floats(n: usize) -> Vec<f32> {
    let mut random = Random(SEED);
    (0..n).map(|_| (random.unit() - 0.5) * [1e-30, 1.0, 1e30][random.below(3) as usize]).collect()
}

fn points(n: usize) -> Vec<[f32; 4]> {
    let mut random = Random(SEED);
    // The fourth word must not count.
    (0..n).map(|_| [random.unit() - 2.0, 9.0 * random.unit() - 4.0, random.unit() + 5.0, f32::NAN]).collect()
}

fn cpu_reductions_equal_the_loop() {
    for n in lengths() {
        let (values, floats) = (random_words(n, SEED), floats(n));
        assert_eq!(reduce::sum(&values), values.iter().fold(0, |sum, &v| sum + u64::from(v)), "{n}");
        assert_eq!(reduce::smallest(&values), values.iter().copied().min(), "{n}");
        assert_eq!(reduce::largest(&values), values.iter().copied().max(), "{n}");
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for &value in &floats {
            low = if value < low { value } else { low };
            high = if value > high { value } else { high };
        }
        assert_eq!((reduce::smallest_f32(&floats), reduce::largest_f32(&floats)), (low, high), "{n}");
        let points: Vec<Vec3> = points(n).iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
        let axis = |axis: usize| {
            let values = points.iter().map(move |p| p[axis]);
            (values.clone().fold(f32::INFINITY, f32::min), values.fold(f32::NEG_INFINITY, f32::max))
        };
        let [x, y, z] = [0, 1, 2].map(axis);
        assert_eq!(reduce::bounds(&points), Aabb::new(Vec3::new(x.0, y.0, z.0), Vec3::new(x.1, y.1, z.1)), "{n}");
    }
}

fn gpu_reductions_equal_the_loop(gpu: &Gpu) {
    let plan = GpuReduce::new(gpu).unwrap();
    let mut lengths = lengths();
    if long_cases(gpu) {
        lengths.push((1 << 22) + 1);
    }
    for n in lengths {
        let (values, mut floats) = (random_words(n, SEED), floats(n));
        if n > 40 {
            (floats[7], floats[33]) = (f32::NAN, -f32::NAN);
        }
        let input = gpu.upload("values", &values).unwrap();
        let float_input = gpu.upload("floats", &floats).unwrap();
        let sum = poisoned::<u64>(gpu, 1);
        let words = [(); 2].map(|()| poisoned::<u32>(gpu, 1));
        let extremes = [(); 2].map(|()| poisoned::<f32>(gpu, 1));
        let mut commands = gpu.commands("reduce");
        plan.record_sum(&mut commands, &input, n, &sum).unwrap();
        plan.record_smallest(&mut commands, &input, n, &words[0]).unwrap();
        plan.record_largest(&mut commands, &input, n, &words[1]).unwrap();
        plan.record_smallest_f32(&mut commands, &float_input, n, &extremes[0]).unwrap();
        plan.record_largest_f32(&mut commands, &float_input, n, &extremes[1]).unwrap();
        commands.submit().unwrap();
        assert_eq!(gpu.read(&sum).unwrap()[0], values.iter().map(|&v| u64::from(v)).sum::<u64>(), "sum of {n}");
        let found = words.map(|word| gpu.read(&word).unwrap()[0]);
        let expected = [values.iter().min().copied().unwrap_or(u32::MAX), values.iter().max().copied().unwrap_or(0)];
        assert_eq!(found, expected, "{n}");
        let found = extremes.map(|float| gpu.read(&float).unwrap()[0]);
        let numbers = floats.iter().copied().filter(|v| !v.is_nan());
        let low = numbers.clone().fold(f32::INFINITY, |a, b| if b < a { b } else { a });
        let high = numbers.fold(f32::NEG_INFINITY, |a, b| if b > a { b } else { a });
        assert_eq!(found, [low, high], "{n}");
    }
}

fn gpu_bounds(gpu: &Gpu, points: &[[f32; 4]]) -> GpuBounds {
    let input = gpu.upload("points", points).unwrap();
    let result = poisoned::<GpuBounds>(gpu, 1);
    let mut commands = gpu.commands("bounds");
    GpuReduce::new(gpu).unwrap().record_bounds(&mut commands, &input, points.len(), &result).unwrap();
    commands.submit().unwrap();
    gpu.read(&result).unwrap()[0]
}

fn gpu_bounds_equal_the_loop(gpu: &Gpu) {
    for n in lengths() {
        let points = points(n);
        let found = gpu_bounds(gpu, &points);
        for axis in 0..3 {
            let values = points.iter().map(|p| p[axis]);
            assert_eq!(found.min[axis], values.clone().fold(f32::INFINITY, f32::min), "axis {axis} of {n}");
            assert_eq!(found.max[axis], values.fold(f32::NEG_INFINITY, f32::max), "axis {axis} of {n}");
        }
        assert_eq!((found.min[3], found.max[3]), (0.0, 0.0));
        assert_eq!((found.n_non_finite, found.first_non_finite), (0, u32::MAX), "{n}");
    }
}

fn gpu_bounds_count_points_that_are_not_finite(gpu: &Gpu) {
    let mut points = points(70_000);
    points[69_999] = [f32::INFINITY, 0.0, 0.0, 0.0];
    points[12_345] = [0.0, f32::NAN, 0.0, 0.0];
    points[12_346] = [0.0, 0.0, f32::NEG_INFINITY, 0.0];
    let found = gpu_bounds(gpu, &points);
    assert_eq!((found.n_non_finite, found.first_non_finite), (3, 12_345));
    // 0 lies outside the other coordinates of x and z: the three points must not have counted.
    assert!(found.max[0] < 0.0 && found.min[2] > 0.0 && found.min[2] < 5.1, "{found:?}");

    let found = gpu_bounds(gpu, &[[f32::NAN; 4]; 5]);
    assert_eq!((found.n_non_finite, found.first_non_finite), (5, 0));
    assert_eq!(
        (found.min[..3].to_vec(), found.max[..3].to_vec()),
        (vec![f32::INFINITY; 3], vec![f32::NEG_INFINITY; 3])
    );
}

fn gpu_bounds_refuse_points_of_another_size(gpu: &Gpu) {
    let (points, result) = (poisoned::<[f32; 3]>(gpu, 4), poisoned(gpu, 1));
    let found = GpuReduce::new(gpu).unwrap().record_bounds(&mut gpu.commands("bounds"), &points, 4, &result);
    assert!(matches!(found, Err(Error::Unsupported { .. })));
}

// ---- histogram ----

fn counted_by_loop(values: &[u32], n_bins: usize) -> Vec<u32> {
    let mut counts = vec![0; n_bins + 1];
    for &value in values {
        let outside = value as usize >= n_bins;
        counts[if outside { n_bins } else { value as usize }] += 1;
    }
    counts
}

/// Values of which some are outside the bins.
fn values_for_bins(n: usize, n_bins: usize) -> Vec<u32> {
    let mut random = Random(SEED);
    (0..n).map(|i| if i % 11 == 5 { random.word() } else { random.below(n_bins as u32 + 2) }).collect()
}

/// 2,048 bins are the most that are counted in workgroup memory.
const BINS: [usize; 6] = [0, 1, 100, 2047, 2048, 5000];

fn cpu_histogram_equals_the_loop() {
    for n in lengths() {
        for n_bins in BINS {
            let values = values_for_bins(n, n_bins);
            let found = histogram::count(&values, n_bins).unwrap();
            assert_same(&found, &counted_by_loop(&values, n_bins), &format!("{n} values in {n_bins} bins"));
        }
    }
}

fn gpu_histogram_equals_the_loop(gpu: &Gpu) {
    for n_bins in BINS {
        let plan = GpuHistogram::new(gpu, n_bins).unwrap();
        for n in lengths() {
            let values = values_for_bins(n, n_bins);
            let input = gpu.upload("values", &values).unwrap();
            let counts = poisoned(gpu, n_bins + 1 + MARGIN);
            let mut commands = gpu.commands("histogram");
            plan.record(&mut commands, &input, &counts, n).unwrap();
            commands.submit().unwrap();
            let expected = [counted_by_loop(&values, n_bins), vec![POISON; MARGIN]].concat();
            assert_same(&gpu.read(&counts).unwrap(), &expected, &format!("{n} values in {n_bins} bins"));
        }
    }
}

// ---- compact ----

/// A flag made of a random word.
type FlagPattern = fn(u32) -> u32;

const FLAG_PATTERNS: [(&str, FlagPattern); 4] =
    [("none", |_| 0), ("all", |k| k | 1), ("few", |k| u32::from(k % 97 == 0)), ("half", |k| k & 0x100)];

fn chosen_by_loop(flags: &[u32]) -> Vec<u32> {
    flags.iter().zip(0..).filter(|(flag, _)| **flag != 0).map(|(_, i)| i).collect()
}

fn cpu_compaction_equals_the_loop() {
    for n in lengths() {
        for (name, pattern) in FLAG_PATTERNS {
            let flags: Vec<u32> = random_words(n, SEED).into_iter().map(pattern).collect();
            let found = compact::indices_where(n, |i| flags[i] != 0).unwrap();
            assert_same(&found, &chosen_by_loop(&flags), &format!("{name} of {n}"));
        }
    }
}

fn gpu_compaction_equals_the_loop(gpu: &Gpu) {
    let plan = GpuCompact::new(gpu, 100_003).unwrap();
    for n in lengths() {
        for (name, pattern) in FLAG_PATTERNS {
            let flags: Vec<u32> = random_words(n, SEED).into_iter().map(pattern).collect();
            let input = gpu.upload("flags", &flags).unwrap();
            let (indices, count) = (poisoned(gpu, n + MARGIN), poisoned(gpu, 1));
            let mut commands = gpu.commands("compact");
            plan.record(&mut commands, &input, &indices, &count, n).unwrap();
            commands.submit().unwrap();
            let mut expected = chosen_by_loop(&flags);
            assert_same(&gpu.read(&count).unwrap(), &[expected.len() as u32], &format!("number of {name} of {n}"));
            expected.resize(n + MARGIN, POISON);
            assert_same(&gpu.read(&indices).unwrap(), &expected, &format!("{name} of {n}"));
        }
    }
}

// ---- the checks themselves ----

fn planted_differences_are_found() {
    let right = random_words(1000, SEED);
    assert_eq!(first_difference(&right, &right), None);
    for i in [0, 500, 999] {
        let mut wrong = right.clone();
        wrong[i] ^= 1;
        assert!(first_difference(&wrong, &right).is_some_and(|text| text.contains(&format!("element {i} of"))));
    }
    assert!(first_difference(&right[1..], &right).is_some());
    assert!(std::panic::catch_unwind(|| assert_same(&[1], &[2], "planted")).is_err());
    // Two pairs with equal keys in the wrong order are told apart by their values.
    let (_, values) = sorted_by_loop(&[5u32, 5, 1], &[0, 1, 2], &(0..32));
    assert_eq!(values, [2, 0, 1]);
}

fn main() {
    let mut trials: Vec<Trial> = vec![
        trial("cpu_scan_equals_the_loop", cpu_scan_equals_the_loop),
        trial("cpu_sort_of_u32_equals_the_library_sort", cpu_sort_equals_the_library_sort::<u32>),
        trial("cpu_sort_of_u64_equals_the_library_sort", cpu_sort_equals_the_library_sort::<u64>),
        trial("cpu_sort_refuses_what_does_not_fit", cpu_sort_refuses_what_does_not_fit),
        trial("counting_sort_groups_indices_in_order", counting_sort_groups_indices_in_order),
        trial("cpu_reductions_equal_the_loop", cpu_reductions_equal_the_loop),
        trial("cpu_histogram_equals_the_loop", cpu_histogram_equals_the_loop),
        trial("cpu_compaction_equals_the_loop", cpu_compaction_equals_the_loop),
        trial("planted_differences_are_found", planted_differences_are_found),
        gpu_trial("gpu_scan_equals_the_loop", gpu_scan_equals_the_loop),
        gpu_trial(
            "gpu_scan_of_more_tiles_than_a_tile_equals_the_loop",
            gpu_scan_of_more_tiles_than_a_tile_equals_the_loop,
        ),
        gpu_trial("gpu_scan_leaves_what_stands_behind", gpu_scan_leaves_what_stands_behind),
        gpu_trial("gpu_scan_refuses_what_does_not_fit", gpu_scan_refuses_what_does_not_fit),
        gpu_trial("gpu_sort_refuses_what_does_not_fit", gpu_sort_refuses_what_does_not_fit),
        gpu_trial("gpu_reductions_equal_the_loop", gpu_reductions_equal_the_loop),
        gpu_trial("gpu_bounds_equal_the_loop", gpu_bounds_equal_the_loop),
        gpu_trial("gpu_bounds_count_points_that_are_not_finite", gpu_bounds_count_points_that_are_not_finite),
        gpu_trial("gpu_bounds_refuse_points_of_another_size", gpu_bounds_refuse_points_of_another_size),
        gpu_trial("gpu_histogram_equals_the_loop", gpu_histogram_equals_the_loop),
        gpu_trial("gpu_compaction_equals_the_loop", gpu_compaction_equals_the_loop),
    ];
    let methods = [
        ("single_pass", RankMethod::SinglePass),
        ("ballot", RankMethod::Ballot),
        ("wide_ballot", RankMethod::WideBallot),
        ("counters", RankMethod::Counters),
    ];
    for (name, method) in methods {
        trials.push(gpu_trial(format!("gpu_sort_of_u32_by_{name}_equals_the_library_sort"), move |gpu| {
            gpu_sort_equals_the_library_sort::<u32>(gpu, method);
        }));
        trials.push(gpu_trial(format!("gpu_sort_of_u64_by_{name}_equals_the_library_sort"), move |gpu| {
            gpu_sort_equals_the_library_sort::<u64>(gpu, method);
        }));
        trials.push(gpu_trial(format!("gpu_sort_of_u32_by_{name}_takes_any_pattern"), move |gpu| {
            gpu_sort_takes_any_pattern::<u32>(gpu, method);
        }));
        trials.push(gpu_trial(format!("gpu_sort_of_u64_by_{name}_takes_any_pattern"), move |gpu| {
            gpu_sort_takes_any_pattern::<u64>(gpu, method);
        }));
    }
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
