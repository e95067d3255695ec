//! Octrees on the device against the CPU, and all structures there at their edges: one program, since each would link the whole library.

mod dense_octree;
mod edges;
mod linear_octree;
#[path = "../support/mod.rs"]
mod support;

use libtest_mimic::Arguments;

fn main() {
    let by_subject = [
        ("dense_octree", dense_octree::trials()),
        ("edges", edges::trials()),
        ("linear_octree", linear_octree::trials()),
    ];
    libtest_mimic::run(&Arguments::from_args(), support::named(by_subject)).exit();
}
