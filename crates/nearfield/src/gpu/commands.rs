//! Recording of dispatches and copies in named stages, and their times.

use std::sync::{Arc, Mutex, OnceLock, PoisonError, mpsc};

use super::buffer::Accounted;
use super::encode::encode_stage;
use super::read_back::{Destination, ReadBack};
use super::{Buffer, DeviceElement, Gpu, Pipeline};
use crate::{Error, Result};

/// Stages that one set of timestamps holds: two for each stage.
const MOST_TIMED_STAGES: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;

/// Repetitions that are submitted together: the fewer, the sooner the device begins, but a submission takes the host 40 µs.
const TOGETHER: u32 = 2;
/// Most threads that encode them: one takes some 9 µs a dispatch on the host of an H200, where a step of ten small ones takes 100.
const ENCODERS: usize = 4;

/// A buffer as a kernel sees it.
#[derive(Debug, Clone)]
pub struct Bind {
    pub(super) raw: wgpu::Buffer,
    /// Bytes that the kernel sees: those of the elements, of one where there is none, however large the buffer is.
    pub(super) bytes: u64,
    /// Work that is recorded keeps the memory of its buffers, also when they are dropped before it is submitted.
    accounted: Option<Arc<Accounted>>,
}

impl<T: DeviceElement> From<&Buffer<T>> for Bind {
    fn from(buffer: &Buffer<T>) -> Self {
        let bytes = buffer.bytes().max(size_of::<T>() as u64).max(4).next_multiple_of(4).min(buffer.raw().size());
        Self { raw: buffer.raw().clone(), bytes, accounted: buffer.accounted() }
    }
}

/// How many workgroups a dispatch has.
#[derive(Debug, Clone)]
pub enum Workgroups {
    /// That many.
    Count(u32),
    /// Enough for one invocation an item.
    Covering(u64),
    /// Three words of a buffer, from that byte on: x, y, z. Written by a kernel before.
    Indirect(Bind, u64),
}

/// Time of a stage on the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageTime {
    /// Name as given to [`Commands::stage`].
    pub name: &'static str,
    /// Milliseconds; `None` where the device has no timestamps, or the work has more stages than they can time.
    pub milliseconds: Option<f64>,
}

/// Recorded work: stages of dispatches and copies, run in order when submitted.
pub struct Commands {
    gpu: Gpu,
    label: &'static str,
    stages: Vec<Stage>,
    reads: Vec<Arc<Destination>>,
    error: Option<Error>,
}

/// Work that is recorded once and submitted again and again: bindings are made once.
pub struct Recorded {
    gpu: Gpu,
    label: &'static str,
    stages: Vec<Stage>,
    reads: Vec<Arc<Destination>>,
    /// Held while it is submitted: threads that share it take turns with what is read back.
    turn: Mutex<()>,
}

/// Steps that are timed together.
pub(super) struct Stage {
    pub(super) name: &'static str,
    pub(super) steps: Vec<Step>,
}

/// What is recorded, in order.
pub(super) enum Step {
    Dispatch {
        pipeline: Arc<Pipeline>,
        groups: [Vec<Bind>; 2],
        made: OnceLock<Vec<wgpu::BindGroup>>,
        workgroups: Workgroups,
    },
    Clear {
        buffer: Bind,
        bytes: u64,
    },
    Copy {
        source: Bind,
        offset: u64,
        destination: Bind,
        bytes: u64,
    },
    /// Into staging memory.
    ReadBack {
        source: Bind,
        destination: Arc<Destination>,
    },
}

impl Step {
    fn binds(&self) -> impl Iterator<Item = &Bind> {
        let (first, second, groups) = match self {
            Self::Dispatch { groups, workgroups: Workgroups::Indirect(bind, _), .. } => (Some(bind), None, &groups[..]),
            Self::Dispatch { groups, .. } => (None, None, &groups[..]),
            Self::Clear { buffer, .. } => (Some(buffer), None, &[][..]),
            Self::Copy { source, destination, .. } => (Some(source), Some(destination), &[][..]),
            Self::ReadBack { source, .. } => (Some(source), None, &[][..]),
        };
        groups.iter().flatten().chain(first).chain(second)
    }
}

