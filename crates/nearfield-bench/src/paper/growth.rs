//! How much the boxes of a tree have grown since it was built.

use nearfield::structure::aabb_tree::NodeBox;

/// The largest volume of a box by its volume when the tree was built, both grown by `radius` on every side, so that flat boxes have
/// a volume; 1 without boxes.
pub fn largest_ratio(now: &[NodeBox], at_build: &[NodeBox], radius: f32) -> f64 {
    let ratios = now.iter().zip(at_build).map(|(now, before)| volume(now, radius) / volume(before, radius));
    ratios.fold(1.0, f64::max)
}

fn volume(aabb: &NodeBox, radius: f32) -> f64 {
    (0..3).map(|axis| f64::from(aabb.max[axis]) - f64::from(aabb.min[axis]) + 2.0 * f64::from(radius)).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_box_that_grows_to_a_cube_has_a_finite_ratio() {
        let flat = NodeBox { min: [0.0; 3], max: [1.0, 1.0, 0.0] };
        let cube = NodeBox { min: [0.0; 3], max: [1.0; 3] };
        assert_eq!(largest_ratio(&[cube], &[flat], 0.5), 8.0 / 4.0);
        assert_eq!(largest_ratio(&[flat, cube], &[cube, cube], 0.5), 1.0);
        assert_eq!(largest_ratio(&[], &[], 0.5), 1.0);
    }
}
