//! Locally optimal projection on a device: points, samples, what finds them and all sums stay there.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use glam::Vec3;

use super::gpu_layout::{AdvanceParameters, DensityParameters, PairParameters, Pull, Record, RecordPart};
use super::samples::Around;
use super::start::{self, sample_spacing};
use super::variant::{Density, Formula, Power};
use super::{WlopReport, WlopSamples, WlopSettings, WlopStart};
use crate::Result;
use crate::application::Watch;
use crate::gpu::{Access, Bind, Buffer, Commands, Gpu, Kernel, Pipeline, StageTime, Workgroups};
use crate::query::{DeviceQueries, Stage, VisitorModule, record_module};
use crate::structure::{
    AabbTreeN, AabbTreeNSettings, AabbTreeSettings, BuildOrder, DevicePoint, GpuAabbTree, GpuStructure, GpuUniformGrid,
    GridSettings,
};

use Access::{Read, ReadWrite, Uniform};

/// Invocations of a workgroup of `advance.wesl`.
const WORKGROUP: u32 = 256;
/// Most iterations that are submitted together.
const TOGETHER: u32 = 10;
/// Milliseconds that a submission should take at most, for the sake of drivers' time limits and of those who wait.
const SUBMISSION: f64 = 200.0;
/// Set in the number of samples around one that is attracted. Twin of `ATTRACTED` in pairs.wesl.
const ATTRACTED: u32 = 1 << 31;
/// Stages of an iteration.
const STAGES: usize = 4;

/// [`super::Wlop`] on a device, in f32. Positions agree with those of the CPU but for rounding.
///
/// A grid over the points is built once; the tree over the samples, built along the Hilbert curve, is refitted in every iteration. Up to
/// ten iterations are submitted together, after which the host reads the sums of their reports; samples that rest in between are left
/// alone.
pub struct GpuWlop {
    gpu: Gpu,
    settings: WlopSettings,
    formula: Formula,
    radius: f32,
    /// Sum of the moves below which the samples rest.
    least_move: f32,
    inputs: GpuUniformGrid,
    /// `[n]` v by index, or nothing that is read.
    input_weights: Buffer<f32>,
    tree: GpuAabbTree,
    /// `[s]` by index, as all that follow.
    sample_weights: Buffer<f32>,
    pulls: Buffer<Pull>,
    moved: Buffer<DevicePoint>,
    parts: Buffer<RecordPart>,
    /// `[1 + TOGETHER]` of the iterations that run together, and what comes before them.
    records: Buffer<Record>,
    density: Buffer<DensityParameters>,
    /// Of the first iteration and of the others.
    attraction: [Buffer<PairParameters>; 2],
    repulsion: Buffer<PairParameters>,
    /// Of each iteration of those that run together.
    steps: Vec<Buffer<AdvanceParameters>>,
    advance: Arc<Pipeline>,
    conclude: Arc<Pipeline>,
    iterations: u32,
    /// Iterations of the next submission.
    together: u32,
    rests: bool,
}

impl GpuWlop {
    /// Samples that begin at some of the points or elsewhere; computes the weights of the points.
    ///
    /// # Errors
    /// As [`super::Wlop::new`]; `CoordinateTooLarge`, `InvalidRadius`, `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`; `Unsupported`
    /// where the device would end the loops of a search.
    pub fn new(
        gpu: &Gpu,
        points: &[Vec3],
        start: &WlopStart<'_, f32>,
        settings: &WlopSettings,
        watch: &mut Watch<'_>,
    ) -> Result<Self> {
        settings.validate()?;
        let positions = start.positions(points.len(), |index| points[index].to_array())?;
        let samples = AabbTreeN::build(&positions, &AabbTreeNSettings::default())?;
        let on_host = || {
            let points: Vec<[f32; 3]> = points.iter().map(Vec3::to_array).collect();
            AabbTreeN::build(&points, &AabbTreeNSettings::default()).map(Cow::Owned)
        };
        let radius = if positions.is_empty() { 1.0 } else { start::radius(settings, on_host, &samples)? };
        let formula = Formula::new(settings.variant, settings.weigh_inputs, radius.into());
        let along_curve = AabbTreeSettings::DEFAULT.order(BuildOrder::Hilbert);
        // Searches among the points reach as far as this or a little less, and the points stay.
        let reach = formula.attraction.reach as f32 * radius;
        let inputs = GpuUniformGrid::build(gpu, points, &GridSettings::for_radius(reach))?;
        let vectors: Vec<Vec3> = positions.iter().map(|&p| Vec3::from_array(p)).collect();
        let tree = GpuAabbTree::build(gpu, &vectors, &along_curve)?;
        let n = positions.len();
        let input_weights = match formula.inputs.filter(|_| n > 0) {
            Some(density) => input_weights(gpu, &inputs, &density, radius, watch)?,
            None => gpu.upload("weights of points", &[1.0])?,
        };
        let least_move = (settings.tolerance * sample_spacing(&samples) * n as f64) as f32;
        let n_parts = (n as u32).div_ceil(WORKGROUP);
        let step = |iteration| {
            gpu.uniform(
                "advance parameters",
                &AdvanceParameters { n_samples: n as u32, n_parts, iteration, least_move },
            )
        };
        let attraction = |power: Power| {
            let pairs = PairParameters::new(&formula.attraction, power, &formula, radius, settings.mu);
            gpu.uniform("attraction", &pairs)
        };
        let pushes = PairParameters::new(&formula.repulsion, formula.repulsion.power, &formula, radius, settings.mu);
        let pipeline = |entry, accesses: &[Access]| {
            gpu.prepare(&Kernel::new("package::application::wlop::advance", entry, accesses, WORKGROUP))
        };
        Ok(Self {
            input_weights,
            sample_weights: gpu.buffer("weights of samples", n)?,
            pulls: gpu.buffer("pulls", n)?,
            moved: gpu.buffer("moved samples", n)?,
            parts: gpu.buffer("sums of workgroups", n_parts.max(1) as usize)?,
            records: gpu.buffer("sums of iterations", 1 + TOGETHER as usize)?,
            density: gpu.uniform("density of samples", &DensityParameters::new(&formula.samples, radius))?,
            attraction: [attraction(formula.first_power)?, attraction(formula.attraction.power)?],
            repulsion: gpu.uniform("repulsion", &pushes)?,
            steps: (1..=TOGETHER).map(step).collect::<Result<_>>()?,
            advance: pipeline("advance", &[Uniform, ReadWrite, ReadWrite, Read, Read, ReadWrite])?,
            conclude: pipeline("conclude", &[Uniform, ReadWrite, ReadWrite])?,
            gpu: gpu.clone(),
            settings: *settings,
            formula,
            radius,
            least_move,
            inputs,
            tree,
            iterations: 0,
            together: 1,
            rests: false,
        })
    }

