//! One iteration on the CPU: the points side by side, in the order of the tree. `conclude.wesl` is the twin of what is done with a
//! fit.

use rayon::prelude::*;

use super::cloud::{Cloud, Fitted, Query};
use super::report::Sums;
#[cfg(feature = "gpu")]
use super::settings::PlaneSearch;
use super::settings::{MlsMethod, MlsSettings, Support};
use super::{apss, bilateral, jet, pss, rimls};
use crate::application::PointFlags;
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::query::NearestFew;
use crate::structure::AabbTreeN;
use crate::{Error, Result};

/// Points of a task.
const TASK: usize = 128;
/// A radius is larger than the distance it is made from by so many roundings, so that the square holds the squared distance.
const ROUNDINGS: f64 = 4.0;

/// All points: where they are and what was said of them, by the caller's index.
#[derive(Debug, Clone)]
pub(super) struct Points<T> {
    /// Where they began.
    pub(super) origins: Vec<Vector<T>>,
    pub(super) positions: Vec<Vector<T>>,
    /// Of length 1; 0 where there is none yet.
    pub(super) normals: Vec<Vector<T>>,
    pub(super) curvatures: Vec<T>,
    pub(super) flags: Vec<PointFlags>,
    /// Those that are not to move any more.
    pub(super) done: Vec<bool>,
}

/// What an iteration does with a point.
#[derive(Debug, Clone, Copy)]
struct Outcome<T> {
    position: Vector<T>,
    normal: Vector<T>,
    curvature: T,
    flags: PointFlags,
    neighbors: u32,
}

/// What is the same for all points of an iteration.
pub(super) struct Iteration<'a, T> {
    pub(super) settings: &'a MlsSettings,
    /// Centre that volumes are measured from.
    pub(super) center: Vector<T>,
    /// Of projected points: the move at which they have arrived, and whether this is their last step.
    pub(super) arrival: Option<(T, bool)>,
}

/// Radii of the searches.
pub(super) enum Radii<'a, T> {
    One(T),
    Each(&'a [T]),
}

impl<T: Scalar> Radii<'_, T> {
    fn of(&self, index: usize) -> T {
        match self {
            Self::One(radius) => *radius,
            Self::Each(radii) => radii[index],
        }
    }
}

impl<T: Scalar> Points<T> {
    pub(super) fn new(positions: Vec<Vector<T>>, normals: Vec<Vector<T>>) -> Self {
        let n = positions.len();
        Self {
            origins: positions.clone(),
            positions,
            normals,
            curvatures: vec![T::ZERO; n],
            flags: vec![PointFlags::default(); n],
            done: vec![false; n],
        }
    }

