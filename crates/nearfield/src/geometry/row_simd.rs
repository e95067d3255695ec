//! One query against runs of ordered points: the inner loop of every CPU search.
//!
//! Three forms of one formula (`distance::norm2` of the difference, never fused): AVX-512, AVX2 and portable. The form
//! is chosen once by what the processor has; all three give the same bits.

#![allow(unsafe_code, reason = "vector loads, stores and compaction have no safe form")]

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

/// Number of points of `spans` inside the ball.
#[inline]
pub(crate) fn count(simd: Simd, points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball) -> u32 {
    check(points, spans);
    match (simd, ball.period.is_periodic()) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the form was chosen by `Simd::best` or a test that asked the processor; spans are in range.
        (Simd::Avx512, false) => unsafe { avx512::count::<false>(points, spans, ball) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        (Simd::Avx512, true) => unsafe { avx512::count::<true>(points, spans, ball) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        (Simd::Avx2, false) => unsafe { avx2::count::<false>(points, spans, ball) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        (Simd::Avx2, true) => unsafe { avx2::count::<true>(points, spans, ball) },
        _ => portable::count(points, spans, ball),
    }
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
    let most = spans.iter().map(|s| s.len()).sum::<usize>() + OrderedPoints::PADDING;
    hits.ids.reserve(most);
    if DIST2 {
        hits.dist2.reserve(most);
    }
    match (simd, ball.period.is_periodic()) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as in `count`; `hits` has room for every candidate and one vector more.
        (Simd::Avx512, false) => unsafe { avx512::collect::<DIST2, false>(points, spans, ball, hits) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        (Simd::Avx512, true) => unsafe { avx512::collect::<DIST2, true>(points, spans, ball, hits) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        (Simd::Avx2, false) => unsafe { avx2::collect::<DIST2, false>(points, spans, ball, hits) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        (Simd::Avx2, true) => unsafe { avx2::collect::<DIST2, true>(points, spans, ball, hits) },
        _ => portable::collect::<DIST2>(points, spans, ball, hits),
    }
}

/// Spans must lie inside the points: vector loads rely on it.
#[inline(always)]
fn check(points: &OrderedPoints, spans: &[Range<usize>]) {
    for span in spans {
        assert!(span.start <= span.end && span.end <= points.len(), "a span should lie inside the points");
    }
}

mod portable {
    use super::*;

    #[inline(always)]
    fn dist2(points: &OrderedPoints, i: usize, ball: &Ball) -> f32 {
        let difference = ball.center - points.position(i);
        crate::geometry::distance::norm2(ball.period.nearest_image(difference))
    }

    pub(super) fn count(points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball) -> u32 {
        spans.iter().cloned().flatten().filter(|&i| dist2(points, i, ball) <= ball.radius2).count() as u32
    }

    pub(super) fn collect<const DIST2: bool>(
        points: &OrderedPoints,
        spans: &[Range<usize>],
        ball: &Ball,
        hits: &mut Hits,
    ) {
        for i in spans.iter().cloned().flatten() {
            let d2 = dist2(points, i, ball);
            if d2 <= ball.radius2 {
                hits.ids.push(points.id(i));
                if DIST2 {
                    hits.dist2.push(d2);
                }
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use std::arch::x86_64::*;

    use super::*;

    const LANES: usize = 16;

    /// Squared distances of 16 points from place `i` on, and which of them are in the ball and before `end`.
    ///
    /// # Safety
    /// The processor has AVX-512F and `i + 16` is at most the padded length.
    #[inline]
    #[target_feature(enable = "avx512f")]
    unsafe fn test<const PERIODIC: bool>(
        (x, y, z): (&[f32], &[f32], &[f32]),
        i: usize,
        end: usize,
        ball: &Ball,
    ) -> (__mmask16, __m512) {
        let axis = |column: &[f32], axis: usize| {
            // SAFETY: the caller keeps `i + 16` within the padded column.
            let p = unsafe { _mm512_loadu_ps(column.as_ptr().add(i)) };
            let d = _mm512_sub_ps(_mm512_set1_ps(ball.center[axis]), p);
            if !PERIODIC {
                return d;
            }
            let turns = _mm512_mul_ps(d, _mm512_set1_ps(ball.period.inverse()[axis]));
            let turns = _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(turns);
            _mm512_sub_ps(d, _mm512_mul_ps(_mm512_set1_ps(ball.period.lengths()[axis]), turns))
        };
        let (dx, dy, dz) = (axis(x, 0), axis(y, 1), axis(z, 2));
        let xy = _mm512_add_ps(_mm512_mul_ps(dx, dx), _mm512_mul_ps(dy, dy));
        let d2 = _mm512_add_ps(xy, _mm512_mul_ps(dz, dz));
        let left = end - i;
        let valid: __mmask16 = if left >= LANES { !0 } else { (1u16 << left) - 1 };
        (_mm512_mask_cmp_ps_mask::<_CMP_LE_OQ>(valid, d2, _mm512_set1_ps(ball.radius2)), d2)
    }

    /// # Safety
    /// The processor has AVX-512F; the spans lie inside the points.
    #[target_feature(enable = "avx512f,popcnt")]
    pub(super) unsafe fn count<const PERIODIC: bool>(
        points: &OrderedPoints,
        spans: &[Range<usize>],
        ball: &Ball,
    ) -> u32 {
        let (x, y, z, _) = points.columns();
        let mut total = 0;
        for span in spans {
            for i in span.clone().step_by(LANES) {
                // SAFETY: i < len, so i + 16 is within the padding.
                total += unsafe { test::<PERIODIC>((x, y, z), i, span.end, ball) }.0.count_ones();
            }
        }
        total
    }

    /// # Safety
    /// As `count`, and `hits` has capacity for every candidate and 16 more.
    #[target_feature(enable = "avx512f,popcnt")]
    pub(super) unsafe fn collect<const DIST2: bool, const PERIODIC: bool>(
        points: &OrderedPoints,
        spans: &[Range<usize>],
        ball: &Ball,
        hits: &mut Hits,
    ) {
        let (x, y, z, ids) = points.columns();
        let mut len = hits.ids.len();
        let (out_ids, out_dist2) = (hits.ids.as_mut_ptr(), hits.dist2.as_mut_ptr());
        for span in spans {
            for i in span.clone().step_by(LANES) {
                // SAFETY: i < len, so loads stay within the padding; at most the candidates seen so far plus one
                // vector are written, for which the capacity was reserved.
                unsafe {
                    let (mask, d2) = test::<PERIODIC>((x, y, z), i, span.end, ball);
                    let id = _mm512_loadu_si512(ids.as_ptr().add(i).cast());
                    _mm512_storeu_si512(out_ids.add(len).cast(), _mm512_maskz_compress_epi32(mask, id));
                    if DIST2 {
                        _mm512_storeu_ps(out_dist2.add(len), _mm512_maskz_compress_ps(mask, d2));
                    }
                    len += mask.count_ones() as usize;
                }
            }
        }
        // SAFETY: the first `len` elements were written above or before.
        unsafe {
            hits.ids.set_len(len);
            if DIST2 {
                hits.dist2.set_len(len);
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;

    const LANES: usize = 8;

    /// For each mask of 8 lanes: the lanes to move to the front.
    static COMPACT: [[u32; 8]; 256] = {
        let mut table = [[0; 8]; 256];
        let mut mask = 0;
        while mask < 256 {
            let (mut lane, mut next) = (0, 0);
            while lane < 8 {
                if mask >> lane & 1 == 1 {
                    table[mask][next] = lane as u32;
                    next += 1;
                }
                lane += 1;
            }
            mask += 1;
        }
        table
    };

    /// Squared distances of 8 points from place `i` on, and which of them are in the ball and before `end`.
    ///
    /// # Safety
    /// The processor has AVX2 and `i + 8` is at most the padded length.
    #[inline]
    #[target_feature(enable = "avx2")]
    unsafe fn test<const PERIODIC: bool>(
        (x, y, z): (&[f32], &[f32], &[f32]),
        i: usize,
        end: usize,
        ball: &Ball,
    ) -> (u32, __m256) {
        let axis = |column: &[f32], axis: usize| {
            // SAFETY: the caller keeps `i + 8` within the padded column.
            let p = unsafe { _mm256_loadu_ps(column.as_ptr().add(i)) };
            let d = _mm256_sub_ps(_mm256_set1_ps(ball.center[axis]), p);
            if !PERIODIC {
                return d;
            }
            let turns = _mm256_mul_ps(d, _mm256_set1_ps(ball.period.inverse()[axis]));
            let turns = _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(turns);
            _mm256_sub_ps(d, _mm256_mul_ps(_mm256_set1_ps(ball.period.lengths()[axis]), turns))
        };
        let (dx, dy, dz) = (axis(x, 0), axis(y, 1), axis(z, 2));
        let xy = _mm256_add_ps(_mm256_mul_ps(dx, dx), _mm256_mul_ps(dy, dy));
        let d2 = _mm256_add_ps(xy, _mm256_mul_ps(dz, dz));
        let inside = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(d2, _mm256_set1_ps(ball.radius2))) as u32;
        let left = end - i;
        let valid = if left >= LANES { 0xff } else { (1u32 << left) - 1 };
        (inside & valid, d2)
    }

    /// # Safety
    /// The processor has AVX2; the spans lie inside the points.
    #[target_feature(enable = "avx2,popcnt")]
    pub(super) unsafe fn count<const PERIODIC: bool>(
        points: &OrderedPoints,
        spans: &[Range<usize>],
        ball: &Ball,
    ) -> u32 {
        let (x, y, z, _) = points.columns();
        let mut total = 0;
        for span in spans {
            for i in span.clone().step_by(LANES) {
                // SAFETY: i < len, so i + 8 is within the padding.
                total += unsafe { test::<PERIODIC>((x, y, z), i, span.end, ball) }.0.count_ones();
            }
        }
        total
    }

    /// # Safety
    /// As `count`, and `hits` has capacity for every candidate and 8 more.
    #[target_feature(enable = "avx2,popcnt")]
    pub(super) unsafe fn collect<const DIST2: bool, const PERIODIC: bool>(
        points: &OrderedPoints,
        spans: &[Range<usize>],
        ball: &Ball,
        hits: &mut Hits,
    ) {
        let (x, y, z, ids) = points.columns();
        let mut len = hits.ids.len();
        let (out_ids, out_dist2) = (hits.ids.as_mut_ptr(), hits.dist2.as_mut_ptr());
        for span in spans {
            for i in span.clone().step_by(LANES) {
                // SAFETY: as in the AVX-512 form, with 8 lanes.
                unsafe {
                    let (mask, d2) = test::<PERIODIC>((x, y, z), i, span.end, ball);
                    let front = _mm256_loadu_si256(COMPACT[mask as usize].as_ptr().cast());
                    let id = _mm256_loadu_si256(ids.as_ptr().add(i).cast());
                    _mm256_storeu_si256(out_ids.add(len).cast(), _mm256_permutevar8x32_epi32(id, front));
                    if DIST2 {
                        _mm256_storeu_ps(out_dist2.add(len), _mm256_permutevar8x32_ps(d2, front));
                    }
                    len += mask.count_ones() as usize;
                }
            }
        }
        // SAFETY: the first `len` elements were written above or before.
        unsafe {
            hits.ids.set_len(len);
            if DIST2 {
                hits.dist2.set_len(len);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forms() -> Vec<Simd> {
        let mut forms = vec![Simd::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") {
                forms.push(Simd::Avx2);
            }
            if is_x86_feature_detected!("avx512f") {
                forms.push(Simd::Avx512);
            }
        }
        forms
    }

    /// 61 points on a lattice of eighths: distances are exact, and many are equal to the radius.
    fn lattice() -> OrderedPoints {
        let points: Vec<Vec3> =
            (0..61).map(|i| Vec3::new((i % 5) as f32, (i / 5 % 5) as f32, (i / 25) as f32) * 0.125).collect();
        let order: Vec<u32> = (0..61).rev().collect();
        OrderedPoints::gather(&points, &order)
    }

    #[test]
    fn every_form_agrees_with_the_plain_loop_on_every_span() {
        let points = lattice();
        for period in [Period::NONE, Period::new(Vec3::new(0.5, 0.0, 0.25)).unwrap()] {
            let ball = Ball { center: Vec3::splat(0.25), radius2: 0.0625, period };
            for start in 0..20 {
                for end in start..points.len() {
                    let spans = [start..end, 3..5];
                    let expected: Vec<(u32, f32)> = spans
                        .iter()
                        .cloned()
                        .flatten()
                        .map(|i| (points.id(i), period.dist2(ball.center, points.position(i))))
                        .filter(|&(_, d2)| d2 <= 0.0625)
                        .collect();
                    for form in forms() {
                        let mut hits = Hits { ids: vec![7], dist2: vec![9.0] };
                        collect::<true>(form, &points, &spans, &ball, &mut hits);
                        let found: Vec<(u32, f32)> = hits.ids.into_iter().zip(hits.dist2).skip(1).collect();
                        assert_eq!(found, expected, "{form:?} {start}..{end}");
                        assert_eq!(count(form, &points, &spans, &ball) as usize, expected.len(), "{form:?}");
                    }
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "inside the points")]
    fn a_span_past_the_end_is_caught() {
        let points = lattice();
        let past_the_end = 60..62;
        count(
            Simd::best(),
            &points,
            std::slice::from_ref(&past_the_end),
            &Ball { center: Vec3::ZERO, radius2: 1.0, period: Period::NONE },
        );
    }
}
