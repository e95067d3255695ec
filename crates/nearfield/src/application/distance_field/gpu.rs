//! Distance fields of samples on a device, in `f32`.

use glam::Vec3;
use rayon::prelude::*;

use super::cpu::no_pseudonormals;
use super::gpu_run::{GpuDistanceField, Run, Surface, pipeline};
use super::samples::{OrientedSamples, measured_spacing, places, unit_normals};
use super::{DistanceSettings, SignRule};
use crate::Result;
use crate::application::GpuWindingNumber;
use crate::geometry::RegularGrid;
use crate::gpu::Access::{Read, ReadWrite, Uniform};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::query::{FixedRadius, NeighborSearch};
use crate::structure::{AabbTreeSettings, BuildOrder, GpuAabbTree, GpuStructure};

/// Samples of a leaf at most: the nearest is in one of a few leaves.
const LEAF: u32 = 8;

const EVALUATE: [Access; 9] = [Uniform, Read, Read, Uniform, Read, Read, Read, ReadWrite, ReadWrite];

/// Oriented samples on a device, in a tree that was built there.
#[derive(Debug)]
pub struct GpuOrientedSamples {
    gpu: Gpu,
    tree: GpuAabbTree,
    /// `[2n]` position and unit normal by index.
    samples: Buffer<[f32; 4]>,
    points: Vec<Vec3>,
    normals: Vec<[f32; 3]>,
    spacing: f32,
}

impl GpuOrientedSamples {
    /// Copies the samples to the device and builds the tree there.
    ///
    /// # Errors
    /// As [`OrientedSamples::new`] and [`GpuAabbTree::build`].
    pub fn build(gpu: &Gpu, points: &[Vec3], normals: &[Vec3]) -> Result<Self> {
        let normals: Vec<[f32; 3]> = normals.par_iter().map(|n| n.to_array()).collect();
        let normals = unit_normals(points.len(), &normals)?;
        let settings = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert).bucket_size(LEAF);
        let tree = GpuAabbTree::build(gpu, points, &settings)?;
        let quad = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        let both = points.par_iter().zip(&normals).map(|(p, &n)| [quad(p.to_array()), quad(n)]);
        let samples = gpu.upload("oriented samples", both.collect::<Vec<[[f32; 4]; 2]>>().as_flattened())?;
        let queries: Vec<Vec3> = places(points.len()).map(|place| points[place]).collect();
        let diagonal = f64::from(crate::parallel::reduce::bounds(points).diagonal());
        let spacing = measured_spacing(diagonal, queries.len(), |radius| {
            let counts = tree.count(&FixedRadius::new(radius as f32).queries(&queries))?;
            Ok(counts.as_slice().iter().map(|&n| u64::from(n)).sum())
        })?;
        Ok(Self { gpu: gpu.clone(), tree, samples, points: points.to_vec(), normals, spacing: spacing as f32 })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
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
        let run = Run::new(&self.gpu, self.surface(), grid, settings)?;
        let mut stages = run.find_nearest()?;
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
        stages.extend(run.evaluate(&evaluate, &binds, winding.as_ref())?);
        run.finish(stages, settings)
    }

    fn surface(&self) -> Surface<'static> {
        Surface {
            module: "package::application::distance_field::samples",
            accesses: [Uniform, Read, Read],
            binds: self.tree_bindings(),
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
        let points: Vec<[f32; 3]> = self.points.iter().map(|p| p.to_array()).collect();
        let samples = OrientedSamples::new(&points, &self.normals)?;
        let settings = DistanceSettings::default().sign(SignRule::WindingNumber);
        let winding = samples.winding(&settings)?.expect("a winding number should be there where it is asked for");
        GpuWindingNumber::upload(&self.gpu, &winding)
    }
}
