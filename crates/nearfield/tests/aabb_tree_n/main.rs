//! The tree of boxes in 2 to 16 dimensions: every search on the CPU and the GPU against brute force.

#[path = "../support/mod.rs"]
mod support;

mod cases;
mod on_cpu;
mod on_gpu;
mod reference;

use libtest_mimic::{Arguments, Trial};
use support::{gpu_trial, trial};

/// A trial for each dimension and type.
macro_rules! for_each_tree {
    ($trials:ident, $name:literal, $test:ident, [$($d:literal),*]) => {$(
        $trials.push(trial(format!("{}, f32, {} dimensions", $name, $d), $test::<f32, $d>));
        $trials.push(trial(format!("{}, f64, {} dimensions", $name, $d), $test::<f64, $d>));
    )*};
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
    for_each_tree!(trials, "answers are those of brute force", answers_are_those_of_brute_force, [2, 3, 5, 8, 12, 16]);
    for_each_tree!(trials, "trees follow moving points", trees_follow_moving_points, [2, 3, 8, 16]);
    for_each_tree!(trials, "searches do different work", searches_do_different_work, [2, 5, 12]);
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
        [2, 3, 5, 8, 12, 16]
    );
    for_each_device_tree!(trials, "refit gives the boxes of the CPU", refit_gives_the_boxes_of_the_cpu, [2, 4, 7, 16]);
    let mut push = |name: &str, test: fn(&nearfield::Gpu)| trials.push(gpu_trial(format!("GPU: {name}"), test));
    push("heavy packs are split", on_gpu::heavy_packs_are_split);
    push("searches do different work", on_gpu::searches_do_different_work);
    push("short memory gives the same in parts", on_gpu::short_memory_gives_the_same_in_parts);
    push("bad input is an error with numbers", on_gpu::bad_input_is_an_error_with_numbers);
    push("planted differences are found", on_gpu::planted_differences_are_found);
}
