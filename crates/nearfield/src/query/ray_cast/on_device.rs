//! Rays and hits that stay on the device.

use bytemuck::{Pod, Zeroable};

use super::HitRecord;
use crate::geometry::Ray;
use crate::gpu::shader::Fill;
use crate::gpu::{Access, Bind, Buffer, Commands, DeviceElement, Kernel, Workgroups};
use crate::structure::{GpuRayStructure, RayWork};
use crate::{Error, Result};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 64;

/// `RayBatch` in cast.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct RayBatch {
    /// Rays of this batch.
    pub count: u32,
    /// Unused.
    pub padding: [u32; 3],
}

/// What a kernel does with the hits of a ray.
#[derive(Debug, Clone, Copy)]
pub(super) struct HitCode {
    pub(super) module: &'static str,
    pub(super) accesses: &'static [Access],
    pub(super) counts_work: bool,
}

pub(super) const CLOSEST: HitCode =
    HitCode { module: "package::query::ray_cast::closest", accesses: &[Access::ReadWrite], counts_work: false };
pub(super) const CLOSEST_WITH_WORK: HitCode =
    HitCode { accesses: &[Access::ReadWrite, Access::ReadWrite], counts_work: true, ..CLOSEST };
pub(super) const ANY: HitCode = HitCode { module: "package::query::ray_cast::any", ..CLOSEST };
pub(super) const COUNT: HitCode = HitCode { module: "package::query::ray_cast::count", ..CLOSEST };
pub(super) const ALL: HitCode = HitCode {
    module: "package::query::ray_cast::all",
    accesses: &[Access::Read, Access::ReadWrite, Access::ReadWrite],
    counts_work: false,
};

/// Checks that the device takes all loop rounds of a walk.
///
/// # Errors
/// `Unsupported` where it may end them before.
pub(super) fn check_loops<S: GpuRayStructure>(structure: &S) -> Result<()> {
    let Some(limit) = structure.gpu().limits().loop_rounds else { return Ok(()) };
    let rounds = structure.fewest_rounds();
    if rounds <= u64::from(limit) { Ok(()) } else { Err(too_many_rounds(structure, limit)) }
}

/// The error for rays that a software device cannot follow to their end.
pub(super) fn too_many_rounds<S: GpuRayStructure>(structure: &S, limit: u32) -> Error {
    Error::Unsupported {
        what: format!(
            "casting rays into {} triangles by {} on {}, which ends the loops of a kernel after {limit} rounds,",
            structure.triangles().len(),
            S::NAME,
            structure.gpu().name()
        ),
        advice: "use the CPU, or a structure that looks at fewer triangles",
    }
}

/// Rays in device memory, and which of them are cast.
#[derive(Debug, Clone)]
pub struct DeviceRays<'a> {
    /// The rays.
    pub buffer: &'a Buffer<Ray>,
    /// The first of them that are cast; those beyond are not.
    pub count: usize,
    /// With [`Workgroups::Covering`]`(count)` all `count` are cast; a kernel that ran before may leave fewer, in workgroups
    /// of 64, by [`Workgroups::Indirect`].
    pub workgroups: Workgroups,
}

impl<'a> DeviceRays<'a> {
    /// The first `count` rays of a buffer.
    pub fn first(buffer: &'a Buffer<Ray>, count: usize) -> Self {
        Self { buffer, count, workgroups: Workgroups::Covering(count as u64) }
    }

    /// Checks that a buffer has an element for each ray that is cast.
    fn check_length<T: DeviceElement>(&self, buffer: &Buffer<T>) -> Result<()> {
        if buffer.len() < self.count {
            let (found, expected) = (buffer.len() as u64, self.count as u64);
            return Err(Error::LengthMismatch { what: buffer.label(), found, expected });
        }
        Ok(())
    }
}

