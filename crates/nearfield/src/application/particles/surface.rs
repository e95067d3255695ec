//! The surface of a fluid, from the centres of its particles: a field that is negative inside, for contouring.
//!
//! At a place x the field is |x − m| − radius, where m is the mean of the centres within the support, weighted by (1 − |x − c|² / support²)³:
//! spheres around single particles, and flat over a lattice of them, where balls alone would leave a bump for each. Beyond the support of
//! all it is support − radius. Cost: a search of the particles around each node.
//!
//! Source: Zhu2005 §4. Differs: the radius is the same for all particles.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::scene::positive;
use crate::application::Watch;
use crate::geometry::{Aabb, DistanceGrid, RegularGrid};
use crate::query::MapRows;
use crate::structure::{GridSettings, UniformGrid};
use crate::{Error, FixedRadius, Result, RowOrder};

/// Nodes between two looks at the watch.
const PART: usize = 1 << 20;

/// How a surface is laid around particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParticleSurface {
    /// Distance from the surface to the mean of the centres around it.
    pub radius: f64,
    /// Distance up to which centres count.
    pub support: f64,
    /// Distance of the nodes of the grid.
    pub cell: f64,
}

impl ParticleSurface {
    /// For particles of a fluid at rest this far apart: the surface of a lattice of them lies half a spacing beyond its outer centres, where its
    /// cells end.
    pub fn of_spacing(spacing: f64) -> Self {
        // Half a spacing above a plane of a lattice, with a support of two spacings, the mean lies 0.045 spacings below the plane: the
        // layer below it, 1.5 spacings away, has the weight (1 − 0.75²)⁴ beside (1 − 0.25²)⁴.
        Self { radius: 0.545 * spacing, support: 2.0 * spacing, cell: 0.5 * spacing }
    }

    fn validate(&self) -> Result<()> {
        positive("radius of the surface", self.radius)?;
        positive("support of the surface", self.support)?;
        positive("distance of nodes", self.cell)?;
        if self.support > self.radius {
            return Ok(());
        }
        let found = format!("{} with radius {}", self.support, self.radius);
        Err(Error::InvalidSetting { setting: "support of the surface", found, expected: "more than the radius" })
    }

    /// The field of particles, negative inside the fluid; its surface is closed around all of them.
    ///
    /// - `points`: `[n]` centres relative to `origin`
    ///
    /// ```
    /// use nearfield::application::particles::{Dimensions, ParticleSurface, fill_ball};
    /// use nearfield::application::{ContourSettings, Watch, contour};
    /// use nearfield::geometry::mesh_topology::MeshTopology;
    /// use nearfield::{DVec3, Vec3};
    ///
    /// let centers = fill_ball(DVec3::ZERO, 1.0, 0.2, Dimensions::Three);
    /// let points: Vec<Vec3> = centers.iter().map(|center| center.as_vec3()).collect();
    /// let field = ParticleSurface::of_spacing(0.2).field(DVec3::ZERO, &points, &mut Watch::none())?;
    /// let surface = contour(&(&field).into(), &ContourSettings::default(), &mut Watch::none())?;
    /// assert!(MeshTopology::of(&surface.mesh()).is_closed());
    /// # Ok::<(), nearfield::Error>(())
    /// ```
    ///
    /// # Errors
    /// `InvalidSetting` for lengths that are not positive, a support that is not above the radius, and no points; `NonFinite`,
    /// `CoordinateTooLarge` for points that cannot be searched; `TooMany` and `OutOfMemory` for grids with too many nodes; `Interrupted` by
    /// the watch.
    pub fn field(&self, origin: DVec3, points: &[Vec3], watch: &mut Watch<'_>) -> Result<DistanceGrid> {
        self.validate()?;
        let search = UniformGrid::build(points, &GridSettings::for_radius(self.support as f32))?;
        if points.is_empty() {
            let expected = "one or more";
            return Err(Error::InvalidSetting {
                setting: "particles of a surface",
                found: "none".to_owned(),
                expected,
            });
        }
        let around = self.radius + 2.0 * self.cell;
        let grid = RegularGrid::over(origin, &Aabb::of_points(points).swept(around as f32), self.cell as f32)?;
        let mut field = DistanceGrid::undefined(grid)?;
        let total = grid.n_nodes();
        let values = field.values_mut();
        for start in (0..total).step_by(PART) {
            watch.report("surface of particles", start as u64, total as u64)?;
            let nodes = start..(start + PART).min(total);
            values[nodes.clone()].copy_from_slice(&self.values(&search, points, &grid, nodes)?);
        }
        Ok(field)
    }

    /// The field at nodes with these numbers.
    fn values(
        &self,
        search: &UniformGrid,
        points: &[Vec3],
        grid: &RegularGrid,
        nodes: Range<usize>,
    ) -> Result<Vec<f32>> {
        let places: Vec<Vec3> = nodes.filter_map(|number| grid.node(number)).map(|node| grid.position(node)).collect();
        // In the order of indices: the same bits whatever the number of threads.
        let question = FixedRadius::new(self.support as f32).queries(&places).order(RowOrder::Index);
        search.map_rows(&question, |i, row| {
            let place = places[i as usize].as_dvec3();
            let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
            for &particle in row {
                let offset = points[particle as usize].as_dvec3() - place;
                let weight = (1.0 - offset.length_squared() / (self.support * self.support)).max(0.0).powi(3);
                sum += weight * offset;
                weights += weight;
            }
            let distance = if weights > 0.0 { (sum / weights).length() } else { self.support };
            (distance - self.radius) as f32
        })
    }
}
