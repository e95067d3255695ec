//! The array primitives on the CPU and on the GPU against the obvious loop, at all lengths around tile sizes.

mod compact;
mod histogram;
mod radix_sort;
mod reduce;
mod scan;
#[path = "../support/mod.rs"]
mod support;

use std::fmt::Display;

use libtest_mimic::{Arguments, Trial};
use nearfield::gpu::{Buffer, DeviceElement, Gpu};
use support::{Random, trial};

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
    let (_, values) = radix_sort::sorted_by_loop(&[5u32, 5, 1], &[0, 1, 2], &(0..32));
    assert_eq!(values, [2, 0, 1]);
}

fn main() {
    let checks = vec![trial("planted_differences_are_found", planted_differences_are_found)];
    let primitives = [scan::trials(), radix_sort::trials(), reduce::trials(), histogram::trials(), compact::trials()];
    let trials: Vec<Trial> = checks.into_iter().chain(primitives.into_iter().flatten()).collect();
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