    /// Moves all points that are not done, each by the surface around it.
    ///
    /// - `order`: their indices, neighbours near each other
    /// - `falloff`: radius of the bilateral weight, where it is not that of the search
    pub(super) fn advance(
        &mut self,
        cloud: &Cloud<'_, T>,
        order: &[u32],
        (radii, falloff): (&Radii<'_, T>, Option<T>),
        iteration: &Iteration<'_, T>,
    ) -> Sums {
        let points = &*self;
        let fit = |&index: &u32| -> Option<Outcome<T>> {
            let index = index as usize;
            if points.done[index] {
                return None;
            }
            let radius = radii.of(index);
            let query = Query {
                origin: points.origins[index],
                at: points.positions[index],
                normal: points.normals[index],
                radius,
                falloff: falloff.unwrap_or(radius),
            };
            Some(conclude(&query, &fitted(cloud, &query, &iteration.settings.method), iteration.settings.domain))
        };
        let outcomes: Vec<Option<Outcome<T>>> = order.par_iter().with_min_len(TASK).map(fit).collect();
        let mut sums = Sums::default();
        for (&index, outcome) in order.iter().zip(&outcomes) {
            if let Some(outcome) = outcome {
                self.take(index as usize, outcome, iteration, &mut sums);
            }
        }
        sums.flagged = PointFlags::totals(&self.flags);
        sums
    }

    fn take(&mut self, index: usize, outcome: &Outcome<T>, iteration: &Iteration<'_, T>, sums: &mut Sums) {
        let moved = vector::subtract(outcome.position, self.positions[index]);
        let way = vector::norm(moved);
        let mut flags = outcome.flags;
        if let Some((accuracy, is_last)) = iteration.arrival {
            // What was cut once stays said.
            if self.flags[index].contains(PointFlags::LIMITED) {
                flags |= PointFlags::LIMITED;
            }
            let failed = flags.0 & (PointFlags::FEW_NEIGHBORS.0 | PointFlags::DEGENERATE.0) != 0;
            self.done[index] = failed || way < accuracy;
            if is_last && !self.done[index] {
                flags |= PointFlags::NOT_CONVERGED;
                self.done[index] = true;
            }
        }
        let away = vector::subtract(self.positions[index], iteration.center);
        sums.fitted += 1;
        sums.moving += u64::from(!self.done[index]);
        sums.moves += way.to_f64();
        sums.largest = sums.largest.max(way.to_f64());
        sums.along += vector::dot(moved, outcome.normal).to_f64();
        sums.outwards += vector::dot(away, outcome.normal).to_f64();
        sums.distances += vector::norm(away).to_f64();
        sums.neighbors += u64::from(outcome.neighbors);
        self.positions[index] = outcome.position;
        self.normals[index] = outcome.normal;
        self.curvatures[index] = outcome.curvature;
        self.flags[index] = flags;
    }
}

fn fitted<T: Scalar>(cloud: &Cloud<'_, T>, query: &Query<T>, method: &MlsMethod) -> Fitted<T> {
    let least = method.least_neighbors();
    if !(query.radius > T::ZERO) {
        return Fitted::none(PointFlags::DEGENERATE, 0);
    }
    match *method {
        MlsMethod::Pss { degree, plane } => pss::fit(cloud, query, (degree, plane, least)),
        MlsMethod::Apss { sphericity } => apss::fit(cloud, query, sphericity, least),
        MlsMethod::Rimls { normal_width } => rimls::fit(cloud, query, normal_width, least),
        MlsMethod::Bilateral { sharpness_degrees } => bilateral::fit(cloud, query, sharpness_degrees, least),
        MlsMethod::Jet => jet::fit(cloud, query, least),
    }
}

/// Cuts a move at the radius, marks what is outside, and leaves a point without a surface where it began.
fn conclude<T: Scalar>(query: &Query<T>, fitted: &Fitted<T>, domain: f64) -> Outcome<T> {
    let mut flags = fitted.flags;
    let (mut position, mut normal) = (query.origin, query.normal);
    if let Some((target, at_target)) = fitted.place {
        let step = vector::subtract(target, query.at);
        let length = vector::norm(step);
        if !length.is_finite() {
            flags |= PointFlags::DEGENERATE;
        } else {
            (position, normal) = (target, at_target);
            if length > fitted.reach {
                flags |= PointFlags::LIMITED;
                position = vector::add_scaled(query.at, step, fitted.reach / length);
            }
            if fitted.mean_distance > T::of(domain) * fitted.reach {
                flags |= PointFlags::OUTSIDE;
            }
        }
    }
    Outcome { position, normal, curvature: fitted.curvature, flags, neighbors: fitted.neighbors }
}

/// The distance of the k-th nearest sample beside the point itself, for every point, a little enlarged so that it is within.
///
/// - `positions`: the points, which are the samples themselves where `are_samples`
pub(super) fn nearest_radii<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    positions: &[Vector<T>],
    order: &[u32],
    (k, are_samples): (u32, bool),
) -> Vec<T> {
    let k = k as usize + usize::from(are_samples);
    let slack = T::ONE + T::of(ROUNDINGS) * T::EPSILON;
    let found: Vec<T> = order
        .par_iter()
        .with_min_len(TASK)
        .map_init(
            || NearestFew::new(k),
            |few, &index| {
                tree.nearest_few(&positions[index as usize], T::of(f64::INFINITY), few);
                few.found().last().map_or(T::ZERO, |hit| hit.0.sqrt() * slack)
            },
        )
        .collect();
    let mut radii = vec![T::ZERO; positions.len()];
    order.iter().zip(found).for_each(|(&index, radius)| radii[index as usize] = radius);
    radii
}

/// A support as an object keeps it.
#[derive(Debug, Clone)]
pub(super) enum KeptSupport<T> {
    Radius(T),
    OfQueries(Vec<T>),
    OfPoints { radii: Vec<T>, largest: T },
    Nearest(u32),
}

impl<T: Scalar> KeptSupport<T> {
    pub(super) fn of(support: &Support<'_, T>) -> Self {
        match support {
            Support::Radius(radius) => Self::Radius(*radius),
            Support::OfQueries(radii) => Self::OfQueries(radii.to_vec()),
            Support::OfPoints(radii) => {
                let largest = radii.iter().fold(T::ZERO, |largest, &radius| largest.larger(radius));
                Self::OfPoints { radii: radii.to_vec(), largest }
            }
            Support::Nearest(k) => Self::Nearest(*k),
        }
    }

    /// Radii of the samples' own supports.
    pub(super) fn own_radii(&self) -> Option<&[T]> {
        match self {
            Self::OfPoints { radii, .. } => Some(radii),
            _ => None,
        }
    }
}

