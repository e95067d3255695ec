//! The test of 8 points at a time, by AVX2.

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
pub(super) unsafe fn count<const PERIODIC: bool>(points: &OrderedPoints, spans: &[Range<usize>], ball: &Ball) -> u32 {
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

/// # Safety
/// As `count`, and `marks` has capacity for the bytes of all spans and two more.
#[target_feature(enable = "avx2,popcnt")]
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
            // SAFETY: i < len, so loads stay within the padding; room for all marks was made.
            unsafe {
                let mask = test::<PERIODIC>((x, y, z), i, span.end, ball).0;
                *out.add(len) = mask as u8;
                total += mask.count_ones();
            }
            len += 1;
        }
    }
    // SAFETY: the first `len` bytes were written above or before.
    unsafe { marks.set_len(len) };
    total
}

/// # Safety
/// As `collect`, and `marks` has a bit for every point of the spans.
#[target_feature(enable = "avx2,popcnt")]
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
            // SAFETY: as `collect`; a bit a point was asserted.
            unsafe {
                let mask = *bits;
                bits = bits.add(1);
                let front = _mm256_loadu_si256(COMPACT[mask as usize].as_ptr().cast());
                let id = _mm256_loadu_si256(ids.as_ptr().add(i).cast());
                _mm256_storeu_si256(out_ids.add(len).cast(), _mm256_permutevar8x32_epi32(id, front));
                if DIST2 {
                    let d2 = test::<PERIODIC>((x, y, z), i, span.end, ball).1;
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
