//! Points in axis-aligned boxes: the question, who answers it, and the answer on the CPU.

use std::ops::Range;
use std::time::Instant;

use rayon::prelude::*;

use super::{Counts, Neighbors, Report, cpu, rows};
use crate::geometry::Aabb;
use crate::parallel::scan;
use crate::structure::{BruteForce, CpuStructure, LinearOctree};
use crate::{Error, Result};

/// Which points lie in each of these boxes?
///
/// Boxes are closed: a point is inside where min ≤ p ≤ max on each axis. These are comparisons of f32, so the answer is
/// the same to the bit on every device. A box with min above max on any axis is empty; corners may be infinite. Boxes
/// take no notice of a period: coordinates are compared as they were given.
///
/// ```
/// use nearfield::{Aabb, BoxSearch, Boxes, LinearOctree, OctreeSettings, Vec3};
///
/// let points = [Vec3::ZERO, Vec3::ONE, Vec3::splat(0.5)];
/// let tree = LinearOctree::build(&points, &OctreeSettings::default())?;
/// let boxes = [Aabb::new(Vec3::ZERO, Vec3::splat(0.5)), Aabb::EMPTY];
/// let inside = tree.list_in_boxes(&Boxes::new(&boxes))?;
/// assert_eq!((inside.row(0), inside.row(1)), (&[0, 2][..], &[][..]));
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Boxes<'a> {
    /// The boxes.
    pub boxes: &'a [Aabb],
    /// Largest size in bytes of a list in host memory; `None` for no limit.
    pub max_bytes: Option<u64>,
}

impl<'a> Boxes<'a> {
    /// Asks for these boxes.
    pub fn new(boxes: &'a [Aabb]) -> Self {
        Self { boxes, max_bytes: None }
    }

    /// Limits the size of a list in host memory.
    pub fn max_bytes(mut self, limit: u64) -> Self {
        self.max_bytes = Some(limit);
        self
    }

    /// Checks the question.
    ///
    /// # Errors
    /// `InvalidSetting` for a corner that is not a number, `TooMany` for 2³² − 1 boxes or more.
    pub fn validate(&self) -> Result<()> {
        if self.boxes.len() as u64 >= u64::from(u32::MAX) {
            return Err(Error::TooMany {
                what: "boxes",
                found: self.boxes.len() as u64,
                limit: u64::from(u32::MAX) - 1,
                advice: "ask in several calls",
            });
        }
        let Some(first) = self.boxes.iter().position(|b| b.min.is_nan() || b.max.is_nan()) else { return Ok(()) };
        Err(Error::InvalidSetting {
            setting: "boxes",
            found: format!("NaN in a corner of box {first}"),
            expected: "numbers; they may be infinite",
        })
    }

    /// Offsets of rows with these lengths, once the list is known to fit.
    ///
    /// # Errors
    /// `OutOfMemory`.
    pub(super) fn offsets(&self, counts: &[u32]) -> Result<Vec<u64>> {
        let offsets = scan::exclusive_u64(counts);
        let needed = 4 * offsets[counts.len()] + 8 * offsets.len() as u64;
        let available = self.max_bytes.unwrap_or(u64::MAX).min(rows::available_memory());
        if needed > available {
            return Err(Error::OutOfMemory { what: "the list of points in boxes", needed, available });
        }
        Ok(offsets)
    }
}

