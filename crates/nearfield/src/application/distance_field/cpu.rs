//! Distance fields of samples on the CPU.

use super::bricks::{Brick, Bricks, NodeValue, UNDEFINED};
use super::samples::OrientedSamples;
use super::value::{self, Near};
use super::{DistanceField, DistanceMode, DistanceSettings, SignRule};
use crate::application::winding_number::disk_areas;
use crate::application::{Watch, WindingNumber};
use crate::geometry::vector::{Vector, subtract};
use crate::geometry::{RegularGrid, Scalar};
use crate::{Error, Result};

/// The nearest so far: squared distance, index and place in the tree's order.
#[derive(Debug, Clone, Copy)]
struct Best<T> {
    dist2: T,
    index: u32,
    place: usize,
}

impl<T: Scalar> OrientedSamples<T> {
    /// The field over a grid whose origin is that of the samples.
    ///
    /// # Errors
    /// As [`DistanceSettings::validate`]; `InvalidSetting` where no node lies within the band, or for pseudonormals, which
    /// samples have not; `Interrupted`.
    pub fn distance_field(
        &self,
        grid: &RegularGrid,
        settings: &DistanceSettings,
        watch: &mut Watch<'_>,
    ) -> Result<DistanceField> {
        settings.validate(grid)?;
        let winding = self.winding(settings)?;
        let radius = T::of(settings.radius(grid).min(T::MAX_COORDINATE.to_f64()));
        let bricks = Bricks::new(grid);
        let field = bricks
            .compute("distances", watch, |brick| self.fill(&bricks, brick, radius, settings, winding.as_ref()))?;
        check_band(&field, settings, grid, "samples", self.len())?;
        Ok(field)
    }

    /// The distance at one place, as [`OrientedSamples::distance_field`] gives it, with the index of the nearest sample;
    /// `None` with no sample within `radius`. The sign is that of the formula.
    pub fn distance(&self, query: &Vector<T>, radius: T, mode: DistanceMode, smoothing: T) -> Option<(T, u32)> {
        let best = self.nearest(query, Best { dist2: radius * radius, index: DistanceField::NONE, place: 0 });
        (best.index != DistanceField::NONE).then(|| {
            let near = self.near(query, &best);
            (value::distance(self, query, &near, mode, smoothing), best.index)
        })
    }

    /// The winding number of the samples, where the sign is by it.
    pub(super) fn winding(&self, settings: &DistanceSettings) -> Result<Option<WindingNumber<T>>> {
        match settings.sign {
            None | Some(SignRule::Normal) => Ok(None),
            Some(SignRule::WindingNumber) => {
                let points = self.tree.ordered_points();
                let mut by_index = vec![[T::ZERO; 3]; points.len()];
                points.ids().iter().enumerate().for_each(|(place, &id)| by_index[id as usize] = points.position(place));
                WindingNumber::of_points(&by_index, &self.normals, &disk_areas(&self.tree)).map(Some)
            }
            Some(SignRule::Pseudonormal) => Err(no_pseudonormals()),
        }
    }

    fn near(&self, query: &Vector<T>, best: &Best<T>) -> Near<T> {
        let offset = subtract(*query, self.tree.ordered_points().position(best.place));
        Near { offset, dist2: best.dist2, normal: self.normals[best.index as usize] }
    }

    /// What is nearer than `best`, or as near with a smaller index.
    fn nearest(&self, query: &Vector<T>, mut best: Best<T>) -> Best<T> {
        let points = self.tree.ordered_points();
        self.tree.nearest_first(query, best.dist2, |leaf| {
            points.for_each_dist2(self.tree.places(leaf), query, |place, dist2| {
                if dist2 <= best.dist2 {
                    let index = points.ids()[place];
                    if dist2 < best.dist2 || index < best.index {
                        best = Best { dist2, index, place };
                    }
                }
            });
            best.dist2
        });
        best
    }

    fn fill(
        &self,
        bricks: &Bricks<T>,
        brick: &Brick,
        radius: T,
        settings: &DistanceSettings,
        winding: Option<&WindingNumber<T>>,
    ) -> Option<Vec<NodeValue>> {
        let none = |reach: T| Best { dist2: reach * reach, index: DistanceField::NONE, place: 0 };
        let (middle, half) = bricks.ball(brick);
        let mut last = self.nearest(&middle, none(radius + half));
        if last.index == DistanceField::NONE {
            return None;
        }
        let (points, smoothing) = (self.tree.ordered_points(), T::of(settings.smoothing));
        let mut values = vec![UNDEFINED; brick.len()];
        for node in brick.nodes() {
            let query = bricks.position(node);
            // The nearest of the node before is no farther than one width more.
            let known = points.position(last.place);
            let dist2 = crate::structure::aabb_tree::any_dimension::dist2(&query, &known);
            let start = if dist2 <= radius * radius { Best { dist2, ..last } } else { none(radius) };
            let best = self.nearest(&query, start);
            if best.index == DistanceField::NONE {
                continue;
            }
            last = best;
            let value = value::distance(self, &query, &self.near(&query, &best), settings.mode, smoothing);
            let value = match winding {
                Some(winding) if winding.is_inside(query) => -value.abs(),
                Some(_) => value.abs(),
                None => value,
            };
            values[brick.place(node)] = (value.to_f64() as f32, best.index);
        }
        Some(values)
    }
}

/// Samples have normals, not pseudonormals.
pub(super) fn no_pseudonormals() -> Error {
    Error::InvalidSetting {
        setting: "sign",
        found: SignRule::Pseudonormal.to_string(),
        expected: "normal or winding-number for samples; pseudonormals are those of a mesh",
    }
}

/// Refuses a field without any value.
pub(super) fn check_band(
    field: &DistanceField,
    settings: &DistanceSettings,
    grid: &RegularGrid,
    what: &str,
    n: usize,
) -> Result<()> {
    if field.nearest.iter().any(|&index| index != DistanceField::NONE) {
        return Ok(());
    }
    let bounds = grid.bounds();
    Err(empty_band(settings, grid, &format!("{n} {what} and the grid from {} to {}", bounds.min, bounds.max)))
}

pub(super) fn empty_band(settings: &DistanceSettings, grid: &RegularGrid, between: &str) -> Error {
    Error::InvalidSetting {
        setting: "band",
        found: format!("{} widths of {}: none of {between} are that near each other", settings.band, grid.spacing()),
        expected: "a grid over the surface, or a wider band",
    }
}
