//! Which structure to build, by name or by what was measured.
//!
//! A grid has cells of one size, made for the radius: it is the fastest where one radius is asked for. A tree adapts, and
//! is the only one that finds the nearest without a radius. [`choose`] weighs what was asked and how the points fill
//! cells of the radius (`occupancy.rs`), and says why in a sentence.

use std::str::FromStr;

use glam::Vec3;

use super::occupancy::Occupancy;
use super::{FixedRadius, Knn, Radius};
use crate::geometry::Period;
use crate::{Error, Result};

/// Up to this many pairs of query and point, testing all of them beats building anything where a radius is asked for, and where the nearest are. A
/// thousand points of their own set, brute force and the best structure with its build: counts 0.051 and 0.061 ms on an H200, lists 0.191 and
/// 0.083, 16 nearest 0.640 and 0.161; on two cores 0.33 and 0.29, 0.97 and 0.48, 10.3 and 1.7.
const BRUTE_FORCE_PAIRS: u64 = 1 << 18;
const BRUTE_FORCE_PAIRS_OF_NEAREST: u64 = 1 << 14;
/// Largest radius over the median one from which a tree is built: a query of the median radius would be put to cells
/// that hold 64 times as much as its ball.
const VARIED_RADII: f32 = 4.0;
/// Points in the cell of a point over those in an occupied cell, both on average, from which a tree is built. Build and
/// count on two cores, grid and AABB-tree in ms: clustered sets at a ratio of 37: 233 and 131; at 104: 1076 and 688; at
/// 138: 227 and 180; but at 88, where a used cell has 11 points, 161 and 261. Even sets have 1.1 to 3.3, and the grid
/// is as fast or twice as fast there. On an H200 at 37: 0.320 and 0.332; at 104: 3.26 and 2.61.
const UNEVEN: f64 = 32.0;
/// The same on the CPU where a used cell has fewer points than `SPARSE`: at a ratio of 8.9 and 1.8 points 8.6 and 2.4 ms on two cores, but
/// 0.126 and 0.189 on an H200.
const UNEVEN_AND_SPARSE: f64 = 6.0;
const SPARSE: f64 = 4.0;
/// Radii whose median is taken.
const RADII_SAMPLE: usize = 4096;

/// Which structure to build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StructureChoice {
    /// Brute force for a few hundred points; the uniform grid for one radius; else a tree. [`Index::reason`] says why.
    ///
    /// [`Index::reason`]: super::Index::reason
    #[default]
    Auto,
    /// [`BruteForce`](crate::BruteForce).
    BruteForce,
    /// [`UniformGrid`](crate::UniformGrid).
    UniformGrid,
    /// [`LinearOctree`](crate::LinearOctree).
    LinearOctree,
    /// [`AabbTree`](crate::AabbTree).
    AabbTree,
}

impl StructureChoice {
    /// Every structure there is, without `Auto`.
    pub const ALL: [Self; 4] = [Self::BruteForce, Self::UniformGrid, Self::LinearOctree, Self::AabbTree];

    /// The tree that `Auto` builds where cells of one size do not fit.
    const TREE: Self = Self::AabbTree;

    /// The tree that `Auto` builds for the nearest.
    const NEAREST: Self = Self::AabbTree;

    /// The structure's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::BruteForce => "brute-force",
            Self::UniformGrid => "uniform-grid",
            Self::LinearOctree => "linear-octree",
            Self::AabbTree => "aabb-tree",
        }
    }

    /// Whether it finds the nearest points without a radius.
    pub fn finds_nearest(self) -> bool {
        self != Self::UniformGrid
    }
}

impl FromStr for StructureChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        std::iter::once(Self::Auto).chain(Self::ALL).find(|c| c.name() == text).ok_or_else(|| Error::InvalidSetting {
            setting: "structure",
            found: text.into(),
            expected: "auto, brute-force, uniform-grid, linear-octree or aabb-tree",
        })
    }
}

/// The error of a structure that does not find the nearest points without a radius.
pub(super) fn no_radius(structure: &str) -> Error {
    Error::Unsupported {
        what: format!("finding the nearest points without a radius in the structure {structure}"),
        advice: "choose brute-force, linear-octree, aabb-tree or auto, or give a radius too",
    }
}

/// The questions that an index is built for.
#[derive(Debug, Clone, Copy)]
pub enum Purpose<'a> {
    /// All points within a radius.
    FixedRadius(FixedRadius<'a>),
    /// The nearest points.
    Knn(Knn<'a>),
}

impl<'a> From<&FixedRadius<'a>> for Purpose<'a> {
    fn from(question: &FixedRadius<'a>) -> Self {
        Self::FixedRadius(*question)
    }
}

impl<'a> From<&Knn<'a>> for Purpose<'a> {
    fn from(question: &Knn<'a>) -> Self {
        Self::Knn(*question)
    }
}

