//! A simulation on a device: particles, structures and sums stay there from the first step to the last.

use std::sync::Arc;
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::dem::GpuDem;
use super::dfsph::GpuDfsph;
use super::gpu_neighborhood::{GpuNeighborhood, Recorder};
use super::gpu_state::{GpuState, WORKGROUP};
use super::pbf::GpuPbf;
use super::reach::Reach;
use super::simulate::same_particles;
use super::wcsph::GpuWcsph;
use super::{ParticleModel, ParticleScene, Particles, SearchTime, Simulate, SimulationSettings, StepReport, TimeStep};
use crate::application::Watch;
use crate::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, Workgroups};
use crate::query::Stage;
use crate::{Error, Result};

use Access::{Read, ReadWrite, Uniform};

/// Most steps that are submitted together.
const TOGETHER: u32 = 128;
/// Steps after which a model reads and writes the same buffers again.
const PERIOD: u32 = 2;
/// Milliseconds that a submission should take at most, for the sake of drivers' time limits and of those who wait.
const SUBMISSION: f64 = 100.0;

/// `ParticleClock` in clock.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct ParticleClock {
    /// Of the next step.
    pub time_step: f32,
    /// Of the steps of a submission, together.
    pub time: f32,
    /// Steps of the submission.
    pub made: u32,
    /// Unused.
    pub padding: u32,
}

/// `ParticleInspection` in inspect.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct ParticleInspection {
    /// Particles that move.
    pub n_particles: u32,
    /// Workgroups that inspect.
    pub n_parts: u32,
    /// Density at rest.
    pub rest_density: f32,
    /// The highest squared speed that is allowed.
    pub max_speed2: f32,
    /// Part of the largest stable step.
    pub factor: f32,
    /// Length that a signal has to go in a step.
    pub length: f32,
    /// Its speed in a fluid at rest.
    pub sound_speed: f32,
    /// The shortest step.
    pub least_step: f32,
    /// The longest step.
    pub most_step: f32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
    /// Unused.
    pub padding_2: u32,
}

/// `ParticlePart` in inspect.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct ParticlePart {
    /// Neighbours, summed.
    pub neighbors: f32,
    /// The highest squared speed.
    pub max_speed2: f32,
    /// Compressions, summed.
    pub compression: f32,
    /// The largest compression.
    pub max_compression: f32,
    /// The first particle that is not where it can be.
    pub first_bad: u32,
}

/// `ParticleRecord` in inspect.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct ParticleRecord {
    /// Neighbours, summed.
    pub neighbors: f32,
    /// The highest squared speed.
    pub max_speed2: f32,
    /// Compressions, summed.
    pub compression: f32,
    /// The largest compression.
    pub max_compression: f32,
    /// The first particle that is not where it can be.
    pub first_bad: u32,
    /// How far the step led.
    pub time_step: f32,
    /// How far the steps of the submission led, with this one.
    pub time: f32,
    /// Unused.
    pub padding: u32,
    /// Of the first bad one.
    pub position: [f32; 4],
    /// Of the first bad one.
    pub velocity: [f32; 4],
}

