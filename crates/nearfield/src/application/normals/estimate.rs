//! Normals on the CPU, in either precision: many queries side by side, in the order of the tree.

use rayon::prelude::*;

use super::jet::fit_jet;
use super::plane::fit_plane;
use super::sample::Samples;
use super::{Neighborhood, NormalMethod, NormalSettings, Normals};
use crate::Result;
use crate::application::{PointFlags, Watch};
use crate::geometry::Scalar;
use crate::geometry::vector::{self, Vector};
use crate::query::NearestFew;
use crate::structure::AabbTreeN;

/// Queries between two reports of how far it is.
const BLOCK: usize = 1 << 14;
/// Queries of a task.
const TASK: usize = 256;

/// Normals of all points of a tree.
///
/// ```
/// use nearfield::application::{NormalSettings, Watch, estimate_normals};
/// use nearfield::{AabbTreeN, AabbTreeNSettings};
///
/// let points: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10), 5.0]).collect();
/// let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default())?;
/// let normals = estimate_normals(&tree, &NormalSettings::default().nearest(9), &mut Watch::none())?;
/// assert!(normals.vectors.iter().all(|n| n[2].abs() > 0.999));
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// Points with a NaN or infinite coordinate make no tree (`NonFinite`), so none is met here.
///
/// # Errors
/// `InvalidSetting` for the settings or the radius, `Interrupted`.
pub fn estimate_normals<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    settings: &NormalSettings,
    watch: &mut Watch<'_>,
) -> Result<Normals<T>> {
    let points = tree.ordered_points();
    let queries = (0..points.len()).map(|place| points.position(place)).collect::<Vec<_>>();
    estimate(tree, &queries, Some(points.ids()), settings, watch)
}

/// Normals of the surface at other places, from the points of a tree that are near them.
///
/// - `queries`: `[q]` places in the unit of the points; those with a NaN or infinite coordinate are flagged `INVALID`
///
/// # Errors
/// As [`estimate_normals`].
pub fn estimate_normals_at<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    queries: &[Vector<T>],
    settings: &NormalSettings,
    watch: &mut Watch<'_>,
) -> Result<Normals<T>> {
    estimate(tree, queries, None, settings, watch)
}

/// What is found at one query.
#[derive(Debug, Clone, Copy)]
struct Found<T> {
    vector: Vector<T>,
    variation: T,
    curvatures: [T; 2],
    flags: PointFlags,
}

/// Answers stand at `slots`, or in the order of the queries.
fn estimate<T: Scalar>(
    tree: &AabbTreeN<T, 3>,
    queries: &[Vector<T>],
    slots: Option<&[u32]>,
    settings: &NormalSettings,
    watch: &mut Watch<'_>,
) -> Result<Normals<T>> {
    settings.validate()?;
    let radius = match settings.neighborhood {
        Neighborhood::Nearest(_) => T::ZERO,
        Neighborhood::Within(_) if tree.is_empty() => T::ZERO,
        Neighborhood::Within(length) => T::of(length.resolve("radius", tree)?),
    };
    let estimator = Estimator { tree, positions: &in_caller_order(tree), settings, radius };
    let n = queries.len();
    let is_jet = settings.method == NormalMethod::Jet;
    let mut normals = Normals {
        vectors: vec![[T::ZERO; 3]; n],
        variation: vec![T::ZERO; n],
        curvatures: vec![[T::ZERO; 2]; if is_jet { n } else { 0 }],
        flags: vec![PointFlags::default(); n],
    };
    for (block, queries) in queries.chunks(BLOCK).enumerate() {
        let first = block * BLOCK;
        watch.report("normals", first as u64, n as u64)?;
        let found: Vec<Found<T>> = queries
            .par_iter()
            .with_min_len(TASK)
            .map_init(|| estimator.scratch(), |scratch, query| estimator.at(query, scratch))
            .collect();
        for (place, found) in (first..).zip(found) {
            let slot = slots.map_or(place, |slots| slots[place] as usize);
            (normals.vectors[slot], normals.variation[slot]) = (found.vector, found.variation);
            normals.flags[slot] = found.flags;
            if is_jet {
                normals.curvatures[slot] = found.curvatures;
            }
        }
    }
    watch.report("normals", n as u64, n as u64)?;
    Ok(normals)
}

/// The points of a tree in the caller's order.
pub(super) fn in_caller_order<T: Scalar>(tree: &AabbTreeN<T, 3>) -> Vec<Vector<T>> {
    let points = tree.ordered_points();
    let mut positions = vec![[T::ZERO; 3]; points.len()];
    points.ids().iter().enumerate().for_each(|(place, &id)| positions[id as usize] = points.position(place));
    positions
}

/// What all queries have in common.
struct Estimator<'a, T: Scalar> {
    tree: &'a AabbTreeN<T, 3>,
    /// In the caller's order.
    positions: &'a [Vector<T>],
    settings: &'a NormalSettings,
    radius: T,
}

/// Memory of a thread.
struct Scratch<T> {
    few: NearestFew<T>,
    samples: Samples,
}

impl<T: Scalar> Estimator<'_, T> {
    fn scratch(&self) -> Scratch<T> {
        let k = match self.settings.neighborhood {
            Neighborhood::Nearest(k) => (k as usize).min(self.tree.len()),
            Neighborhood::Within(_) => 0,
        };
        Scratch { few: NearestFew::new(k), samples: Samples::default() }
    }

    fn at(&self, query: &Vector<T>, scratch: &mut Scratch<T>) -> Found<T> {
        let none = |flags| Found { vector: [T::ZERO; 3], variation: T::ZERO, curvatures: [T::ZERO; 2], flags };
        if query.iter().any(|x| !x.is_finite()) {
            return none(PointFlags::INVALID);
        }
        self.gather(query, scratch);
        let plane = match fit_plane(&scratch.samples) {
            Ok(plane) => plane,
            Err(flags) => return none(flags),
        };
        let (normal, curvatures, flags) = match self.settings.method {
            NormalMethod::Pca => (plane.normal, [0.0; 2], PointFlags::default()),
            NormalMethod::Jet => match fit_jet(&scratch.samples, plane.normal) {
                Ok(jet) => (jet.normal, jet.curvatures, PointFlags::default()),
                Err(flags) => (plane.normal, [0.0; 2], flags),
            },
        };
        Found { vector: normal.map(T::of), variation: T::of(plane.variation), curvatures: curvatures.map(T::of), flags }
    }

    /// The neighbours of a query, relative to it.
    fn gather(&self, query: &Vector<T>, Scratch { few, samples }: &mut Scratch<T>) {
        samples.begin();
        let offset = |id: u32| vector::subtract(self.positions[id as usize], *query).map(T::to_f64);
        let radius = match self.settings.neighborhood {
            Neighborhood::Nearest(_) => {
                self.tree.nearest_few(query, T::of(f64::INFINITY), few);
                few.found().iter().for_each(|&(_, id)| samples.add(offset(id)));
                few.found().last().map_or(0.0, |farthest| farthest.0.to_f64().sqrt())
            }
            Neighborhood::Within(_) => {
                self.tree.for_each_within(query, self.radius, |id, _| samples.add(offset(id)));
                self.radius.to_f64()
            }
        };
        samples.finish(radius, self.settings.weighted.then(|| self.settings.support2()));
    }
}