    /// Moves every sample once.
    ///
    /// # Errors
    /// `NonFinite` where samples would have left what can be searched: they are then where they were, and the others have moved.
    /// `Unsupported` where the device would end the loops of a search; `OutOfDeviceMemory`, `DeviceLost`.
    pub fn iterate(&mut self) -> Result<WlopReport> {
        Ok(self.submit(1)?.pop().unwrap_or_default())
    }

    /// Makes some iterations, up to ten, in one submission; fewer once the samples rest. How many follows from the time of those
    /// before, so that a submission takes some tenths of a second at most. Returns their reports, none where all is done.
    ///
    /// # Errors
    /// As [`GpuWlop::iterate`].
    pub fn iterate_some(&mut self) -> Result<Vec<WlopReport>> {
        if self.is_done() {
            return Ok(Vec::new());
        }
        let reports = self.submit(self.together.min(self.settings.iterations - self.iterations))?;
        let took = reports.iter().map(|report| report.milliseconds).fold(0.0, f64::max);
        self.together = ((SUBMISSION / took.max(1e-3)) as u32).clamp(1, TOGETHER);
        Ok(reports)
    }

    /// Whether the samples rest, have made all iterations, or are none.
    pub fn is_done(&self) -> bool {
        self.rests || self.iterations >= self.settings.iterations || self.pulls.is_empty()
    }

    /// Iterates until all is done.
    ///
    /// # Errors
    /// `Interrupted` where the watch ends it; the samples are then where their last move led. As [`GpuWlop::iterate`].
    pub fn run(&mut self, watch: &mut Watch<'_>) -> Result<Vec<WlopReport>> {
        let mut reports = Vec::new();
        while !self.is_done() {
            watch.report("resampling", self.iterations.into(), self.settings.iterations.into())?;
            reports.extend(self.iterate_some()?);
        }
        Ok(reports)
    }

    fn submit(&mut self, n: u32) -> Result<Vec<WlopReport>> {
        let start = Instant::now();
        let n_samples = self.pulls.len();
        if n_samples == 0 {
            let first = self.iterations + 1;
            self.iterations += n;
            let report = |iteration| WlopReport { iteration, ..WlopReport::default() };
            return Ok((first..first + n).map(report).collect());
        }
        let before = Record { moves: f32::MAX, is_made: 1, ..Record::default() };
        self.gpu.write(&self.records, 0, &[before])?;
        let mut commands = self.gpu.commands("resample");
        for step in 0..n as usize {
            self.record(&mut commands, step)?;
        }
        let times = commands.run()?;
        let records = self.gpu.read_range(&self.records, 1..1 + n as usize)?;
        let made = records.iter().take_while(|record| record.is_made == 1).count();
        let milliseconds = start.elapsed().as_secs_f64() * 1e3 / made.max(1) as f64;
        let first = self.iterations + 1;
        let report = |(i, (record, times)): (usize, (&Record, &[StageTime]))| {
            record.sums().report(first + i as u32, n_samples, stages(times), milliseconds)
        };
        let reports: Vec<WlopReport> =
            records[..made].iter().zip(times.chunks(STAGES)).enumerate().map(report).collect();
        self.iterations += made as u32;
        self.rests = records[..made].last().is_none_or(|last| last.moves < self.least_move);
        records[..made].last().map_or(Ok(()), Record::check)?;
        Ok(reports)
    }