/// What a model on a device does.
pub(super) trait GpuModel: Send {
    /// Records one step; the structures follow the positions when the model says so. At its end the velocities and densities of the state
    /// are those after the step, and `neighbors` those that acted in it.
    ///
    /// - `clock`: says how far the step leads
    fn record_step(
        &mut self,
        recorder: &mut Recorder,
        state: &mut GpuState,
        around: &mut GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()>;

    /// Whether a step can be recorded once and submitted again and again: it never needs the host, and after two steps reads and writes the same
    /// buffers.
    fn can_repeat(&self) -> bool {
        true
    }

    /// Forgets what it knows of single particles: they have another order.
    fn forget(&mut self) {}

    /// Length and speed of signals that steps must not outrun; an infinite length for models without such a rule.
    fn signals(&self) -> [f64; 2] {
        [f64::INFINITY, 0.0]
    }

    /// The longest stable step, however slow particles are; infinite for models without such a rule.
    fn longest_step(&self) -> f64 {
        f64::INFINITY
    }

    /// Iterations of the last step's solvers.
    fn iterations(&self) -> u32 {
        0
    }

    /// Mean and largest compression as the last step's solver left it, where that is not what the densities say.
    fn density_error(&self) -> Option<[f64; 2]> {
        None
    }
}

/// A simulation on a device, in single precision. Steps are recorded and submitted in batches of up to 128; nothing but their reports, and what the
/// search needs of the host, is read back.
///
/// Positions are relative to the middle of the domain. Trees ask the host in each step whether they are built anew, and lists whether they
/// are made anew; grids and brute force run by themselves.
pub struct GpuSimulation {
    gpu: Gpu,
    scene: ParticleScene,
    settings: SimulationSettings,
    state: GpuState,
    around: GpuNeighborhood,
    model: Box<dyn GpuModel>,
    clock: Buffer<ParticleClock>,
    inspection: Buffer<ParticleInspection>,
    parts: Buffer<ParticlePart>,
    records: Buffer<ParticleRecord>,
    inspect: Arc<Pipeline>,
    conclude: Arc<Pipeline>,
    step: u64,
    time: f64,
    /// Of the next step.
    time_step: f32,
    /// Steps of the next submission.
    together: u32,
    /// Of the finished steps of a call that is under way or has failed.
    reports: Vec<StepReport>,
}

impl GpuSimulation {
    /// A simulation of the scene from its start.
    ///
    /// # Errors
    /// As [`ParticleScene::validate`] and [`SimulationSettings::validate`]; `OutOfDeviceMemory`, `DeviceLost`, `KernelRejected`.
    pub fn new(gpu: &Gpu, scene: &ParticleScene, settings: &SimulationSettings) -> Result<Self> {
        scene.validate()?;
        settings.validate()?;
        if scene.periodic.contains(&true) {
            let what = "a domain with periodic sides on a GPU".to_owned();
            return Err(Error::Unsupported { what, advice: "use the CPU" });
        }
        let reach = Reach::of(&scene.model);
        let state = GpuState::new(gpu, scene, reach.radii().len())?;
        let around = GpuNeighborhood::new(gpu, scene, settings.search, settings.deterministic, reach);
        let model: Box<dyn GpuModel> = match &scene.model {
            ParticleModel::Dem(dem) => Box::new(GpuDem::new(gpu, dem, scene, &state)?),
            ParticleModel::Pbf(pbf) => Box::new(GpuPbf::new(gpu, pbf, scene, &state)?),
            ParticleModel::Dfsph(dfsph) => Box::new(GpuDfsph::new(gpu, dfsph, scene, &state)?),
            ParticleModel::Wcsph(wcsph) => Box::new(GpuWcsph::new(gpu, wcsph, scene, &state)?),
        };
        let (least, most) = match scene.time_step {
            TimeStep::Fixed(step) => (step, step),
            TimeStep::Cfl { least, most, .. } => (least, most),
        };
        if least < f64::from(f32::MIN_POSITIVE) || most > f64::from(f32::MAX) {
            let found = format!("{least:e} to {most:e}");
            let expected = "one that single precision has, or the CPU";
            return Err(Error::InvalidSetting { setting: "time step on a GPU", found, expected });
        }
        let n_parts = (state.n_moving as u32).div_ceil(WORKGROUP);
        let [length, sound_speed] = model.signals();
        let (factor, least_step, most_step) = match scene.time_step {
            TimeStep::Fixed(step) => (1.0, step, step),
            TimeStep::Cfl { factor, least, most } => {
                (factor, least, most.min(factor * model.longest_step()).max(least))
            }
        };
        let inspection = ParticleInspection {
            n_particles: state.n_moving as u32,
            n_parts,
            rest_density: scene.model.rest_density() as f32,
            max_speed2: (settings.max_speed as f32).powi(2).min(f32::MAX),
            factor: factor as f32,
            length: (length as f32).min(1e30),
            sound_speed: sound_speed as f32,
            least_step: least_step as f32,
            most_step: most_step as f32,
            padding_0: 0,
            padding_1: 0,
            padding_2: 0,
        };
        let accesses = [Uniform, Read, Read, ReadWrite, Read, Read, ReadWrite, ReadWrite];
        let features = [("fluid", scene.model.is_fluid())];
        let pipeline = |entry| {
            gpu.prepare(&Kernel {
                features: &features,
                ..Kernel::new("package::application::particles::inspect", entry, &accesses, WORKGROUP)
            })
        };
        let mut simulation = Self {
            clock: gpu.buffer("clock of particles", 1)?,
            inspection: gpu.uniform("inspection of particles", &inspection)?,
            parts: gpu.buffer("parts of an inspection", n_parts.max(1) as usize)?,
            records: gpu.buffer("reports of steps", TOGETHER as usize)?,
            inspect: pipeline("inspect")?,
            conclude: pipeline("conclude")?,
            gpu: gpu.clone(),
            scene: scene.clone(),
            settings: *settings,
            state,
            around,
            model,
            step: 0,
            time: 0.0,
            time_step: 0.0,
            together: 1,
            reports: Vec::new(),
        };
        simulation.time_step = simulation.first_step(&scene.particles);
        Ok(simulation)
    }