/// Search for the points in boxes. All implementations give the same answer in every bit.
pub trait BoxSearch {
    /// Number of points in each box, in the order of the boxes.
    ///
    /// # Errors
    /// See [`Boxes::validate`]; on a device `OutOfDeviceMemory`, `DeviceLost`, and on software renderers `Unsupported`
    /// where a kernel would need more loop rounds than they take.
    fn count_in_boxes(&self, question: &Boxes<'_>) -> Result<Counts>;

    /// The points in each box as compressed sparse rows in the order of the boxes, each row by ascending index.
    ///
    /// # Errors
    /// As [`BoxSearch::count_in_boxes`]; `OutOfMemory` with the size where the list would pass [`Boxes::max_bytes`] or
    /// the memory of the host.
    fn list_in_boxes(&self, question: &Boxes<'_>) -> Result<Neighbors>;
}

/// A structure on the CPU that knows where points in a box are.
trait SpansInBox: CpuStructure {
    /// Spans that together hold all points in the box, each once, and whether all points of the span are inside.
    fn spans_in(&self, aabb: &Aabb, visit: impl FnMut(Range<usize>, bool));
}

impl SpansInBox for BruteForce {
    fn spans_in(&self, _: &Aabb, mut visit: impl FnMut(Range<usize>, bool)) {
        visit(0..CpuStructure::points(self).len(), false);
    }
}

impl SpansInBox for LinearOctree {
    fn spans_in(&self, aabb: &Aabb, visit: impl FnMut(Range<usize>, bool)) {
        self.spans_in_box(aabb, visit);
    }
}

/// Boxes that a thread takes at a time, at least.
const FEW_BOXES: usize = 16;

fn report<S: SpansInBox>(structure: &S) -> Report {
    cpu::report(structure, "boxes")
}

fn count<S: SpansInBox>(structure: &S, boxes: &[Aabb]) -> Vec<u32> {
    let points = structure.points();
    let count = |aabb: &Aabb| {
        let mut count = 0;
        structure.spans_in(aabb, |span, inside| {
            count += if inside { span.len() } else { span.filter(|&i| aabb.contains(points.position(i))).count() };
        });
        count as u32
    };
    boxes.par_iter().with_min_len(FEW_BOXES).map(count).collect()
}

fn fill<S: SpansInBox>(structure: &S, aabb: &Aabb, row: &mut [u32]) {
    let points = structure.points();
    let mut filled = 0;
    structure.spans_in(aabb, |span, inside| {
        for i in span.filter(|&i| inside || aabb.contains(points.position(i))) {
            row[filled] = points.id(i);
            filled += 1;
        }
    });
}

/// Sorts every row.
pub(super) fn sort_rows(offsets: &[u64], indices: &mut [u32]) {
    split(offsets, indices).into_par_iter().with_min_len(FEW_BOXES).for_each(|row| row.sort_unstable());
}

/// The rows as slices.
fn split<'a>(offsets: &[u64], mut rest: &'a mut [u32]) -> Vec<&'a mut [u32]> {
    let row = |ends: &[u64]| {
        let (row, after) = std::mem::take(&mut rest).split_at_mut((ends[1] - ends[0]) as usize);
        rest = after;
        row
    };
    offsets.windows(2).map(row).collect()
}

impl<S: SpansInBox> BoxSearch for S {
    fn count_in_boxes(&self, question: &Boxes<'_>) -> Result<Counts> {
        question.validate()?;
        let start = Instant::now();
        let counts = count(self, question.boxes);
        let mut report = report(self);
        report.host_stage("query", start);
        Ok(Counts { counts, report })
    }

    fn list_in_boxes(&self, question: &Boxes<'_>) -> Result<Neighbors> {
        question.validate()?;
        let mut report = report(self);
        let start = Instant::now();
        let offsets = question.offsets(&count(self, question.boxes))?;
        report.host_stage("count", start);
        let start = Instant::now();
        let mut indices = rows::zeroed(offsets[question.boxes.len()] as usize)?;
        let filled = split(&offsets, &mut indices).into_par_iter().zip(question.boxes).with_min_len(FEW_BOXES);
        filled.for_each(|(row, aabb)| fill(self, aabb, row));
        report.host_stage("fill", start);
        let start = Instant::now();
        sort_rows(&offsets, &mut indices);
        report.host_stage("sort rows", start);
        Ok(Neighbors { offsets, indices, report, ..Neighbors::default() })
    }
}