impl Purpose<'_> {
    /// The largest radius asked for; `None` where there is none.
    pub(super) fn largest_radius(&self) -> Option<f32> {
        match self {
            Self::FixedRadius(question) => Some(question.largest_radius()),
            Self::Knn(question) => question.radius.map(|_| question.as_fixed_radius().largest_radius()),
        }
    }

    fn n_queries(&self, points: usize) -> usize {
        match self {
            Self::FixedRadius(question) => question.len(points),
            Self::Knn(question) => question.as_fixed_radius().len(points),
        }
    }
}

/// What of a device counts for the choice.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Device {
    /// Whether it is a GPU.
    pub(super) is_gpu: bool,
    /// Whether it ends long loops: there the octree counts beforehand how far its loops really go, and the tree takes the worst case.
    pub(super) ends_loops: bool,
}

/// The structure that fits these points and questions, and why, in one sentence.
pub(super) fn choose(
    points: &[Vec3],
    purpose: &Purpose<'_>,
    period: &Period,
    device: Device,
) -> (StructureChoice, String) {
    let (n, n_queries) = (points.len(), purpose.n_queries(points.len()));
    let few = match purpose {
        Purpose::FixedRadius(_) => BRUTE_FORCE_PAIRS,
        Purpose::Knn(_) => BRUTE_FORCE_PAIRS_OF_NEAREST,
    };
    let (structure, why) = if n as u64 * n_queries as u64 <= few {
        (StructureChoice::BruteForce, format!("{n_queries} queries of {n} points are too few to build anything for"))
    } else {
        match purpose {
            Purpose::Knn(Knn { k, radius: None, .. }) if device.ends_loops => (
                StructureChoice::LinearOctree,
                format!("this device ends long loops, and the {k} nearest have no radius to size cells by"),
            ),
            Purpose::Knn(Knn { k, radius: None, .. }) => {
                (StructureChoice::NEAREST, format!("the {k} nearest have no radius to size cells by"))
            }
            Purpose::Knn(Knn { k, .. }) => (
                StructureChoice::NEAREST,
                format!("a tree finds the {k} nearest without testing all within the radius"),
            ),
            Purpose::FixedRadius(question) => by_radius(points, question, period, device),
        }
    };
    (structure, format!("auto chose {}: {why}", structure.name()))
}

fn by_radius(
    points: &[Vec3],
    question: &FixedRadius<'_>,
    period: &Period,
    device: Device,
) -> (StructureChoice, String) {
    let largest = question.largest_radius();
    if let Radius::Each(radii) = question.radius {
        let median = median(radii);
        if largest > VARIED_RADII * median {
            let (largest, median) = (short(largest.into()), short(median.into()));
            return (StructureChoice::TREE, format!("radii vary, the largest is {largest} and the median {median}"));
        }
    }
    let Some(found) = Occupancy::of(points, largest, period) else {
        return (StructureChoice::UniformGrid, "the radius is 0, so cells are sized by density".to_owned());
    };
    let [a_cell, a_point, share] = [found.a_cell, found.a_point, 100.0 * found.share].map(short);
    let (high, most) = (found.high, found.most);
    let is_sparse = !device.is_gpu && found.a_cell < SPARSE;
    let uneven = if is_sparse { UNEVEN_AND_SPARSE } else { UNEVEN };
    if found.a_point > uneven * found.a_cell {
        let why = format!(
            "points fill cells of the radius very unevenly, {a_cell} in a used cell on average but {a_point} in the cell \
             of a point (99 % have at most {high}, the fullest {most})"
        );
        return (StructureChoice::TREE, why);
    }
    let why = format!(
        "points fill cells of the radius evenly enough, {a_cell} in a used cell on average and {a_point} in the cell of a \
         point (99 % have at most {high}), with {share} % of the cells used"
    );
    (StructureChoice::UniformGrid, why)
}

