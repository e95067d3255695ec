//! Smoothing: all points move at once, and the next iteration is fitted to where they are then.

use std::time::Instant;

use super::MlsReport;
use super::bilateral;
use super::cloud::Cloud;
use super::cpu::{self, Iteration, KeptSupport, Points, Radii};
use super::settings::{MlsMethod, MlsSettings, Support};
use crate::Result;
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::query::Stage;
use crate::structure::{AabbTreeN, AabbTreeNSettings};

/// Points that smooth themselves, iteration by iteration, as in Xing2017: a diffusion. Planes shrink what they smooth; spheres and
/// heights of degree 2 hardly do.
///
/// Each iteration moves every point onto the surface fitted around it; then the tree is refitted. Where normals were given
/// they are carried along: a point's normal is that of the surface it moved to. Number and order of the points stay; flags say what
/// could not be done with a point in the last iteration.
///
/// ```
/// use nearfield::application::{MlsMethod, MlsSettings, MlsSmoothing, PointFlags, Support};
/// use nearfield::geometry::generate::{CloudKind, cloud};
///
/// let noisy = cloud(CloudKind::Shell, 4000, 1);
/// let points: Vec<[f32; 3]> = noisy.points.iter().map(|p| p.to_array()).collect();
/// let normals = points.clone(); // outwards; their length does not matter
/// let settings = MlsSettings::new(MlsMethod::APSS);
/// let mut smoothing = MlsSmoothing::new(&points, Some(&normals), &Support::Radius(0.2), &settings)?;
/// for _ in 0..3 {
///     let report = smoothing.iterate()?;
///     println!("{}: moved by {} on average", report.iteration, report.mean_move);
/// }
/// assert_eq!(smoothing.positions().len(), 4000);
/// assert!(smoothing.flags().iter().all(|flags| flags.is_empty()));
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct MlsSmoothing<T> {
    settings: MlsSettings,
    support: KeptSupport<T>,
    tree: AabbTreeN<T, 3>,
    points: Points<T>,
    /// Where the points were at the last refit: those that fits go to.
    samples: Vec<Vector<T>>,
    oriented: bool,
    center: Vector<T>,
    iterations: u32,
}

impl<T: Scalar> MlsSmoothing<T> {
    /// Over these points.
    ///
    /// - `normals`: `[n]` oriented, of any length; methods that need them refuse `None`. A point whose normal has no length or is not
    ///   finite stays where it is under such a method, with [`PointFlags::INVALID`], and counts for no other.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateBeyond`, `TooMany` for the points; `LengthMismatch` for normals or radii; `InvalidSetting`.
    pub fn new(
        points: &[Vector<T>],
        normals: Option<&[Vector<T>]>,
        support: &Support<'_, T>,
        settings: &MlsSettings,
    ) -> Result<Self> {
        settings.validate()?;
        support.validate(points.len(), points.len())?;
        let normals = cpu::unit_normals(&settings.method, normals, points.len())?;
        let tree = AabbTreeN::build(points, &AabbTreeNSettings::default())?;
        let center = cpu::center(&tree);
        let oriented = normals.is_some();
        let normals = normals.unwrap_or_else(|| vec![[T::ZERO; 3]; points.len()]);
        let mut points = Points::new(points.to_vec(), normals);
        if settings.method.needs_normals() {
            points.keep_invalid();
        }
        let (support, samples) = (KeptSupport::of(support), points.positions.clone());
        Ok(Self { settings: *settings, support, tree, points, samples, oriented, center, iterations: 0 })
    }

    /// Moves every point once, and refits the tree.
    ///
    /// # Errors
    /// `CoordinateBeyond` where a point has left the domain of the tree; the positions are then as they were.
    pub fn iterate(&mut self) -> Result<MlsReport> {
        let start = Instant::now();
        let mut stages = Vec::new();
        let order = self.tree.ordered_points().ids();
        let found = match self.support {
            KeptSupport::Nearest(k) => Some(cpu::nearest_radii(&self.tree, &self.samples, order, (k, true))),
            _ => None,
        };
        if found.is_some() {
            stages.push(Stage::on_host("nearest", start));
        }
        let (radii, falloff) = radii(&self.support, found.as_deref(), &self.settings);
        let fit_start = Instant::now();
        // Fits look at the normals as they are while new ones are written.
        let normals = self.oriented.then(|| self.points.normals.clone());
        let cloud = Cloud {
            tree: &self.tree,
            positions: &self.samples,
            normals: normals.as_deref(),
            own_radii: self.support.own_radii(),
            weight: self.settings.weight,
        };
        // Every iteration begins where the last one ended.
        self.points.origins.copy_from_slice(&self.samples);
        let iteration = Iteration { settings: &self.settings, center: self.center, arrival: None };
        let sums = self.points.advance(&cloud, order, (&radii, falloff), &iteration);
        stages.push(Stage::on_host("fit", fit_start));
        let refit_start = Instant::now();
        if let Err(error) = self.tree.refit(&self.points.positions) {
            self.points.positions.copy_from_slice(&self.samples);
            return Err(error);
        }
        self.samples.copy_from_slice(&self.points.positions);
        stages.push(Stage::on_host("refit", refit_start));
        self.iterations += 1;
        Ok(sums.report(self.iterations, self.oriented, stages, start.elapsed().as_secs_f64() * 1e3))
    }

    /// `[n]` where the points are now.
    pub fn positions(&self) -> &[Vector<T>] {
        &self.samples
    }

    /// `[n]` normals of the surfaces they moved to, of length 1; 0 before the first iteration where none were given. Without
    /// given normals their sign is arbitrary.
    pub fn normals(&self) -> &[Vector<T>] {
        &self.points.normals
    }

    /// `[n]` 1 / radius of the spheres of [`MlsMethod::Apss`], positive where the surface bends away from its normal; `None` for other
    /// methods.
    pub fn mean_curvatures(&self) -> Option<&[T]> {
        matches!(self.settings.method, MlsMethod::Apss { .. }).then_some(&self.points.curvatures)
    }

    /// `[n]` what the last iteration said of each point.
    pub fn flags(&self) -> &[PointFlags] {
        &self.points.flags
    }

    /// The tree over the points as they are now.
    pub fn tree(&self) -> &AabbTreeN<T, 3> {
        &self.tree
    }
}

impl<T: Scalar> Points<T> {
    /// Points without a normal stay where they are.
    fn keep_invalid(&mut self) {
        for (index, normal) in self.normals.iter().enumerate() {
            if *normal == [T::ZERO; 3] {
                (self.done[index], self.flags[index]) = (true, PointFlags::INVALID);
            }
        }
    }
}

/// Radii of the searches, and the one that the bilateral weight falls over where that is another.
pub(super) fn radii<'a, T: Scalar>(
    support: &'a KeptSupport<T>,
    nearest: Option<&'a [T]>,
    settings: &MlsSettings,
) -> (Radii<'a, T>, Option<T>) {
    match (support, nearest) {
        (KeptSupport::Radius(radius), _) => (Radii::One(*radius), None),
        (KeptSupport::OfPoints { largest, .. }, _) => (Radii::One(*largest), None),
        (KeptSupport::OfQueries(radii), _) => (Radii::Each(radii), None),
        (KeptSupport::Nearest(_), found) => {
            let found = found.unwrap_or_default();
            let largest = found.iter().fold(T::ZERO, |largest, &radius| largest.larger(radius));
            let is_bilateral = matches!(settings.method, MlsMethod::Bilateral { .. });
            (Radii::Each(found), is_bilateral.then(|| largest * T::of(bilateral::FALLOFF)))
        }
    }
}
