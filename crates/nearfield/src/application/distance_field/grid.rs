//! The grid that a field is computed on where the caller has none.

use glam::{DVec3, Vec3};

use crate::geometry::{Aabb, RegularGrid};
use crate::{Error, Result};

/// The grid around a box and a band of so many widths on each side of it, with `resolution` nodes along its longest side.
///
/// # Errors
/// `InvalidSetting` where the resolution has no room for the band, the box is empty or a single place, or as
/// [`RegularGrid::new`]; `TooMany`.
pub fn grid_around(origin: DVec3, bounds: &Aabb, resolution: u32, band: f64) -> Result<RegularGrid> {
    let band = if band.is_finite() { band.max(0.0) } else { 4.0 };
    let cells = f64::from(resolution) - 1.0 - 2.0 * band;
    if cells < 1.0 {
        return Err(Error::InvalidSetting {
            setting: "resolution",
            found: format!("{resolution} with a band of {band} widths on each side"),
            expected: "at least twice the band and two nodes more",
        });
    }
    let extent = bounds.max.as_dvec3() - bounds.min.as_dvec3();
    let longest = extent.max_element();
    if bounds.is_empty() || !(longest > 0.0 && longest.is_finite()) {
        return Err(Error::InvalidSetting {
            setting: "bounds of a grid",
            found: format!("{} to {}", bounds.min, bounds.max),
            expected: "points at more than one place",
        });
    }
    // Never narrower than asked for, so that rounding adds no node.
    let spacing = (longest / cells) as f32;
    let spacing = if f64::from(spacing) < longest / cells { spacing.next_up() } else { spacing };
    let width = f64::from(spacing);
    let nodes = [0, 1, 2].map(|axis| {
        let cells = extent[axis] / width + 2.0 * band;
        (((cells - 1e-5).ceil()).max(1.0) as u32).saturating_add(1)
    });
    let middle = 0.5 * (bounds.min.as_dvec3() + bounds.max.as_dvec3());
    let half = DVec3::from_array(nodes.map(|n| 0.5 * width * f64::from(n - 1)));
    let corner: Vec3 = (middle - half).as_vec3();
    RegularGrid::new(origin, corner, spacing, nodes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_side_has_the_resolution_and_the_band_fits() {
        for (extent, resolution, band) in [(1.0f32, 257, 4.0), (0.3, 129, 4.0), (1234.5, 33, 2.5), (7.7, 65, 0.0)] {
            let bounds = Aabb::new(Vec3::splat(0.25), Vec3::new(0.25 + extent, 0.25 + 0.4 * extent, 0.25));
            let grid = grid_around(DVec3::ZERO, &bounds, resolution, band).unwrap();
            assert_eq!(grid.nodes()[0], resolution);
            let reach = (band as f32 - 1e-3) * grid.spacing();
            let held = grid.bounds();
            assert!(held.contains(bounds.min - reach) && held.contains(bounds.max + reach), "{grid:?}");
        }
    }

    #[test]
    fn grids_without_room_are_refused() {
        let unit = Aabb::new(Vec3::ZERO, Vec3::ONE);
        let error = grid_around(DVec3::ZERO, &unit, 9, 4.0).unwrap_err().to_string();
        assert!(error.contains("9 with a band of 4 widths"), "{error}");
        assert!(grid_around(DVec3::ZERO, &Aabb::EMPTY, 33, 4.0).is_err());
        assert!(grid_around(DVec3::ZERO, &Aabb::new(Vec3::ONE, Vec3::ONE), 33, 4.0).is_err());
    }
}
