//! The tree in any dimension on the GPU: built on the CPU and copied, fitted to moving points on the device.
//!
//! In device memory a place is a row of ⌈D / 4⌉ vectors of four numbers, filled up with zeros: loads are whole vectors, no
//! array is indexed by axis, and zeros add nothing to a distance. A box is two rows.

use std::time::Instant;

use super::tree::check_moved;
use super::{AabbTreeN, AabbTreeNSettings, PointsN};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Workgroups};
use crate::structure::BuildStage;
use crate::structure::aabb_tree::{BoxN, TreeSearch, TreeShape};
use crate::{Error, Result};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 128;

/// Vectors of four numbers that a place takes on the device.
pub fn row_vectors(dimension: usize) -> usize {
    dimension.div_ceil(4)
}

/// Places as rows on the device.
pub(crate) fn rows_of<const D: usize>(places: &[[f32; D]]) -> Vec<[f32; 4]> {
    let vector = |place: &[f32; D], first: usize| std::array::from_fn(|i| place.get(first + i).copied().unwrap_or(0.0));
    places.iter().flat_map(|place| (0..D).step_by(4).map(|first| vector(place, first))).collect()
}

/// A place from its row.
fn place_of<const D: usize>(row: &[[f32; 4]]) -> [f32; D] {
    std::array::from_fn(|axis| row[axis / 4][axis % 4])
}

/// Points in up to 16 dimensions, a number given at run time, and the boxes over them on the GPU, in f32.
///
/// Shape and order are those of [`AabbTreeN`]. It answers by the searches `Primary` and `Coherent`; on the device there
/// is no search `Packed`.
#[derive(Debug)]
pub struct GpuAabbTreeN {
    gpu: Gpu,
    dimension: usize,
    settings: AabbTreeNSettings,
    shape: TreeShape,
    /// `[n × row]` in the tree's order.
    points: Buffer<[f32; 4]>,
    /// `[n]` the caller's index of the point at each place, there and here.
    ids: Buffer<u32>,
    order: Vec<u32>,
    /// `[n_nodes × 2 × row]` smallest and largest corners in breadth-first order.
    boxes: Buffer<[f32; 4]>,
    stages: Vec<BuildStage>,
}

impl GpuAabbTreeN {
    /// Builds the tree on the CPU and copies it to the device.
    ///
    /// # Errors
    /// As [`AabbTreeN::build`] and [`GpuAabbTreeN::upload`].
    pub fn build<const D: usize>(gpu: &Gpu, points: &[[f32; D]], settings: &AabbTreeNSettings) -> Result<Self> {
        Self::upload(gpu, &AabbTreeN::build(points, settings)?)
    }

    /// Copies a tree to the device.
    ///
    /// # Errors
    /// `Unsupported` for the search `Packed`, which is the default on the CPU only; on devices that end long loops also for
    /// more points than one query may have to test there. `OutOfDeviceMemory`, `DeviceLost`.
    pub fn upload<const D: usize>(gpu: &Gpu, tree: &AabbTreeN<f32, D>) -> Result<Self> {
        let settings = *tree.settings();
        check_search(settings.search)?;
        check_loops(gpu, &tree.shape())?;
        let start = Instant::now();
        let points = tree.ordered_points();
        let positions: Vec<[f32; D]> = (0..points.len()).map(|place| points.position(place)).collect();
        let corners: Vec<[f32; D]> = tree.boxes().iter().flat_map(|node| [node.min, node.max]).collect();
        let made = Self {
            gpu: gpu.clone(),
            dimension: D,
            settings,
            shape: tree.shape(),
            points: gpu.upload("points of the tree", &rows_of(&positions))?,
            ids: gpu.upload("indices of the tree's points", points.ids())?,
            order: points.ids().to_vec(),
            boxes: gpu.upload("boxes of the tree", &rows_of(&corners))?,
            stages: Vec::new(),
        };
        let mut stages = tree.build_stages().to_vec();
        stages.push(BuildStage::on_host("upload", start));
        Ok(Self { stages, ..made })
    }

    /// Copies moved points to the device and fits the boxes to them there, level by level; shape and order stay. Returns
    /// the times of the stages "upload", "gather" and "fit", those on the device where it has a clock.
    ///
    /// - `points`: `[n]` new positions in the caller's order
    ///
    /// # Errors
    /// `InvalidSetting` for another dimension, `LengthMismatch`, `NonFinite`, `CoordinateBeyond`: the tree is then as it
    /// was. `OutOfDeviceMemory`, `DeviceLost`.
    pub fn refit<const D: usize>(&mut self, points: &[[f32; D]]) -> Result<Vec<BuildStage>> {
        self.check_dimension(D)?;
        check_moved(points, self.len())?;
        let start = Instant::now();
        let moved = self.gpu.upload("moved points", &rows_of(points))?;
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        let mut commands = self.gpu.commands("refit");
        commands.stage("gather");
        let n_points = self.shape.n_points() as u32;
        let binds = [(&moved).into(), (&self.ids).into(), (&self.points).into()];
        let accesses = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        self.record(&mut commands, ("gather", "gather_points"), &accesses, ([n_points, 0, 0, 0], n_points), &binds)?;
        commands.stage("fit");
        for level in (0..=self.shape.depth()).rev() {
            let nodes = self.shape.level(level);
            let parameters = [n_points, self.shape.depth(), nodes.start as u32, nodes.len() as u32];
            let (entry, binds, accesses): (_, &[Bind], &[Access]) = match level == self.shape.depth() {
                true => (
                    "fit_leaves",
                    &[(&self.boxes).into(), (&self.points).into()],
                    &[Access::Uniform, Access::ReadWrite, Access::Read],
                ),
                false => ("fit_level", &[(&self.boxes).into()], &[Access::Uniform, Access::ReadWrite]),
            };
            self.record(&mut commands, ("fit", entry), accesses, (parameters, nodes.len() as u32), binds)?;
        }
        let times = commands.run()?;
        let mut stages = vec![BuildStage { name: "upload", milliseconds, on_device: false }];
        stages.extend(times.iter().filter_map(BuildStage::on_device));
        Ok(stages)
    }

