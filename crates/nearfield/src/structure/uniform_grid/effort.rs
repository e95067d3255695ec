//! How much a traversal of the grid on a device can have to do: bounds for devices that end long loops.

use super::GridLayout;
use crate::geometry::Aabb;
use crate::geometry::distance::{LENGTH_SLACK, PERIOD_SLACK, RADIUS_SLACK, WRAP_SLACK};
use crate::structure::Effort;

/// Invocations that may run in step on a device that does not say how many do.
pub(super) const MOST_IN_STEP: u32 = 64;

/// The balls that are asked about.
#[derive(Debug, Clone, Copy)]
pub(super) struct Balls<'a> {
    /// The largest radius.
    pub(super) radius: f32,
    /// What holds the centres, where they are not the points.
    pub(super) queries: Option<&'a Aabb>,
}

impl Balls<'_> {
    /// Largest distance of a centre from the grid's origin along an axis that is periodic.
    fn farthest(&self, layout: &GridLayout, axis: usize) -> f64 {
        let from_origin = |at: f32| (f64::from(at) - f64::from(layout.origin[axis])).abs();
        match self.queries {
            Some(bounds) if !bounds.is_empty() => from_origin(bounds.min[axis]).max(from_origin(bounds.max[axis])),
            Some(_) => 0.0,
            None => f64::from(layout.farthest),
        }
    }
}

/// The bounds of [`most`] for a grid that is a part of another structure.
pub(in crate::structure) fn most_effort(
    layout: &GridLayout,
    starts: &[u32],
    radius: f32,
    queries: Option<&Aabb>,
    in_step: u32,
) -> Effort {
    most(layout, starts, &Balls { radius, queries }, in_step)
}

/// Upper bounds for queries with these balls, `in_step` of which are answered together: a loop of theirs goes on until
/// the last of them is done.
///
/// - `starts`: `[table_size + 1]` place of the first point of each table entry
pub(super) fn most(layout: &GridLayout, starts: &[u32], balls: &Balls<'_>, in_step: u32) -> Effort {
    let [x, y, z] = [0, 1, 2].map(|axis| most_cells(layout, axis, balls));
    let (n, hashed) = (u64::from(layout.n_points), layout.hashed == 1);
    let rows = y.saturating_mul(z);
    let mut candidates = rows.saturating_mul(most_in_row(starts, x, hashed));
    if !hashed {
        // Only in a hashed table may two rows share entries.
        candidates = candidates.min(n * u64::from(in_step));
    }
    // `visit_rows` gives up on more rows than points, and on more cells than a hashed table has: some queries may, and
    // others not.
    let many_cells = hashed && rows as f32 * x as f32 > layout.table_size as f32;
    if rows > n.max(64) || many_cells {
        candidates = candidates.saturating_add(n);
    }
    // Hashed rows may wrap at the end of the table, periodic ones at the end of the axis. A loop over a run takes up to
    // two rounds more than full ones: the last points, and the look that ends it. So do the loops over rows.
    let runs_a_row = (1 + u64::from(hashed)) * (1 + u64::from(layout.periodic));
    let rounds = rows.saturating_mul(2 + 2 * runs_a_row).saturating_add(2 * z + 4);
    Effort { candidates, rounds }
}

/// Largest number of cells on an axis that a ball can touch. Twin of `cells_near` in layout.wesl, for any centre.
fn most_cells(layout: &GridLayout, axis: usize, balls: &Balls<'_>) -> u64 {
    let cells = f64::from(layout.cells[axis]);
    let (inverse_cell, period) = (f64::from(layout.inverse_cell[axis]), f64::from(layout.period[axis]));
    let reach = f64::from(balls.radius) * f64::from(RADIUS_SLACK).powi(2) + 2.0 * f64::from(LENGTH_SLACK);
    let far = balls.farthest(layout, axis) + f64::from(layout.farthest);
    let wrap = period * f64::from(PERIOD_SLACK) + far * f64::from(WRAP_SLACK) * f64::from(RADIUS_SLACK).powi(2);
    let wrap = if period > 0.0 { wrap } else { 0.0 };
    // Rounding of coordinates this large in f32: those farther out are clamped to a border.
    let extent = if inverse_cell > 0.0 { cells / inverse_cell } else { 0.0 };
    let rounding = (f64::from(layout.origin[axis]).abs() + extent + reach) * f64::from(f32::EPSILON);
    let width = 2.0 * (reach + wrap + rounding) * inverse_cell;
    // An interval `width` cells long touches this many.
    (width.ceil() + 1.0).min(cells) as u64
}

