//! One query against runs of ordered points: the inner loop of every CPU search.
//!
//! Three forms of one formula (`distance::norm2` of the difference, never fused): AVX-512, AVX2 and portable. The form
//! is chosen once by what the processor has; all three give the same bits.
//!
//! What is inside can be counted, collected, or marked by a bit a candidate and collected later.

#![allow(unsafe_code, reason = "vector loads, stores and compaction have no safe form")]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;
#[cfg(test)]
mod tests;

use std::ops::Range;
use std::sync::OnceLock;

use glam::Vec3;

use super::OrderedPoints;
use super::distance::Period;

/// The closed ball of one query.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ball {
    /// Center.
    pub(crate) center: Vec3,
    /// Squared radius.
    pub(crate) radius2: f32,
    /// Period of the domain.
    pub(crate) period: Period,
}

/// Neighbours found for one or more rows: indices in the caller's order, and squared distances where asked for.
#[derive(Debug, Clone, Default)]
pub(crate) struct Hits {
    /// The caller's indices.
    pub(crate) ids: Vec<u32>,
    /// Squared distances; empty where not asked for.
    pub(crate) dist2: Vec<f32>,
}

impl Hits {
    /// Forgets all hits, keeping the memory.
    pub(crate) fn clear(&mut self) {
        self.ids.clear();
        self.dist2.clear();
    }

    /// Removes the hit of this index, if there is one.
    pub(crate) fn leave_out(&mut self, id: u32) {
        if let Some(place) = self.ids.iter().position(|&other| other == id) {
            self.ids.remove(place);
            if !self.dist2.is_empty() {
                self.dist2.remove(place);
            }
        }
    }

    /// Makes room for all points of `spans`, and a vector more.
    fn reserve<const DIST2: bool>(&mut self, spans: &[Range<usize>]) {
        let most = spans.iter().map(Range::len).sum::<usize>() + OrderedPoints::PADDING;
        self.ids.reserve(most);
        if DIST2 {
            self.dist2.reserve(most);
        }
    }

    /// Pairs of index and squared distance; empty where distances were not asked for.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (u32, f32)> + '_ {
        self.ids.iter().copied().zip(self.dist2.iter().copied())
    }
}

/// The instruction set in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Simd {
    /// 16 lanes.
    Avx512,
    /// 8 lanes.
    Avx2,
    /// As many as the compiler finds.
    Portable,
}

impl Simd {
    /// The widest form this processor has.
    pub(crate) fn best() -> Self {
        static BEST: OnceLock<Simd> = OnceLock::new();
        *BEST.get_or_init(|| {
            #[cfg(target_arch = "x86_64")]
            {
                if is_x86_feature_detected!("avx512f") {
                    return Simd::Avx512;
                }
                if is_x86_feature_detected!("avx2") {
                    return Simd::Avx2;
                }
            }
            Simd::Portable
        })
    }

    /// "avx512", "avx2" or "portable".
    pub(crate) fn name(self) -> &'static str {
        match self {
            Simd::Avx512 => "avx512",
            Simd::Avx2 => "avx2",
            Simd::Portable => "portable",
        }
    }
}

/// Calls a function in the form that was chosen.
macro_rules! in_form {
    ($simd:expr, $function:ident, [$($flag:ident),*], ($points:expr, $spans:expr, $ball:expr $(, $rest:expr)*)) => {
        match ($simd, $ball.period.is_periodic()) {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the form was chosen by `Simd::best` or a test that asked the processor; spans are in range, and the
            // caller made the room that the function asks for.
            (Simd::Avx512, false) => unsafe { avx512::$function::<$($flag,)* false>($points, $spans, $ball $(, $rest)*) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            (Simd::Avx512, true) => unsafe { avx512::$function::<$($flag,)* true>($points, $spans, $ball $(, $rest)*) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            (Simd::Avx2, false) => unsafe { avx2::$function::<$($flag,)* false>($points, $spans, $ball $(, $rest)*) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            (Simd::Avx2, true) => unsafe { avx2::$function::<$($flag,)* true>($points, $spans, $ball $(, $rest)*) },
            _ => portable::$function::<$($flag),*>($points, $spans, $ball $(, $rest)*),
        }
    };
}

/// Number of points of `spans` inside the ball.
#[inline]
pub(crate) fn count(simd: Simd, points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball) -> u32 {
    check(points, spans);
    in_form!(simd, count, [], (points, spans, ball))
}

/// Appends the points of `spans` inside the ball to `hits`, in the order of the spans.
#[inline]
pub(crate) fn collect<const DIST2: bool>(
    simd: Simd,
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    hits: &mut Hits,
) {
    check(points, spans);
    hits.reserve::<DIST2>(spans);
    in_form!(simd, collect, [DIST2], (points, spans, ball, hits));
}

/// Bytes of the marks of `spans`: a bit a point, each span from a byte of its own on.
#[inline]
pub(crate) fn mark_bytes(spans: &[Range<usize>]) -> usize {
    spans.iter().map(|span| span.len().div_ceil(8)).sum()
}

/// Appends [`mark_bytes`] of marks, in which the bits of the points inside the ball are set; returns how many are.
#[inline]
pub(crate) fn mark(
    simd: Simd,
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    marks: &mut Vec<u8>,
) -> u32 {
    check(points, spans);
    marks.reserve(mark_bytes(spans) + size_of::<u16>());
    in_form!(simd, mark, [], (points, spans, ball, marks))
}

/// Appends the points of `spans` whose bits are set to `hits`: what [`collect`] appends, if [`mark`] made the marks.
#[inline]
pub(crate) fn collect_marked<const DIST2: bool>(
    simd: Simd,
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    marks: &[u8],
    hits: &mut Hits,
) {
    check(points, spans);
    assert_eq!(marks.len(), mark_bytes(spans), "there should be a bit a point");
    hits.reserve::<DIST2>(spans);
    in_form!(simd, collect_marked, [DIST2], (points, spans, ball, marks, hits));
}

/// Clears the bit of the point at `place`; returns whether it was set.
#[inline]
pub(crate) fn unmark(spans: &[Range<usize>], place: usize, marks: &mut [u8]) -> bool {
    let mut byte = 0;
    for span in spans {
        if span.contains(&place) {
            let (byte, bit) = (byte + (place - span.start) / 8, 1 << ((place - span.start) % 8));
            let was_set = marks[byte] & bit != 0;
            marks[byte] &= !bit;
            return was_set;
        }
        byte += span.len().div_ceil(8);
    }
    false
}

/// Places of the points of `spans` whose bits are set in `marks`.
pub(crate) fn marked(spans: &[Range<usize>], marks: &[u8]) -> impl Iterator<Item = usize> {
    let starts = spans.iter().flat_map(|span| span.clone().step_by(8));
    starts
        .zip(marks)
        .flat_map(|(start, &mask)| (0..8).filter(move |bit| mask >> bit & 1 == 1).map(move |bit| start + bit))
}

/// Appends the points at these places, which are inside the ball.
pub(crate) fn collect_places<const DIST2: bool>(
    points: &OrderedPoints,
    places: impl Iterator<Item = usize>,
    ball: &Ball,
    hits: &mut Hits,
) {
    for place in places {
        hits.ids.push(points.id(place));
        if DIST2 {
            hits.dist2.push(portable::dist2(points, place, ball));
        }
    }
}

/// Spans must lie inside the points: vector loads rely on it.
#[inline(always)]
fn check(points: &OrderedPoints, spans: &[Range<usize>]) {
    for span in spans {
        assert!(span.start <= span.end && span.end <= points.len(), "a span should lie inside the points");
    }
}
