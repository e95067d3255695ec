//! The tree of boxes in 2 to 16 dimensions: every search on the CPU and the GPU against brute force.

#[path = "../support/mod.rs"]
mod support;

mod cases;
mod on_cpu;
mod on_gpu;
mod reference;

use libtest_mimic::{Arguments, Trial};
use support::{gpu_trial, trial};

/// A trial for each dimension of each type. Few, low, middle and high ones in either: every one is compiled anew.
macro_rules! for_each_tree {
    ($trials:ident, $name:literal, $test:ident, $($type:ident in [$($d:literal),*]),*) => {$($(
        $trials.push(trial(format!("{}, {}, {} dimensions", $name, stringify!($type), $d), $test::<$type, $d>));
    )*)*};
}

/// A trial on the device for each dimension.
macro_rules! for_each_device_tree {
    ($trials:ident, $name:literal, $test:ident, [$($d:literal),*]) => {$(
        $trials.push(gpu_trial(format!("GPU: {}, {} dimensions", $name, $d), $test::<$d>));
    )*};
}

fn main() {
    let mut trials: Vec<Trial> = Vec::new();
    use on_cpu::{answers_are_those_of_brute_force, searches_do_different_work, trees_follow_moving_points};
    for_each_tree!(
        trials,
        "answers are those of brute force",
        answers_are_those_of_brute_force,
        f32 in [2, 3, 8, 16],
        f64 in [3, 5, 12]
    );
    for_each_tree!(
        trials,
        "trees follow moving points",
        trees_follow_moving_points,
        f32 in [2, 3, 16],
        f64 in [3, 5]
    );
    for_each_tree!(
        trials,
        "searches do different work",
        searches_do_different_work,
        f32 in [2],
        f64 in [5, 12]
    );
    trials.push(trial("bad input is an error with numbers", on_cpu::bad_input_is_an_error_with_numbers));
    on_the_device(&mut trials);
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}

fn on_the_device(trials: &mut Vec<Trial>) {
    use on_gpu::{answers_are_those_of_brute_force, refit_gives_the_boxes_of_the_cpu};
    for_each_device_tree!(
        trials,
        "answers are those of brute force",
        answers_are_those_of_brute_force,
        [2, 3, 5, 12, 16]
    );
    for_each_device_tree!(trials, "refit gives the boxes of the CPU", refit_gives_the_boxes_of_the_cpu, [2, 4, 5, 16]);
    let mut push = |name: &str, test: fn(&nearfield::Gpu)| trials.push(gpu_trial(format!("GPU: {name}"), test));
    push("heavy packs are split", on_gpu::heavy_packs_are_split);
    push("searches do different work", on_gpu::searches_do_different_work);
    push("short memory gives the same in parts", on_gpu::short_memory_gives_the_same_in_parts);
    push("bad input is an error with numbers", on_gpu::bad_input_is_an_error_with_numbers);
    push("planted differences are found", on_gpu::planted_differences_are_found);
}
