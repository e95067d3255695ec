//! Offset surfaces: all places at a distance from a surface, outside it, inside it, or on both sides.
//!
//! The offset surface of a distance field is where its values are the distance, so it is contoured as the surface itself is.
//! Outwards the body grows: the grid needs room for it, and the field must reach so far. Inwards parts thinner than twice the
//! distance vanish, and nothing may be left. Where distances come from two sides, the field has a crease, and so has the
//! offset surface. Cost: that of contouring.
//!
//! Source: Xing2017, §5.2.3. Differs: the grid is the bounding box, the distance and three widths on each side; open surfaces
//! have offsets on both sides at once.

use glam::DVec3;

use super::dual_contouring::{Contour, ContourSettings, NodeValues, contour};
use crate::application::Watch;
use crate::geometry::{Aabb, DistanceGrid, RegularGrid};
use crate::{Error, Result};

/// Widths of cells around the grown body.
const MARGIN: f64 = 3.0;

/// At which distance, and on which side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Offset {
    /// At this signed distance: above 0 the body grows, below 0 it shrinks.
    Signed(f64),
    /// At this distance from both sides of the surface, which may be open: a body around it.
    TwoSided(f64),
}

impl Offset {
    /// How far the body grows beyond its box.
    fn growth(self) -> f64 {
        match self {
            Self::Signed(distance) => distance.max(0.0),
            Self::TwoSided(distance) => distance,
        }
    }

    fn check(self) -> Result<()> {
        let (distance, is_usable, expected) = match self {
            Self::Signed(distance) => (distance, distance != 0.0, "a finite length that is not 0"),
            Self::TwoSided(distance) => (distance, distance > 0.0, "a finite length above 0"),
        };
        if is_usable && distance.is_finite() {
            return Ok(());
        }
        Err(Error::InvalidSetting { setting: "offset distance", found: distance.to_string(), expected })
    }

    /// The values of a field seen from the offset surface.
    ///
    /// # Errors
    /// `InvalidSetting` for a distance that is not usable.
    pub fn values(self, field: &DistanceGrid) -> Result<NodeValues<'_, f32>> {
        self.check()?;
        let values = NodeValues::from(field);
        Ok(match self {
            Self::Signed(distance) => values.at_level(distance as f32),
            Self::TwoSided(distance) => values.two_sided(distance as f32),
        })
    }

    /// The grid for the field of a body with this box: the box, the distance where the body grows, and three widths on each
    /// side, with `resolution` nodes along the longest side.
    ///
    /// # Errors
    /// `InvalidSetting` for a distance that is not usable, a box without extent, or a resolution below 9; as [`RegularGrid::over`].
    pub fn grid(self, origin: DVec3, bounds: &Aabb, resolution: u32) -> Result<RegularGrid> {
        self.check()?;
        let cells = f64::from(resolution) - 1.0 - 2.0 * MARGIN;
        if cells < 2.0 {
            let (setting, found) = ("resolution", resolution.to_string());
            return Err(Error::InvalidSetting { setting, found, expected: "at least 9 nodes along the longest side" });
        }
        let longest = f64::from(bounds.extent().max_element()) + 2.0 * self.growth();
        let spacing = (longest / cells) as f32;
        let around = (self.growth() + MARGIN * longest / cells) as f32;
        // A little less than the margin, so that rounding adds no layer of nodes.
        RegularGrid::over(origin, &bounds.swept(around * (1.0 - 1e-5)), spacing)
    }

    /// Checks that a field reaches as far as the offset surface.
    ///
    /// # Errors
    /// `InvalidSetting` where it does not, with how far it does, and where nothing of the body is left.
    pub fn check_reach(self, field: &DistanceGrid) -> Result<()> {
        let setting = "offset distance";
        let Some([low, high]) = range(field) else {
            let found = "any in a field without a defined value".to_owned();
            return Err(Error::InvalidSetting { setting, found, expected: "a field with distances around a surface" });
        };
        let (distance, reach) = match self {
            Offset::Signed(distance) if distance < 0.0 => (-distance, -low),
            Offset::Signed(distance) => (distance, high),
            Offset::TwoSided(distance) => (distance, high.max(-low)),
        };
        if distance < reach {
            return Ok(());
        }
        let is_whole = field.n_defined() == field.values().len();
        if matches!(self, Offset::Signed(distance) if distance < 0.0) && is_whole {
            return Err(nothing_left(field, self));
        }
        let found = format!("{distance} in a field that reaches to {reach} on that side");
        let expected =
            "a distance within the field; compute it with a wider band on a grid that has room for the grown body";
        Err(Error::InvalidSetting { setting, found, expected })
    }

    /// The distance that the field must have around the surface: its band.
    pub fn band(self, grid: &RegularGrid) -> f64 {
        let (Self::Signed(distance) | Self::TwoSided(distance)) = self;
        distance.abs() + 2.0 * f64::from(grid.spacing())
    }
}

