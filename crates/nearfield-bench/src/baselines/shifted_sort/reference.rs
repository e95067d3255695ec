//! The definition of the search, written plainly: what the GPU's rows are tested against.

use nearfield::parallel::reduce;
use nearfield::{Curve, Result, Vec3};
use rayon::prelude::*;

use super::ShiftedSortSettings;
use crate::baselines::points::dist2;
use crate::baselines::rows::KnnRows;

/// Who asks.
#[derive(Debug, Clone, Copy)]
pub enum Asking<'a> {
    /// Every point; `without_self` leaves itself out.
    Points {
        /// Leave out the query itself.
        without_self: bool,
    },
    /// Other points.
    Other(&'a [Vec3]),
}

/// Rows of the nearest points met along the shifted curves, by the first `key_bits` of 63-bit keys.
///
/// # Errors
/// `InvalidSetting`.
pub fn knn(points: &[Vec3], asking: Asking<'_>, settings: &ShiftedSortSettings, key_bits: u32) -> Result<KnnRows> {
    settings.validate()?;
    let queries = match asking {
        Asking::Points { .. } => points,
        Asking::Other(queries) => queries,
    };
    let left_out = |query: usize| matches!(asking, Asking::Points { without_self: true }).then_some(query as u32);
    let mut met: Vec<Vec<(f32, u32)>> = vec![vec![]; queries.len()];
    for domain in settings.domains(&reduce::bounds(points))? {
        let key = |p: &Vec3| domain.key_of(Curve::Morton, *p) >> (63 - key_bits);
        let keys: Vec<u64> = points.par_iter().map(key).collect();
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        order.par_sort_by_key(|&i| keys[i as usize]);
        let mut place_of = vec![0; points.len()];
        for (place, &i) in order.iter().enumerate() {
            place_of[i as usize] = place;
        }
        met.par_iter_mut().enumerate().for_each(|(query, met)| {
            let (place, after) = match asking {
                Asking::Points { .. } => (place_of[query], place_of[query] + 1),
                Asking::Other(queries) => {
                    let wanted = key(&queries[query]);
                    let place = order.partition_point(|&i| keys[i as usize] < wanted);
                    (place, place)
                }
            };
            let window = place.saturating_sub(settings.window)..(after + settings.window).min(points.len());
            for &i in order[window].iter().filter(|&&i| Some(i) != left_out(query)) {
                let distance = dist2(&queries[query].to_array(), &points[i as usize].to_array());
                if !met.contains(&(distance, i)) {
                    met.push((distance, i));
                }
            }
        });
    }
    Ok(KnnRows::of_candidates(settings.k, met))
}
