//! Applications on the device against the CPU: one program for all of them, since each would link the whole library.

mod distance_field;
mod dual_contouring;
mod mls;
mod path_trace;
#[path = "../support/scenes.rs"]
mod scenes;
#[path = "../support/solids.rs"]
mod solids;
#[path = "../support/mod.rs"]
mod support;
#[path = "../support/surfaces.rs"]
mod surfaces;
mod winding_number;

use libtest_mimic::Arguments;

fn main() {
    let by_subject = [
        ("distance_field", distance_field::trials()),
        ("dual_contouring", dual_contouring::trials()),
        ("mls", mls::trials()),
        ("path_trace", path_trace::trials()),
        ("winding_number", winding_number::trials()),
    ];
    libtest_mimic::run(&Arguments::from_args(), support::named(by_subject)).exit();
}
