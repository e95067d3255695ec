//! Lattices of particles: blocks and balls of them, and walls that hold a fluid.

use glam::DVec3;

use super::Dimensions;

/// Most particles of a scene that is made from a description: 2²⁸.
pub(super) const MOST_PARTICLES: f64 = (1u32 << 28) as f64;

/// About how many places [`fill_box`] gives.
#[cfg(feature = "io")]
pub(super) fn places_in(size: DVec3, spacing: f64, dimensions: Dimensions) -> f64 {
    let cells = (size / spacing).max(DVec3::ZERO);
    match dimensions {
        Dimensions::Two => cells.x * cells.y,
        Dimensions::Three => cells.element_product(),
    }
}

/// Places of a cubic lattice that fills a box: each stands for a cell of the spacing's width, and no cell leaves the box. x runs fastest, then
/// y. In the plane z = 0, whatever the box's z.
pub fn fill_box(low: DVec3, high: DVec3, spacing: f64, dimensions: Dimensions) -> Vec<DVec3> {
    // A box of a whole number of cells should not lose one by rounding.
    let cells = ((high - low) / spacing + 1e-6).floor();
    let along = |axis: usize| {
        let count = cells[axis].max(0.0) as u64;
        (0..count).map(move |i| low[axis] + (i as f64 + 0.5) * spacing)
    };
    match dimensions {
        Dimensions::Three => {
            along(2).flat_map(|z| along(1).flat_map(move |y| along(0).map(move |x| DVec3::new(x, y, z)))).collect()
        }
        Dimensions::Two => along(1).flat_map(|y| along(0).map(move |x| DVec3::new(x, y, 0.0))).collect(),
    }
}

/// Places of a cubic lattice within a ball, a disc in the plane z = 0: those whose centres are nearer than the radius. One lies in the middle.
pub fn fill_ball(center: DVec3, radius: f64, spacing: f64, dimensions: Dimensions) -> Vec<DVec3> {
    let cells = (radius / spacing).floor() + 0.5;
    let center = if dimensions == Dimensions::Two { center.with_z(0.0) } else { center };
    let corner = DVec3::splat(cells * spacing);
    let mut places = fill_box(center - corner, center + corner, spacing, dimensions);
    places.retain(|place| place.distance_squared(center) < radius * radius);
    places
}

/// One layer of particles around a box, half a spacing outside of it, so that a lattice that fills the box goes on in its walls. In the plane
/// z = 0 the four sides of the rectangle.
pub fn line_box(low: DVec3, high: DVec3, spacing: f64, dimensions: Dimensions) -> Vec<DVec3> {
    let cells = ((high - low) / spacing).round().max(DVec3::ONE);
    // The walls stand where the box ends, so the last cells may be a little narrower or wider than the others.
    let place = |axis: usize, i: i64| match i {
        -1 => low[axis] - 0.5 * spacing,
        i if i == cells[axis] as i64 => high[axis] + 0.5 * spacing,
        i => low[axis] + (i as f64 + 0.5) * (high[axis] - low[axis]) / cells[axis],
    };
    let steps = |axis: usize| -1..=cells[axis] as i64;
    let is_end = |axis: usize, i: i64| i == -1 || i == cells[axis] as i64;
    let mut places = Vec::new();
    if dimensions == Dimensions::Two {
        for y in steps(1) {
            let row = steps(0).filter(|&x| is_end(0, x) || is_end(1, y));
            places.extend(row.map(|x| DVec3::new(place(0, x), place(1, y), 0.0)));
        }
        return places;
    }
    for z in steps(2) {
        for y in steps(1) {
            let row = steps(0).filter(|&x| is_end(0, x) || is_end(1, y) || is_end(2, z));
            places.extend(row.map(|x| DVec3::new(place(0, x), place(1, y), place(2, z))));
        }
    }
    places
}