    /// Records a kernel of this folder with an invocation for each vector of `rows` rows.
    fn record(
        &self,
        commands: &mut Commands,
        (module, entry): (&str, &str),
        accesses: &[Access],
        (parameters, rows): ([u32; 4], u32),
        binds: &[Bind],
    ) -> Result<()> {
        let module = format!("package::structure::aabb_tree::any_dimension::{module}");
        let constants = [("WORKGROUP", f64::from(WORKGROUP)), ("DIMENSION", self.dimension as f64)];
        let kernel = Kernel { constants: &constants, ..Kernel::new(&module, entry, accesses, WORKGROUP) };
        let parameters = self.gpu.uniform("parameters of a refit", &parameters)?;
        let binds: Vec<Bind> = std::iter::once((&parameters).into()).chain(binds.iter().cloned()).collect();
        let invocations = u64::from(rows) * row_vectors(self.dimension) as u64;
        commands.dispatch(&self.gpu.prepare(&kernel)?, &binds, Workgroups::Covering(invocations));
        Ok(())
    }

    /// The same tree on the host: a copy of everything.
    ///
    /// # Errors
    /// `InvalidSetting` for another dimension; `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn read<const D: usize>(&self) -> Result<AabbTreeN<f32, D>> {
        self.check_dimension(D)?;
        let row = row_vectors(D);
        let mut positions = vec![[0.0; D]; self.len()];
        for (row, &id) in self.gpu.read(&self.points)?.chunks_exact(row).zip(&self.order) {
            positions[id as usize] = place_of(row);
        }
        let corners = self.gpu.read(&self.boxes)?;
        let node = |rows: &[[f32; 4]]| BoxN { min: place_of(&rows[..row]), max: place_of(&rows[row..]) };
        let boxes = corners.chunks_exact(2 * row).map(node).collect();
        let points = PointsN::gather(&positions, self.order.clone());
        Ok(AabbTreeN::from_parts(self.settings, self.shape, points, boxes))
    }

    /// Checks that a question is one of this tree's dimension.
    ///
    /// # Errors
    /// `InvalidSetting`.
    pub(crate) fn check_dimension(&self, dimension: usize) -> Result<()> {
        if dimension == self.dimension {
            return Ok(());
        }
        Err(Error::InvalidSetting {
            setting: "dimension",
            found: format!("{dimension} for a tree of {} dimensions", self.dimension),
            expected: "the dimension that the tree was built with",
        })
    }

    /// Chooses how fixed-radius questions are answered; the tree stays.
    ///
    /// # Errors
    /// `Unsupported` for `Packed`.
    pub fn set_search(&mut self, search: TreeSearch) -> Result<()> {
        check_search(search)?;
        self.settings.search = search;
        Ok(())
    }

    /// The settings, with the search as it was set last.
    pub fn settings(&self) -> &AabbTreeNSettings {
        &self.settings
    }

    /// Number of dimensions.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// The shape of the tree.
    pub fn shape(&self) -> TreeShape {
        self.shape
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// `[n × ⌈D / 4⌉]` the points in the tree's order.
    pub fn points(&self) -> &Buffer<[f32; 4]> {
        &self.points
    }

    /// `[n]` the caller's index of the point at each place.
    pub fn ids(&self) -> &Buffer<u32> {
        &self.ids
    }

    /// The same on the host.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// `[n_nodes × 2 × ⌈D / 4⌉]` smallest and largest corners in breadth-first order.
    pub fn boxes(&self) -> &Buffer<[f32; 4]> {
        &self.boxes
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.shape.n_points()
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Times of the build.
    pub fn build_stages(&self) -> &[BuildStage] {
        &self.stages
    }

    /// Bytes held on the device, points included.
    pub fn memory_bytes(&self) -> u64 {
        self.points.bytes() + self.ids.bytes() + self.boxes.bytes()
    }
}

fn check_search(search: TreeSearch) -> Result<()> {
    if search != TreeSearch::Packed {
        return Ok(());
    }
    Err(Error::Unsupported {
        what: "the search packed on a device in any dimension".into(),
        advice: "choose primary or coherent, or search on the CPU",
    })
}

/// Loop rounds of a kernel beside those that points and nodes take: ways along the levels, and the queries of a pack.
const OTHER_ROUNDS: u64 = 1024;

/// Where a device ends long loops, checks that none of the kernels takes so many: a search looks at each node three times
/// at most on its way to a leaf and once on its way back, and at each point once, in one loop, whatever others in step do.
fn check_loops(gpu: &Gpu, shape: &TreeShape) -> Result<()> {
    let Some(limit) = gpu.limits().loop_rounds else { return Ok(()) };
    let rounds = shape.n_points() as u64 + 4 * shape.n_nodes() as u64 + OTHER_ROUNDS;
    if rounds <= u64::from(limit) {
        return Ok(());
    }
    Err(Error::Unsupported {
        what: format!(
            "a search of {} points and {} nodes on {}, which ends the loops of a kernel after {limit} rounds,",
            shape.n_points(),
            shape.n_nodes(),
            gpu.name()
        ),
        advice: "use the CPU, fewer points or larger buckets",
    })
}
