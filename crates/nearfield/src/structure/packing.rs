//! Packs of query points along a curve: what structures in curve order search together.

use glam::Vec3;
use rayon::prelude::*;

use super::Packed;
use crate::Result;
use crate::curve::{Curve, Domain};
use crate::parallel::radix_sort;

/// Levels of the 32-bit keys that queries are sorted by.
const LEVELS: u32 = 10;

/// Orders queries along the curve through `domain`, and cuts the order where it leaves a cell that is about as large as a
/// pack of points, of which there are `n_packs`, or after `most` queries.
pub(super) fn along_curve(
    queries: &[Vec3],
    domain: &Domain,
    curve: Curve,
    n_packs: usize,
    most: usize,
) -> Result<Packed> {
    let key = |&query: &Vec3| (domain.key_of(curve, query) >> 33) as u32;
    let mut keys: Vec<u32> = queries.par_iter().with_min_len(1 << 12).map(key).collect();
    let mut order: Vec<u32> = (0..queries.len() as u32).collect();
    radix_sort::sort_pairs(&mut keys, &mut order, 0..3 * LEVELS)?;
    // Eight times fewer cells than packs of the points, if those were spread evenly.
    let level = (n_packs as u32).max(1).ilog2().div_ceil(3).min(LEVELS);
    let shift = 3 * (LEVELS - level);
    let mut packs: Vec<u32> = Vec::new();
    for place in 0..keys.len() {
        let starts = packs.last().is_none_or(|&first| {
            let first = first as usize;
            place - first >= most || keys[first] >> shift != keys[place] >> shift
        });
        if starts {
            packs.push(place as u32);
        }
    }
    packs.push(queries.len() as u32);
    Ok(Packed { order, packs })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;

    #[test]
    fn packs_hold_every_query_once_and_none_is_larger_than_asked() {
        let queries: Vec<Vec3> = (0..5000u32)
            .map(|i| Vec3::new((i * 7919 % 1009) as f32, (i * 31 % 977) as f32, (i * 17 % 499) as f32))
            .collect();
        let domain = Domain::of_bounds(&Aabb::of_points(&queries));
        for n_packs in [0, 1, 100, 1 << 30] {
            let packed = along_curve(&queries, &domain, Curve::Hilbert, n_packs, 50).unwrap();
            let mut order = packed.order.clone();
            order.sort_unstable();
            assert!(order.into_iter().eq(0..5000));
            assert_eq!((packed.packs[0], *packed.packs.last().unwrap()), (0, 5000));
            assert!(packed.packs.windows(2).all(|pack| pack[0] < pack[1] && pack[1] - pack[0] <= 50));
        }
        let none = along_curve(&[], &domain, Curve::Morton, 3, 50).unwrap();
        assert_eq!(none, Packed { order: vec![], packs: vec![0] });
    }
}
