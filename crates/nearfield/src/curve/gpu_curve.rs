//! Keys of many points and cells on the GPU, the same bits as on the CPU.

use glam::Vec3;

use super::{Curve, Domain};
use crate::Result;
use crate::geometry::validate;
use crate::gpu::{Access, Bind, Buffer, Commands, DeviceElement, Gpu, Kernel, Workgroups};
use crate::parallel::tile::{MAX_LEN, ParameterCache, check_holds, check_len};

/// Invocations of a workgroup.
const WORKGROUP: u32 = 256;

/// Keys that the GPU makes: `u32` (30 bits in three dimensions, 32 in two) and `u64` (63 and 62).
pub trait Key: DeviceElement + private::Sealed {
    #[doc(hidden)]
    const WIDE: bool;
}

/// Cells that have keys: `[u32; 2]` and `[u32; 3]`.
pub trait Cell: DeviceElement + private::Sealed {
    #[doc(hidden)]
    const PLANAR: bool;
}

mod private {
    pub trait Sealed {}
    impl Sealed for u32 {}
    impl Sealed for u64 {}
    impl Sealed for [u32; 2] {}
    impl Sealed for [u32; 3] {}
}

impl Key for u32 {
    const WIDE: bool = false;
}

impl Key for u64 {
    const WIDE: bool = true;
}

impl Cell for [u32; 2] {
    const PLANAR: bool = true;
}

impl Cell for [u32; 3] {
    const PLANAR: bool = false;
}

/// Records the kernels that make keys along one curve, and cells from keys. Lengths go from 0 to 2³¹.
#[derive(Debug)]
pub struct GpuCurve {
    gpu: Gpu,
    curve: Curve,
    parameters: ParameterCache,
}

impl GpuCurve {
    /// For this curve; kernels are compiled when they are first recorded.
    pub fn new(gpu: &Gpu, curve: Curve) -> Self {
        Self { gpu: gpu.clone(), curve, parameters: ParameterCache::new(gpu) }
    }

    /// Records the keys of points: all 63 bits as `u64`, the first 30 of them as `u32`.
    ///
    /// - `points`: `[len]` xyz, the fourth value is not used; trusted to be finite
    /// - `keys`: `[len]` as [`Domain::key_of`]
    ///
    /// # Errors
    /// `TooMany`, `LengthMismatch` if a buffer is shorter than `len`, `KernelRejected`, `OutOfDeviceMemory`.
    pub fn record_point_keys<K: Key>(
        &self,
        commands: &mut Commands,
        domain: &Domain,
        points: &Buffer<[f32; 4]>,
        keys: &Buffer<K>,
        len: usize,
    ) -> Result<()> {
        check_holds(points, len)?;
        check_holds(keys, len)?;
        let domain = self.gpu.uniform("domain of keys", domain)?;
        let features = [("hilbert", self.curve == Curve::Hilbert), ("wide", K::WIDE)];
        let access = [Access::Uniform, Access::Uniform, Access::Read, Access::ReadWrite];
        let kernel = Kernel::new("package::curve::point_keys", "compute_keys", &access, WORKGROUP);
        let kernel = Kernel { features: &features, ..kernel };
        self.record(commands, kernel, &[(&domain).into(), points.into(), keys.into()], "points to make keys of", len)
    }

    /// Records the keys of cells: `keys[i]` for `cells[i]`, i below `len`.
    ///
    /// # Errors
    /// As [`GpuCurve::record_point_keys`].
    pub fn record_encode<C: Cell, K: Key>(
        &self,
        commands: &mut Commands,
        cells: &Buffer<C>,
        keys: &Buffer<K>,
        len: usize,
    ) -> Result<()> {
        check_holds(cells, len)?;
        check_holds(keys, len)?;
        self.record_cell_keys::<C, K>(commands, "encode_cells", cells.into(), keys.into(), len)
    }

    /// Records the cells of keys: `cells[i]` for `keys[i]`, i below `len`.
    ///
    /// # Errors
    /// As [`GpuCurve::record_point_keys`].
    pub fn record_decode<C: Cell, K: Key>(
        &self,
        commands: &mut Commands,
        keys: &Buffer<K>,
        cells: &Buffer<C>,
        len: usize,
    ) -> Result<()> {
        check_holds(keys, len)?;
        check_holds(cells, len)?;
        self.record_cell_keys::<C, K>(commands, "decode_keys", keys.into(), cells.into(), len)
    }

    /// The keys of points, computed on the device.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn point_keys<K: Key>(&self, domain: &Domain, points: &[Vec3]) -> Result<Vec<K>> {
        validate::points(points)?;
        let points: Vec<[f32; 4]> = points.iter().map(|p| p.extend(0.0).to_array()).collect();
        let points = self.gpu.upload("points", &points)?;
        let keys = self.gpu.buffer("keys of points", points.len())?;
        let mut commands = self.gpu.commands("keys of points");
        self.record_point_keys(&mut commands, domain, &points, &keys, points.len())?;
        commands.submit()?;
        self.gpu.read(&keys)
    }

    /// The keys of cells, computed on the device.
    ///
    /// # Errors
    /// `TooMany`, `KernelRejected`, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn encode<C: Cell, K: Key>(&self, cells: &[C]) -> Result<Vec<K>> {
        let cells = self.gpu.upload("cells", cells)?;
        let keys = self.gpu.buffer("keys of cells", cells.len())?;
        let mut commands = self.gpu.commands("keys of cells");
        self.record_encode(&mut commands, &cells, &keys, cells.len())?;
        commands.submit()?;
        self.gpu.read(&keys)
    }

    /// The cells of keys, computed on the device.
    ///
    /// # Errors
    /// As [`GpuCurve::encode`].
    pub fn decode<C: Cell, K: Key>(&self, keys: &[K]) -> Result<Vec<C>> {
        let keys = self.gpu.upload("keys", keys)?;
        let cells = self.gpu.buffer("cells of keys", keys.len())?;
        let mut commands = self.gpu.commands("cells of keys");
        self.record_decode(&mut commands, &keys, &cells, keys.len())?;
        commands.submit()?;
        self.gpu.read(&cells)
    }

    fn record_cell_keys<C: Cell, K: Key>(
        &self,
        commands: &mut Commands,
        entry: &str,
        from: Bind,
        to: Bind,
        len: usize,
    ) -> Result<()> {
        let features = [("hilbert", self.curve == Curve::Hilbert), ("planar", C::PLANAR), ("wide", K::WIDE)];
        let access = [Access::Uniform, Access::Read, Access::ReadWrite];
        let kernel = Kernel::new("package::curve::cell_keys", entry, &access, WORKGROUP);
        let kernel = Kernel { features: &features, ..kernel };
        self.record(commands, kernel, &[from, to], "cells or keys to convert", len)
    }

    fn record(
        &self,
        commands: &mut Commands,
        kernel: Kernel<'_>,
        bindings: &[Bind],
        what: &'static str,
        len: usize,
    ) -> Result<()> {
        check_len(what, len, MAX_LEN)?;
        let constants = [("WORKGROUP", f64::from(WORKGROUP))];
        let pipeline = self.gpu.prepare(&Kernel { constants: &constants, ..kernel })?;
        let parameters = self.parameters.uniform([len as u32, 0, 0, 0])?;
        let bindings = [&[(&parameters).into()], bindings].concat();
        commands.dispatch(&pipeline, &bindings, Workgroups::Covering(len as u64));
        Ok(())
    }
}