    /// How far a first step leads, by the rule of inspect.wesl.
    fn first_step(&self, particles: &Particles) -> f32 {
        let TimeStep::Cfl { factor, least, most } = self.scene.time_step else {
            return self.scene.time_step.most() as f32;
        };
        let [length, sound_speed] = self.model.signals();
        let fastest = particles.velocities.iter().map(|v| v.length()).fold(0.0, f64::max);
        let stable = (length / (sound_speed + fastest)).min(self.model.longest_step());
        (factor * stable).clamp(least, most) as f32
    }

    /// Makes one step and takes the times of its stages, which are those of the device's clock where it has one, without what structures do
    /// by themselves to prepare questions.
    ///
    /// # Errors
    /// As [`Simulate::advance`].
    pub fn advance_timed(&mut self) -> Result<(StepReport, Vec<Stage>)> {
        self.reports.clear();
        let mut recorder = Recorder::timed(&self.gpu);
        let reports = self.submit(1, &mut recorder)?;
        Ok((reports.first().copied().unwrap_or_default(), recorder.into_times()))
    }

    /// Makes up to `most` steps in one submission, or in one a step where the search needs the host.
    fn submit(&mut self, most: u32, recorder: &mut Recorder) -> Result<Vec<StepReport>> {
        let start = Instant::now();
        let every = u64::from(self.settings.reorder_every);
        let mut n = self.together.min(most);
        if every > 0 {
            n = n.min((every - self.step % every) as u32);
            if self.step.is_multiple_of(every) {
                self.state.record_reorder(&self.gpu, recorder.commands(), &self.scene)?;
                self.around.forget_order();
                self.model.forget();
            }
        }
        let clock = ParticleClock { time_step: self.time_step, time: 0.0, made: 0, padding: 0 };
        self.gpu.write(&self.clock, 0, &[clock])?;
        self.state.record_keep(recorder.commands());
        let mut built = Vec::with_capacity(n as usize);
        let mut record = |simulation: &mut Self, recorder: &mut Recorder| {
            let before = simulation.around.rebuilds();
            simulation.record(recorder)?;
            let rebuilds = (simulation.around.rebuilds() - before) as u32;
            built.push((rebuilds, simulation.model.iterations(), simulation.model.density_error()));
            Ok(())
        };
        let repeats = self.around.can_repeat() && self.model.can_repeat() && n >= PERIOD;
        let recorded = if repeats {
            n -= n % PERIOD;
            recorder
                .submit()
                .and_then(|()| (0..PERIOD).try_for_each(|_| record(self, recorder)))
                .and_then(|()| recorder.submit_repeated(n / PERIOD))
        } else {
            (0..n).try_for_each(|_| record(self, recorder))
        };
        if repeats && recorded.is_ok() {
            built.resize(n as usize, built[0]);
        }
        // A structure may have found out before the records are read: particles that are no numbers cannot be searched.
        let recorded = recorder.submit().and(recorded);
        let records = self.gpu.read(&self.records)?;
        let made = if recorded.is_ok() { n as usize } else { built.len() };
        if let Some(bad) = records[..made].iter().position(|record| record.first_bad < self.state.n_moving as u32) {
            return Err(self.give_up(bad, &records[bad])?);
        }
        if let Err(error) = recorded {
            // Where particles could not be searched, why is more than that.
            let step = self.step + 1 + built.len() as u64;
            let error = self.state.first_bad(&self.gpu, step, self.settings.max_speed)?.unwrap_or(error);
            self.state.restore(&self.gpu)?;
            self.around.forget();
            self.model.forget();
            return Err(error);
        }
        let per_particle = 1.0 / self.state.n_moving.max(1) as f64;
        let report = |(i, (record, &(rebuilds, iterations, solved))): (usize, (&ParticleRecord, &_))| StepReport {
            step: self.step + 1 + i as u64,
            time: self.time + f64::from(record.time),
            time_step: record.time_step.into(),
            mean_neighbors: f64::from(record.neighbors) * per_particle,
            iterations,
            density_error: Option::unwrap_or(
                solved,
                [f64::from(record.compression) * per_particle, record.max_compression.into()],
            ),
            rebuilds,
        };
        let reports: Vec<StepReport> = records[..made].iter().zip(&built).enumerate().map(report).collect();
        self.step += made as u64;
        if let Some(last) = reports.last() {
            self.time = last.time;
        }
        if matches!(self.scene.time_step, TimeStep::Cfl { .. }) {
            self.time_step = self.gpu.read(&self.clock)?[0].time_step;
        }
        let took = start.elapsed().as_secs_f64() * 1e3 / f64::from(n);
        self.together = ((SUBMISSION / took.max(1e-3)) as u32).clamp(1, TOGETHER);
        Ok(reports)
    }

