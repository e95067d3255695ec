//! Normals on the device: a visitor for the plane, and for the jet a second one over the same neighbours.

use bytemuck::cast_slice;
use glam::Vec3;

use super::{Neighborhood, NormalMethod, NormalSettings, Normals};
use crate::Result;
use crate::application::{Length, PointFlags};
use crate::geometry::validate;
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::query::{DeviceQueries, Knn, Queries, Report, VisitorModule, record_module, visit_nearest};
use crate::structure::{
    AabbTreeN, AabbTreeNSettings, AabbTreeSettings, GpuAabbTree, GpuStructure, GpuUniformGrid, GridSettings,
};

/// Rounds of Jacobi's sweeps in `finish` of the plane.
const PLANE_ROUNDS: u64 = 6;
/// Rounds of the solver in `finish` of the jet; twin of `SOLVE_ROUNDS` in quadratic_height.wesl.
const JET_ROUNDS: u64 = 200;

/// Normals that stay on the device.
#[derive(Debug)]
pub struct GpuNormals {
    /// `[q]` normal and surface variation by index of the query; see [`Normals`].
    pub planes: Buffer<[f32; 4]>,
    /// `[q]` the larger and the smaller principal curvature; one place without meaning but by [`NormalMethod::Jet`].
    pub curvatures: Buffer<[f32; 2]>,
    /// `[q]` bits of [`PointFlags`].
    pub flags: Buffer<u32>,
    method: NormalMethod,
    weighting: Buffer<[f32; 4]>,
}

impl GpuNormals {
    /// Normals of `q` queries from the points within their radius.
    ///
    /// - `queries`: with slots from 0 to q − 1; their own radii where each has one. The neighbourhood of the settings does not
    ///   matter
    ///
    /// # Errors
    /// `InvalidRadius`; `Unsupported` where the device would end the kernel's loops; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn within<S: GpuStructure>(
        structure: &S,
        queries: &DeviceQueries<'_>,
        settings: &NormalSettings,
    ) -> Result<Self> {
        let gpu = structure.gpu();
        let settings = settings.within(Length::Absolute(f64::from(queries.radius)));
        let made = Self::new(gpu, queries.points.len(), &settings)?;
        let mut commands = gpu.commands("normals");
        made.each_pass(|name, visitor| {
            commands.stage(name);
            record_module(&mut commands, structure, queries, visitor)
        })?;
        commands.run()?;
        Ok(made)
    }

    /// Normals of the points of a tree, or at other places, from so many nearest points, and what ran.
    ///
    /// # Errors
    /// `InvalidSetting` with too few; `NonFinite` or `CoordinateTooLarge` for queries; `Unsupported` for trees with periodic
    /// axes and where the device would end the kernel's loops; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn nearest(
        tree: &GpuAabbTree,
        queries: Queries<'_>,
        k: u32,
        settings: &NormalSettings,
    ) -> Result<(Self, Report)> {
        let settings = settings.nearest(k);
        settings.validate()?;
        let question = Knn { queries, ..Knn::new(k) };
        let n = match queries {
            Queries::Points => GpuStructure::len(tree),
            Queries::Other(queries) => queries.len(),
        };
        let made = Self::new(tree.gpu(), n, &settings)?;
        let mut report = Report::default();
        made.each_pass(|_, visitor| {
            let pass = visit_nearest(tree, &question, visitor)?;
            let stages = std::mem::take(&mut report.stages);
            report = Report { stages: [stages, pass.stages.clone()].concat(), ..pass };
            Ok(())
        })?;
        Ok((made, report))
    }

    fn new(gpu: &Gpu, n: usize, settings: &NormalSettings) -> Result<Self> {
        let is_jet = settings.method == NormalMethod::Jet;
        let weighted = if settings.weighted { 1.0 } else { 0.0 };
        Ok(Self {
            planes: gpu.buffer("normals", n)?,
            curvatures: gpu.buffer("curvatures", if is_jet { n } else { 1 })?,
            flags: gpu.buffer("point flags", n)?,
            method: settings.method,
            weighting: gpu.uniform("weighting", &[weighted, 1.0 / settings.support2() as f32, 0.0, 0.0])?,
        })
    }

    /// Runs the visitors one after the other.
    fn each_pass(&self, mut run: impl FnMut(&'static str, &VisitorModule<'_>) -> Result<()>) -> Result<()> {
        let mut bindings: Vec<(Access, Bind)> = vec![
            (Access::Uniform, (&self.weighting).into()),
            (Access::ReadWrite, (&self.planes).into()),
            (Access::ReadWrite, (&self.flags).into()),
        ];
        let module = "package::application::normals::plane";
        run(
            "planes",
            &VisitorModule { module, features: &[], bindings: &bindings, rounds: [0, PLANE_ROUNDS], combines: false },
        )?;
        if self.method == NormalMethod::Jet {
            bindings.push((Access::ReadWrite, (&self.curvatures).into()));
            let module = "package::application::normals::jet";
            run(
                "jets",
                &VisitorModule { module, features: &[], bindings: &bindings, rounds: [0, JET_ROUNDS], combines: false },
            )?;
        }
        Ok(())
    }

    /// Reads everything back.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read(&self, gpu: &Gpu) -> Result<Normals<f32>> {
        let planes = gpu.read(&self.planes)?;
        let curvatures = match self.method {
            NormalMethod::Pca => Vec::new(),
            NormalMethod::Jet => gpu.read(&self.curvatures)?,
        };
        Ok(Normals {
            vectors: planes.iter().map(|&[x, y, z, _]| [x, y, z]).collect(),
            variation: planes.iter().map(|plane| plane[3]).collect(),
            curvatures,
            flags: gpu.read(&self.flags)?.into_iter().map(PointFlags).collect(),
        })
    }
}

/// Normals of points by the device: over a tree of boxes for the nearest points, over a grid for those within a radius. The
/// answer is that of [`super::estimate_normals`], up to rounding and the side of each normal.
///
/// # Errors
/// `InvalidSetting` for the settings or the radius; `NonFinite`, `CoordinateTooLarge`; `Unsupported` where the device would end
/// the kernel's loops; `OutOfDeviceMemory`, `DeviceLost`.
pub fn estimate_normals_on_gpu(gpu: &Gpu, points: &[Vec3], settings: &NormalSettings) -> Result<Normals<f32>> {
    settings.validate()?;
    validate::points(points)?;
    match settings.neighborhood {
        _ if points.is_empty() => Ok(Normals::default()),
        Neighborhood::Nearest(k) => {
            let tree = GpuAabbTree::build(gpu, points, &AabbTreeSettings::DEFAULT)?;
            GpuNormals::nearest(&tree, Queries::Points, k, settings)?.0.read(gpu)
        }
        Neighborhood::Within(length) => {
            let radius = resolve(length, points)?;
            let grid = GpuUniformGrid::build(gpu, points, &GridSettings::for_radius(radius))?;
            let queries = DeviceQueries::new(grid.points(), radius);
            GpuNormals::within(&grid, &queries, settings)?.read(gpu)
        }
    }
}

/// The radius in the unit of the points. Only relative ones need a tree.
fn resolve(length: Length, points: &[Vec3]) -> Result<f32> {
    let of_tree: &[[f32; 3]] = match length {
        Length::Absolute(_) => &[],
        Length::Percent(_) | Length::Spacings(_) => cast_slice(points),
    };
    let tree = AabbTreeN::build(of_tree, &AabbTreeNSettings::default())?;
    Ok(length.resolve("radius", &tree)? as f32)
}
