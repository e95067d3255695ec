//! Simulations of particles: published numbers, what is conserved, and the same trajectory by every search on every device.

mod checkpoint;
mod dem;
mod dem_gpu;
mod dfsph_gpu;
mod pbf;
mod pbf_gpu;
mod pbf_reference;
mod runs;
mod scene_file;
mod scenes;
mod sph;
#[path = "../support/mod.rs"]
mod support;
mod surface;
mod wcsph_gpu;

use libtest_mimic::Arguments;

fn main() {
    let mut trials = dem::trials();
    trials.extend(dem_gpu::trials());
    for more in [scenes::trials(), scene_file::trials(), checkpoint::trials(), surface::trials()] {
        trials.extend(more);
    }
    trials.extend(pbf::trials());
    trials.extend(pbf_gpu::trials());
    trials.extend(sph::trials());
    trials.extend(dfsph_gpu::trials());
    trials.extend(wcsph_gpu::trials());
    libtest_mimic::run(&Arguments::from_args(), trials).exit();
}
