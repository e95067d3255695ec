//! Relations of many octants at once on the GPU, the same bits as on the CPU.

use std::sync::Arc;

use super::{Curve, Octant};
use crate::gpu::{Access, Bind, Buffer, Commands, DeviceElement, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::tile::{MAX_LEN, ParameterCache, check_holds, check_len};
use crate::{Error, Result};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 256;
/// Pairs that a workgroup takes: two an invocation.
const PAIRS: usize = 2 * WORKGROUP as usize;

/// Records the kernels of relations between octants. Lengths go from 0 to 2³¹.
///
/// On the device an octant is its bits, and 0 where there is none: a `Buffer<u64>` holds octants that may be missing.
#[derive(Debug)]
pub struct GpuOctants {
    gpu: Gpu,
    parameters: ParameterCache,
    common_ancestors: Arc<Pipeline>,
    children_towards: Arc<Pipeline>,
    containments: Arc<Pipeline>,
}

impl GpuOctants {
    /// Compiles the kernels of pairs; those of neighbours are compiled when they are first recorded.
    ///
    /// # Errors
    /// `KernelRejected`, `Unsupported` where the device has too small workgroups.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        let access = [Access::Uniform, Access::Read, Access::Read, Access::ReadWrite];
        let constants = [("WORKGROUP", f64::from(WORKGROUP))];
        let pipeline = |entry: &str| {
            let kernel = Kernel::new("package::curve::octant_pairs", entry, &access, WORKGROUP);
            gpu.prepare(&Kernel { constants: &constants, ..kernel })
        };
        Ok(Self {
            gpu: gpu.clone(),
            parameters: ParameterCache::new(gpu),
            common_ancestors: pipeline("common_ancestors")?,
            children_towards: pipeline("children_towards")?,
            containments: pipeline("containments")?,
        })
    }

    /// Records `ancestors[i]`, the smallest octant that contains `first[i]` and `second[i]`, for i below `len`.
    ///
    /// # Errors
    /// `TooMany`, `LengthMismatch` if a buffer is shorter than `len`, `OutOfDeviceMemory`.
    pub fn record_common_ancestors(
        &self,
        commands: &mut Commands,
        first: &Buffer<Octant>,
        second: &Buffer<Octant>,
        ancestors: &Buffer<Octant>,
        len: usize,
    ) -> Result<()> {
        check_holds(ancestors, len)?;
        self.record_pairs(commands, &self.common_ancestors, [first, second], ancestors.into(), len)
    }

    /// Records `children[i]`, the child of `first[i]` that contains `second[i]`, 0 where that is not inside and
    /// smaller, for i below `len`.
    ///
    /// # Errors
    /// As [`GpuOctants::record_common_ancestors`].
    pub fn record_children_towards(
        &self,
        commands: &mut Commands,
        first: &Buffer<Octant>,
        second: &Buffer<Octant>,
        children: &Buffer<u64>,
        len: usize,
    ) -> Result<()> {
        check_holds(children, len)?;
        self.record_pairs(commands, &self.children_towards, [first, second], children.into(), len)
    }

    /// Records `flags[i]`, 1 where `first[i]` contains `second[i]` and else 0, for i below `len`.
    ///
    /// # Errors
    /// As [`GpuOctants::record_common_ancestors`].
    pub fn record_contains(
        &self,
        commands: &mut Commands,
        first: &Buffer<Octant>,
        second: &Buffer<Octant>,
        flags: &Buffer<u32>,
        len: usize,
    ) -> Result<()> {
        check_holds(flags, len)?;
        self.record_pairs(commands, &self.containments, [first, second], flags.into(), len)
    }

    /// Records `neighbors[i]`, the octant of the same level one step from `octants[i]` along `direction` (−1, 0 or 1 by
    /// axis), 0 outside the domain, for i below `len`.
    ///
    /// # Errors
    /// As [`GpuOctants::record_common_ancestors`], and `KernelRejected`.
    pub fn record_neighbors(
        &self,
        commands: &mut Commands,
        curve: Curve,
        octants: &Buffer<Octant>,
        direction: [i32; 3],
        neighbors: &Buffer<u64>,
        len: usize,
    ) -> Result<()> {
        check_len("octants to step from", len, MAX_LEN)?;
        check_holds(octants, len)?;
        check_holds(neighbors, len)?;
        let access = [Access::Uniform, Access::Read, Access::ReadWrite];
        let kernel = Kernel::new("package::curve::octant_neighbors", "step_octants", &access, WORKGROUP);
        let pipeline = self.gpu.prepare(&Kernel {
            constants: &[("WORKGROUP", f64::from(WORKGROUP))],
            features: &[("hilbert", curve == Curve::Hilbert)],
            ..kernel
        })?;
        let [x, y, z] = direction.map(i32::cast_unsigned);
        let parameters = self.parameters.uniform([len as u32, x, y, z])?;
        let bindings = [(&parameters).into(), octants.into(), neighbors.into()];
        commands.dispatch(&pipeline, &bindings, Workgroups::Covering(len as u64));
        Ok(())
    }

    /// The smallest octant that contains both, for every pair.
    ///
    /// # Errors
    /// `LengthMismatch` if the lists differ in length, `TooMany`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn common_ancestors(&self, first: &[Octant], second: &[Octant]) -> Result<Vec<Octant>> {
        self.of_pairs(first, second, |commands, [first, second], out, len| {
            self.record_common_ancestors(commands, first, second, out, len)
        })
    }

    /// The child of the first that contains the second, for every pair; `None` where that is not inside and smaller.
    ///
    /// # Errors
    /// As [`GpuOctants::common_ancestors`].
    pub fn children_towards(&self, first: &[Octant], second: &[Octant]) -> Result<Vec<Option<Octant>>> {
        let children = self.of_pairs(first, second, |commands, [first, second], out, len| {
            self.record_children_towards(commands, first, second, out, len)
        })?;
        Ok(children.into_iter().map(Octant::from_bits).collect())
    }

    /// Whether the first contains the second, for every pair.
    ///
    /// # Errors
    /// As [`GpuOctants::common_ancestors`].
    pub fn contains(&self, first: &[Octant], second: &[Octant]) -> Result<Vec<bool>> {
        let flags: Vec<u32> = self.of_pairs(first, second, |commands, [first, second], out, len| {
            self.record_contains(commands, first, second, out, len)
        })?;
        Ok(flags.into_iter().map(|flag| flag == 1).collect())
    }

    /// The octants of the same level one step along `direction` (−1, 0 or 1 by axis); `None` outside the domain.
    ///
    /// # Errors
    /// `TooMany`, `KernelRejected`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn neighbors(&self, curve: Curve, octants: &[Octant], direction: [i32; 3]) -> Result<Vec<Option<Octant>>> {
        let octants = self.gpu.upload("octants", octants)?;
        let neighbors = self.gpu.buffer("neighbours of octants", octants.len())?;
        let mut commands = self.gpu.commands("neighbours of octants");
        self.record_neighbors(&mut commands, curve, &octants, direction, &neighbors, octants.len())?;
        commands.submit()?;
        Ok(self.gpu.read(&neighbors)?.into_iter().map(Octant::from_bits).collect())
    }

    fn record_pairs(
        &self,
        commands: &mut Commands,
        pipeline: &Arc<Pipeline>,
        [first, second]: [&Buffer<Octant>; 2],
        out: Bind,
        len: usize,
    ) -> Result<()> {
        check_len("pairs of octants", len, MAX_LEN)?;
        check_holds(first, len)?;
        check_holds(second, len)?;
        let parameters = self.parameters.uniform([len as u32, 0, 0, 0])?;
        let bindings = [(&parameters).into(), first.into(), second.into(), out];
        commands.dispatch(pipeline, &bindings, Workgroups::Count(len.div_ceil(PAIRS) as u32));
        Ok(())
    }

    fn of_pairs<T: DeviceElement>(
        &self,
        first: &[Octant],
        second: &[Octant],
        record: impl FnOnce(&mut Commands, [&Buffer<Octant>; 2], &Buffer<T>, usize) -> Result<()>,
    ) -> Result<Vec<T>> {
        if first.len() != second.len() {
            let (found, expected) = (second.len() as u64, first.len() as u64);
            return Err(Error::LengthMismatch { what: "second octants of pairs", found, expected });
        }
        let pairs = [self.gpu.upload("first octants", first)?, self.gpu.upload("second octants", second)?];
        let out = self.gpu.buffer("answers for pairs of octants", first.len())?;
        let mut commands = self.gpu.commands("pairs of octants");
        record(&mut commands, [&pairs[0], &pairs[1]], &out, first.len())?;
        commands.submit()?;
        self.gpu.read(&out)
    }
}
