//! The tree in any dimension on the CPU.

use std::time::Instant;

use super::check;
use super::points::PointsN;
use super::settings::AabbTreeNSettings;
use crate::geometry::Scalar;
use crate::structure::BuildStage;
use crate::structure::aabb_tree::build::{self, Item};
use crate::structure::aabb_tree::{BoxN, TreeSearch, TreeShape};
use crate::{Error, Result};

/// Most dimensions of a tree.
pub const MAX_DIMENSION: usize = 16;

/// Points in `D` dimensions, 1 to 16, in the order of a complete binary tree, and the tree's boxes.
///
/// ```
/// use nearfield::{AabbTreeN, AabbTreeNSettings, FixedRadiusN};
///
/// let points = [[0.0f64, 0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0], [9.0, 0.0, 0.0, 0.0, 0.0]];
/// let tree = AabbTreeN::build(&points, &AabbTreeNSettings::default())?;
/// let neighbors = tree.list(&FixedRadiusN::new(0.5).exclude_self())?;
/// assert_eq!((neighbors.row(0), neighbors.row(2)), (&[1][..], &[][..]));
/// # Ok::<(), nearfield::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct AabbTreeN<T, const D: usize> {
    pub(super) settings: AabbTreeNSettings,
    pub(super) shape: TreeShape,
    pub(super) points: PointsN<T, D>,
    /// `[n_nodes]` in breadth-first order.
    pub(super) boxes: Vec<BoxN<T, D>>,
    stages: Vec<BuildStage>,
}

impl<T: Scalar, const D: usize> AabbTreeN<T, D> {
    /// Brings the points into the tree's order, by median splits of the longest side, and fits the boxes.
    ///
    /// More than [`MAX_DIMENSION`] dimensions, or none, do not compile.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateBeyond` (±1e18 in f32, ±1e150 in f64), `TooMany` (2³² − 1 points or more),
    /// `InvalidSetting`.
    pub fn build(points: &[[T; D]], settings: &AabbTreeNSettings) -> Result<Self> {
        const { assert!(1 <= D && D <= MAX_DIMENSION, "a tree has 1 to 16 dimensions") };
        settings.validate()?;
        check::coordinates("points", points)?;
        let start = Instant::now();
        let shape = TreeShape::new(points.len() as u32, settings.bucket_size);
        let mut items: Vec<Item<T, D>> = points.iter().zip(0..).map(|(&position, id)| Item { position, id }).collect();
        build::median_order(&mut items, &shape);
        let order = items.iter().map(|item| item.id).collect();
        drop(items);
        let ordered = PointsN::gather(points, order);
        let boxes = vec![BoxN::EMPTY; shape.n_nodes()];
        let mut tree = Self { settings: *settings, shape, points: ordered, boxes, stages: Vec::new() };
        tree.stages.push(BuildStage::on_host("order", start));
        let start = Instant::now();
        tree.fit();
        tree.stages.push(BuildStage::on_host("fit", start));
        Ok(tree)
    }

    /// The tree of parts that were made elsewhere.
    #[cfg(feature = "gpu")]
    pub(super) fn from_parts(
        settings: AabbTreeNSettings,
        shape: TreeShape,
        points: PointsN<T, D>,
        boxes: Vec<BoxN<T, D>>,
    ) -> Self {
        Self { settings, shape, points, boxes, stages: Vec::new() }
    }

    /// Moves the points and fits the boxes to them, from the leaves up; shape and order stay.
    ///
    /// - `points`: `[n]` new positions in the caller's order
    ///
    /// # Errors
    /// `LengthMismatch`, `NonFinite`, `CoordinateBeyond`: the tree is then as it was.
    pub fn refit(&mut self, points: &[[T; D]]) -> Result<()> {
        check_moved(points, self.points.len())?;
        self.points.move_to(points);
        self.fit();
        Ok(())
    }

    fn fit(&mut self) {
        let points = &self.points;
        build::fit(&self.shape, &mut self.boxes, |places| {
            places.fold(BoxN::EMPTY, |bounds, place| bounds.grown_to(&points.position(place)))
        });
    }

    /// The settings, with the search as it was set last.
    pub fn settings(&self) -> &AabbTreeNSettings {
        &self.settings
    }

    /// Chooses how fixed-radius questions are answered; the tree stays.
    pub fn set_search(&mut self, search: TreeSearch) {
        self.settings.search = search;
    }

    /// The shape of the tree.
    pub fn shape(&self) -> TreeShape {
        self.shape
    }

    /// `[n_nodes]` the boxes in breadth-first order.
    pub fn boxes(&self) -> &[BoxN<T, D>] {
        &self.boxes
    }

    /// `[n]` the points in the tree's order.
    pub fn ordered_points(&self) -> &PointsN<T, D> {
        &self.points
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Times of the build.
    pub fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    /// Bytes held, points included.
    pub fn memory_bytes(&self) -> u64 {
        self.points.memory_bytes() + size_of_val(&self.boxes[..]) as u64
    }
}

/// Checks new positions of `expected` points.
///
/// # Errors
/// `LengthMismatch`, `NonFinite`, `CoordinateBeyond`.
pub(super) fn check_moved<T: Scalar, const D: usize>(points: &[[T; D]], expected: usize) -> Result<()> {
    if points.len() != expected {
        let (found, expected) = (points.len() as u64, expected as u64);
        return Err(Error::LengthMismatch { what: "new positions of the points", found, expected });
    }
    check::coordinates("points", points)
}
