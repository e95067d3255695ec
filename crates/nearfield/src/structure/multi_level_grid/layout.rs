//! The tables of all levels, in the bytes of the kernels' uniform.

use bytemuck::{Pod, Zeroable};

use crate::geometry::Aabb;
use crate::structure::GridSettings;
use crate::structure::uniform_grid::GridLayout;
use crate::{Error, Result};

/// Largest number of levels.
pub(super) const MOST_LEVELS: usize = 8;

/// How far a question with a radius reaches into a level with another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LevelRule {
    /// The sum of both radii.
    Sum,
    /// The larger one.
    Larger,
    /// That of the question.
    Own,
}

/// A level, in the bytes of the kernels' uniform.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GridLevel {
    /// Its cells, always hashed.
    pub grid: GridLayout,
    /// Place of its table in the table of all.
    pub first_entry: u32,
    /// Place of its first point.
    pub first_point: u32,
    /// Radius of its points.
    pub radius: f32,
    /// Unused.
    pub padding: u32,
}

/// All levels, in the bytes of the kernels' uniform.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct MultiLevelLayout {
    /// Number of points.
    pub n_points: u32,
    /// Number of levels.
    pub n_levels: u32,
    /// Number of the rule.
    pub rule: u32,
    /// Unused.
    pub padding: u32,
    /// The levels; those behind `n_levels` are empty.
    pub levels: [GridLevel; MOST_LEVELS],
}

impl LevelRule {
    /// All of them; their places are their numbers.
    pub const ALL: [Self; 3] = [Self::Sum, Self::Larger, Self::Own];

    /// The reach of a question with radius `own` into a level of radius `other`.
    pub fn reach(self, own: f32, other: f32) -> f32 {
        match self {
            Self::Sum => own + other,
            Self::Larger => own.max(other),
            Self::Own => own,
        }
    }

    fn number(self) -> u32 {
        match self {
            Self::Sum => 0,
            Self::Larger => 1,
            Self::Own => 2,
        }
    }
}

impl MultiLevelLayout {
    /// - `levels`: number of points and radius of each, in the order of their blocks
    ///
    /// # Errors
    /// `InvalidSetting` for more than 8 levels or none, and radii that are not positive; `TooMany` points.
    pub fn new(levels: &[(usize, f32)], rule: LevelRule, bounds: &Aabb) -> Result<Self> {
        if levels.is_empty() || levels.len() > MOST_LEVELS {
            let found = levels.len().to_string();
            return Err(Error::InvalidSetting { setting: "levels of a grid", found, expected: "1 to 8" });
        }
        if let Some((_, radius)) = levels.iter().find(|(_, radius)| !(*radius > 0.0 && radius.is_finite())) {
            let (setting, found) = ("radius of a level", radius.to_string());
            return Err(Error::InvalidSetting { setting, found, expected: "a finite number above 0" });
        }
        let n: usize = levels.iter().map(|(n, _)| n).sum();
        if n >= 1 << 30 {
            let (what, found, limit) = ("points of a grid of several levels", n as u64, (1 << 30) - 1);
            return Err(Error::TooMany { what, found, limit, advice: "search them in parts" });
        }
        let number = rule.number();
        let mut layout = Self { n_points: n as u32, n_levels: levels.len() as u32, rule: number, ..Zeroable::zeroed() };
        let (mut first_entry, mut first_point) = (0, 0);
        for (level, &(n, radius)) in layout.levels.iter_mut().zip(levels) {
            // As large as the reach among points of the level.
            let settings = GridSettings::for_radius(rule.reach(radius, radius));
            let grid = GridLayout::new(n as u32, bounds, &settings).hashed();
            *level = GridLevel { grid, first_entry, first_point, radius, padding: 0 };
            first_entry += grid.table_size;
            first_point += n as u32;
        }
        Ok(layout)
    }

    /// The levels that there are.
    pub fn levels(&self) -> &[GridLevel] {
        &self.levels[..self.n_levels as usize]
    }

    /// Entries of all tables together.
    pub fn table_size(&self) -> u32 {
        self.levels().iter().map(|level| level.grid.table_size).sum()
    }

    /// How far a question with radius `own` reaches into a level.
    pub fn reach(&self, own: f32, level: &GridLevel) -> f32 {
        LevelRule::ALL[self.rule as usize].reach(own, level.radius)
    }
}
