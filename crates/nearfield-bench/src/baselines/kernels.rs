//! The kernels of the baselines: WESL modules of this crate, composed with those of the library.
//!
//! Sizes that arrays in a kernel depend on stand in the module `package::baselines::sizes`, which is written when a
//! pipeline is made. Like the library's kernels they are compiled without run-time checks, so that times compare; with
//! `NEARFIELD_SHADER_CHECKS=1` and in debug builds checks are on.

use std::sync::Arc;

use nearfield::Result;
use nearfield::gpu::shader::Fill;
use nearfield::gpu::{Access, Gpu, Kernel, Pipeline};

/// Invocations of a workgroup.
pub(super) const WORKGROUP: u32 = 128;

const MODULES: [(&str, &str); 6] = [
    ("package::baselines::nearest_row", include_str!("nearest_row.wesl")),
    ("package::baselines::shifted_sort::gather", include_str!("shifted_sort/gather.wesl")),
    ("package::baselines::shifted_sort::merge", include_str!("shifted_sort/merge.wesl")),
    ("package::baselines::lsh::hash", include_str!("lsh/hash.wesl")),
    ("package::baselines::lsh::column", include_str!("lsh/column.wesl")),
    ("package::baselines::lsh::probe", include_str!("lsh/probe.wesl")),
];
const SIZES: &str = "package::baselines::sizes";

/// Constants of `package::baselines::sizes`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sizes {
    /// Places of a row.
    pub(super) row: usize,
    /// Groups of four coordinates of a point.
    pub(super) quads: usize,
    /// Hash tables.
    pub(super) tables: usize,
    /// Projections of a table.
    pub(super) projections: usize,
}

impl Sizes {
    /// Where a kernel needs none but the row.
    pub(super) fn of_row(row: usize) -> Self {
        Self { row, quads: 1, tables: 1, projections: 1 }
    }

    fn source(&self) -> String {
        let Self { row, quads, tables, projections } = self;
        format!(
            "const ROW: u32 = {row}u;\nconst QUADS: u32 = {quads}u;\nconst TABLES: u32 = {tables}u;\n\
             const PROJECTIONS: u32 = {projections}u;\n"
        )
    }
}

/// The pipeline of entry `entry` of `package::baselines::…`.
pub(super) fn pipeline(
    gpu: &Gpu,
    (module, entry): (&str, &str),
    bindings: &[Access],
    features: &[(&str, bool)],
    sizes: Sizes,
) -> Result<Arc<Pipeline>> {
    let (module, source) = (format!("package::baselines::{module}"), sizes.source());
    let fills = fills(&source);
    let constants = [("WORKGROUP", f64::from(WORKGROUP))];
    let kernel =
        Kernel { fills: &fills, features, constants: &constants, ..Kernel::new(&module, entry, bindings, WORKGROUP) };
    // SAFETY: every kernel guards its indices by the lengths in its parameters, which are those of the buffers that
    // the host checked, and indices that come out of buffers by the same; every loop has a bound. The tests run the
    // same kernels with checks on.
    unsafe { gpu.pipeline_unchecked(&kernel) }
}

fn fills(sizes: &str) -> Vec<(&str, Fill<'_>)> {
    let mut fills: Vec<_> = MODULES.iter().map(|&(path, source)| (path, Fill::Caller(source))).collect();
    fills.push((SIZES, Fill::Caller(sizes)));
    fills
}

#[cfg(test)]
mod tests {
    use nearfield::gpu::shader::compose;
    use nearfield::gpu::wgpu::naga;

    use super::*;

    #[test]
    fn every_kernel_composes_and_validates_in_every_variant() {
        let sizes = Sizes { row: 20, quads: 3, tables: 4, projections: 5 }.source();
        let modes = [(false, false), (true, false), (false, true)];
        let mut kernels = 0;
        for (module, source) in MODULES.iter().filter(|(_, source)| source.contains("@compute")) {
            for (own, wide, mode) in (0..12).map(|i| (i & 1 == 1, i & 2 == 2, modes[i / 4])) {
                let features =
                    [("own", own), ("wide", wide), ("hilbert", false), ("counting", mode.0), ("listing", mode.1)];
                let wgsl = compose(module, &fills(&sizes), &features, false).expect(module);
                let parsed = naga::front::wgsl::parse_str(&wgsl).map_err(|e| e.emit_to_string(&wgsl)).expect(module);
                naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
                    .validate(&parsed)
                    .map_err(|e| e.emit_to_string(&wgsl))
                    .expect(module);
                kernels += parsed.entry_points.len();
                assert!(!parsed.entry_points.is_empty(), "{module}: {source}");
            }
        }
        assert_eq!(kernels, 12 * 5);
    }
}