/// Largest number of points in so many neighbouring cells of a row.
fn most_in_row(starts: &[u32], cells: u64, hashed: bool) -> u64 {
    let entries = starts.len() - 1;
    let n = starts[entries];
    if cells >= entries as u64 {
        return u64::from(n);
    }
    let cells = cells as usize;
    let inside = starts.windows(cells + 1).map(|w| w[cells] - w[0]).max().unwrap_or(n);
    let wrapped = (entries - cells + 1..entries).map(|first| n - starts[first] + starts[first + cells - entries]);
    u64::from(if hashed { wrapped.fold(inside, u32::max) } else { inside })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::Period;
    use crate::structure::GridSettings;

    fn layout(n: u32, edge: f32, cell: f32) -> GridLayout {
        let settings = GridSettings { refine_x: 1, ..GridSettings::for_radius(cell) };
        GridLayout::new(n, &Aabb::new(Vec3::ZERO, Vec3::splat(edge)), &settings)
    }

    #[test]
    fn a_ball_touches_at_most_that_many_cells() {
        let layout = layout(100_000, 16.0, 0.5);
        for radius in [0.0, 0.1, 0.25, 0.5, 0.75, 3.0, 100.0] {
            let most = most_cells(&layout, 1, &Balls { radius, queries: None });
            let touched = (0..=1600).map(|i| {
                let at = i as f32 * 0.01;
                u64::from(layout.cells_near(1, at, at, radius).count)
            });
            let widest = touched.max().unwrap_or(0);
            assert!((widest..=widest + 1).contains(&most), "radius {radius}: {most}, found {widest}");
        }
    }

    #[test]
    fn a_ball_many_periods_away_touches_at_most_that_many_cells() {
        let settings = GridSettings { refine_x: 1, ..GridSettings::for_radius(0.25) };
        let settings = settings.periodic(Period::new(Vec3::splat(16.0)).unwrap());
        let layout = GridLayout::new(100_000, &Aabb::new(Vec3::ZERO, Vec3::splat(16.0)), &settings);
        for far in [16.0f32, 1e5, 1e6, 1e7, 1e12] {
            let queries = Aabb::new(Vec3::splat(-far), Vec3::splat(far));
            let most = most_cells(&layout, 1, &Balls { radius: 0.5, queries: Some(&queries) });
            let touched = (0..=1600).map(|i| {
                let at = far - i as f32 * 0.01;
                u64::from(layout.cells_near(1, at, at, 0.5).count)
            });
            let widest = touched.max().unwrap_or(0);
            assert!((widest..=widest + 2).contains(&most), "{far} away: {most}, found {widest}");
        }
    }

    #[test]
    fn the_fullest_cells_of_a_row_are_counted() {
        // Cells of 6, 0, 1, 1 and 8 points.
        let starts = [0, 6, 6, 7, 8, 16];
        assert_eq!(most_in_row(&starts, 1, false), 8);
        assert_eq!(most_in_row(&starts, 2, false), 9);
        assert_eq!(most_in_row(&starts, 2, true), 14, "the last and the first");
        assert_eq!(most_in_row(&starts, 3, true), 15, "the last two and the first");
        assert_eq!(most_in_row(&starts, 9, true), 16);
    }

    #[test]
    fn equal_points_are_each_tested_once_by_each_query() {
        let layout = GridLayout::new(70_000, &Aabb::new(Vec3::ONE, Vec3::ONE), &GridSettings::for_radius(0.5));
        let starts: Vec<u32> = vec![0, 70_000];
        assert_eq!((layout.hashed, layout.table_size), (0, 1));
        assert_eq!(
            most(&layout, &starts, &Balls { radius: 0.5, queries: None }, 8),
            Effort { candidates: 70_000, rounds: 10 }
        );
    }
}
