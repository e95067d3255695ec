//! Exclusive scans.

use libtest_mimic::Trial;
use nearfield::Error;
use nearfield::gpu::Gpu;
use nearfield::parallel::scan::{self, GpuScan};

use super::support::{gpu_trial, long_cases, trial};
use super::{POISON, SEED, assert_same, lengths, poisoned, random_words};

pub(super) fn trials() -> Vec<Trial> {
    vec![
        trial("cpu_scan_equals_the_loop", cpu_scan_equals_the_loop),
        gpu_trial("gpu_scan_equals_the_loop", gpu_scan_equals_the_loop),
        gpu_trial(
            "gpu_scan_of_more_tiles_than_a_tile_equals_the_loop",
            gpu_scan_of_more_tiles_than_a_tile_equals_the_loop,
        ),
        gpu_trial("gpu_scan_leaves_what_stands_behind", gpu_scan_leaves_what_stands_behind),
        gpu_trial("gpu_scan_refuses_what_does_not_fit", gpu_scan_refuses_what_does_not_fit),
    ]
}

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
