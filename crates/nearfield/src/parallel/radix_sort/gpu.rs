//! The radix sort on the device: for every digit count, scan, scatter.
//!
//! A pass counts the digits of each tile into a table `[digits × tiles]`, scans its rows, and moves every pair to the
//! start of its digit plus the row's prefix of its tile plus its rank within the tile: three dispatches. Pairs go back
//! and forth between two pairs of buffers.

use std::ops::Range;
use std::sync::Arc;

use super::{SortKey, check_bits, digits};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::tile::{ParameterCache, RowScan, WORKGROUP, check_capacity, check_holds, check_len};
use crate::{Error, Result};

/// How a workgroup ranks equal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RankMethod {
    /// 8-bit digits; lanes find their equals by subgroup ballots of one word.
    Ballot,
    /// As `Ballot` with ballots of four words, for subgroups of up to 128 lanes.
    WideBallot,
    /// 4-bit digits; counters in workgroup memory. Runs everywhere.
    Counters,
}

/// Most subgroups of a workgroup in scatter_ballot.wesl, and its workgroup memory.
const MAX_SUBGROUPS: u32 = 8;
const BALLOT_BYTES: u32 = 26 * 1024;
/// Keys of one invocation, as in pass.wesl.
const BALLOT_ITEMS: usize = 16;
const COUNTER_ITEMS: usize = 8;

/// A plan for stable sorts of (key, u32 value) pairs on the device; keys are `u32` or `u64`.
#[derive(Debug)]
pub struct GpuRadixSort<K: SortKey = u32> {
    parameters: ParameterCache,
    capacity: usize,
    method: RankMethod,
    tile: usize,
    count_digits: Arc<Pipeline>,
    rows: RowScan,
    scatter: Arc<Pipeline>,
    scatter_indices: Arc<Pipeline>,
    copy: Arc<Pipeline>,
    copy_indices: Arc<Pipeline>,
    table: Buffer<u32>,
    totals: Buffer<u32>,
    spare_keys: Buffer<K>,
    spare_values: Buffer<u32>,
}

impl<K: SortKey> GpuRadixSort<K> {
    /// A plan for up to `capacity` pairs, ranking by ballots where the device can. Its scratch
    /// memory is a second pair of buffers, and 4 bytes for each digit and tile (3 % of the pairs with subgroups of 32 lanes).
    ///
    /// # Errors
    /// `TooMany` beyond 2³¹ pairs, `OutOfDeviceMemory`, `KernelRejected`.
    pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self> {
        // Half the passes win even with 8 lanes: 22 bits of 1 M keys on llvmpipe 0.46 s by ballots, 1.18 s by counters.
        let method = match gpu.limits().subgroup {
            Some((_, largest)) if ballot_workgroup(gpu).is_some() => {
                if largest <= 32 {
                    RankMethod::Ballot
                } else {
                    RankMethod::WideBallot
                }
            }
            _ => RankMethod::Counters,
        };
        Self::with_method(gpu, capacity, method)
    }