impl Gpu {
    /// Starts recording.
    pub fn commands(&self, label: &'static str) -> Commands {
        Commands { gpu: self.clone(), label, stages: Vec::new(), reads: Vec::new(), error: None }
    }
}

impl Commands {
    /// Opens a stage: what is recorded until the next one is timed under this name.
    pub fn stage(&mut self, name: &'static str) -> &mut Self {
        self.stages.push(Stage { name, steps: Vec::new() });
        self
    }

    fn step(&mut self, step: Step) {
        let foreign = step.binds().filter_map(|bind| bind.accounted.as_ref());
        let checked = foreign.map(|accounted| accounted.check_context(&self.gpu, self.label)).find(Result::is_err);
        if let Some(Err(error)) = checked {
            self.error.get_or_insert(error);
            return;
        }
        if self.stages.is_empty() {
            self.stage(self.label);
        }
        self.stages.last_mut().expect("a stage should be open").steps.push(step);
    }

    /// Runs a kernel with `bindings` as `@group(0)`. Dispatches of more than 65,535 workgroups fold into y: kernels
    /// take their number from `package::gpu::dispatch`.
    pub fn dispatch(&mut self, pipeline: &Arc<Pipeline>, bindings: &[Bind], workgroups: Workgroups) -> &mut Self {
        self.dispatch_with_visitor(pipeline, bindings, &[], workgroups)
    }

    /// As [`Commands::dispatch`], with the bindings of a visitor as `@group(1)`.
    pub fn dispatch_with_visitor(
        &mut self,
        pipeline: &Arc<Pipeline>,
        bindings: &[Bind],
        visitor: &[Bind],
        workgroups: Workgroups,
    ) -> &mut Self {
        let groups = [bindings.to_vec(), visitor.to_vec()];
        self.step(Step::Dispatch { pipeline: Arc::clone(pipeline), groups, made: OnceLock::new(), workgroups });
        self
    }

    /// Sets every byte of the buffer to zero.
    pub fn clear<T: DeviceElement>(&mut self, buffer: &Buffer<T>) -> &mut Self {
        let bytes = buffer.bytes().max(4).next_multiple_of(4);
        self.step(Step::Clear { buffer: buffer.into(), bytes });
        self
    }

    /// Copies all of `source` to the start of `destination`.
    pub fn copy<T: DeviceElement>(&mut self, source: &Buffer<T>, destination: &Buffer<T>) -> &mut Self {
        if destination.len() < source.len() {
            let (found, expected) = (destination.len() as u64, source.len() as u64);
            self.error.get_or_insert(Error::LengthMismatch { what: destination.label(), found, expected });
        }
        let bytes = source.bytes().next_multiple_of(4);
        self.step(Step::Copy { source: source.into(), offset: 0, destination: destination.into(), bytes });
        self
    }

    /// Copies as many elements as `destination` has from `source`, from element `first` on.
    pub fn copy_from<T: DeviceElement>(
        &mut self,
        source: &Buffer<T>,
        first: usize,
        destination: &Buffer<T>,
    ) -> &mut Self {
        let (end, offset) = (first.saturating_add(destination.len()), (first * size_of::<T>()) as u64);
        if end > source.len() {
            let (found, expected) = (source.len() as u64, end as u64);
            self.error.get_or_insert(Error::LengthMismatch { what: source.label(), found, expected });
        }
        if !(offset.is_multiple_of(4) && destination.bytes().is_multiple_of(4)) {
            self.error.get_or_insert(Error::Unsupported {
                what: format!("copying {} bytes from byte {offset} of {}", destination.bytes(), source.label()),
                advice: "copy whole words of 4 bytes",
            });
        }
        let bytes = destination.bytes();
        self.step(Step::Copy { source: source.into(), offset, destination: destination.into(), bytes });
        self
    }

    /// Copies all of `buffer` to the host, as it is at this place of the recording. The values can be had once the work was submitted, and cost no
    /// submission of their own. For small buffers: as much staging memory is held for as long as the answer lives.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for the staging memory, `DeviceLost`.
    pub fn read_back<T: DeviceElement>(&mut self, buffer: &Buffer<T>) -> Result<ReadBack<T>> {
        let read = ReadBack::new(&self.gpu, buffer)?;
        let destination = Arc::clone(read.destination());
        self.reads.push(Arc::clone(&destination));
        self.step(Step::ReadBack { source: buffer.into(), destination });
        Ok(read)
    }

