//! Winding numbers on a device, in `f32`, by the tree that was built on the CPU.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::WindingNumber;
use super::tree::{Elements, Node};
use crate::geometry::validate;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::structure::{DevicePoint, upload_points};
use crate::{Error, Result};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 64;

/// What kernels know of the tree, in the bytes of a uniform. `evaluate.wesl` has the twin.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct WindingLayout {
    /// The middle of the elements.
    pub center: [f32; 3],
    /// One over half their diagonal.
    pub scale: f32,
    /// Samples or triangles.
    pub n_elements: u32,
    /// Level of the leaves.
    pub depth: u32,
    /// 1 where the elements are triangles.
    pub triangles: u32,
    /// Unused.
    pub padding: u32,
}

/// A [`WindingNumber`] on a device.
#[derive(Debug)]
pub struct GpuWindingNumber {
    gpu: Gpu,
    layout: Buffer<WindingLayout>,
    expansions: Buffer<[f32; 4]>,
    elements: Buffer<[f32; 4]>,
    kernel: Arc<Pipeline>,
    unfinished: Buffer<u32>,
    n_elements: usize,
}

impl GpuWindingNumber {
    /// Bindings of the tree in kernels that import `evaluate.wesl`: 1 to 3 of the first group.
    pub(crate) const ACCESSES: [Access; 3] = [Access::Uniform, Access::Read, Access::Read];

    /// Copies the tree to the device.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `KernelRejected`, `DeviceLost`.
    pub fn upload(gpu: &Gpu, winding: &WindingNumber<f32>) -> Result<Self> {
        let layout = WindingLayout {
            center: winding.unit.center.map(|x| x as f32),
            scale: winding.unit.scale as f32,
            n_elements: winding.len() as u32,
            depth: winding.shape.depth(),
            triangles: u32::from(matches!(winding.elements, Elements::Triangles(_))),
            padding: 0,
        };
        let expansions: Vec<[f32; 4]> = winding.nodes.iter().flat_map(packed).collect();
        let quad = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        let elements: Vec<[f32; 4]> = match &winding.elements {
            Elements::Dipoles(dipoles) => dipoles.iter().flatten().copied().map(quad).collect(),
            Elements::Triangles(triangles) => triangles.iter().flatten().copied().map(quad).collect(),
        };
        let [layout_access, nodes, places] = Self::ACCESSES;
        let accesses =
            [Access::Uniform, layout_access, nodes, places, Access::Read, Access::ReadWrite, Access::ReadWrite];
        let kernel = gpu.prepare(&Kernel {
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            features: &[("short_loops", gpu.limits().loop_rounds.is_some())],
            ..Kernel::new("package::application::winding_number::at_each", "winding_numbers", &accesses, WORKGROUP)
        })?;
        Ok(Self {
            gpu: gpu.clone(),
            layout: gpu.uniform("layout of a winding number", &layout)?,
            expansions: gpu.upload("expansions of a winding number", &expansions)?,
            elements: gpu.upload("elements of a winding number", &elements)?,
            kernel,
            unfinished: gpu.upload("unfinished winding numbers", &[0])?,
            n_elements: winding.len(),
        })
    }

    /// The tree as kernels that import `evaluate.wesl` have it bound.
    pub(crate) fn bindings(&self) -> [Bind; 3] {
        [(&self.layout).into(), (&self.expansions).into(), (&self.elements).into()]
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Number of samples or triangles.
    pub fn len(&self) -> usize {
        self.n_elements
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Records the winding number at each query into `numbers`, by slot; queries with slots from their number on are left
    /// out. Neighbouring queries should lie near each other. Once the commands have run, [`GpuWindingNumber::check`]
    /// tells whether the device has followed all of them to their end.
    ///
    /// # Errors
    /// `LengthMismatch` with less room than queries, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn record(&self, commands: &mut Commands, queries: &Buffer<DevicePoint>, numbers: &Buffer<f32>) -> Result<()> {
        if numbers.len() < queries.len() {
            let (found, expected) = (numbers.len() as u64, queries.len() as u64);
            return Err(Error::LengthMismatch { what: "the buffer of winding numbers", found, expected });
        }
        let parameters = self.gpu.uniform("winding parameters", &[queries.len() as u32, 0, 0, 0])?;
        let [layout, nodes, elements] = self.bindings();
        let binds =
            [(&parameters).into(), layout, nodes, elements, queries.into(), numbers.into(), (&self.unfinished).into()];
        commands.dispatch(&self.kernel, &binds, Workgroups::Covering(queries.len() as u64));
        Ok(())
    }

    /// Whether everything that was recorded and has run was followed to its end.
    ///
    /// # Errors
    /// `Unsupported` where the device has ended loops early, as software devices do with many elements; `DeviceLost`.
    pub fn check(&self) -> Result<()> {
        match self.gpu.read(&self.unfinished)?[0] {
            0 => Ok(()),
            unfinished => Err(Error::Unsupported {
                what: format!(
                    "{unfinished} winding numbers of {} elements on {}, which would have ended their loops,",
                    self.n_elements,
                    self.gpu.name()
                ),
                advice: "use the CPU",
            }),
        }
    }

    /// The winding numbers at `[q]` places.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`; as [`GpuWindingNumber::record`] and [`GpuWindingNumber::check`].
    pub fn at_each(&self, queries: &[Vec3]) -> Result<Vec<f32>> {
        validate::coordinates("queries", queries)?;
        let on_device = upload_points(&self.gpu, "queries", queries, 0)?;
        let numbers = self.gpu.buffer("winding numbers", queries.len())?;
        let mut commands = self.gpu.commands("winding numbers");
        self.record(&mut commands, &on_device, &numbers)?;
        commands.submit()?;
        self.check()?;
        self.gpu.read(&numbers)
    }
}

/// A node in the order that `field` in evaluate.wesl takes it apart.
fn packed(node: &Node<f32>) -> [[f32; 4]; 6] {
    let [x, y, z] = node.center;
    let [mx, my, mz] = node.moments.first;
    let [xx, yy, zz, xy, xz, yz] = node.moments.second;
    let [xxx, yyy, zzz, xxy, xxz, xyy, yyz, xzz, yzz, xyz] = node.moments.third;
    [
        [x, y, z, node.reach2],
        [mx, my, mz, xx],
        [yy, zz, xy, xz],
        [yz, xxx, yyy, zzz],
        [xxy, xxz, xyy, yyz],
        [xzz, yzz, xyz, 0.0],
    ]
}
