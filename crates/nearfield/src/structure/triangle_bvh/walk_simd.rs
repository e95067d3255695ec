//! The inner tests of a walk with AVX2, and the choice between them and the portable ones, made once by what the
//! processor has. Both give the same bits: no operation is fused.

#![allow(
    unsafe_code,
    reason = "functions that need a feature of the processor, and vector loads and stores, have no safe form"
)]

use super::layout::{Block, Node};
use super::walk::{Portable, walk};
use crate::geometry::PreparedRay;
use crate::geometry::row_simd::Simd;
use crate::structure::{CountRayWork, HitVisitor};

/// Walks with the widest form. AVX-512 would test no more than the eight boxes of a node either.
#[inline]
pub(super) fn walk_best<const STACK: usize, V: HitVisitor, W: CountRayWork>(
    simd: Simd,
    nodes: &[Node],
    blocks: &[Block],
    ray: &PreparedRay,
    visitor: &mut V,
    work: &mut W,
) {
    match simd {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the form was chosen by `Simd::best` or a test that asked the processor; AVX-512F comes with AVX2.
        Simd::Avx512 | Simd::Avx2 => unsafe { avx2::walk_avx2::<STACK, V, W>(nodes, blocks, ray, visitor, work) },
        _ => walk::<Portable, STACK, V, W>(nodes, blocks, ray, visitor, work),
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;
    use crate::structure::triangle_bvh::collapse::WIDTH;
    use crate::structure::triangle_bvh::settings::BLOCK;
    use crate::structure::triangle_bvh::walk::{Lanes, WalkRay};

    /// # Safety
    /// The processor has AVX2 and the instructions that came with it.
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    pub(super) unsafe fn walk_avx2<const STACK: usize, V: HitVisitor, W: CountRayWork>(
        nodes: &[Node],
        blocks: &[Block],
        ray: &PreparedRay,
        visitor: &mut V,
        work: &mut W,
    ) {
        walk::<Avx2, STACK, V, W>(nodes, blocks, ray, visitor, work);
    }

    /// Eight lanes of AVX2. Used by [`walk_avx2`] alone, whose callers know that the processor has it.
    struct Avx2;

    impl Lanes for Avx2 {
        #[inline(always)]
        fn entries(node: &Node, walk: &WalkRay<'_>, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
            // SAFETY: the processor has AVX2; see `Avx2`.
            unsafe { self::entries(node, walk, limit, entries) }
        }

        #[inline(always)]
        fn candidates(block: &Block, walk: &WalkRay<'_>) -> u32 {
            // SAFETY: the processor has AVX2; see `Avx2`.
            unsafe { self::candidates(block, walk) }
        }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(row: &[f32; WIDTH]) -> __m256 {
        // SAFETY: eight numbers are there.
        unsafe { _mm256_loadu_ps(row.as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn entries(node: &Node, walk: &WalkRay<'_>, limit: f32, entries: &mut [f32; WIDTH]) -> u32 {
        let mut enter = _mm256_set1_ps(walk.ray.t_min);
        let mut leave = _mm256_set1_ps(limit);
        for axis in 0..3 {
            let (near, far) = (load(&node.planes[walk.near[axis]]), load(&node.planes[walk.far[axis]]));
            let origin = _mm256_set1_ps(walk.origin[axis]);
            let inverse = _mm256_set1_ps(walk.inverse[axis]);
            enter = _mm256_max_ps(_mm256_mul_ps(_mm256_sub_ps(near, origin), inverse), enter);
            leave = _mm256_min_ps(_mm256_mul_ps(_mm256_sub_ps(far, origin), inverse), leave);
        }
        // SAFETY: there is room for eight numbers.
        unsafe { _mm256_storeu_ps(entries.as_mut_ptr(), enter) };
        _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave)) as u32
    }

    #[inline]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn candidates(block: &Block, walk: &WalkRay<'_>) -> u32 {
        let [x, y, z] = walk.axes;
        let [origin_x, origin_y, origin_z] = walk.axes.map(|axis| _mm256_set1_ps(walk.origin[axis]));
        let (shear_x, shear_y) = (_mm256_set1_ps(walk.ray.shear.x), _mm256_set1_ps(walk.ray.shear.y));
        let place = |corner: &[[f32; BLOCK]; 3]| {
            let along = _mm256_sub_ps(load(&corner[z]), origin_z);
            let (from_x, from_y) =
                (_mm256_sub_ps(load(&corner[x]), origin_x), _mm256_sub_ps(load(&corner[y]), origin_y));
            (_mm256_sub_ps(from_x, _mm256_mul_ps(shear_x, along)), _mm256_sub_ps(from_y, _mm256_mul_ps(shear_y, along)))
        };
        let (low, middle, high) = (place(&block.corners[0]), place(&block.corners[1]), place(&block.corners[2]));
        let edge =
            |from: (__m256, __m256), to: (__m256, __m256)| (_mm256_mul_ps(from.0, to.1), _mm256_mul_ps(from.1, to.0));
        let less = |a: __m256, b: __m256| _mm256_cmp_ps::<_CMP_LT_OQ>(a, b);
        let (a, b, c) = (edge(low, middle), edge(middle, high), edge(low, high));
        let left = _mm256_or_ps(_mm256_or_ps(less(a.0, a.1), less(b.0, b.1)), less(c.1, c.0));
        let right = _mm256_or_ps(_mm256_or_ps(less(a.1, a.0), less(b.1, b.0)), less(c.0, c.1));
        let outside = _mm256_movemask_ps(_mm256_and_ps(left, right)) as u32;
        block.lanes & !outside
    }
}