    /// As [`GpuRadixSort::new`] with a given method.
    ///
    /// # Errors
    /// `Unsupported` for ballots on a device without subgroup operations, with less than 26 KiB of workgroup memory, or
    /// with more lanes than the method has; the other errors of [`GpuRadixSort::new`].
    pub fn with_method(gpu: &Gpu, capacity: usize, method: RankMethod) -> Result<Self> {
        check_capacity("pairs to sort", capacity)?;
        let (ballot, wide) = (method != RankMethod::Counters, K::BITS > u32::BITS);
        let narrow = method == RankMethod::Ballot;
        let (workgroup, items) = if ballot {
            let fits = |_: &u32| !narrow || gpu.limits().subgroup.is_some_and(|(_, largest)| largest <= 32);
            let workgroup = ballot_workgroup(gpu).filter(fits).ok_or_else(|| Error::Unsupported {
                what: format!("sorting by subgroup ballots ({method:?}) on {}", gpu.name()),
                advice: "use GpuRadixSort::new, which picks a method that runs",
            })?;
            (workgroup, BALLOT_ITEMS)
        } else {
            (WORKGROUP, COUNTER_ITEMS)
        };
        let tile = workgroup as usize * items;
        let n_tiles = capacity.div_ceil(tile);
        let radix = 1 << Self::widest(method);

        let constants = [("WORKGROUP", f64::from(workgroup))];
        let count = Kernel {
            features: &[("ballot", ballot), ("wide", wide)],
            constants: &constants,
            ..Kernel::new(
                "package::parallel::radix_sort::count_digits",
                "count_digits",
                &[Access::Uniform, Access::Read, Access::ReadWrite],
                workgroup,
            )
        };
        let scatter = |values_are_indices: bool| {
            let (module, constants): (_, &[_]) = if ballot {
                ("package::parallel::radix_sort::scatter_ballot", &constants)
            } else {
                ("package::parallel::radix_sort::scatter", &[])
            };
            let bindings = [
                Access::Uniform,
                Access::Read,
                Access::Read,
                Access::Read,
                Access::ReadWrite,
                Access::ReadWrite,
                Access::Read,
            ];
            gpu.pipeline(&Kernel {
                features: &[
                    ("ballot", ballot),
                    ("wide", wide),
                    ("narrow", narrow),
                    ("values_are_indices", values_are_indices),
                ],
                constants,
                ..Kernel::new(module, "scatter", &bindings[..7 - usize::from(values_are_indices)], workgroup)
            })
        };
        let copy = |values_are_indices: bool| {
            let bindings = [Access::Uniform, Access::Read, Access::ReadWrite, Access::ReadWrite, Access::Read];
            let module = "package::parallel::radix_sort::copy_pairs";
            gpu.pipeline(&Kernel {
                features: &[("wide", wide), ("ballot", ballot), ("values_are_indices", values_are_indices)],
                ..Kernel::new(module, "copy_pairs", &bindings[..5 - usize::from(values_are_indices)], WORKGROUP)
            })
        };
        Ok(Self {
            parameters: ParameterCache::new(gpu),
            capacity,
            method,
            tile,
            count_digits: gpu.pipeline(&count)?,
            rows: RowScan::new(gpu)?,
            scatter: scatter(false)?,
            scatter_indices: scatter(true)?,
            copy: copy(false)?,
            copy_indices: copy(true)?,
            table: gpu.buffer("digit counts of tiles", radix * n_tiles)?,
            totals: gpu.buffer("digit counts", radix)?,
            spare_keys: gpu.buffer("spare sort keys", capacity)?,
            spare_values: gpu.buffer("spare sort values", capacity)?,
        })
    }

    /// How digits are ranked.
    pub fn method(&self) -> RankMethod {
        self.method
    }

    /// Most bits of a digit.
    fn widest(method: RankMethod) -> u32 {
        match method {
            RankMethod::Ballot | RankMethod::WideBallot => 8,
            RankMethod::Counters => 4,
        }
    }

    /// Records the sort of the first `len` pairs in place: ascending by the bits `bits` of the key, pairs with equal
    /// bits in their former order.
    ///
    /// With an odd number of digits (8 bits each, or 4: see [`RankMethod`]) the pairs are copied once more than with
    /// [`GpuRadixSort::record_from`].
    ///
    /// # Errors
    /// `InvalidSetting` for bits beyond those of the key, `TooMany` if `len` passes the capacity, `LengthMismatch` if a buffer is
    /// shorter, `OutOfDeviceMemory`.
    pub fn record(
        &self,
        commands: &mut Commands,
        keys: &Buffer<K>,
        values: &Buffer<u32>,
        len: usize,
        bits: Range<u32>,
    ) -> Result<()> {
        self.check(&[keys], &[values], len, &bits)?;
        let passes = digits(&bits, Self::widest(self.method));
        let own: [Bind; 2] = [keys.into(), values.into()];
        let spare = [(&self.spare_keys).into(), (&self.spare_values).into()];
        let odd = !passes.len().is_multiple_of(2);
        if odd {
            self.copy_pairs(commands, own.clone().map(Some), &spare, len)?;
        }
        for (number, &digit) in passes.iter().enumerate() {
            let (from, to) = if (number % 2 == 0) == odd { (&spare, &own) } else { (&own, &spare) };
            self.pass(commands, from.clone().map(Some), to, len, digit)?;
        }
        Ok(())
    }

