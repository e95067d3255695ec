//! Compaction.

use libtest_mimic::Trial;
use nearfield::gpu::Gpu;
use nearfield::parallel::compact::{self, GpuCompact};

use super::support::{gpu_trial, trial};
use super::{MARGIN, POISON, SEED, assert_same, lengths, poisoned, random_words};

pub(super) fn trials() -> Vec<Trial> {
    vec![
        trial("cpu_compaction_equals_the_loop", cpu_compaction_equals_the_loop),
        gpu_trial("gpu_compaction_equals_the_loop", gpu_compaction_equals_the_loop),
    ]
}

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
