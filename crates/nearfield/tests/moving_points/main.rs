//! Points that move: after every motion a tree that was fitted, one that was built anew and the obvious loop agree, each
//! policy builds exactly when it says, and positions that are refused leave everything as it was. On the CPU and the GPU.

mod errors;
mod follow;
mod model;
mod motions;
mod policies;
mod reference;
mod subject;
#[path = "../support/mod.rs"]
mod support;

use libtest_mimic::Arguments;

const SEED: u64 = 20_261_124;

fn main() {
    let arguments = Arguments::from_args();
    let mut trials = reference::trials();
    trials.extend(follow::trials());
    trials.extend(policies::trials());
    trials.extend(errors::trials());
    libtest_mimic::run(&arguments, trials).exit();
}