/// Records one cast.
///
/// # Errors
/// `LengthMismatch` where there are fewer rays than are to be cast; as [`RaysOnDevice::record_closest`].
pub(super) fn record<S: GpuRayStructure>(
    commands: &mut Commands,
    structure: &S,
    rays: &DeviceRays<'_>,
    code: &HitCode,
    visitor: &[Bind],
) -> Result<()> {
    check_loops(structure)?;
    rays.check_length(rays.buffer)?;
    let gpu = structure.gpu();
    let batch = gpu.uniform("ray batch", &RayBatch { count: rays.count as u32, padding: [0; 3] })?;
    let space = gpu.uniform("ray space", structure.triangles().space())?;
    let mut binds: Vec<Bind> = vec![(&batch).into(), rays.buffer.into(), (&space).into()];
    let mut accesses = vec![Access::Uniform, Access::Read, Access::Uniform];
    for (access, bind) in structure.bindings() {
        accesses.push(access);
        binds.push(bind);
    }
    let mut features = structure.features();
    features.push(("count_work", code.counts_work));
    let kernel = Kernel {
        visitor_bindings: code.accesses,
        fills: &[
            ("package::structure::ray_selected", Fill::Module(structure.trace_module())),
            ("package::structure::hit_visitor", Fill::Module(code.module)),
        ],
        features: &features,
        constants: &[("WORKGROUP", f64::from(WORKGROUP))],
        ..Kernel::new("package::query::ray_cast::cast", "cast_rays", &accesses, WORKGROUP)
    };
    commands.dispatch_with_visitor(&gpu.prepare(&kernel)?, &binds, visitor, rays.workgroups.clone());
    Ok(())
}

/// Ray casting with rays and answers in device memory, recorded into the caller's commands. How many rays a submission
/// should cast at most, where a driver ends long ones, says [`GpuRayStructure::rays_a_submission`].
pub trait RaysOnDevice {
    /// First hit of each ray: `hits[i]` for ray `i`, [`HitRecord::MISS`], [`HitRecord::INVALID`] or, on software
    /// devices that end long loops, [`HitRecord::ABANDONED`] with the largest f32 as t where there is none.
    ///
    /// # Errors
    /// `LengthMismatch` where a buffer is shorter than the number of rays that are cast; `Unsupported` on devices that end
    /// long loops; `OutOfDeviceMemory`, `DeviceLost`.
    fn record_closest(&self, commands: &mut Commands, rays: &DeviceRays<'_>, hits: &Buffer<HitRecord>) -> Result<()>;

    /// As [`RaysOnDevice::record_closest`], with the work of each ray.
    ///
    /// # Errors
    /// As [`RaysOnDevice::record_closest`].
    fn record_closest_with_work(
        &self,
        commands: &mut Commands,
        rays: &DeviceRays<'_>,
        hits: &Buffer<HitRecord>,
        work: &Buffer<RayWork>,
    ) -> Result<()>;

    /// Whether each ray hits anything: 0 for a miss, 1 for a hit, 2 for a ray that cannot be cast,
    /// [`HitRecord::ABANDONED`] as above.
    ///
    /// # Errors
    /// As [`RaysOnDevice::record_closest`].
    fn record_any(&self, commands: &mut Commands, rays: &DeviceRays<'_>, states: &Buffer<u32>) -> Result<()>;
}

impl<S: GpuRayStructure> RaysOnDevice for S {
    fn record_closest(&self, commands: &mut Commands, rays: &DeviceRays<'_>, hits: &Buffer<HitRecord>) -> Result<()> {
        rays.check_length(hits)?;
        record(commands, self, rays, &CLOSEST, &[hits.into()])
    }

    fn record_closest_with_work(
        &self,
        commands: &mut Commands,
        rays: &DeviceRays<'_>,
        hits: &Buffer<HitRecord>,
        work: &Buffer<RayWork>,
    ) -> Result<()> {
        rays.check_length(hits)?;
        rays.check_length(work)?;
        record(commands, self, rays, &CLOSEST_WITH_WORK, &[hits.into(), work.into()])
    }

    fn record_any(&self, commands: &mut Commands, rays: &DeviceRays<'_>, states: &Buffer<u32>) -> Result<()> {
        rays.check_length(states)?;
        record(commands, self, rays, &ANY, &[states.into()])
    }
}