/// The median of a sample of the radii, evenly spaced in their order; 0 without any.
fn median(radii: &[f32]) -> f32 {
    let mut sample: Vec<f32> = radii.iter().copied().step_by(radii.len().div_ceil(RADII_SAMPLE).max(1)).collect();
    let middle = sample.len() / 2;
    if sample.is_empty() { 0.0 } else { *sample.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

/// Three digits are enough for a sentence.
fn short(value: f64) -> String {
    let text = format!("{value:.2e}");
    // Through the number again: 8.20e0 reads better as 8.2.
    text.parse::<f64>()
        .map_or(text.clone(), |v| if (1e-3..1e6).contains(&v) || v == 0.0 { format!("{v}") } else { text })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generate::{CloudKind, cloud};

    fn chosen(points: &[Vec3], purpose: impl Into<Purpose<'static>>) -> (StructureChoice, String) {
        let (structure, reason) = choose(points, &purpose.into(), &Period::NONE, Device::default());
        assert!(reason.starts_with(&format!("auto chose {}: ", structure.name())), "{reason}");
        (structure, reason)
    }

    #[test]
    fn names_are_read_back() {
        for choice in std::iter::once(StructureChoice::Auto).chain(StructureChoice::ALL) {
            assert_eq!(choice.name().parse::<StructureChoice>().unwrap(), choice);
        }
        assert!("tree".parse::<StructureChoice>().is_err());
    }

    #[test]
    fn even_clouds_get_the_grid_and_the_figures() {
        for (kind, radius) in [(CloudKind::Uniform, 0.08), (CloudKind::Shell, 0.1), (CloudKind::Plummer, 0.5)] {
            let (structure, reason) = chosen(&cloud(kind, 20_000, 7).points, &FixedRadius::new(radius));
            assert_eq!(structure, StructureChoice::UniformGrid, "{reason}");
            assert!(reason.contains(" in a used cell on average") && reason.contains("% of the cells"), "{reason}");
        }
    }

    #[test]
    fn clusters_in_emptiness_get_the_tree() {
        // A ball of 0.01 with half of the points, and the other half spread over a cube of 100.
        let mut points = cloud(CloudKind::Uniform, 20_000, 7).points;
        points.iter_mut().step_by(2).for_each(|p| *p *= 0.01);
        points.iter_mut().skip(1).step_by(2).for_each(|p| *p = *p * 100.0 + Vec3::ONE);
        let (structure, reason) = chosen(&points, &FixedRadius::new(0.01));
        assert_eq!(structure, StructureChoice::TREE, "{reason}");
        assert!(reason.contains("unevenly"), "{reason}");
    }

    #[test]
    fn one_outlier_does_not_matter() {
        let mut points = cloud(CloudKind::Uniform, 20_000, 7).points;
        points.push(Vec3::splat(1e6));
        assert_eq!(chosen(&points, &FixedRadius::new(0.08)).0, StructureChoice::UniformGrid);
    }

    #[test]
    fn few_pairs_are_tested_one_by_one() {
        let points = cloud(CloudKind::Uniform, 512, 7).points;
        assert_eq!(chosen(&points, &FixedRadius::new(0.1)).0, StructureChoice::BruteForce);
        assert_eq!(chosen(&points[..128], &Knn::new(3)).0, StructureChoice::BruteForce);
        assert_eq!(chosen(&points[..129], &Knn::new(3)).0, StructureChoice::NEAREST);
        assert_eq!(chosen(&[], &FixedRadius::new(0.1)).0, StructureChoice::BruteForce);
        let more = cloud(CloudKind::Uniform, 513, 7).points;
        assert_eq!(chosen(&more, &FixedRadius::new(0.1)).0, StructureChoice::UniformGrid);
    }

    #[test]
    fn a_gpu_takes_the_grid_for_clusters_that_are_less_dense() {
        let (points, question) = (cloud(CloudKind::Clustered, 10_000, 7).points, FixedRadius::new(0.0093));
        let on = |is_gpu| {
            let device = Device { is_gpu, ends_loops: false };
            choose(&points, &(&question).into(), &Period::NONE, device).0
        };
        assert_eq!((on(false), on(true)), (StructureChoice::TREE, StructureChoice::UniformGrid));
    }

    #[test]
    fn the_nearest_and_radii_that_vary_get_the_tree() {
        let points = cloud(CloudKind::Uniform, 2000, 7).points;
        for question in [Knn::new(8), Knn::new(8).within(0.1)] {
            let (structure, reason) = chosen(&points, &question);
            assert!(structure == StructureChoice::NEAREST && reason.contains("the 8 nearest"), "{reason}");
        }
        let by = |ratio: f32| (0..2000).map(|i| if i % 3 == 0 { 0.02 * ratio } else { 0.02 }).collect::<Vec<f32>>();
        let choice =
            |radii: &[f32]| choose(&points, &(&FixedRadius::each(radii)).into(), &Period::NONE, Device::default());
        assert_eq!(choice(&by(3.9)).0, StructureChoice::UniformGrid);
        let (structure, reason) = choice(&by(5.0));
        assert!(
            structure == StructureChoice::TREE && reason.contains("the largest is 0.1 and the median 0.02"),
            "{reason}"
        );
        assert_eq!(choice(&vec![0.0; 2000]).0, StructureChoice::UniformGrid);
    }

    #[test]
    fn bad_radii_are_left_to_the_question() {
        let points = cloud(CloudKind::Uniform, 2000, 7).points;
        for radius in [f32::NAN, -1.0, f32::INFINITY] {
            assert_eq!(chosen(&points, &FixedRadius::new(radius)).0, StructureChoice::UniformGrid);
        }
    }
}
