//! Neighbours of particles on the CPU, by any search, as rows that a model folds into values.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::ParticleSearch;
use super::images::Images;
use super::reach::Reach;
use crate::geometry::Period;
use crate::query::MapRows;
use crate::structure::{
    AabbTreeSettings, BruteForce, GridSettings, MovingPoints, RebuildPolicy, TreeSearch, UniformGrid,
};
use crate::{FixedRadius, NeighborSearch, Neighbors, Result, RowOrder};

/// How far rounding a coordinate to `f32` can move a point, in parts of the coordinate, along all three axes together, for both ends of a
/// distance, and twice that.
const ROUNDING: f64 = 4.0 * 1.733 * f32::EPSILON as f64;

/// Particles as they are searched: structures over their places in single precision around the middle of the domain. Rows hold everything
/// within the reach in double precision, and a little more: models test pairs by their own positions.
pub(super) struct Neighborhood {
    search: ParticleSearch,
    deterministic: bool,
    /// The middle of the domain, which positions are taken relative to before they are rounded.
    middle: DVec3,
    images: Images,
    /// `[n_classes]` of particles that stand one after the other.
    classes: Vec<Range<usize>>,
    reach: Reach,
    positions: Vec<Vec3>,
    levels: Vec<Level>,
    rebuilds: u64,
}

/// Particles that are in one structure.
struct Level {
    members: Range<usize>,
    structure: Structure,
    /// `[n]` radius of the search of every particle, where they are not all one.
    radii: Vec<f32>,
    radius: f32,
}

/// What finds neighbours, as it is after the last step.
enum Structure {
    BruteForce(BruteForce),
    Grid(UniformGrid),
    Tree(Box<MovingPoints>),
    List { rows: Neighbors, built_at: Vec<Vec3>, skin: f32 },
}

/// Neighbours of a particle, itself among them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row<'a> {
    ids: &'a [u32],
    first: usize,
}

impl<'a> Row<'a> {
    /// Their indices.
    pub(super) fn iter(self) -> impl Iterator<Item = usize> + use<'a> {
        self.ids.iter().map(move |&id| self.first + id as usize)
    }
}

impl Neighborhood {
    /// Of particles that stand in blocks by class.
    ///
    pub(super) fn new(
        search: ParticleSearch,
        deterministic: bool,
        domain: [DVec3; 2],
        images: Images,
        classes: Vec<Range<usize>>,
        reach: Reach,
    ) -> Self {
        let middle = 0.5 * (domain[0] + domain[1]);
        let (positions, levels) = (Vec::new(), Vec::new());
        Self { search, deterministic, middle, images, classes, reach, positions, levels, rebuilds: 0 }
    }

    /// How often trees and lists were built anew since the start, without the first time. Grids are built in every step and not counted.
    pub(super) fn rebuilds(&self) -> u64 {
        self.rebuilds
    }

    /// Images of places in the domain.
    pub(super) fn images(&self) -> &Images {
        &self.images
    }

    /// Forgets all structures: the particles have another order.
    pub(super) fn forget(&mut self) {
        self.levels.clear();
    }

    /// Makes the structures follow the particles; nothing is done where none has moved.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge` for particles that cannot be searched; `InvalidRadius` for a reach, `InvalidSetting` for a period
    /// that cannot.
    pub(super) fn follow(&mut self, positions: &[DVec3]) -> Result<()> {
        let middle = self.middle;
        let is_same = |(p, old): (&DVec3, &Vec3)| (*p - middle).as_vec3() == *old;
        if !self.levels.is_empty() && positions.par_iter().zip(&self.positions).all(is_same) {
            return Ok(());
        }
        self.update(positions)
    }

    /// As [`Neighborhood::follow`], also where none has moved.
    fn update(&mut self, positions: &[DVec3]) -> Result<()> {
        let middle = self.middle;
        positions.par_iter().map(|p| (*p - middle).as_vec3()).collect_into_vec(&mut self.positions);
        if self.levels.is_empty() {
            self.levels = self.build_levels()?;
            return Ok(());
        }
        let period = self.period()?;
        for level in &mut self.levels {
            let positions = &self.positions[level.members.clone()];
            let rebuilt = match &mut level.structure {
                Structure::BruteForce(all) => {
                    *all = BruteForce::build_periodic(positions, period)?;
                    false
                }
                Structure::Grid(grid) => {
                    let cells = GridSettings::for_radius(self.search.cell_size(level.radius)).periodic(period);
                    *grid = UniformGrid::build(positions, &cells)?;
                    false
                }
                Structure::Tree(tree) => tree.update(positions)?.is_rebuild(),
                Structure::List { built_at, skin, .. } => {
                    let limit = 0.25 * *skin * *skin;
                    let moved = |(a, b): (&Vec3, &Vec3)| !(period.dist2(*a, *b) < limit);
                    let is_old = positions.par_iter().zip(&*built_at).any(moved);
                    if is_old {
                        level.structure = list(positions, level.radius, *skin, period)?;
                    }
                    is_old
                }
            };
            self.rebuilds += u64::from(rebuilt);
        }
        Ok(())
    }

    /// Makes the structures follow the particles and counts the neighbours of the first `n` of them, each itself among its own.
    ///
    /// # Errors
    /// As [`Neighborhood::follow`] and the search.
    pub(super) fn count(&mut self, positions: &[DVec3], n: usize) -> Result<u64> {
        self.update(positions)?;
        let (period, positions) = (self.period()?, self.positions.as_slice());
        let mut counts = vec![0; positions.len()];
        for level in &self.levels {
            let add = |i: usize, row: Row<'_>, count: u64| count + level.count(positions, &period, i, row);
            counts = level.fold(positions, self.deterministic, counts, &add)?;
        }
        Ok(counts[..n].iter().sum())
    }

