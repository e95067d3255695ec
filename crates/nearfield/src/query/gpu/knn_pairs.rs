//! The nearest of a grid's own points by pairs: all within the reach of the cells as masks (`pairs`), and the nearest of those.

use super::knn_boxes::MOST_PLACES;
use super::knn_cells::{CellsRun, InCells};
use super::knn_packs::LeftQueries;
use super::pairs::Pairs;
use crate::gpu::{Access, Bind, Buffer, Commands, Kernel, Workgroups};
use crate::query::{FixedRadius, Radius};
use crate::structure::GpuStructure;
use crate::{Error, Result};

/// Invocations of a workgroup of the kernel. For 16 of uniform-1m on an H200: 0.338 ms, 0.361 with 64 or 128 and 0.371 with 256.
const WORKGROUP: u32 = 32;

/// Most words of a pair whose candidates have numbers: 11 bits, five of which are a candidate's place in its word.
const MOST_WORDS: u32 = 64;

/// A search in pairs that suits a question.
pub(super) struct NearestInPairs {
    pairs: Pairs,
    /// `[pairs]` words that a pair has or would need.
    words: Buffer<u32>,
    /// `[capacity · pairs]`.
    masks: Buffer<[u32; 4]>,
    capacity: u32,
}

impl NearestInPairs {
    /// Modules of the kernels.
    pub(super) const KERNELS: [&'static str; 2] =
        ["package::structure::uniform_grid::find_pairs", "package::query::knn_pairs"];

    /// Where rows are short, the queries can be searched in pairs, and there is memory for their masks.
    ///
    /// # Errors
    /// `OutOfMemory`, `DeviceLost`.
    pub(super) fn suiting(run: &InCells<'_>) -> Result<Option<Self>> {
        let (gpu, n) = (run.grid.gpu(), run.queries.len());
        let capacity = run.grid.mask_words();
        let mask_bytes = n.div_ceil(2) as u64 * u64::from(capacity) * size_of::<[u32; 4]>() as u64;
        if run.places > MOST_PLACES || capacity > MOST_WORDS || mask_bytes > gpu.limits().binding_bytes {
            return Ok(None);
        }
        let within = FixedRadius { radius: Radius::One(run.reach()), ..*run.within };
        let made = || -> Result<Option<Self>> {
            let Some(pairs) = Pairs::of(run.grid, &within, run.queries)? else { return Ok(None) };
            let (words, masks) = pairs.words_and_masks(capacity)?;
            Ok(Some(Self { pairs, words, masks, capacity }))
        };
        match made() {
            Err(Error::OutOfDeviceMemory { .. }) => Ok(None),
            made => made,
        }
    }

    /// Records the search; the rows of those left are not filled.
    ///
    /// # Errors
    /// `KernelRejected`, `OutOfDeviceMemory`.
    pub(super) fn record(&self, commands: &mut Commands, run: &InCells<'_>) -> Result<LeftQueries> {
        let gpu = run.grid.gpu();
        self.pairs.record_marks(commands, &self.words, &self.masks)?;
        commands.stage("keep nearest");
        let left = LeftQueries::none_of(commands, gpu, run.queries.len())?;
        let parameters = CellsRun { capacity: self.capacity, ..run.run() };
        let parameters = gpu.uniform("nearest run", &parameters)?;
        let mut binds: Vec<Bind> = vec![
            (&parameters).into(),
            run.queries.points().into(),
            run.queries.radii().into(),
            (&self.words).into(),
            (&self.masks).into(),
        ];
        binds.extend(left.binds());
        use Access::{Read, ReadWrite, Uniform};
        let kernel = Kernel {
            visitor_bindings: &[ReadWrite; 2],
            features: &run.features(0),
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            ..Kernel::new(
                Self::KERNELS[1],
                "keep_nearest",
                &[Uniform, Read, Read, Read, Read, ReadWrite, ReadWrite],
                WORKGROUP,
            )
        };
        let covering = Workgroups::Covering(run.queries.len() as u64);
        commands.dispatch_with_visitor(&gpu.prepare(&kernel)?, &binds, &run.row_binds(), covering);
        Ok(left)
    }
}
