//! Points in the order of a curve on the GPU, the same bits as on the CPU.

use glam::Vec3;

use super::{Curve, Domain, GpuCurve, MAX_LEVEL};
use crate::Result;
use crate::geometry::validate;
use crate::gpu::{Buffer, Commands, Gpu};
use crate::parallel::radix_sort::GpuRadixSort;
use crate::parallel::reduce;
use crate::parallel::tile::{MAX_LEN, check_holds, check_len};

/// A plan for orders along one curve: keys of 63 bits and their stable sort.
#[derive(Debug)]
pub struct GpuCurveOrder {
    gpu: Gpu,
    curve: GpuCurve,
    sort: GpuRadixSort<u64>,
    capacity: usize,
    keys: Buffer<u64>,
    sorted_keys: Buffer<u64>,
}

impl GpuCurveOrder {
    /// A plan for up to `capacity` points.
    ///
    /// Its scratch memory is 16 bytes a point, and that of a [`GpuRadixSort`] of `u64`.
    ///
    /// # Errors
    /// `TooMany` beyond 2³¹ points, `OutOfDeviceMemory`, `KernelRejected`.
    pub fn new(gpu: &Gpu, curve: Curve, capacity: usize) -> Result<Self> {
        check_len("points to put in order", capacity, MAX_LEN)?;
        Ok(Self {
            gpu: gpu.clone(),
            curve: GpuCurve::new(gpu, curve),
            sort: GpuRadixSort::new(gpu, capacity)?,
            capacity,
            keys: gpu.buffer("keys of points", capacity)?,
            sorted_keys: gpu.buffer("sorted keys of points", capacity)?,
        })
    }

    /// Records the order of the first `len` points along the curve, in the stages "keys" and "sort".
    ///
    /// - `points`: `[len]` xyz, the fourth value is not used; trusted to be finite. Those outside the domain count to its
    ///   border
    /// - `order`: `[len]` at each place the index of the point there; points of one cell stand by index
    ///
    /// # Errors
    /// `TooMany` if `len` passes the capacity, `LengthMismatch` if a buffer is shorter than `len`, `KernelRejected`,
    /// `OutOfDeviceMemory`.
    pub fn record(
        &self,
        commands: &mut Commands,
        domain: &Domain,
        points: &Buffer<[f32; 4]>,
        order: &Buffer<u32>,
        len: usize,
    ) -> Result<()> {
        check_len("points to put in order", len, self.capacity)?;
        check_holds(points, len)?;
        check_holds(order, len)?;
        commands.stage("keys");
        self.curve.record_point_keys(commands, domain, points, &self.keys, len)?;
        commands.stage("sort");
        self.sort.record_from(commands, &self.keys, None, &self.sorted_keys, order, len, 0..3 * MAX_LEVEL)
    }

    /// As [`super::order`], computed on the device.
    ///
    /// # Errors
    /// `NonFinite`, `CoordinateTooLarge`, `TooMany` for more points than the capacity, `KernelRejected`,
    /// `OutOfDeviceMemory`, `DeviceLost`.
    pub fn order(&self, points: &[Vec3]) -> Result<Vec<u32>> {
        validate::points(points)?;
        check_len("points to put in order", points.len(), self.capacity)?;
        let domain = Domain::of_bounds(&reduce::bounds(points));
        let points: Vec<[f32; 4]> = points.iter().map(|p| p.extend(0.0).to_array()).collect();
        let points = self.gpu.upload("points", &points)?;
        let order = self.gpu.buffer("order along a curve", points.len())?;
        let mut commands = self.gpu.commands("order along a curve");
        self.record(&mut commands, &domain, &points, &order, points.len())?;
        commands.submit()?;
        self.gpu.read(&order)
    }
}
