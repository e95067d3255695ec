//! Counts of values.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::parallel::histogram::{self, GpuHistogram};

use super::support::{Random, gpu_trial, trial};
use super::{MARGIN, POISON, SEED, assert_same, lengths, poisoned};

pub(super) fn trials() -> Vec<Trial> {
    vec![
        trial("cpu_histogram_equals_the_loop", cpu_histogram_equals_the_loop),
        gpu_trial("gpu_histogram_equals_the_loop", gpu_histogram_equals_the_loop),
    ]
}

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