/// The offset surface of a distance field.
///
/// It is closed where the field reaches beyond it everywhere; [`crate::geometry::mesh_topology::MeshTopology`] tells.
///
/// # Errors
/// `InvalidSetting` for a distance of 0 or one that is not a number; where the field does not reach so far; and where nothing
/// of the body is left, with the depth of the body; as [`contour`].
pub fn offset(
    field: &DistanceGrid,
    offset: Offset,
    settings: &ContourSettings,
    watch: &mut Watch<'_>,
) -> Result<Contour<f32>> {
    let values = offset.values(field)?;
    offset.check_reach(field)?;
    let surface = contour(&values, settings, watch)?;
    if surface.n_quads() == 0 {
        return Err(nothing_left(field, offset));
    }
    Ok(surface)
}

/// The smallest and the largest value.
fn range(field: &DistanceGrid) -> Option<[f64; 2]> {
    let defined = field.values().iter().filter(|value| value.is_finite());
    let range = defined.fold(None, |range: Option<[f32; 2]>, &value| {
        Some(range.map_or([value; 2], |[low, high]| [low.min(value), high.max(value)]))
    });
    range.map(|range| range.map(f64::from))
}

fn nothing_left(field: &DistanceGrid, offset: Offset) -> Error {
    let (Offset::Signed(distance) | Offset::TwoSided(distance)) = offset;
    let depth = range(field).map_or(0.0, |[low, _]| (-low).max(0.0));
    Error::InvalidSetting {
        setting: "offset distance",
        found: format!("{distance}, which leaves nothing of a body that is {depth} deep"),
        expected: "a distance inwards that is less than the depth of the body",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::mesh_topology::MeshTopology;
    use glam::Vec3;

    fn sampled(grid: &RegularGrid, of: impl Fn(Vec3) -> f32) -> DistanceGrid {
        let values = (0..grid.n_nodes()).map(|i| of(grid.position(grid.node(i).unwrap())));
        DistanceGrid::new(*grid, values.collect()).unwrap()
    }

    fn run(field: &DistanceGrid, by: Offset) -> Result<Contour<f32>> {
        offset(field, by, &ContourSettings::default(), &mut Watch::none())
    }

    #[test]
    fn a_ball_grows_and_shrinks_to_balls() {
        // 0.2 L of the ball's box: radii 1.693 and 0.307.
        let bounds = Aabb::new(Vec3::NEG_ONE, Vec3::ONE);
        let distance = 0.2 * f64::from(bounds.diagonal());
        for (distance, radius) in [(distance, 1.0 + distance), (-distance, 1.0 - distance)] {
            let by = Offset::Signed(distance);
            let grid = by.grid(DVec3::ZERO, &bounds, 65).unwrap();
            let surface = run(&sampled(&grid, |p| p.length() - 1.0), by).unwrap();
            let topology = MeshTopology::of(&surface.mesh());
            assert!(topology.is_closed() && topology.is_manifold() && topology.euler_number() == 2);
            let off = |v: &[f32; 3]| (f64::from(Vec3::from(*v).length()) - radius).abs();
            let worst = surface.vertices().iter().map(off).fold(0.0, f64::max);
            assert!(worst < 0.1 * f64::from(grid.spacing()), "{distance}: {worst} of {}", grid.spacing());
        }
    }

    #[test]
    fn the_grid_has_room_for_the_grown_body() {
        let bounds = Aabb::new(Vec3::new(-1.0, 0.0, 3.0), Vec3::new(2.0, 1.0, 3.5));
        for by in [Offset::Signed(0.7), Offset::Signed(-0.2), Offset::TwoSided(0.3)] {
            let grid = by.grid(DVec3::ZERO, &bounds, 129).unwrap();
            let held = grid.bounds();
            let needed = bounds.swept(by.growth() as f32 + 2.99 * grid.spacing());
            assert!(held.contains(needed.min) && held.contains(needed.max), "{by:?}");
            assert_eq!(grid.nodes()[0], 129, "{by:?}");
        }
        assert!(Offset::Signed(1.0).grid(DVec3::ZERO, &bounds, 8).is_err());
    }

    #[test]
    fn a_torus_shrinks_to_nothing_with_a_clear_message() {
        let bounds = Aabb::new(Vec3::new(-1.4, -1.4, -0.4), Vec3::new(1.4, 1.4, 0.4));
        let by = Offset::Signed(-0.2 * f64::from(bounds.diagonal()));
        let grid = by.grid(DVec3::ZERO, &bounds, 65).unwrap();
        let field = sampled(&grid, |p| (p.x.hypot(p.y) - 1.0).hypot(p.z) - 0.4);
        let error = run(&field, by).unwrap_err().to_string();
        assert!(error.contains("leaves nothing of a body that is 0.3"), "{error}");
        // A little less than its depth leaves a thin ring.
        let topology = MeshTopology::of(&run(&field, Offset::Signed(-0.25)).unwrap().mesh());
        assert!(topology.is_closed() && topology.euler_number() == 0);
    }

    #[test]
    fn an_open_surface_gets_a_body_around_it() {
        // A half sphere, open below, with distances that have no sign.
        let shell = |p: Vec3| {
            if p.z >= 0.0 { (p.length() - 1.0).abs() } else { (p.x.hypot(p.y) - 1.0).hypot(p.z) }
        };
        let bounds = Aabb::new(Vec3::new(-1.0, -1.0, 0.0), Vec3::ONE);
        let by = Offset::TwoSided(0.2);
        let grid = by.grid(DVec3::ZERO, &bounds, 65).unwrap();
        let surface = run(&sampled(&grid, shell), by).unwrap();
        let topology = MeshTopology::of(&surface.mesh());
        assert!(topology.is_closed() && topology.is_manifold() && topology.euler_number() == 2);
        let off = |v: &[f32; 3]| (shell(Vec3::from(*v)) - 0.2).abs();
        let worst = surface.vertices().iter().map(off).fold(0.0, f32::max);
        assert!(worst < grid.spacing(), "{worst}");
    }

    #[test]
    fn fields_that_do_not_reach_say_how_far_they_do() {
        let grid = RegularGrid::new(DVec3::ZERO, Vec3::splat(-2.0), 0.125, [33; 3]).unwrap();
        let band = sampled(&grid, |p| if (p.length() - 1.0).abs() < 0.3 { p.length() - 1.0 } else { f32::NAN });
        for distance in [0.5, -0.5] {
            let error = run(&band, Offset::Signed(distance)).unwrap_err().to_string();
            assert!(error.contains("reaches to 0.") && error.contains("wider band"), "{error}");
        }
        for (by, told) in
            [(Offset::Signed(0.0), "not 0"), (Offset::Signed(f64::NAN), "finite"), (Offset::TwoSided(-1.0), "above 0")]
        {
            assert!(run(&band, by).unwrap_err().to_string().contains(told));
        }
        let nothing = DistanceGrid::undefined(grid).unwrap();
        assert!(run(&nothing, Offset::Signed(0.1)).unwrap_err().to_string().contains("without a defined value"));
    }
}