    /// Submits without waiting; later reads see the results.
    ///
    /// # Errors
    /// `Device` with the driver's message, `OutOfDeviceMemory`, `DeviceLost`.
    pub fn submit(self) -> Result<()> {
        self.submit_repeated(1)
    }

    /// Submits so many times, one after the other, without waiting. Bindings are made once and several threads encode, so that this takes the host
    /// much less time than recording the work again.
    ///
    /// # Errors
    /// As [`Commands::submit`]. Repetitions before the one that fails may have been submitted: what they write is then undefined.
    pub fn submit_repeated(self, times: u32) -> Result<()> {
        let recorded = self.record()?;
        match times {
            0 => Ok(()),
            1 => recorded.submit(),
            _ => {
                let submission = submit_parts(&recorded.gpu, recorded.label, &recorded.stages, times)?;
                recorded.gpu.checked(recorded.label, 0, || {
                    recorded.reads.iter().for_each(|read| read.submitted(&submission));
                })
            }
        }
    }

    /// Ends the recording, to submit it again and again.
    ///
    /// # Errors
    /// `Device` for buffers of another context, `LengthMismatch`, `Unsupported`: what was wrong with a step.
    pub fn record(mut self) -> Result<Recorded> {
        if let Some(error) = self.error.take() {
            return Err(error);
        }
        // Without times to take, all dispatches between two copies are one pass.
        let steps = self.stages.drain(..).flat_map(|stage| stage.steps).collect();
        let stages = vec![Stage { name: self.label, steps }];
        Ok(Recorded { gpu: self.gpu, label: self.label, stages, reads: self.reads, turn: Mutex::new(()) })
    }

    /// Submits, waits, and returns the time of every stage; none where there is no memory to read them back.
    ///
    /// # Errors
    /// As [`Commands::submit`]. After `OutOfDeviceMemory` nothing was run.
    pub fn run(self) -> Result<Vec<StageTime>> {
        let Self { gpu, label, stages, reads, error } = self;
        if let Some(error) = error {
            return Err(error);
        }
        let ticks = Ticks::new(&gpu, stages.len())?;
        let submission = encode_and_submit(&gpu, label, &stages, &reads, ticks.as_ref())?;
        gpu.wait(label, submission)?;
        let times = ticks.map(|ticks| ticks.milliseconds(&gpu)).transpose()?;
        let time = |(i, stage): (usize, &Stage)| StageTime {
            name: stage.name,
            milliseconds: times.as_ref().and_then(|times| times.get(i)).copied(),
        };
        Ok(stages.iter().enumerate().map(time).collect())
    }
}

impl Recorded {
    /// Submits without waiting; later reads see the results. Values of an earlier submission that were not taken are waited for and lost.
    ///
    /// # Errors
    /// As [`Commands::submit`].
    pub fn submit(&self) -> Result<()> {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        encode_and_submit(&self.gpu, self.label, &self.stages, &self.reads, None).map(drop)
    }
}

impl std::fmt::Debug for Recorded {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Recorded({})", self.label)
    }
}

/// Timestamps of stages, read back with the work that they time.
struct Ticks {
    query_set: wgpu::QuerySet,
    resolved: Buffer<u64>,
    read: ReadBack<u64>,
}