/// Normals at length 1, and 0 for those that have none: not finite, or of no length.
///
/// # Errors
/// `LengthMismatch`; `InvalidSetting` where the method needs normals and there are none.
pub(super) fn unit_normals<T: Scalar>(
    method: &MlsMethod,
    normals: Option<&[Vector<T>]>,
    n_points: usize,
) -> Result<Option<Vec<Vector<T>>>> {
    match normals {
        None if method.needs_normals() => Err(Error::InvalidSetting {
            setting: "method of moving least squares",
            found: format!("{} without normals", method.name()),
            expected: "oriented normals of the points, or `pss` or `jet`, which need none",
        }),
        None => Ok(None),
        Some(normals) if normals.len() != n_points => {
            let (found, expected) = (normals.len() as u64, n_points as u64);
            Err(Error::LengthMismatch { what: "normals of the points", found, expected })
        }
        Some(normals) => {
            let unit = |&normal: &Vector<T>| vector::normalized(normal).unwrap_or([T::ZERO; 3]);
            Ok(Some(normals.par_iter().with_min_len(1 << 12).map(unit).collect()))
        }
    }
}

/// The middle of the box around the points.
pub(super) fn center<T: Scalar>(tree: &AabbTreeN<T, 3>) -> Vector<T> {
    match tree.boxes().first() {
        Some(root) if !tree.is_empty() => {
            std::array::from_fn(|axis| T::of(0.5) * root.min[axis] + T::of(0.5) * root.max[axis])
        }
        _ => [T::ZERO; 3],
    }
}

/// Whether a fast-form surface or another that projects where points began.
#[cfg(feature = "gpu")]
pub(super) fn projects_the_origin(method: &MlsMethod) -> bool {
    match method {
        MlsMethod::Pss { plane, .. } => *plane == PlaneSearch::Fast,
        MlsMethod::Apss { .. } | MlsMethod::Jet => true,
        MlsMethod::Rimls { .. } | MlsMethod::Bilateral { .. } => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::application::mls::spread::{Sample, Spread};

    fn query() -> Query<f64> {
        Query { origin: [1.0; 3], at: [1.0, 1.0, 2.0], normal: [0.0, 0.0, 1.0], radius: 0.5, falloff: 0.5 }
    }

    fn spread(offset: [f64; 3]) -> Spread<f64> {
        let mut spread = Spread::default();
        spread.add(&Sample { index: 0, offset, y: 0.0, reach: 1.0 }, 1.0);
        spread
    }

    #[test]
    fn moves_end_at_the_radius() {
        let fitted = Fitted::at(&query(), &spread([0.0; 3]), [1.0, 1.0, 4.0], [1.0, 0.0, 0.0]);
        let outcome = conclude(&query(), &fitted, 0.5);
        assert_eq!((outcome.position, outcome.normal), ([1.0, 1.0, 2.5], [1.0, 0.0, 0.0]));
        assert_eq!(outcome.flags, PointFlags::LIMITED);
    }

    #[test]
    fn far_means_are_outside_and_faults_go_back() {
        for (mean, flags) in [(0.5, PointFlags::default()), (0.51, PointFlags::OUTSIDE)] {
            let fitted = Fitted::at(&query(), &spread([0.0, mean, 0.0]), [1.0, 1.0, 2.25], [1.0, 0.0, 0.0]);
            let outcome = conclude(&query(), &fitted, 0.5);
            assert_eq!((outcome.position, outcome.flags), ([1.0, 1.0, 2.25], flags));
        }
        let outcome = conclude(&query(), &Fitted::none(PointFlags::FEW_NEIGHBORS, 2), 0.5);
        assert_eq!((outcome.position, outcome.neighbors), ([1.0; 3], 2));
        let endless = Fitted::at(&query(), &spread([0.0; 3]), [f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0]);
        let outcome = conclude(&query(), &endless, 0.5);
        assert_eq!((outcome.position, outcome.flags), ([1.0; 3], PointFlags::DEGENERATE));
    }

    #[test]
    fn radii_of_the_nearest_hold_them() {
        let points: Vec<[f32; 3]> = (0..50u8).map(|i| [f32::from(i) * 0.1, f32::from(i % 3) * 0.07, 0.0]).collect();
        let tree = AabbTreeN::build(&points, &Default::default()).unwrap();
        let order: Vec<u32> = (0..50).collect();
        for (k, are_samples) in [(5, true), (5, false), (80, true)] {
            let radii = nearest_radii(&tree, &points, &order, (k, are_samples));
            for (point, radius) in points.iter().zip(radii) {
                let mut within = 0;
                tree.for_each_within(point, radius, |_, _| within += 1);
                assert!(within >= (k + u32::from(are_samples)).min(50), "{within}");
            }
        }
    }
}
