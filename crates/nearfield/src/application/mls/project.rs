//! Projecting: points move onto the surface of samples that stay where they are.

use std::time::Instant;

use super::MlsReport;
use super::cloud::Cloud;
use super::cpu::{self, Iteration, KeptSupport, Points};
use super::settings::{MlsMethod, MlsSettings, Support};
use super::smooth::radii;
use crate::Result;
use crate::application::{Length, PointFlags, Watch};
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::query::Stage;
use crate::structure::AabbTreeN;

/// Roundings of the largest coordinate below which a move is none.
const ROUNDINGS: f64 = 4.0;

/// Points on their way onto the surface of a cloud that stays.
///
/// A step fits the surface around where each point is. Spheres, jets and the fast point-set surfaces then project the place
/// where the point began onto it, so that the map is idempotent; the others walk on from where the point is. A point has arrived
/// once it moves less than the accuracy. One without a surface on its way goes back to where it began, flagged.
///
/// ```
/// use nearfield::application::{MlsProjection, MlsSettings, Support, Watch};
/// use nearfield::geometry::generate::{CloudKind, cloud};
/// use nearfield::{AabbTreeN, AabbTreeNSettings};
///
/// let sphere: Vec<[f64; 3]> =
///     cloud(CloudKind::Shell, 4000, 1).points.iter().map(|p| p.as_dvec3().normalize().to_array()).collect();
/// let tree = AabbTreeN::build(&sphere, &AabbTreeNSettings::default())?;
/// let queries = [[0.0, 0.0, 1.05], [0.9, 0.0, 0.0]];
/// let mut projection =
///     MlsProjection::new(&tree, Some(&sphere), &queries, &Support::Radius(0.3), &MlsSettings::default())?;
/// projection.run(&mut Watch::none())?;
/// assert!((projection.positions()[0][2] - 1.0).abs() < 1e-9);
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MlsProjection<'a, T> {
    settings: MlsSettings,
    support: KeptSupport<T>,
    tree: &'a AabbTreeN<T, 3>,
    samples: Vec<Vector<T>>,
    sample_normals: Option<Vec<Vector<T>>>,
    points: Points<T>,
    /// The points by the leaves nearest to where they began.
    order: Vec<u32>,
    accuracy: T,
    center: Vector<T>,
    iterations: u32,
}

impl<'a, T: Scalar> MlsProjection<'a, T> {
    /// Onto the points of `tree`.
    ///
    /// - `normals`: `[n]` oriented normals of the points of the tree, of any length; methods that need them refuse `None`. Points whose
    ///   normal has no length or is not finite count for no query under such a method.
    /// - `queries`: what moves; those that are not finite stay, with [`PointFlags::INVALID`]
    ///
    /// # Errors
    /// `LengthMismatch` for normals or radii; `InvalidSetting`, also for an accuracy in spacings or percent of points that have none.
    pub fn new(
        tree: &'a AabbTreeN<T, 3>,
        normals: Option<&[Vector<T>]>,
        queries: &[Vector<T>],
        support: &Support<'_, T>,
        settings: &MlsSettings,
    ) -> Result<Self> {
        settings.validate()?;
        support.validate(queries.len(), tree.len())?;
        let sample_normals = cpu::unit_normals(&settings.method, normals, tree.len())?;
        let mut points = Points::new(queries.to_vec(), vec![[T::ZERO; 3]; queries.len()]);
        for (index, query) in queries.iter().enumerate() {
            if !query.iter().all(|x| x.is_finite() && x.abs() <= T::MAX_COORDINATE) {
                (points.done[index], points.flags[index]) = (true, PointFlags::INVALID);
            }
        }
        let accuracy = accuracy(&settings.accuracy, tree)?;
        Ok(Self {
            settings: *settings,
            support: KeptSupport::of(support),
            samples: in_callers_order(tree),
            sample_normals,
            order: by_leaf(tree, queries),
            points,
            accuracy: T::of(accuracy),
            center: cpu::center(tree),
            tree,
            iterations: 0,
        })
    }