impl Ticks {
    /// For so many stages; `None` where they cannot be timed, or there is no memory to read the ticks back.
    fn new(gpu: &Gpu, n_stages: usize) -> Result<Option<Self>> {
        if gpu.limits().timestamp_period.is_none() || !(1..=MOST_TIMED_STAGES).contains(&n_stages) {
            return Ok(None);
        }
        let resolved = gpu.query_buffer("stage timestamps", 2 * n_stages)?;
        let read = match ReadBack::new(gpu, &resolved) {
            Err(Error::OutOfDeviceMemory { .. }) => return Ok(None),
            made => made?,
        };
        let descriptor = wgpu::QuerySetDescriptor {
            label: Some("stage timestamps"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * n_stages as u32,
        };
        let query_set = gpu.checked("stage timestamps", 0, || gpu.device().create_query_set(&descriptor))?;
        Ok(Some(Self { query_set, resolved, read }))
    }

    /// Records the copy of all ticks.
    fn encode(&self, encoder: &mut wgpu::CommandEncoder) {
        let n = self.resolved.len() as u32;
        encoder.resolve_query_set(&self.query_set, 0..n, self.resolved.raw(), 0);
        self.read.destination().encode(encoder, self.resolved.raw());
    }

    /// Milliseconds of each stage, once the work is done.
    fn milliseconds(&self, gpu: &Gpu) -> Result<Vec<f64>> {
        let period = f64::from(gpu.limits().timestamp_period.unwrap_or(1.0));
        let time = |pair: &[u64]| pair[1].saturating_sub(pair[0]) as f64 * period * 1e-6;
        Ok(self.read.values()?.chunks_exact(2).map(time).collect())
    }
}

/// Submits once, with ticks around each stage if they are given.
fn encode_and_submit(
    gpu: &Gpu,
    label: &'static str,
    stages: &[Stage],
    reads: &[Arc<Destination>],
    ticks: Option<&Ticks>,
) -> Result<wgpu::SubmissionIndex> {
    compile(gpu, stages)?;
    for read in reads {
        read.begin();
    }
    let submission = gpu.checked(label, 0, || {
        let device = gpu.device();
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
        for (number, stage) in stages.iter().enumerate() {
            encode_stage(gpu, &mut encoder, stage, ticks.map(|ticks| (&ticks.query_set, 2 * number as u32)));
        }
        if let Some(ticks) = ticks {
            ticks.encode(&mut encoder);
        }
        gpu.queue().submit([encoder.finish()])
    })?;
    if !reads.is_empty() || ticks.is_some() {
        gpu.checked(label, 0, || {
            for read in reads.iter().chain(ticks.map(|ticks| ticks.read.destination())) {
                read.submitted(&submission);
            }
        })?;
    }
    Ok(submission)
}

/// Compiles what the stages use, if it was not used before.
fn compile(gpu: &Gpu, stages: &[Stage]) -> Result<()> {
    gpu.compile_all(stages.iter().flat_map(|stage| &stage.steps).filter_map(|step| match step {
        Step::Dispatch { pipeline, .. } => Some(pipeline),
        _ => None,
    }))
}

/// Submits so many repetitions in parts, one after the other. The device works on some while threads make the next ones ready: one thread
/// takes longer for a part of small kernels than the device does.
fn submit_parts(gpu: &Gpu, label: &'static str, stages: &[Stage], times: u32) -> Result<wgpu::SubmissionIndex> {
    compile(gpu, stages)?;
    let parts = times.div_ceil(TOGETHER) as usize;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(ENCODERS)).min(parts);
    let encode = |part: usize| {
        let repetitions = (times - part as u32 * TOGETHER).min(TOGETHER);
        gpu.checked(label, 0, || {
            let descriptor = wgpu::CommandEncoderDescriptor { label: Some(label) };
            let mut encoder = gpu.device().create_command_encoder(&descriptor);
            for stage in (0..repetitions).flat_map(|_| stages) {
                encode_stage(gpu, &mut encoder, stage, None);
            }
            encoder.finish()
        })
    };
    let encode = &encode;
    let submit = || {
        std::thread::scope(|scope| {
            let spawn = |thread: usize| {
                let (sender, receiver) = mpsc::sync_channel(1);
                // Nobody takes a part after one that failed.
                let work = move || (thread..parts).step_by(threads).all(|part| sender.send(encode(part)).is_ok());
                std::thread::Builder::new().spawn_scoped(scope, work).ok().map(|_| receiver)
            };
            let ready: Vec<mpsc::Receiver<Result<wgpu::CommandBuffer>>> =
                if threads > 1 { (0..threads).map_while(spawn).collect() } else { Vec::new() };
            let mut last = None;
            for part in 0..parts {
                // A thread that could not be had leaves its parts to this one.
                let encoded = match ready.get(part % threads) {
                    Some(receiver) => receiver.recv().unwrap_or_else(|_| encode(part)),
                    None => encode(part),
                };
                last = Some(gpu.queue().submit([encoded?]));
            }
            Ok(last.expect("there should be a part"))
        })
    };
    gpu.checked(label, 0, submit)?
}
