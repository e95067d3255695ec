//! Reduce on the device: every workgroup reduces a part, one workgroup the parts.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::gpu::{Access, Bind, Buffer, Commands, DeviceElement, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::tile::{MAX_LEN, ParameterCache, WORKGROUP, check_holds, check_len};
use crate::{Error, Result};

/// Parts of the first stage: eight workgroups for each of 128 multiprocessors; more only lengthen the second stage.
const MAX_PARTS: usize = 1024;
/// Values of an invocation below which parts are not worth a workgroup.
const ITEMS: usize = 4;

/// The bounding box of points as the device writes it.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuBounds {
    /// Smallest finite coordinates, and 0; plus infinity for no finite point.
    pub min: [f32; 4],
    /// Largest finite coordinates, and 0; minus infinity for no finite point.
    pub max: [f32; 4],
    /// How many points have a NaN or infinite coordinate; they do not count for the box.
    pub n_non_finite: u32,
    /// Index of the first such point; `u32::MAX` for none.
    pub first_non_finite: u32,
    /// Fills the 48 bytes; 0.
    pub unused: [u32; 2],
}

/// What a reduction keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Sum,
    Smallest { float: bool },
    Largest { float: bool },
    Bounds,
}

/// Reductions of device arrays of up to 2³¹ elements. Each kind is compiled when it is first recorded.
#[derive(Debug)]
pub struct GpuReduce {
    gpu: Gpu,
    parameters: ParameterCache,
    parts: Buffer<[u32; 8]>,
}

impl GpuReduce {
    /// A plan for any length; its scratch memory is 32 KiB.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`.
    pub fn new(gpu: &Gpu) -> Result<Self> {
        let parts = gpu.buffer("parts of a reduction", MAX_PARTS)?;
        Ok(Self { gpu: gpu.clone(), parameters: ParameterCache::new(gpu), parts })
    }

    /// Records the exact sum of the first `len` values into `result[0]`.
    ///
    /// # Errors
    /// `TooMany` beyond 2³¹ values, `LengthMismatch` if a buffer is shorter, `OutOfDeviceMemory`, `KernelRejected`; the
    /// same for all reductions.
    pub fn record_sum(
        &self,
        commands: &mut Commands,
        input: &Buffer<u32>,
        len: usize,
        result: &Buffer<u64>,
    ) -> Result<()> {
        self.record(commands, Kind::Sum, input, len, result)
    }

    /// Records the smallest of the first `len` values into `result[0]`; `u32::MAX` for none.
    ///
    /// # Errors
    /// As [`GpuReduce::record_sum`].
    pub fn record_smallest(
        &self,
        commands: &mut Commands,
        input: &Buffer<u32>,
        len: usize,
        result: &Buffer<u32>,
    ) -> Result<()> {
        self.record(commands, Kind::Smallest { float: false }, input, len, result)
    }

    /// Records the largest of the first `len` values into `result[0]`; 0 for none.
    ///
    /// # Errors
    /// As [`GpuReduce::record_sum`].
    pub fn record_largest(
        &self,
        commands: &mut Commands,
        input: &Buffer<u32>,
        len: usize,
        result: &Buffer<u32>,
    ) -> Result<()> {
        self.record(commands, Kind::Largest { float: false }, input, len, result)
    }

    /// Records the smallest of the first `len` values that are not NaN into `result[0]`; infinity for none. Minus zero
    /// is below zero.
    ///
    /// # Errors
    /// As [`GpuReduce::record_sum`].
    pub fn record_smallest_f32(
        &self,
        commands: &mut Commands,
        input: &Buffer<f32>,
        len: usize,
        result: &Buffer<f32>,
    ) -> Result<()> {
        self.record(commands, Kind::Smallest { float: true }, input, len, result)
    }

    /// Records the largest of the first `len` values that are not NaN into `result[0]`; minus infinity for none. Zero
    /// is above minus zero.
    ///
    /// # Errors
    /// As [`GpuReduce::record_sum`].
    pub fn record_largest_f32(
        &self,
        commands: &mut Commands,
        input: &Buffer<f32>,
        len: usize,
        result: &Buffer<f32>,
    ) -> Result<()> {
        self.record(commands, Kind::Largest { float: true }, input, len, result)
    }

    /// Records the bounding box of the first `len` points into `result[0]`.
    ///
    /// - `points`: elements of 16 bytes: x, y, z and one word that is left alone
    ///
    /// # Errors
    /// As [`GpuReduce::record_sum`]; `Unsupported` if the elements have another size.
    pub fn record_bounds<P: DeviceElement>(
        &self,
        commands: &mut Commands,
        points: &Buffer<P>,
        len: usize,
        result: &Buffer<GpuBounds>,
    ) -> Result<()> {
        if size_of::<P>() != 16 {
            return Err(Error::Unsupported {
                what: format!("the bounding box of {}: points of {} bytes", points.label(), size_of::<P>()),
                advice: "store a point as four f32",
            });
        }
        self.record(commands, Kind::Bounds, points, len, result)
    }

    fn record<T: DeviceElement, R: DeviceElement>(
        &self,
        commands: &mut Commands,
        kind: Kind,
        input: &Buffer<T>,
        len: usize,
        result: &Buffer<R>,
    ) -> Result<()> {
        check_len("values to reduce", len, MAX_LEN)?;
        check_holds(input, len)?;
        check_holds(result, 1)?;
        let n_parts = len.div_ceil(WORKGROUP as usize * ITEMS).min(MAX_PARTS);
        let parameters = self.parameters.uniform([len as u32, n_parts as u32, 0, 0])?;
        let parts = Bind::from(&self.parts);
        let [values, rest] = self.pipelines(kind)?;
        // An empty buffer is too small to be bound as an array of points.
        if n_parts > 0 {
            let bindings = [(&parameters).into(), input.into(), parts.clone()];
            commands.dispatch(&values, &bindings, Workgroups::Count(n_parts as u32));
        }
        commands.dispatch(&rest, &[(&parameters).into(), parts, result.into()], Workgroups::Count(1));
        Ok(())
    }

    /// The two stages of a kind: of the values, and of the parts.
    fn pipelines(&self, kind: Kind) -> Result<[Arc<Pipeline>; 2]> {
        let (module, entries) = match kind {
            Kind::Bounds => ("package::parallel::reduce::bounds", ["bound_points", "bound_parts"]),
            _ => ("package::parallel::reduce", ["reduce_values", "reduce_parts"]),
        };
        let features = [
            ("sum", kind == Kind::Sum),
            ("smallest", matches!(kind, Kind::Smallest { .. })),
            ("largest", matches!(kind, Kind::Largest { .. })),
            ("float", matches!(kind, Kind::Smallest { float: true } | Kind::Largest { float: true })),
        ];
        let features = if kind == Kind::Bounds { &[][..] } else { &features[..] };
        let bindings = [Access::Uniform, Access::Read, Access::ReadWrite];
        let stage = |entry| self.gpu.prepare(&Kernel { features, ..Kernel::new(module, entry, &bindings, WORKGROUP) });
        Ok([stage(entries[0])?, stage(entries[1])?])
    }
}