    /// Moves every point that has not arrived by one step.
    ///
    /// # Errors
    /// None yet; a step may come to need memory that is not there.
    pub fn iterate(&mut self) -> Result<MlsReport> {
        let start = Instant::now();
        let mut stages = Vec::new();
        let found = match self.support {
            KeptSupport::Nearest(k) => {
                Some(cpu::nearest_radii(self.tree, &self.points.positions, &self.order, (k, false)))
            }
            _ => None,
        };
        if found.is_some() {
            stages.push(Stage::on_host("nearest", start));
        }
        let (radii, falloff) = radii(&self.support, found.as_deref(), &self.settings);
        let fit_start = Instant::now();
        let cloud = Cloud {
            tree: self.tree,
            positions: &self.samples,
            normals: self.sample_normals.as_deref(),
            own_radii: self.support.own_radii(),
            weight: self.settings.weight,
        };
        self.iterations += 1;
        let is_last = self.iterations >= self.settings.most_steps;
        let arrival = Some((self.accuracy, is_last));
        let iteration = Iteration { settings: &self.settings, center: self.center, arrival };
        let sums = self.points.advance(&cloud, &self.order, (&radii, falloff), &iteration);
        stages.push(Stage::on_host("fit", fit_start));
        let oriented = self.sample_normals.is_some();
        Ok(sums.report(self.iterations, oriented, stages, start.elapsed().as_secs_f64() * 1e3))
    }

    /// Whether every point has arrived, could not be projected, or has taken all its steps.
    pub fn is_done(&self) -> bool {
        self.points.done.iter().all(|done| *done)
    }

    /// Steps until all is done.
    ///
    /// # Errors
    /// `Interrupted` where the watch ends it; the points are then where their last step led.
    pub fn run(&mut self, watch: &mut Watch<'_>) -> Result<Vec<MlsReport>> {
        let mut reports = Vec::new();
        while !self.is_done() {
            watch.report("projection", self.iterations.into(), self.settings.most_steps.into())?;
            reports.push(self.iterate()?);
        }
        Ok(reports)
    }

    /// `[q]` where the points are now.
    pub fn positions(&self) -> &[Vector<T>] {
        &self.points.positions
    }

    /// `[q]` normals of the surface there, of length 1; 0 where there was none. Without given normals their sign is arbitrary.
    pub fn normals(&self) -> &[Vector<T>] {
        &self.points.normals
    }

    /// `[q]` 1 / radius of the spheres of [`MlsMethod::Apss`], positive where the surface bends away from its normal; `None` for other
    /// methods.
    pub fn mean_curvatures(&self) -> Option<&[T]> {
        matches!(self.settings.method, MlsMethod::Apss { .. }).then_some(&self.points.curvatures)
    }

    /// `[q]` what is to be said of each point.
    pub fn flags(&self) -> &[PointFlags] {
        &self.points.flags
    }
}

/// The move at which a point has arrived: the accuracy, and no less than some roundings of the largest coordinate.
pub(super) fn accuracy<T: Scalar>(accuracy: &Length, tree: &AabbTreeN<T, 3>) -> Result<f64> {
    if tree.is_empty() {
        return Ok(0.0);
    }
    let largest = tree
        .boxes()
        .first()
        .map_or(0.0, |root| root.min.iter().chain(&root.max).map(|x| x.abs().to_f64()).fold(0.0, f64::max));
    Ok(accuracy.resolve("accuracy", tree)?.max(ROUNDINGS * T::EPSILON.to_f64() * largest))
}

fn in_callers_order<T: Scalar>(tree: &AabbTreeN<T, 3>) -> Vec<Vector<T>> {
    let ordered = tree.ordered_points();
    let mut points = vec![[T::ZERO; 3]; ordered.len()];
    ordered.ids().iter().enumerate().for_each(|(place, &id)| points[id as usize] = ordered.position(place));
    points
}

/// Indices of the queries, those of a leaf one after the other.
fn by_leaf<T: Scalar>(tree: &AabbTreeN<T, 3>, queries: &[Vector<T>]) -> Vec<u32> {
    use rayon::prelude::*;
    let mut order: Vec<u32> = (0..queries.len() as u32).collect();
    if !tree.is_empty() {
        order.par_sort_by_cached_key(|&index| tree.nearest_leaf(&queries[index as usize]));
    }
    order
}