    fn period(&self) -> Result<Period> {
        Period::new(self.images.lengths().as_vec3())
    }

    fn build_levels(&self) -> Result<Vec<Level>> {
        let n = self.positions.len();
        if self.search == ParticleSearch::MultiLevelGrid {
            let level =
                |class: usize| self.build_level(self.classes[class].clone(), |own| self.reach.between(own, class));
            return (0..self.classes.len()).map(level).collect();
        }
        Ok(vec![self.build_level(0..n, |own| self.reach.farthest(own))?])
    }

    /// - `reach`: of a class into the particles of the level
    fn build_level(&self, members: Range<usize>, reach: impl Fn(usize) -> f64) -> Result<Level> {
        let positions = &self.positions[members.clone()];
        let period = self.period()?;
        // The period is rounded too.
        let longest = period.lengths().max_element();
        let farthest = self.positions.iter().map(|p| p.abs().max_element()).fold(0.0, f32::max) + longest;
        let searched =
            |reach: f64| (reach + ROUNDING * f64::from(farthest)).next_up() as f32 * (1.0 + 4.0 * f32::EPSILON);
        let by_class: Vec<f32> = (0..self.classes.len()).map(|class| searched(reach(class))).collect();
        let radius = by_class.iter().copied().fold(0.0, f32::max);
        let mut radii = Vec::new();
        if by_class.iter().any(|&own| own != radius) {
            radii = vec![radius; self.positions.len()];
            for (own, &by_class) in self.classes.iter().zip(&by_class) {
                radii[own.clone()].fill(by_class);
            }
        }
        let tree = |policy: RebuildPolicy, search: TreeSearch| -> Result<Structure> {
            let settings = AabbTreeSettings::DEFAULT.search(search).periodic(period);
            Ok(Structure::Tree(Box::new(MovingPoints::new(positions, radius, &settings, policy)?)))
        };
        let structure = match self.search {
            ParticleSearch::BruteForce => Structure::BruteForce(BruteForce::build_periodic(positions, period)?),
            ParticleSearch::UniformGrid { .. } | ParticleSearch::MultiLevelGrid => {
                let cells = GridSettings::for_radius(self.search.cell_size(radius)).periodic(period);
                Structure::Grid(UniformGrid::build(positions, &cells)?)
            }
            ParticleSearch::AabbTree(policy) => tree(policy, TreeSearch::Packed)?,
            ParticleSearch::Primary(policy) => tree(policy, TreeSearch::Primary)?,
            ParticleSearch::Coherent(policy) => tree(policy, TreeSearch::Coherent)?,
            ParticleSearch::Verlet { skin } => list(positions, radius, skin as f32 * radius, period)?,
        };
        Ok(Level { members, structure, radii, radius })
    }

    /// Folds the rows of every particle into a value, particles in parallel: `[n]` by particle. A particle has a row for each structure;
    /// with `deterministic` all of them together are in the order of indices.
    ///
    /// # Errors
    /// As the search.
    pub(super) fn fold<T: Clone + Default + Send + Sync>(
        &self,
        fold: impl Fn(usize, Row<'_>, T) -> T + Sync,
    ) -> Result<Vec<T>> {
        let mut values = vec![T::default(); self.positions.len()];
        for level in &self.levels {
            values = level.fold(&self.positions, self.deterministic, values, &fold)?;
        }
        Ok(values)
    }
}

impl Level {
    /// Those of a row within the radius of the search: rows of lists hold what is within the skin too.
    fn count(&self, positions: &[Vec3], period: &Period, i: usize, row: Row<'_>) -> u64 {
        if !matches!(self.structure, Structure::List { .. }) {
            return row.ids.len() as u64;
        }
        let radius = self.radii.get(i).copied().unwrap_or(self.radius);
        let is_near = |j: &usize| period.dist2(positions[i], positions[*j]) <= radius * radius;
        row.iter().filter(is_near).count() as u64
    }

    fn fold<T: Clone + Default + Send + Sync>(
        &self,
        positions: &[Vec3],
        deterministic: bool,
        values: Vec<T>,
        fold: &(impl Fn(usize, Row<'_>, T) -> T + Sync),
    ) -> Result<Vec<T>> {
        let first = self.members.start;
        let map = |i: u32, ids: &[u32]| fold(i as usize, Row { ids, first }, values[i as usize].clone());
        let mut question = match self.radii.as_slice() {
            [] => FixedRadius::new(self.radius),
            radii => FixedRadius::each(radii),
        };
        if self.members.len() < positions.len() {
            question = question.queries(positions);
        }
        if deterministic {
            question = question.order(RowOrder::Index);
        }
        match &self.structure {
            Structure::BruteForce(all) => all.map_rows(&question, map),
            Structure::Grid(grid) => grid.map_rows(&question, map),
            Structure::Tree(tree) => tree.tree().map_rows(&question, map),
            Structure::List { rows, .. } => {
                let row = |i: usize| map(i as u32, rows.row(i));
                Ok((0..positions.len()).into_par_iter().with_min_len(256).map(row).collect())
            }
        }
    }
}

/// A list of all within the radius and the skin, in the order of indices.
fn list(positions: &[Vec3], radius: f32, skin: f32, period: Period) -> Result<Structure> {
    let grid = UniformGrid::build(positions, &GridSettings::for_radius(radius + skin).periodic(period))?;
    let rows = grid.list(&FixedRadius::new(radius + skin).order(RowOrder::Index))?;
    Ok(Structure::List { rows, built_at: positions.to_vec(), skin })
}
