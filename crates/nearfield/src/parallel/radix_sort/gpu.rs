//! The radix sort on the device: a survey of the keys, a plan, and a pass for every digit that varies.
//!
//! The survey reads the keys once. From it the device plans by itself which passes run and between which buffers, as
//! pairs go back and forth between two pairs of them; kernels of a pass that does not run return at once.
//!
//! In the portable form a pass counts the digits of each tile into a table `[digits × tiles]`, scans its rows, and
//! moves every pair to the start of its digit plus the row's prefix of its tile plus its rank within the tile: three
//! dispatches. In the single-pass form the survey has counted the digits of all passes, and tiles tell each other their
//! counts while they run: one dispatch, and keys are read once instead of twice.

use std::ops::Range;
use std::sync::Arc;

use super::{SortKey, check_bits};
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::parallel::tile::{ParameterCache, RowScan, WORKGROUP, check_capacity, check_holds, check_len};
use crate::{Error, Result};

/// How a workgroup ranks equal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RankMethod {
    /// 8-bit digits; lanes find their equals by subgroup ballots of one word, or of four for subgroups of more than 32
    /// lanes. Workgroups wait for each other, for a limited time: for devices on which those that have started go on.
    SinglePass,
    /// 8-bit digits; lanes find their equals by subgroup ballots of one word.
    Ballot,
    /// As `Ballot` with ballots of four words, for subgroups of up to 128 lanes.
    WideBallot,
    /// 4-bit digits; counters in workgroup memory. Runs everywhere.
    Counters,
}

/// Most subgroups of a workgroup in scatter_ballot.wesl, and most of its invocations.
const MAX_SUBGROUPS: u32 = 16;
const MAX_BALLOT_WORKGROUP: u32 = 512;
/// Workgroup memory of scatter_ballot.wesl, and keys of one invocation, as in pass.wesl.
///
/// Two workgroups must fit into 48 KiB: an H200 has more for each multiprocessor, but under Vulkan times tell that all
/// workgroups there share that much (two of 23.1 KiB run together but of 26.1 one, three of 14.1 but of 16.1 two).
/// 10 M u32 pairs by 32 bits: 654 µs with one workgroup of 256 × 16 keys, 566 with two of them, 472 with three of
/// 256 × 12, 457 with two of 512 × 8, 422 with two of 512 × 10, 397 with two of 512 × 11.
const BALLOT_BYTES: u32 = 24 * 1024;
const BALLOT_ITEMS: usize = 11;
const COUNTER_ITEMS: usize = 8;
/// Counts of the single-pass form have 30 bits.
const MOST_IN_SINGLE_PASS: usize = (1 << 30) - 1;
/// Workgroups of the survey: enough for any device, and few enough that adding up their counts is cheap (10 M u32 keys on
/// an H200: 30 µs by 264 workgroups, 36 by 1024; u64 73 and 71).
const SURVEY_WORKGROUPS: usize = 1024;
/// Words of a step of the plan, as in pass.wesl.
const STEP_WORDS: usize = 4;

/// A plan for stable sorts of (key, u32 value) pairs on the device; keys are `u32` or `u64`.
#[derive(Debug)]
pub struct GpuRadixSort<K: SortKey = u32> {
    parameters: ParameterCache,
    capacity: usize,
    method: RankMethod,
    tile: usize,
    survey_keys: Arc<Pipeline>,
    make_plan: Arc<Pipeline>,
    scatter: Arc<Pipeline>,
    /// What the portable form runs before it scatters.
    counting: Option<(Arc<Pipeline>, RowScan)>,
    /// Zero but while a sort runs.
    survey: Buffer<u32>,
    plan: Buffer<u32>,
    /// Digit counts of tiles, or what tiles tell each other.
    table: Buffer<u32>,
    spare_keys: Buffer<K>,
    spare_values: Buffer<u32>,
}

/// Where the pairs of a sort come from, as numbered in pass.wesl.
#[derive(Clone, Copy, PartialEq)]
enum Origin {
    Own = 0,
    Source = 2,
    Indices = 3,
}

impl<K: SortKey> GpuRadixSort<K> {
    /// A plan for up to `capacity` pairs, by the fastest method of the device.
    ///
    /// Its scratch memory is a second pair of buffers, and 4 bytes for each digit and tile: 0.7 bytes a pair with
    /// subgroups of 8 lanes, 0.2 with 32.
    ///
    /// # Errors
    /// `TooMany` beyond 2³¹ pairs, `OutOfDeviceMemory`, `KernelRejected`.
    pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self> {
        // Half the passes win even with 8 lanes: 22 bits of 1 M keys on llvmpipe 0.46 s by ballots, 1.18 s by counters.
        let method = match gpu.limits().subgroup {
            Some((_, largest)) if ballot_workgroup(gpu).is_some() => {
                if gpu.limits().workgroups_progress && capacity <= MOST_IN_SINGLE_PASS {
                    RankMethod::SinglePass
                } else if largest <= 32 {
                    RankMethod::Ballot
                } else {
                    RankMethod::WideBallot
                }
            }
            _ => RankMethod::Counters,
        };
        Self::with_method(gpu, capacity, method)
    }

