//! The cut in the middle of the longest side. Source: Accel.

use crate::geometry::Aabb;

/// Axis and plane; `None` where the cell is too thin for a plane inside.
pub(super) fn middle_of_longest_side(cell: &Aabb) -> Option<(usize, f32)> {
    let axis = cell.extent().max_position();
    let split = cell.center()[axis];
    (cell.min[axis] < split && split < cell.max[axis]).then_some((axis, split))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn the_longest_side_is_halved() {
        let cell = Aabb::new(Vec3::ZERO, Vec3::new(1.0, 4.0, 2.0));
        assert_eq!(middle_of_longest_side(&cell), Some((1, 2.0)));
        assert_eq!(middle_of_longest_side(&Aabb::new(Vec3::ONE, Vec3::ONE.map(f32::next_up))), None);
    }
}
