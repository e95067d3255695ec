//! Distance fields of samples on a device, in `f32`.

use super::cpu::no_pseudonormals;
use super::gpu_run::{GpuDistanceField, Run, Surface, pipeline};
use super::gpu_spacing::spacing;
use super::read_field::with_memory;
use super::samples::{OrientedSamples, check_normals, unit_normal};
use super::{DistanceSettings, SignRule};
use crate::Result;
use crate::application::GpuWindingNumber;
use crate::geometry::{DistanceGrid, RegularGrid};
use crate::gpu::Access::{Read, ReadWrite, Uniform};
use crate::gpu::{Access, Bind, Buffer, Gpu, Workgroups};
use crate::structure::{AabbTreeSettings, BuildOrder, GpuAabbTree, GpuStructure};
use glam::Vec3;

/// Samples of a leaf at most: the nearest is in one of a few leaves.
const LEAF: u32 = 8;

const FIT: [Access; 6] = [Uniform, Read, ReadWrite, Uniform, Read, Read];
const EVALUATE: [Access; 9] = [Uniform, Read, Read, Uniform, Read, Read, Read, ReadWrite, ReadWrite];

/// Oriented samples on a device, in a tree that was built there.
#[derive(Debug)]
pub struct GpuOrientedSamples {
    gpu: Gpu,
    tree: GpuAabbTree,
    /// `[2n]` position and unit normal by index.
    samples: Buffer<[f32; 4]>,
    /// `[nodes]` what the samples of each node are between: `Patch` in patches.wesl.
    patches: Buffer<[[f32; 4]; 4]>,
    spacing: f32,
}

impl GpuOrientedSamples {
    /// Copies the samples to the device and builds the tree there, with 64 bytes more for each of its nodes.
    ///
    /// # Errors
    /// As [`OrientedSamples::new`] and [`GpuAabbTree::build`]; `OutOfDeviceMemory` also where those bytes do not fit one binding, `Unsupported` where
    /// the device would end the loops of a kernel, `KernelRejected`.
    pub fn build(gpu: &Gpu, points: &[Vec3], normals: &[Vec3]) -> Result<Self> {
        check_normals::<f32, Vec3>(points.len(), normals)?;
        let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert).bucket_size(LEAF);
        let tree = GpuAabbTree::build(gpu, points, &settings)?;
        let samples = gpu.upload_with("oriented samples", 2 * points.len(), |i| {
            let [x, y, z] = match i % 2 {
                0 => points[i / 2].to_array(),
                _ => unit_normal(normals[i / 2].to_array()).unwrap_or_default(),
            };
            [x, y, z, 0.0]
        })?;
        let patches = gpu.buffer("patches of samples", tree.shape().n_nodes())?;
        let mut samples = Self { gpu: gpu.clone(), tree, samples, patches, spacing: 0.0 };
        samples.fit_patches()?;
        let diagonal = f64::from(crate::parallel::reduce::bounds(points).diagonal());
        samples.spacing = spacing(gpu, &samples.samples, &samples.tree_bindings(), diagonal)? as f32;
        Ok(samples)
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.tree.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// As [`OrientedSamples::spacing`].
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// The field over a grid whose origin is that of the samples, left on the device.
    ///
    /// # Errors
    /// As [`OrientedSamples::distance_field`]; `OutOfDeviceMemory` (4 bytes a node must fit one binding, twice),
    /// `Unsupported` on software devices that would end loops, `KernelRejected`, `DeviceLost`.
    pub fn distance_field(&self, grid: &RegularGrid, settings: &DistanceSettings) -> Result<GpuDistanceField> {
        settings.validate(grid)?;
        if settings.sign == Some(SignRule::Pseudonormal) {
            return Err(no_pseudonormals());
        }
        let run = Run::new(&self.gpu, self.surface(), grid, settings)?.find_nearest()?;
        let [layout, points, nodes] = self.tree_bindings();
        let binds = [
            (&run.parameters).into(),
            (&run.axes).into(),
            (&self.samples).into(),
            layout,
            points,
            nodes,
            (&run.nearest).into(),
            (&run.values).into(),
            (&run.outcome).into(),
        ];
        let evaluate = pipeline(&self.gpu, "evaluate", "evaluate_distances", &EVALUATE, &[], &[])?;
        let winding = (settings.sign == Some(SignRule::WindingNumber)).then(|| self.winding()).transpose()?;
        run.evaluate(&evaluate, &binds, winding.as_ref())?.finish(settings)
    }

    /// The distances of a field on the host: those of [`GpuOrientedSamples::distance_field`] read back, but sooner, since their
    /// memory is made ready while the device computes.
    ///
    /// # Errors
    /// As [`GpuOrientedSamples::distance_field`] and [`GpuDistanceField::read_distances`].
    pub fn distances(&self, grid: &RegularGrid, settings: &DistanceSettings) -> Result<DistanceGrid> {
        settings.validate(grid)?;
        with_memory(grid, || self.distance_field(grid, settings))
    }

    /// Lets the device find what the samples of each node are between.
    fn fit_patches(&self) -> Result<()> {
        let gpu = &self.gpu;
        let n_nodes = self.patches.len() as u64;
        let fit = pipeline(gpu, "patches", "fit_patches", &FIT, &[], &[])?;
        let count = gpu.uniform("number of patches", &[n_nodes as u32, 0, 0, 0])?;
        let [layout, points, nodes] = self.tree_bindings();
        let binds = [(&count).into(), (&self.samples).into(), (&self.patches).into(), layout, points, nodes];
        let mut commands = gpu.commands("patches of samples");
        commands.dispatch(&fit, &binds, Workgroups::Covering(n_nodes));
        commands.submit()
    }

    fn surface(&self) -> Surface<'static> {
        let [layout, points, _] = self.tree_bindings();
        Surface {
            module: "package::application::distance_field::samples",
            accesses: [Uniform, Read, Read],
            binds: [layout, points, (&self.patches).into()],
            features: &[],
            what: "samples",
            n: self.len(),
            spacing: self.spacing,
        }
    }

    /// Layout, points and nodes of the tree: bindings 3 to 5 of all kernels here.
    fn tree_bindings(&self) -> [Bind; 3] {
        let binds: Vec<Bind> = self.tree.bindings().into_iter().map(|(_, bind)| bind).collect();
        binds.try_into().expect("a tree should have three bindings")
    }

    /// The tree of the winding number of the samples, built on the CPU.
    fn winding(&self) -> Result<GpuWindingNumber> {
        let samples = self.gpu.read(&self.samples)?;
        let every_second = |first: usize| samples[first.min(samples.len())..].iter().step_by(2);
        let xyz = |&[x, y, z, _]: &[f32; 4]| [x, y, z];
        let [points, normals] = [0, 1].map(|first| every_second(first).map(xyz).collect::<Vec<[f32; 3]>>());
        let samples = OrientedSamples::new(&points, &normals)?;
        let settings = DistanceSettings::default().sign(SignRule::WindingNumber);
        let winding = samples.winding(&settings)?.expect("a winding number should be there where it is asked for");
        GpuWindingNumber::upload(&self.gpu, &winding)
    }
}
