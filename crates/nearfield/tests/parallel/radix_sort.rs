//! Radix sorts of `u32` and `u64` keys by every method.

use std::fmt::Display;
use std::ops::Range;
use std::slice;

use libtest_mimic::Trial;
use nearfield::Error;
use nearfield::gpu::Gpu;
use nearfield::parallel::radix_sort::{self, GpuRadixSort, RankMethod, SortKey};

use super::support::{Random, count_as_skipped, gpu_trial, long_cases, trial};
use super::{MARGIN, POISON, SEED, assert_same, lengths, poison, poisoned};

pub(super) fn trials() -> Vec<Trial> {
    let mut trials = vec![
        trial("cpu_sort_of_u32_equals_the_library_sort", cpu_sort_equals_the_library_sort::<u32>),
        trial("cpu_sort_of_u64_equals_the_library_sort", cpu_sort_equals_the_library_sort::<u64>),
        trial("cpu_sort_refuses_what_does_not_fit", cpu_sort_refuses_what_does_not_fit),
        trial("counting_sort_groups_indices_in_order", counting_sort_groups_indices_in_order),
        gpu_trial("gpu_sort_refuses_what_does_not_fit", gpu_sort_refuses_what_does_not_fit),
    ];
    trials.extend(gpu_trials::<u32>("u32"));
    trials.extend(gpu_trials::<u64>("u64"));
    trials
}

fn gpu_trials<K: TestKey>(key: &str) -> Vec<Trial> {
    let methods = [
        ("single_pass", RankMethod::SinglePass),
        ("ballot", RankMethod::Ballot),
        ("wide_ballot", RankMethod::WideBallot),
        ("counters", RankMethod::Counters),
    ];
    let of_methods = methods.into_iter().flat_map(|(name, method)| {
        let sort = format!("gpu_sort_of_{key}_by_{name}");
        [
            gpu_trial(format!("{sort}_equals_the_library_sort"), move |gpu| {
                gpu_sort_equals_the_library_sort::<K>(gpu, method);
            }),
            gpu_trial(format!("{sort}_takes_any_pattern"), move |gpu| gpu_sort_takes_any_pattern::<K>(gpu, method)),
        ]
    });
    let name = format!("gpu_sort_of_{key}_by_single_pass_is_right_every_time");
    of_methods.chain([gpu_trial(name, gpu_sort_in_a_single_pass_is_right_every_time::<K>)]).collect()
}

/// What the tests need of a key.
pub(super) trait TestKey: SortKey + Display {
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

pub(super) fn sorted_by_loop<K: TestKey>(keys: &[K], values: &[u32], bits: &Range<u32>) -> (Vec<K>, Vec<u32>) {
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

/// The plan for a method; `None`, counted as skipped, where the device cannot rank by ballots.
fn sort_plan<K: TestKey>(gpu: &Gpu, method: RankMethod, capacity: usize) -> Option<GpuRadixSort<K>> {
    match GpuRadixSort::with_method(gpu, capacity, method) {
        Ok(plan) => {
            assert_eq!(plan.method(), method);
            Some(plan)
        }
        Err(Error::Unsupported { .. }) if gpu.limits().subgroup.is_none_or(|(_, largest)| largest > 32) => {
            count_as_skipped(&format!("sorting by {method:?}"));
            None
        }
        Err(error) => panic!("{error}"),
    }
}

fn gpu_sort_equals_the_library_sort<K: TestKey>(gpu: &Gpu, method: RankMethod) {
    let Some(plan) = sort_plan::<K>(gpu, method, 100_003) else { return };
    let (all_ranges, all_bits, odd) = (bit_ranges::<K>(), 0..K::BITS, 5..27);
    for n in lengths() {
        // All ranges behind one tile; elsewhere one with an odd number of digits, and all bits on one length of many tiles.
        let bits = match n {
            1025 => &all_ranges[..],
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
        for (n, bits) in [(4097, 0..K::BITS), (1000, 8..32)] {
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

/// Tiles that look back at others meet them in another state each time.
fn gpu_sort_in_a_single_pass_is_right_every_time<K: TestKey>(gpu: &Gpu) {
    let (n, rounds) = if long_cases(gpu) { (1_000_003, 100) } else { (30_003, 20) };
    let Some(plan) = sort_plan::<K>(gpu, RankMethod::SinglePass, n) else { return };
    let (keys, values) = (keys_of::<K>(random_bits, n), values_of(n));
    let bits = 0..24;
    let (expected_keys, expected_values) = sorted_by_loop(&keys, &values, &bits);
    let source = (gpu.upload("keys", &keys).unwrap(), gpu.upload("values", &values).unwrap());
    for round in 0..rounds {
        let (found_keys, found_values) = (poisoned(gpu, n), poisoned(gpu, n));
        let mut commands = gpu.commands("sort");
        plan.record_from(&mut commands, &source.0, Some(&source.1), &found_keys, &found_values, n, bits.clone())
            .unwrap();
        commands.submit().unwrap();
        assert_same(&gpu.read(&found_keys).unwrap(), &expected_keys, &format!("keys of round {round}"));
        assert_same(&gpu.read(&found_values).unwrap(), &expected_values, &format!("values of round {round}"));
    }
}
