//! Clusters on the CPU, in either precision: the three passes over a tree of boxes, points side by side in its order.

use std::time::Instant;

use rayon::prelude::*;

use super::union_find::UnionFind;
use super::{Clusters, DbscanSettings, EuclideanSettings, labels};
use crate::Result;
use crate::application::Watch;
use crate::application::finite_points::{FinitePoints, positive};
use crate::geometry::Scalar;
use crate::geometry::vector::Vector;
use crate::query::Stage;
use crate::structure::{AabbTreeN, AabbTreeNSettings};

/// Points between two reports of how far it is.
const BLOCK: usize = 1 << 12;
/// Points of a task.
const TASK: usize = 128;

/// Clusters by density; see [`crate::application::cluster`] for what is fixed beyond Ester1996. The labels are those of scikit-learn's
/// `DBSCAN`, number by number, up to distances that round differently.
///
/// ```
/// use nearfield::application::{Clusters, DbscanSettings, Watch, dbscan};
///
/// let points = [0.0, 0.5, 1.0, 9.0, 20.0, 20.5].map(|x| [x, 0.0, 0.0]);
/// let clusters = dbscan(&points, &DbscanSettings::new(0.5, 2), &mut Watch::none())?;
/// assert_eq!(clusters.labels, [0, 0, 0, Clusters::NONE, 1, 1]);
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// - `points`: `[n]`; those with a NaN or infinite coordinate are told in [`Clusters::invalid`] and count for nothing
///
/// # Errors
/// `InvalidSetting`; `CoordinateBeyond`, `TooMany` for the points; `Interrupted`.
pub fn dbscan<T: Scalar>(points: &[Vector<T>], settings: &DbscanSettings, watch: &mut Watch<'_>) -> Result<Clusters> {
    settings.validate()?;
    of_points(points, positive("eps", settings.eps)?, settings.min_points, watch)
}

/// Connected components of the points within a radius of each other, as PCL's `EuclideanClusterExtraction`. Clusters are numbered by
/// their smallest index, where PCL puts the largest first; those of other sizes than wanted are counted and left out.
///
/// ```
/// use nearfield::application::{EuclideanSettings, Watch, euclidean_clusters};
///
/// let points = [0.0, 5.0, 5.5, 9.0, 9.25].map(|x| [x, 0.0, 0.0]);
/// let settings = EuclideanSettings { min_size: 2, ..EuclideanSettings::new(0.5) };
/// let clusters = euclidean_clusters(&points, &settings, &mut Watch::none())?;
/// assert_eq!((clusters.labels, clusters.too_small.points), (vec![-1, 0, 0, 1, 1], 1));
/// # Ok::<(), nearfield::Error>(())
/// ```
///
/// # Errors
/// As [`dbscan`].
pub fn euclidean_clusters<T: Scalar>(
    points: &[Vector<T>],
    settings: &EuclideanSettings,
    watch: &mut Watch<'_>,
) -> Result<Clusters> {
    settings.validate()?;
    let mut clusters = of_points(points, positive("radius", settings.radius)?, 1, watch)?;
    labels::keep_sizes(&mut clusters, settings);
    Ok(clusters)
}

fn of_points<T: Scalar>(points: &[Vector<T>], radius: T, min_points: u32, watch: &mut Watch<'_>) -> Result<Clusters> {
    let start = Instant::now();
    let finite = FinitePoints::of(points)?;
    let tree = AabbTreeN::build(finite.points(), &AabbTreeNSettings::default())?;
    let mut stages = vec![Stage::on_host("build", start)];
    let search = Search { tree: &tree, radius };
    let start = Instant::now();
    let is_core = search.cores(min_points, watch)?;
    stages.push(Stage::on_host("core points", start));
    let start = Instant::now();
    let mut roots = search.join(&is_core, watch)?;
    stages.push(Stage::on_host("join", start));
    let start = Instant::now();
    search.borders(&is_core, &mut roots, watch)?;
    let (labels, n_clusters) = labels::number(&roots, &is_core)?;
    stages.push(Stage::on_host("borders and labels", start));
    Ok(Clusters {
        labels: finite.spread(labels, Clusters::NONE),
        is_core: finite.spread(is_core, false),
        n_clusters,
        invalid: finite.invalid(),
        stages,
        ..Clusters::default()
    })
}

/// A tree and how far points of it look.
struct Search<'a, T: Scalar> {
    tree: &'a AabbTreeN<T, 3>,
    radius: T,
}

impl<T: Scalar> Search<'_, T> {
    /// Runs `work` on the place and the index of every point, and hands its answers to `take` in the order of the tree.
    fn each<R: Send>(
        &self,
        stage: &'static str,
        watch: &mut Watch<'_>,
        work: impl Fn(&Vector<T>, u32) -> R + Sync,
        mut take: impl FnMut(u32, R),
    ) -> Result<()> {
        let (points, n) = (self.tree.ordered_points(), self.tree.len());
        for first in (0..n).step_by(BLOCK) {
            watch.report(stage, first as u64, n as u64)?;
            let places = first..n.min(first + BLOCK);
            let found: Vec<R> = places
                .clone()
                .into_par_iter()
                .with_min_len(TASK)
                .map(|place| work(&points.position(place), points.ids()[place]))
                .collect();
            places.zip(found).for_each(|(place, found)| take(points.ids()[place], found));
        }
        watch.report(stage, n as u64, n as u64)
    }

    /// `[n]` whether enough points are within the radius.
    fn cores(&self, min_points: u32, watch: &mut Watch<'_>) -> Result<Vec<bool>> {
        let mut is_core = vec![min_points <= 1; self.tree.len()];
        if min_points > 1 {
            let enough = |at: &Vector<T>, _| self.tree.has_within(at, self.radius, min_points);
            self.each("core points", watch, enough, |id, enough| is_core[id as usize] = enough)?;
        }
        Ok(is_core)
    }

    /// `[n]` the smallest core index of the cluster of each core point.
    fn join(&self, is_core: &[bool], watch: &mut Watch<'_>) -> Result<Vec<u32>> {
        let sets = UnionFind::of(is_core);
        let join = |at: &Vector<T>, id: u32| {
            if is_core[id as usize] {
                self.tree.for_each_within(at, self.radius, |other, _| {
                    // Each pair once.
                    if other < id && is_core[other as usize] {
                        sets.join(id, other);
                    }
                });
            }
        };
        self.each("join", watch, join, |_, ()| {})?;
        Ok(sets.roots())
    }

    /// Gives points that are no core points the smallest root of the core points within the radius.
    fn borders(&self, is_core: &[bool], roots: &mut [u32], watch: &mut Watch<'_>) -> Result<()> {
        if is_core.iter().all(|is| *is) {
            return Ok(());
        }
        let mut found = Vec::new();
        let of_cores: &[u32] = roots;
        let smallest = |at: &Vector<T>, id: u32| {
            let mut smallest = labels::NONE;
            if !is_core[id as usize] {
                self.tree.for_each_within(at, self.radius, |other, _| {
                    if is_core[other as usize] {
                        smallest = smallest.min(of_cores[other as usize]);
                    }
                });
            }
            smallest
        };
        self.each("borders", watch, smallest, |id, root| {
            if root != labels::NONE {
                found.push((id, root));
            }
        })?;
        found.into_iter().for_each(|(id, root)| roots[id as usize] = root);
        Ok(())
    }
}
