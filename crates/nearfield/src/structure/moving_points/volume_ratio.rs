//! How much boxes have grown since the build: the largest ratio of volumes. `volume_ratio.wesl` is the twin of this file.
//!
//! The ratio is the product over the axes of (side now + 2r) / (side at the build + 2r). An axis on which the box has no
//! length at either time is left out, so that flat sets have the ratio of areas at r = 0; one that had none and has one now
//! makes the ratio infinite. An empty box counts 1.

use rayon::prelude::*;

use crate::structure::aabb_tree::NodeBox;

/// Ratios beyond this count as infinite, on both sides; it is an f32.
pub(super) const INFINITE_BEYOND: f64 = (1u128 << 100) as f64;

/// Boxes that one thread compares at a time.
const BOXES_A_TASK: usize = 4096;

/// Sides of a box; below zero where it is empty.
#[inline(always)]
fn sides(aabb: &NodeBox) -> [f32; 3] {
    let is_empty = (0..3).any(|axis| aabb.min[axis] > aabb.max[axis]);
    if is_empty { [-1.0; 3] } else { [0, 1, 2].map(|axis| aabb.max[axis] - aabb.min[axis]) }
}

/// The ratio of volumes of one box, grown by the radius.
#[inline(always)]
fn ratio(now: [f32; 3], then: [f32; 3], radius: f32) -> f64 {
    if now[0] < 0.0 || then[0] < 0.0 {
        return 1.0;
    }
    // In f64 neither product leaves the range, whatever the coordinates.
    let (mut volume, mut volume_then) = (1.0, 1.0);
    let mut is_infinite = false;
    for axis in 0..3 {
        let grown = now[axis] + 2.0 * radius;
        let grown_then = then[axis] + 2.0 * radius;
        // Devices may take numbers below the normal ones for zero.
        let (is_flat, was_flat) = (grown < f32::MIN_POSITIVE, grown_then < f32::MIN_POSITIVE);
        is_infinite |= was_flat && !is_flat;
        if !was_flat {
            volume *= if is_flat { 0.0 } else { f64::from(grown) };
            volume_then *= f64::from(grown_then);
        }
    }
    if is_infinite { f64::INFINITY } else { volume / volume_then }
}

/// The boxes of a tree as they were at its build.
#[derive(Debug, Clone, Default)]
pub(super) struct VolumesAtBuild {
    /// `[n_nodes]`.
    sides: Vec<[f32; 3]>,
}

impl VolumesAtBuild {
    /// Takes the boxes of a tree that was just built.
    pub(super) fn keep(&mut self, boxes: &[NodeBox]) {
        boxes.par_iter().with_min_len(BOXES_A_TASK).map(sides).collect_into_vec(&mut self.sides);
    }

    /// The largest ratio of a box of the same tree; 1 for none.
    pub(super) fn largest_ratio(&self, boxes: &[NodeBox], radius: f32) -> f32 {
        let of_box = |(aabb, &then): (&NodeBox, &[f32; 3])| ratio(sides(aabb), then, radius);
        let pairs = boxes.par_iter().zip(&self.sides).with_min_len(BOXES_A_TASK);
        let largest = pairs.map(of_box).reduce(|| f64::NEG_INFINITY, f64::max);
        match boxes.is_empty() {
            true => 1.0,
            false if largest > INFINITE_BEYOND => f32::INFINITY,
            false => largest as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(now: [f32; 3], then: [f32; 3], radius: f32) -> f64 {
        ratio(now, then, radius)
    }

    #[test]
    fn ratios_are_those_of_grown_boxes() {
        assert_eq!(of([2.0, 2.0, 2.0], [1.0, 1.0, 1.0], 0.0), 8.0);
        assert_eq!(of([0.0; 3], [0.0; 3], 0.5), 1.0);
        assert_eq!(of([1.0, 0.0, 0.0], [0.0; 3], 0.5), 2.0);
        assert_eq!(of([0.0; 3], [1.0; 3], 0.5), 0.125);
        assert_eq!(of([-1.0; 3], [5.0; 3], 0.5), 1.0);
    }

    #[test]
    fn without_a_radius_flat_boxes_compare_by_area() {
        assert_eq!(of([4.0, 3.0, 0.0], [2.0, 1.0, 0.0], 0.0), 6.0);
        assert_eq!(of([0.0; 3], [0.0; 3], 0.0), 1.0);
        assert_eq!(of([4.0, 0.0, 1e-3], [2.0, 1.0, 0.0], 0.0), f64::INFINITY);
        assert_eq!(of([4.0, 0.0, 1.0], [2.0, 1.0, 1.0], 0.0), 0.0);
    }

    #[test]
    fn no_coordinates_overflow() {
        assert_eq!(of([2e18; 3], [1e18; 3], 0.0), 8.0);
        assert_eq!(of([2e18; 3], [1e18; 3], 1.8e19), f64::from(3.8e19f32).powi(3) / f64::from(3.7e19f32).powi(3));
        let small = NodeBox { min: [0.0; 3], max: [1e-18; 3] };
        let large = NodeBox { min: [-1e18; 3], max: [1e18; 3] };
        let mut at_build = VolumesAtBuild::default();
        at_build.keep(&[small, small]);
        assert_eq!(at_build.largest_ratio(&[small, large], 0.0), f32::INFINITY);
        assert_eq!(at_build.largest_ratio(&[small, small], 0.0), 1.0);
        assert_eq!(VolumesAtBuild::default().largest_ratio(&[], 1.0), 1.0);
    }
}
