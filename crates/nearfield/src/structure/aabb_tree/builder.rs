//! The order of the dispatches that build a tree on the device, along the Hilbert curve.
//!
//! Two submissions: bounds of the points, which the host reads to choose the domain of the curve; then keys, sort, gather
//! and boxes.

use glam::Vec3;

use super::fitter::Fitter;
use super::gpu::GpuAabbTree;
use super::settings::{AabbTreeSettings, BuildOrder};
use super::shape::TreeShape;
use crate::curve::{Curve, Domain, GpuCurveOrder};
use crate::geometry::Aabb;
use crate::gpu::{Buffer, Gpu, Workgroups};
use crate::parallel::reduce::{GpuBounds, GpuReduce};
use crate::structure::on_gpu::{DevicePoint, upload_points};
use crate::structure::{AabbTree, BuildStage};
use crate::{Error, Result};

/// Everything that builds of trees of one size share: pipelines and scratch memory. Keep it to build again as points move.
#[derive(Debug)]
pub struct AabbTreeBuilder {
    gpu: Gpu,
    settings: AabbTreeSettings,
    shape: TreeShape,
    reduce: GpuReduce,
    bounds: Buffer<GpuBounds>,
    curve: GpuCurveOrder,
    order: Buffer<u32>,
}

impl AabbTreeBuilder {
    /// A builder for `n_points` points.
    ///
    /// # Errors
    /// `InvalidSetting`; `TooMany` for more than 2³¹ points, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn new(gpu: &Gpu, n_points: usize, settings: &AabbTreeSettings) -> Result<Self> {
        settings.validate()?;
        let curve = GpuCurveOrder::new(gpu, Curve::Hilbert, n_points)?;
        Ok(Self {
            gpu: gpu.clone(),
            settings: *settings,
            shape: TreeShape::new(n_points as u32, settings.bucket_size),
            reduce: GpuReduce::new(gpu)?,
            bounds: gpu.buffer("bounds of points", 1)?,
            curve,
            order: gpu.buffer("order of points", n_points)?,
        })
    }

    /// Builds the tree of these points, which may have moved since the last build.
    ///
    /// With [`BuildOrder::Median`] the points are read back and put in order on the CPU.
    ///
    /// - `points`: `[n]` xyz in the caller's order, the fourth value is not used
    ///
    /// # Errors
    /// `LengthMismatch` for another number of points, `NonFinite`, `CoordinateTooLarge`, `OutOfDeviceMemory`,
    /// `DeviceLost`.
    pub fn build(&mut self, points: &Buffer<DevicePoint>) -> Result<GpuAabbTree> {
        self.check_len(points)?;
        if self.settings.order == BuildOrder::Median {
            let points: Vec<Vec3> = self.gpu.read(points)?.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
            return GpuAabbTree::upload(&self.gpu, &AabbTree::build(&points, &self.settings)?);
        }
        let (bounds, stages) = self.find_bounds(points)?;
        let (gpu, n) = (&self.gpu, self.shape.n_points());
        let fitter = Fitter::new(gpu, self.shape, self.settings.period)?;
        let ordered = gpu.buffer("points of a tree", n)?;
        let ids = gpu.buffer("indices of a tree", n)?;
        let nodes = gpu.buffer("nodes of a tree", self.shape.n_nodes())?;
        let mut tree = GpuAabbTree::from_parts(gpu, self.settings, self.shape, ordered, ids, nodes, fitter, Vec::new());
        self.fill(points, &bounds, stages, &mut tree)?;
        Ok(tree)
    }

    /// Builds the tree of these points in the memory of a tree of as many; its search stays.
    ///
    /// - `points`: `[n]` xyz in the caller's order, the fourth value is not used
    ///
    /// # Errors
    /// As [`AabbTreeBuilder::build`], and `InvalidSetting` for a tree of another shape or period. The tree is then as it
    /// was, but after `DeviceLost`.
    pub fn rebuild(&mut self, points: &Buffer<DevicePoint>, tree: &mut GpuAabbTree) -> Result<()> {
        self.check_len(points)?;
        if tree.shape != self.shape || tree.settings().period != self.settings.period {
            return Err(Error::InvalidSetting {
                setting: "tree to build again",
                found: format!("{:?} with {:?}", tree.shape, tree.settings().period),
                expected: "the shape and the period that the builder was made for",
            });
        }
        if self.settings.order == BuildOrder::Median {
            let search = tree.settings().search;
            *tree = self.build(points)?;
            tree.set_search(search);
            return Ok(());
        }
        let (bounds, stages) = self.find_bounds(points)?;
        self.fill(points, &bounds, stages, tree)
    }

    fn check_len(&self, points: &Buffer<DevicePoint>) -> Result<()> {
        if points.len() == self.shape.n_points() {
            return Ok(());
        }
        let (found, expected) = (points.len() as u64, self.shape.n_points() as u64);
        Err(Error::LengthMismatch { what: "points to build a tree of", found, expected })
    }

    /// Bounds of the points, if all of them can be searched.
    fn find_bounds(&self, points: &Buffer<DevicePoint>) -> Result<(Aabb, Vec<BuildStage>)> {
        let mut commands = self.gpu.commands("bounds of points");
        commands.stage("bounds");
        self.reduce.record_bounds(&mut commands, points, points.len(), &self.bounds)?;
        let found = commands.read_back(&self.bounds)?;
        let stages = commands.run()?.iter().filter_map(BuildStage::on_device).collect();
        Ok((self.searchable_bounds(points, found.values()?[0])?, stages))
    }

    /// Fills the memory of a tree: order, points, nodes and the times of the stages.
    fn fill(
        &mut self,
        points: &Buffer<DevicePoint>,
        bounds: &Aabb,
        mut stages: Vec<BuildStage>,
        tree: &mut GpuAabbTree,
    ) -> Result<()> {
        tree.fitter.forget_broken(&self.gpu)?;
        let (n, fitter) = (points.len(), &tree.fitter);
        let mut commands = self.gpu.commands("aabb tree");
        self.curve.record(&mut commands, &Domain::of_bounds(bounds), points, &self.order, n)?;
        let (n_points, order) = ((&fitter.n_points).into(), (&self.order).into());
        commands.stage("gather").dispatch(
            &fitter.gather_points,
            &[n_points, points.into(), order, (&tree.points).into(), (&tree.ids).into()],
            Workgroups::Covering(n as u64),
        );
        commands.stage("fit");
        fitter.record(&mut commands, &tree.points, &tree.nodes);
        stages.extend(commands.run()?.iter().filter_map(BuildStage::on_device));
        tree.stages = stages;
        Ok(())
    }

    /// The bounds that were found, if all points can be searched.
    fn searchable_bounds(&self, points: &Buffer<DevicePoint>, found: GpuBounds) -> Result<Aabb> {
        let corner = |c: [f32; 4]| Vec3::new(c[0], c[1], c[2]);
        let (bounds, what) = (Aabb::new(corner(found.min), corner(found.max)), "points");
        if found.n_non_finite > 0 {
            let (count, first) = (u64::from(found.n_non_finite), u64::from(found.first_non_finite));
            return Err(Error::NonFinite { what, count, first });
        }
        let limit = crate::geometry::validate::MAX_COORDINATE;
        if !bounds.is_empty() && bounds.min.abs().max(bounds.max.abs()).max_element() > limit {
            // The slow way to the message.
            let points: Vec<Vec3> = self.gpu.read(points)?.iter().map(|p| Vec3::new(p[0], p[1], p[2])).collect();
            crate::geometry::validate::coordinates(what, &points)?;
        }
        Ok(bounds)
    }
}

/// Query points on the device, sorted along the Hilbert curve through the bounds of a tree; queries outside count to the
/// border.
pub(super) fn sorted_queries(
    gpu: &Gpu,
    queries: &[Vec3],
    bounds: &Aabb,
    fitter: &Fitter,
) -> Result<Buffer<DevicePoint>> {
    let n = queries.len();
    let input = upload_points(gpu, "queries", queries, 0)?;
    let curve = GpuCurveOrder::new(gpu, Curve::Hilbert, n)?;
    let order = gpu.buffer("order of queries", n)?;
    let sorted = gpu.buffer("sorted queries", n)?;
    let ids: Buffer<u32> = gpu.buffer("indices of sorted queries", n)?;
    let n_queries = gpu.uniform("number of queries", &[n as u32, 0, 0, 0])?;
    let mut commands = gpu.commands("sort queries");
    curve.record(&mut commands, &Domain::of_bounds(bounds), &input, &order, n)?;
    commands.dispatch(
        &fitter.gather_points,
        &[(&n_queries).into(), (&input).into(), (&order).into(), (&sorted).into(), (&ids).into()],
        Workgroups::Covering(n as u64),
    );
    commands.submit()?;
    Ok(sorted)
}