    /// As [`GpuRadixSort::record`] from other buffers, which are left alone: no copy for any number of digits.
    ///
    /// - `source_values`: `None` for the values 0, 1, 2 …, so that `values` becomes the order of the keys
    /// - `keys`, `values`: where the result goes; other buffers than the sources
    ///
    /// # Errors
    /// As [`GpuRadixSort::record`].
    #[allow(clippy::too_many_arguments, reason = "two pairs of buffers and what to do with them")]
    pub fn record_from(
        &self,
        commands: &mut Commands,
        source_keys: &Buffer<K>,
        source_values: Option<&Buffer<u32>>,
        keys: &Buffer<K>,
        values: &Buffer<u32>,
        len: usize,
        bits: Range<u32>,
    ) -> Result<()> {
        self.check(&[source_keys, keys], &[source_values.unwrap_or(values), values], len, &bits)?;
        let passes = digits(&bits, Self::widest(self.method));
        let own: [Bind; 2] = [keys.into(), values.into()];
        let spare = [(&self.spare_keys).into(), (&self.spare_values).into()];
        let mut from = [Some(Bind::from(source_keys)), source_values.map(Bind::from)];
        if passes.is_empty() {
            return self.copy_pairs(commands, from, &own, len);
        }
        for (number, &digit) in passes.iter().enumerate() {
            // The last pass goes to the result.
            let to = if (passes.len() - number) % 2 == 1 { &own } else { &spare };
            self.pass(commands, from, to, len, digit)?;
            from = to.clone().map(Some);
        }
        Ok(())
    }

    fn check(&self, keys: &[&Buffer<K>], values: &[&Buffer<u32>], len: usize, bits: &Range<u32>) -> Result<()> {
        check_bits::<K>(bits)?;
        check_len("pairs to sort", len, self.capacity)?;
        keys.iter().try_for_each(|buffer| check_holds(buffer, len))?;
        values.iter().try_for_each(|buffer| check_holds(buffer, len))
    }

    /// One counting sort. Without source values, the values are the indices.
    fn pass(
        &self,
        commands: &mut Commands,
        [keys, values]: [Option<Bind>; 2],
        to: &[Bind; 2],
        len: usize,
        (shift, width): (u32, u32),
    ) -> Result<()> {
        let n_tiles = len.div_ceil(self.tile);
        if n_tiles == 0 {
            return Ok(());
        }
        let n_digits = 1usize << width;
        let parameters = self.parameters.uniform([len as u32, n_tiles as u32, shift, n_digits as u32 - 1])?;
        let workgroups = Workgroups::Count(n_tiles as u32);
        let keys = keys.expect("a pass should have keys");

        let bindings = [(&parameters).into(), keys.clone(), (&self.table).into()];
        commands.dispatch(&self.count_digits, &bindings, workgroups.clone());
        self.rows.record(commands, &self.table, &self.totals, n_digits, n_tiles)?;
        let scatter = if values.is_some() { &self.scatter } else { &self.scatter_indices };
        let mut bindings = vec![(&parameters).into(), (&self.table).into(), (&self.totals).into(), keys];
        bindings.extend(to.iter().cloned());
        bindings.extend(values);
        commands.dispatch(scatter, &bindings, workgroups);
        Ok(())
    }

    fn copy_pairs(
        &self,
        commands: &mut Commands,
        [keys, values]: [Option<Bind>; 2],
        to: &[Bind; 2],
        len: usize,
    ) -> Result<()> {
        let parameters = self.parameters.uniform([len as u32, 0, 0, 0])?;
        let copy = if values.is_some() { &self.copy } else { &self.copy_indices };
        let mut bindings = vec![(&parameters).into(), keys.expect("a copy should have keys")];
        bindings.extend(to.iter().cloned());
        bindings.extend(values);
        commands.dispatch(copy, &bindings, Workgroups::Covering(len as u64));
        Ok(())
    }
}

/// Workgroup size for ranking by ballots; `None` where the device cannot.
fn ballot_workgroup(gpu: &Gpu) -> Option<u32> {
    let limits = gpu.limits();
    let (smallest, largest) = limits.subgroup?;
    let workgroup = (MAX_SUBGROUPS * smallest).min(WORKGROUP);
    let fits = workgroup <= limits.workgroup_invocations && limits.workgroup_bytes >= BALLOT_BYTES;
    (fits && largest > 0 && workgroup.is_multiple_of(largest)).then_some(workgroup)
}
