//! Distance fields of triangle meshes on a device, in `f32`.

use glam::DVec3;

use super::gpu_run::{GpuDistanceField, Run, Surface, pipeline};
use super::mesh::MeshDistance;
use super::read_field::with_memory;
use super::{DistanceSettings, SignRule};
use crate::Result;
use crate::application::{GpuWindingNumber, WindingNumber};
use crate::geometry::closest_point::TriangleFeature;
use crate::geometry::{DistanceGrid, RegularGrid};
use crate::gpu::Access::{Read, ReadWrite, Uniform};
use crate::gpu::{Access, Bind, Buffer, Gpu};
use crate::structure::{GpuRayStructure, GpuTriangleBvh};

/// Elements of `faces` a triangle.
const FACE: usize = 10;

const EVALUATE: [Access; 5] = [Uniform, Read, Read, Read, ReadWrite];

/// A mesh on a device, ready for signed distances.
///
/// The hierarchy, the pseudonormals and the tree of the winding number are built on the CPU. Distances are those of
/// [`MeshDistance::distance_field`] up to the rounding of `f32`; where two triangles are as close up to that, either is named.
#[derive(Debug)]
pub struct GpuMeshDistance<'a> {
    gpu: Gpu,
    mesh: &'a MeshDistance,
    bvh: GpuTriangleBvh,
    /// x: nodes of the hierarchy.
    hierarchy: Buffer<[u32; 4]>,
    /// `[10 triangles]` corners, normals of corners, of edges, and of the face.
    faces: Buffer<[f32; 4]>,
}

impl<'a> GpuMeshDistance<'a> {
    /// Copies the mesh and its hierarchy to the device.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn upload(gpu: &Gpu, mesh: &'a MeshDistance) -> Result<Self> {
        let bvh = GpuTriangleBvh::upload(gpu, mesh.bvh())?;
        let n_nodes = if bvh.depth() == 0 { 0 } else { bvh.nodes().len() as u32 };
        let quad = |v: DVec3| [v.x as f32, v.y as f32, v.z as f32, 0.0];
        let mut faces = Vec::with_capacity(FACE * mesh.mesh().triangles.len());
        for triangle in 0..mesh.mesh().triangles.len() as u32 {
            let normal = |feature| quad(mesh.pseudonormal(triangle, feature));
            faces.extend(mesh.corners(triangle).map(quad));
            faces.extend([0, 1, 2].map(|i| normal(TriangleFeature::Corner(i))));
            faces.extend([0, 1, 2].map(|i| normal(TriangleFeature::Edge(i))));
            faces.push(normal(TriangleFeature::Face));
        }
        Ok(Self {
            gpu: gpu.clone(),
            mesh,
            hierarchy: gpu.uniform("hierarchy of a mesh", &[n_nodes, 0, 0, 0])?,
            faces: gpu.upload("faces of a mesh", &faces)?,
            bvh,
        })
    }

    /// The field over a grid whose origin is that of the mesh, left on the device.
    ///
    /// # Errors
    /// As [`MeshDistance::distance_field`], without `Interrupted`; `OutOfDeviceMemory` (4 bytes a node must fit one binding,
    /// twice), `Unsupported` on software devices that would end loops, `KernelRejected`, `DeviceLost`.
    pub fn distance_field(&self, grid: &RegularGrid, settings: &DistanceSettings) -> Result<GpuDistanceField> {
        settings.validate(grid)?;
        let sign = self.mesh.sign(settings)?;
        let features = [("deep", self.bvh.is_deep())];
        let run = Run::new(&self.gpu, self.surface(&features), grid, settings)?.find_nearest()?;
        let binds = [
            (&run.parameters).into(),
            (&run.axes).into(),
            (&self.faces).into(),
            (&run.nearest).into(),
            (&run.values).into(),
        ];
        let evaluate = pipeline(&self.gpu, "evaluate_mesh", "evaluate_mesh_distances", &EVALUATE, &[], &[])?;
        let winding = (sign == SignRule::WindingNumber).then(|| self.winding()).transpose()?;
        run.evaluate(&evaluate, &binds, winding.as_ref())?.finish(settings)
    }

    /// The distances of a field on the host, sooner than by [`GpuMeshDistance::distance_field`] and reading back: their memory is
    /// made ready while the device computes.
    ///
    /// # Errors
    /// As [`GpuMeshDistance::distance_field`] and [`GpuDistanceField::read_distances`].
    pub fn distances(&self, grid: &RegularGrid, settings: &DistanceSettings) -> Result<DistanceGrid> {
        settings.validate(grid)?;
        with_memory(grid, || self.distance_field(grid, settings))
    }

    fn surface<'s>(&self, features: &'s [(&'s str, bool)]) -> Surface<'s> {
        let [nodes, triangles]: [Bind; 2] = {
            let binds: Vec<Bind> = self.bvh.bindings().into_iter().map(|(_, bind)| bind).collect();
            binds.try_into().expect("a hierarchy should have two bindings")
        };
        Surface {
            module: "package::application::distance_field::triangles",
            accesses: [Uniform, Read, Read],
            binds: [(&self.hierarchy).into(), nodes, triangles],
            features,
            what: "triangles",
            n: self.mesh.mesh().triangles.len(),
            spacing: 0.0,
        }
    }

    fn winding(&self) -> Result<GpuWindingNumber> {
        let mesh = self.mesh.mesh();
        let vertices: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| v.to_array()).collect();
        GpuWindingNumber::upload(&self.gpu, &WindingNumber::of_triangles(&vertices, &mesh.triangles)?)
    }
}