    /// As [`GpuRadixSort::new`] with a given method. [`RankMethod::SinglePass`] is right on any device, but slow where
    /// workgroups that have started do not go on.
    ///
    /// # Errors
    /// `Unsupported` for ballots on a device without subgroup operations, with less than 24 KiB of workgroup memory, or
    /// with more lanes than the method has; `TooMany` for 2³⁰ pairs or more in a single pass; the other errors of
    /// [`GpuRadixSort::new`].
    pub fn with_method(gpu: &Gpu, capacity: usize, method: RankMethod) -> Result<Self> {
        let single_pass = method == RankMethod::SinglePass;
        if single_pass {
            check_len("pairs to sort in a single pass", capacity, MOST_IN_SINGLE_PASS)?;
        }
        check_capacity("pairs to sort", capacity)?;
        let ballot = method != RankMethod::Counters;
        let few_lanes = gpu.limits().subgroup.is_some_and(|(_, largest)| largest <= 32);
        let narrow = method == RankMethod::Ballot || (single_pass && few_lanes);
        let (workgroup, items) = if ballot {
            let fits = |_: &u32| !narrow || few_lanes;
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
        let most_passes = 64 / Self::widest(method) as usize;

        let features = [
            ("ballot", ballot),
            ("narrow", narrow),
            ("single_pass", single_pass),
            ("short_loops", gpu.limits().loop_rounds.is_some()),
            ("wide", K::BITS > u32::BITS),
        ];
        let constants = [("WORKGROUP", f64::from(workgroup))];
        let pipeline = |stage: (&str, &str), bindings: &[Access], workgroup: u32, constants: &[(&str, f64)]| {
            let kernel =
                Kernel { features: &features, constants, ..Kernel::new(stage.0, stage.1, bindings, workgroup) };
            gpu.prepare(&kernel)
        };
        let (read, write) = (Access::Read, Access::ReadWrite);
        let surveys = [Access::Uniform, read, write, write];
        let plans = [Access::Uniform, write, write];
        let passes =
            [Access::Uniform, read, if single_pass { write } else { read }, write, write, read, write, write, read];
        let counts = [Access::Uniform, read, write, write, write, read];
        let counting = || -> Result<_> {
            let stage = ("package::parallel::radix_sort::count_digits", "count_digits");
            Ok((pipeline(stage, &counts, workgroup, &constants)?, RowScan::new(gpu)?))
        };
        let scatter = if ballot {
            pipeline(("package::parallel::radix_sort::scatter_ballot", "scatter"), &passes, workgroup, &constants)
        } else {
            pipeline(("package::parallel::radix_sort::scatter", "scatter"), &passes, workgroup, &[])
        };
        let surveys = &surveys[..3 + usize::from(single_pass)];
        Ok(Self {
            parameters: ParameterCache::new(gpu),
            capacity,
            method,
            tile,
            survey_keys: pipeline(
                ("package::parallel::radix_sort::survey", "survey_keys"),
                surveys,
                workgroup,
                &constants,
            )?,
            make_plan: pipeline(("package::parallel::radix_sort::plan", "make_plan"), &plans, WORKGROUP, &[])?,
            scatter: scatter?,
            counting: if single_pass { None } else { Some(counting()?) },
            survey: gpu.upload("survey of sort keys", &vec![0; 2 + radix * most_passes])?,
            plan: gpu.buffer("plan of a sort", (radix + STEP_WORDS) * most_passes)?,
            table: gpu.buffer("digit counts of tiles", radix * (n_tiles + 1))?,
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
        if method == RankMethod::Counters { 4 } else { 8 }
    }

    /// Records the sort of the first `len` pairs in place: ascending by the bits `bits` of the key, pairs with equal
    /// bits in their former order.
    ///
    /// Where the number of digits that vary (8 bits each, or 4: see [`RankMethod`]) is odd, the pairs are moved once
    /// more than with [`GpuRadixSort::record_from`].
    ///
    /// # Errors
    /// `InvalidSetting` for bits beyond those of the key, `TooMany` if `len` passes the capacity, `LengthMismatch` if a
    /// buffer is shorter, `OutOfDeviceMemory`.
    pub fn record(
        &self,
        commands: &mut Commands,
        keys: &Buffer<K>,
        values: &Buffer<u32>,
        len: usize,
        bits: Range<u32>,
    ) -> Result<()> {
        self.check(&[keys], &[values], len, &bits)?;
        // Never read: the plan only stands where a source would.
        let source = [(&self.plan).into(), (&self.plan).into()];
        self.sort(commands, Origin::Own, source, [keys.into(), values.into()], len, &bits)
    }

    /// As [`GpuRadixSort::record`] from other buffers, which are left alone.
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
        let (origin, source_values) = match source_values {
            Some(values) => (Origin::Source, values.into()),
            None => (Origin::Indices, (&self.plan).into()),
        };
        self.sort(commands, origin, [source_keys.into(), source_values], [keys.into(), values.into()], len, &bits)
    }

    fn check(&self, keys: &[&Buffer<K>], values: &[&Buffer<u32>], len: usize, bits: &Range<u32>) -> Result<()> {
        check_bits::<K>(bits)?;
        check_len("pairs to sort", len, self.capacity)?;
        keys.iter().try_for_each(|buffer| check_holds(buffer, len))?;
        values.iter().try_for_each(|buffer| check_holds(buffer, len))
    }

    fn sort(
        &self,
        commands: &mut Commands,
        origin: Origin,
        source: [Bind; 2],
        own: [Bind; 2],
        len: usize,
        bits: &Range<u32>,
    ) -> Result<()> {
        let passes = self.passes(origin, bits);
        if len == 0 || passes.is_empty() {
            return Ok(());
        }
        let whole = [len as u32, bits.start, bits.end - bits.start, origin as u32];
        let whole = Bind::from(&self.parameters.uniform(whole)?);
        let [survey, plan, table] = [&self.survey, &self.plan, &self.table].map(Bind::from);
        let n_tiles = len.div_ceil(self.tile);

        let keys = if origin == Origin::Own { &own[0] } else { &source[0] };
        let mut bindings = vec![whole.clone(), keys.clone(), survey.clone()];
        bindings.extend(self.counting.is_none().then(|| table.clone()));
        let workgroups = Workgroups::Count(n_tiles.min(SURVEY_WORKGROUPS) as u32);
        commands.dispatch(&self.survey_keys, &bindings, workgroups);
        let planners = if self.counting.is_none() { passes.len() as u32 } else { 1 };
        commands.dispatch(&self.make_plan, &[whole, survey, plan.clone()], Workgroups::Count(planners));

        let [own_keys, own_values] = own;
        let [source_keys, source_values] = source;
        let (spare_keys, spare_values) = (Bind::from(&self.spare_keys), Bind::from(&self.spare_values));
        let workgroups = Workgroups::Count(n_tiles as u32);
        for (number, &(shift, width)) in passes.iter().enumerate() {
            let n_digits = 1usize << width;
            let pass = [len as u32, shift, n_digits as u32 - 1, number as u32];
            let pass = Bind::from(&self.parameters.uniform(pass)?);
            let keys = [&pass, &plan, &table, &own_keys, &spare_keys, &source_keys].map(Bind::clone);
            if let Some((count_digits, rows)) = &self.counting {
                commands.dispatch(count_digits, &keys, workgroups.clone());
                rows.record(commands, &self.table, &self.plan, n_digits, n_tiles)?;
            }
            let pairs = [&keys[..], &[own_values.clone(), spare_values.clone(), source_values.clone()]].concat();
            commands.dispatch(&self.scatter, &pairs, workgroups.clone());
        }
        Ok(())
    }

    /// The digits of the passes, and as many of no bits as plan.wesl counts on.
    fn passes(&self, origin: Origin, bits: &Range<u32>) -> Vec<(u32, u32)> {
        let mut passes = super::digits(bits, Self::widest(self.method));
        let needs_another = if origin == Origin::Own { !passes.len().is_multiple_of(2) } else { passes.is_empty() };
        passes.extend(needs_another.then_some((0, 0)));
        passes
    }
}

/// Workgroup size for ranking by ballots; `None` where the device cannot.
fn ballot_workgroup(gpu: &Gpu) -> Option<u32> {
    let limits = gpu.limits();
    let (smallest, largest) = limits.subgroup?;
    let most = MAX_BALLOT_WORKGROUP.min(limits.workgroup_invocations);
    let workgroup = (MAX_SUBGROUPS * smallest).min(most);
    (limits.workgroup_bytes >= BALLOT_BYTES && largest > 0 && workgroup.is_multiple_of(largest)).then_some(workgroup)
}
