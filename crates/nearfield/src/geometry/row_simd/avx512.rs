//! The test of 16 points at a time, by AVX-512.

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
pub(super) unsafe fn count<const PERIODIC: bool>(points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball) -> u32 {
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

/// # Safety
/// As `count`, and `marks` has capacity for the bytes of all spans and two more.
#[target_feature(enable = "avx512f,popcnt")]
pub(super) unsafe fn mark<const PERIODIC: bool>(
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    marks: &mut Vec<u8>,
) -> u32 {
    let (x, y, z, _) = points.columns();
    let (mut total, mut len) = (0, marks.len());
    let out = marks.as_mut_ptr();
    for span in spans {
        for i in span.clone().step_by(LANES) {
            // SAFETY: i < len, so loads stay within the padding; room for all marks and two bytes was made.
            unsafe {
                let mask = test::<PERIODIC>((x, y, z), i, span.end, ball).0;
                out.add(len).cast::<u16>().write_unaligned(mask.to_le());
                total += mask.count_ones();
            }
            len += (span.end - i).div_ceil(8).min(2);
        }
    }
    // SAFETY: the first `len` bytes were written above or before.
    unsafe { marks.set_len(len) };
    total
}

/// # Safety
/// As `collect`, and `marks` has a bit for every point of the spans.
#[target_feature(enable = "avx512f,popcnt")]
pub(super) unsafe fn collect_marked<const DIST2: bool, const PERIODIC: bool>(
    points: &OrderedPoints,
    spans: &[Range<usize>],
    ball: &Ball,
    marks: &[u8],
    hits: &mut Hits,
) {
    let (x, y, z, ids) = points.columns();
    let mut len = hits.ids.len();
    let (out_ids, out_dist2) = (hits.ids.as_mut_ptr(), hits.dist2.as_mut_ptr());
    let mut bits = marks.as_ptr();
    for span in spans {
        for i in span.clone().step_by(LANES) {
            // SAFETY: as `collect`; a bit a point was asserted, and the second byte is read only where points are left for it.
            unsafe {
                let low = u16::from(*bits);
                let mask = if span.end - i > 8 { low | u16::from(*bits.add(1)) << 8 } else { low };
                bits = bits.add((span.end - i).div_ceil(8).min(2));
                let id = _mm512_loadu_si512(ids.as_ptr().add(i).cast());
                _mm512_storeu_si512(out_ids.add(len).cast(), _mm512_maskz_compress_epi32(mask, id));
                if DIST2 {
                    let d2 = test::<PERIODIC>((x, y, z), i, span.end, ball).1;
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
