//! The dispatches that fit the boxes of a tree on the device to its points.

use std::sync::Arc;

use super::layout::{AabbNode, TreeLayout};
use super::shape::TreeShape;
use crate::geometry::Period;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::structure::DevicePoint;
use crate::{Error, Result};

/// Nodes that a workgroup takes: those of 8 levels more are then made without leaving it.
const WORKGROUP: u32 = 256;
const RISE: u32 = WORKGROUP.ilog2();

/// Invocations of a workgroup that moves points.
const MOVE_WORKGROUP: u32 = 256;

/// No point that could not be searched.
const NO_BROKEN: [u32; 2] = [0, u32::MAX];

/// Kernels and parameters that follow from the shape of a tree alone.
#[derive(Debug)]
pub(super) struct Fitter {
    shape: TreeShape,
    pub(super) layout: Buffer<TreeLayout>,
    fit_leaves: Arc<Pipeline>,
    fit_levels: Arc<Pipeline>,
    check_points: Arc<Pipeline>,
    move_points: Arc<Pipeline>,
    pub(super) gather_points: Arc<Pipeline>,
    /// From the leaves up: the level that is taken, and how many are made above it.
    plans: Vec<(u32, Buffer<[u32; 4]>)>,
    pub(super) n_points: Buffer<[u32; 4]>,
    /// How many points could not be searched, and the first of them. While there are any, nothing is moved or fitted.
    broken: Buffer<u32>,
    /// Whether a move was recorded whose broken points were not read.
    is_unread: bool,
}

impl Fitter {
    /// # Errors
    /// `Unsupported` for leaves too large for a device that ends long loops; `KernelRejected`, `OutOfDeviceMemory`.
    pub(super) fn new(gpu: &Gpu, shape: TreeShape, period: Period) -> Result<Self> {
        use Access::{Read, ReadWrite, Uniform};
        let largest = shape.leaves().map(|leaf| shape.points(leaf).len()).next().unwrap_or(0) as u64 + 1;
        if let Some(limit) = gpu.limits().loop_rounds.filter(|&limit| largest + 16 > u64::from(limit)) {
            let what = format!("leaves of {largest} points on {}, which ends loops after {limit} rounds,", gpu.name());
            return Err(Error::Unsupported { what, advice: "use a smaller bucket or the CPU" });
        }
        let fit = |entry, accesses: &[Access]| {
            gpu.prepare(&Kernel::new("package::structure::aabb_tree::fit", entry, accesses, WORKGROUP))
        };
        let on_points = |entry, accesses: &[Access]| {
            gpu.prepare(&Kernel {
                constants: &[("WORKGROUP", f64::from(MOVE_WORKGROUP))],
                ..Kernel::new("package::structure::aabb_tree::move_points", entry, accesses, MOVE_WORKGROUP)
            })
        };
        let mut plans = Vec::new();
        let mut level = shape.depth();
        loop {
            let rise = level.min(RISE);
            plans.push((level, gpu.uniform("fit plan", &[level, rise, 0, 0])?));
            level -= rise;
            if level == 0 {
                break;
            }
        }
        Ok(Self {
            shape,
            layout: gpu.uniform("tree layout", &TreeLayout::new(&shape, period))?,
            fit_leaves: fit("fit_leaves", &[Uniform, Uniform, ReadWrite, Read, Read])?,
            fit_levels: fit("fit_levels", &[Uniform, Uniform, ReadWrite, Read])?,
            check_points: on_points("check_points", &[Uniform, Read, ReadWrite])?,
            move_points: on_points("move_points", &[Uniform, Read, Read, Read, ReadWrite])?,
            gather_points: on_points("gather_points", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            plans,
            n_points: gpu.uniform("number of points", &[shape.n_points() as u32, 0, 0, 0])?,
            broken: gpu.upload("broken points", &NO_BROKEN)?,
            is_unread: false,
        })
    }

    /// Records fitting all boxes to points that stand in the tree's order.
    pub(super) fn record(&self, commands: &mut Commands, points: &Buffer<DevicePoint>, nodes: &Buffer<AabbNode>) {
        if self.shape.n_points() == 0 {
            return;
        }
        for (i, (level, plan)) in self.plans.iter().enumerate() {
            let mut binds: Vec<Bind> = vec![plan.into(), (&self.layout).into(), nodes.into(), (&self.broken).into()];
            let mut pipeline = &self.fit_levels;
            if i == 0 {
                pipeline = &self.fit_leaves;
                binds.push(points.into());
            }
            commands.dispatch(pipeline, &binds, Workgroups::Covering(1 << level));
        }
    }

    /// Records moving the points to positions in the caller's order, if all of those can be searched.
    ///
    /// # Errors
    /// As [`Fitter::forget_broken`].
    pub(super) fn record_move(
        &mut self,
        gpu: &Gpu,
        commands: &mut Commands,
        moved: &Buffer<DevicePoint>,
        ids: &Buffer<u32>,
        points: &Buffer<DevicePoint>,
    ) -> Result<()> {
        self.forget_broken(gpu)?;
        self.is_unread = true;
        let covering = Workgroups::Covering(self.shape.n_points() as u64);
        let (n, broken) = (Bind::from(&self.n_points), Bind::from(&self.broken));
        commands.stage("check");
        commands.dispatch(&self.check_points, &[n.clone(), moved.into(), broken.clone()], covering.clone());
        commands.stage("move");
        commands.dispatch(&self.move_points, &[n, moved.into(), broken, ids.into(), points.into()], covering);
        Ok(())
    }

    /// Forgets broken points of a move that failed before they were read; else they would hold back all that comes.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub(super) fn forget_broken(&mut self, gpu: &Gpu) -> Result<()> {
        if self.is_unread {
            gpu.write(&self.broken, 0, &NO_BROKEN)?;
            self.is_unread = false;
        }
        Ok(())
    }

    /// Whether the last move found points that cannot be searched; forgets them.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`: no point was moved then. `DeviceLost`, `OutOfDeviceMemory`.
    pub(super) fn check(&mut self, gpu: &Gpu, moved: &Buffer<DevicePoint>) -> Result<()> {
        let found = gpu.read(&self.broken)?;
        if found[0] == 0 {
            self.is_unread = false;
            return Ok(());
        }
        self.forget_broken(gpu)?;
        let (count, first) = (u64::from(found[0]), found[1] as usize);
        let point = gpu.read_range(moved, first..first + 1)?[0];
        let what = "new positions of the points";
        match (0..3)
            .find(|&axis| point[axis].is_finite() && point[axis].abs() > crate::geometry::validate::MAX_COORDINATE)
        {
            Some(axis) if point[..3].iter().all(|v| v.is_finite()) => Err(Error::CoordinateTooLarge {
                what,
                index: first as u64,
                axis: ['x', 'y', 'z'][axis],
                value: f64::from(point[axis]),
            }),
            _ => Err(Error::NonFinite { what, count, first: first as u64 }),
        }
    }
}
