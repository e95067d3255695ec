//! The last step of samples that are to lie on the points or on their surface: locally optimal projection ends near it.

use rayon::prelude::*;

use super::WlopSamples;
use crate::Result;
use crate::application::{MlsProjection, MlsSettings, Support, Watch};
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::query::NearestFew;
use crate::structure::AabbTreeN;

/// Samples of a task.
const TASK: usize = 256;
/// Samples after which a caller is told and may end it.
const TOLD: usize = 1 << 13;

/// Where samples go at the end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Snap<'a, T> {
    /// To the nearest point each; some may then stand at one place.
    Nearest,
    /// Onto the algebraic spheres of the points (Guennebaud2007).
    Apss {
        /// `[n]` oriented normals of the points, of any length.
        normals: &'a [Vector<T>],
        /// Radius that spheres are fitted within.
        radius: T,
    },
}

impl<T: Scalar> WlopSamples<T> {
    /// Moves the samples onto the points or their surface. Those that cannot be projected stay, with what that gave as their flags.
    /// Returns the mean length of the moves.
    ///
    /// - `tree`: over the points
    ///
    /// # Errors
    /// `LengthMismatch` for normals; `InvalidSetting` for a radius that cannot be searched; `Interrupted` where the watch ends it. The
    /// samples are then as they were.
    pub fn snap(&mut self, tree: &AabbTreeN<T, 3>, snap: Snap<'_, T>, watch: &mut Watch<'_>) -> Result<f64> {
        let snapped = match snap {
            Snap::Nearest => self.nearest(tree, watch)?,
            Snap::Apss { normals, radius } => {
                let (support, settings) = (Support::Radius(radius), MlsSettings::default());
                let mut moving = MlsProjection::new(tree, Some(normals), &self.positions, &support, &settings)?;
                moving.run(watch)?;
                self.flags.iter_mut().zip(moving.flags()).for_each(|(all, more)| *all |= *more);
                moving.positions().to_vec()
            }
        };
        let way = |(from, to): (&Vector<T>, &Vector<T>)| vector::norm(vector::subtract(*to, *from)).to_f64();
        let moves: f64 = self.positions.iter().zip(&snapped).map(way).sum();
        self.positions = snapped;
        Ok(moves / (self.positions.len() as f64).max(1.0))
    }

    fn nearest(&self, tree: &AabbTreeN<T, 3>, watch: &mut Watch<'_>) -> Result<Vec<Vector<T>>> {
        let points = tree.ordered_points();
        let mut by_index = vec![0; points.len()];
        points.ids().iter().enumerate().for_each(|(place, &id)| by_index[id as usize] = place);
        let nearest = |few: &mut NearestFew<T>, at: &Vector<T>| {
            tree.nearest_few(at, T::of(f64::INFINITY), few);
            few.found().first().map_or(*at, |hit| points.position(by_index[hit.1 as usize]))
        };
        let n = self.positions.len();
        let mut snapped = Vec::with_capacity(n);
        for some in self.positions.chunks(TOLD) {
            watch.report("snapping", snapped.len() as u64, n as u64)?;
            let found: Vec<Vector<T>> =
                some.par_iter().with_min_len(TASK).map_init(|| NearestFew::new(1), nearest).collect();
            snapped.extend(found);
        }
        watch.report("snapping", n as u64, n as u64)?;
        Ok(snapped)
    }
}