    fn record(&mut self, recorder: &mut Recorder) -> Result<()> {
        self.model.record_step(recorder, &mut self.state, &mut self.around, &self.clock)?;
        let state = &self.state;
        let binds = [
            (&self.inspection).into(),
            (&state.positions).into(),
            (&state.velocities).into(),
            (&self.parts).into(),
            (&state.neighbors).into(),
            (&state.densities).into(),
            (&self.clock).into(),
            (&self.records).into(),
        ];
        let commands = recorder.commands().stage("inspect");
        commands.dispatch(&self.inspect, &binds, Workgroups::Covering(state.n_moving as u64));
        commands.dispatch(&self.conclude, &binds, Workgroups::Count(1));
        Ok(())
    }

    /// As [`Simulate::time_search`].
    fn count_neighbors(&mut self) -> Result<SearchTime> {
        let counts = self.gpu.buffer("neighbors that are only counted", self.state.len())?;
        let mut recorder = Recorder::new(&self.gpu);
        let start = Instant::now();
        self.around.record_count(&mut recorder, &self.state, &counts)?;
        recorder.submit()?;
        // One number is there when all are.
        self.gpu.read_range(&counts, 0..self.state.len().min(1))?;
        let seconds = start.elapsed().as_secs_f64();
        let counts = self.gpu.read_range(&counts, 0..self.state.n_moving)?;
        Ok(SearchTime { seconds, neighbors: counts.into_iter().map(u64::from).sum() })
    }

    /// Brings back the state before the steps of this submission; the error that tells why.
    fn give_up(&mut self, step: usize, record: &ParticleRecord) -> Result<Error> {
        let particle = self.state.id(&self.gpu, record.first_bad)?;
        self.state.restore(&self.gpu)?;
        self.around.forget();
        self.model.forget();
        let [x, y, z, _] = record.position;
        let [u, v, w, _] = record.velocity;
        Ok(Error::BlowUp {
            step: self.step + 1 + step as u64,
            particle: particle.into(),
            position: (Vec3::new(x, y, z).as_dvec3() + self.state.middle()).to_array(),
            speed: Vec3::new(u, v, w).as_dvec3().length(),
            limit: self.settings.max_speed,
        })
    }
}

impl Simulate for GpuSimulation {
    fn scene(&self) -> &ParticleScene {
        &self.scene
    }

    fn device(&self) -> String {
        self.gpu.name().to_owned()
    }

    fn advance(&mut self, steps: u32, watch: &mut Watch<'_>) -> Result<Vec<StepReport>> {
        self.reports.clear();
        while self.reports.len() < steps as usize {
            let done = self.reports.len() as u32;
            watch.report("simulating", done.into(), steps.into())?;
            let reports = self.submit(steps - done, &mut Recorder::new(&self.gpu))?;
            self.reports.extend(reports);
        }
        Ok(self.take_reports())
    }

    fn take_reports(&mut self) -> Vec<StepReport> {
        std::mem::take(&mut self.reports)
    }

    fn time_search(&mut self) -> Result<SearchTime> {
        self.count_neighbors().inspect_err(|_| {
            // The next step does not go on from what was left half done.
            self.around.forget();
            self.model.forget();
        })
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn time(&self) -> f64 {
        self.time
    }

    fn particles(&self) -> Result<Particles> {
        self.state.particles(&self.gpu)
    }

    fn resume(&mut self, particles: &Particles, step: u64, time: f64) -> Result<()> {
        same_particles(&self.scene.particles, particles)?;
        let mut scene = self.scene.clone();
        scene.particles.clone_from(particles);
        scene.validate_under_way()?;
        self.state.replace(&self.gpu, &scene)?;
        self.around.forget();
        self.model.forget();
        self.reports.clear();
        (self.step, self.time, self.time_step) = (step, time, self.first_step(particles));
        Ok(())
    }
}
