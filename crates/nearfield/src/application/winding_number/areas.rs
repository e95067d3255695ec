//! The share of the surface that each sample stands for.

use rayon::prelude::*;

use crate::geometry::Scalar;
use crate::query::NearestFew;
use crate::structure::AabbTreeN;

/// Neighbours whose disk is measured: fewer are noisier, more reach farther around edges.
const NEIGHBORS: usize = 12;
/// Points of a task.
const TASK: usize = 256;

/// The area of the surface around each sample, by the disk that holds its 12 nearest neighbours: π d² / 12 with the distance
/// d of the last of them, whose mean over samples at random is the area a sample.
///
/// `[n]` in the caller's order; 0 where all samples are at one place.
pub fn disk_areas<T: Scalar>(tree: &AabbTreeN<T, 3>) -> Vec<T> {
    let points = tree.ordered_points();
    let places: Vec<usize> = (0..points.len()).collect();
    let k = NEIGHBORS.min(points.len().saturating_sub(1));
    let factor = T::of(std::f64::consts::PI / k.max(1) as f64);
    let parts: Vec<Vec<T>> = places
        .par_chunks(TASK)
        .map_init(
            // The nearest is the sample itself.
            || NearestFew::new(k + 1),
            |few, places| {
                let area = |&place: &usize| {
                    tree.nearest_few(&points.position(place), T::of(f64::INFINITY), few);
                    few.found().last().map_or(T::ZERO, |hit| hit.0 * factor)
                };
                places.iter().map(area).collect()
            },
        )
        .collect();
    let mut areas = vec![T::ZERO; points.len()];
    points.ids().iter().zip(parts.iter().flatten()).for_each(|(&id, &area)| areas[id as usize] = area);
    areas
}
