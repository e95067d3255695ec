//! Keys, cells of points and octants: against the obvious loop on the CPU, and bit for bit the same on the GPU.

mod domains;
mod keys;
mod octants;
mod orders;
#[path = "../support/mod.rs"]
mod support;

use libtest_mimic::{Arguments, Trial};

/// Lengths around what a workgroup takes: one item an invocation, or two.
const LENGTHS: [usize; 12] = [0, 1, 2, 3, 255, 256, 257, 511, 512, 513, 1025, 5000];

/// Fails with the first place where the two differ.
fn assert_same<T: PartialEq + std::fmt::Debug>(found: &[T], expected: &[T], case: &str) {
    if let Some(difference) = first_difference(found, expected) {
        panic!("{case}: {difference}");
    }
}

fn first_difference<T: PartialEq + std::fmt::Debug>(found: &[T], expected: &[T]) -> Option<String> {
    if found.len() != expected.len() {
        return Some(format!("{} elements, expected {}", found.len(), expected.len()));
    }
    let i = found.iter().zip(expected).position(|(f, e)| f != e)?;
    Some(format!("element {i} of {} is {:?}, expected {:?}", found.len(), found[i], expected[i]))
}

fn planted_differences_are_found() {
    assert!(first_difference(&[1, 2, 3], &[1, 2, 3]).is_none());
    assert!(first_difference(&[1, 2], &[1, 2, 3]).is_some_and(|text| text.contains("2 elements")));
    assert!(first_difference(&[1, 9, 3], &[1, 2, 3]).is_some_and(|text| text.contains("element 1")));
}

fn main() {
    let arguments = Arguments::from_args();
    let mut trials: Vec<Trial> = vec![support::trial("planted_differences_are_found", planted_differences_are_found)];
    trials.extend(keys::trials());
    trials.extend(domains::trials());
    trials.extend(octants::trials());
    trials.extend(orders::trials());
    libtest_mimic::run(&arguments, trials).exit();
}