    /// Records an iteration, the `step`-th of a submission.
    fn record(&self, commands: &mut Commands, step: usize) -> Result<()> {
        let (samples, points) = (&self.tree, self.tree.points());
        let among_samples = DeviceQueries::new(points, self.radius).exclude_self();
        commands.stage("sample weights");
        let weights = [(Uniform, (&self.density).into()), (ReadWrite, (&self.sample_weights).into())];
        visit(commands, samples, &among_samples, "package::application::wlop::density", &weights)?;
        commands.stage("attraction");
        let is_first = self.iterations == 0 && step == 0;
        let pulls = [
            (Uniform, (&self.attraction[usize::from(!is_first)]).into()),
            (Read, (&self.input_weights).into()),
            (ReadWrite, (&self.pulls).into()),
        ];
        let reach = self.formula.attraction.reach as f32 * self.radius;
        let around = DeviceQueries::new(points, reach);
        visit(commands, &self.inputs, &around, "package::application::wlop::attract", &pulls)?;
        commands.stage("repulsion");
        let pushes = [
            (Uniform, (&self.repulsion).into()),
            (Read, (&self.sample_weights).into()),
            (Read, (&self.pulls).into()),
            (ReadWrite, (&self.moved).into()),
        ];
        visit(commands, samples, &among_samples, "package::application::wlop::repel", &pushes)?;
        let sums: [Bind; 3] = [(&self.steps[step]).into(), (&self.records).into(), (&self.parts).into()];
        let mut moves = sums.to_vec();
        moves.extend::<[Bind; 3]>([(&self.moved).into(), (&self.pulls).into(), points.into()]);
        commands.stage("advance");
        commands.dispatch(&self.advance, &moves, Workgroups::Count(self.parts.len() as u32));
        commands.dispatch(&self.conclude, &sums, Workgroups::Count(1));
        samples.record_fit(commands);
        Ok(())
    }

    /// The samples as they are now, read back; no flags before the first iteration.
    ///
    /// # Errors
    /// `OutOfDeviceMemory` for staging memory, `OutOfMemory`, `DeviceLost`.
    pub fn samples(&self) -> Result<WlopSamples<f32>> {
        let points: Vec<DevicePoint> = self.gpu.read(self.tree.points())?;
        let mut positions = vec![[0.0; 3]; points.len()];
        points.iter().for_each(|&[x, y, z, id]| positions[id.to_bits() as usize] = [x, y, z]);
        if self.iterations == 0 || positions.is_empty() {
            let flags = vec![Default::default(); positions.len()];
            return Ok(WlopSamples { positions, flags });
        }
        let (pulls, moved) = (self.gpu.read(&self.pulls)?, self.gpu.read(&self.moved)?);
        let around = |(pull, [.., around]): (&Pull, &DevicePoint)| Around {
            crowd: pull.crowd.into(),
            inputs: pull.inputs,
            samples: around.to_bits() & !ATTRACTED,
            is_attracted: around.to_bits() & ATTRACTED != 0,
        };
        let around: Vec<Around> = pulls.iter().zip(&moved).map(around).collect();
        Ok(WlopSamples::new(positions, &around, self.settings.least_attraction, self.formula.least_samples))
    }

    /// The radius in the unit of the points.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// The tree over the samples as they are now.
    pub fn tree(&self) -> &GpuAabbTree {
        &self.tree
    }
}

/// v of all points, by index.
fn input_weights(
    gpu: &Gpu,
    inputs: &GpuUniformGrid,
    density: &Density,
    radius: f32,
    watch: &mut Watch<'_>,
) -> Result<Buffer<f32>> {
    let (stage, total) = ("weights of points", inputs.len() as u64);
    watch.report(stage, 0, total)?;
    let weights = gpu.buffer("weights of points", inputs.len())?;
    let parameters = gpu.uniform("density of points", &DensityParameters::new(density, radius))?;
    let queries = DeviceQueries::new(inputs.points(), density.reach as f32 * radius).exclude_self();
    let bindings = [(Uniform, (&parameters).into()), (ReadWrite, (&weights).into())];
    let mut commands = gpu.commands("weights of points");
    visit(&mut commands, inputs, &queries, "package::application::wlop::density", &bindings)?;
    commands.run()?;
    watch.report(stage, total, total)?;
    Ok(weights)
}

fn visit<S: GpuStructure>(
    commands: &mut Commands,
    structure: &S,
    queries: &DeviceQueries<'_>,
    module: &'static str,
    bindings: &[(Access, Bind)],
) -> Result<()> {
    let visitor = VisitorModule { module, features: &[], bindings, rounds: [0, 0], combines: true };
    record_module(commands, structure, queries, &visitor)
}

/// Stages timed by the device's clock; a device without one has none.
fn stages(times: &[StageTime]) -> Vec<Stage> {
    times.iter().filter_map(Stage::on_device).collect()
}
