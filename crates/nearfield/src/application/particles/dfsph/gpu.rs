//! A step of incompressible fluids on a device.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::{DfsphSettings, fewest_neighbors, longest_step};
use crate::Result;
use crate::application::particles::fluid::{Lattice, boundary_masses};
use crate::application::particles::gpu::{GpuModel, ParticleClock};
use crate::application::particles::gpu_neighborhood::{GpuNeighborhood, ParticleVisitor, Recorder};
use crate::application::particles::gpu_state::{GpuState, WORKGROUP};
use crate::application::particles::{ParticleScene, SmoothingKernel};
use crate::gpu::{Access, Bind, Buffer, Gpu, Kernel, Pipeline, Workgroups};

use Access::{Read, ReadWrite, Uniform};

/// Iterations that are submitted together at most; those behind the end of a solver do nothing.
const TOGETHER: u32 = 16;

/// `DfsphFluid` in fluid.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct DfsphFluid {
    /// Acceleration of all.
    pub gravity: [f32; 3],
    /// Particles that move.
    pub n_particles: u32,
    /// The support.
    pub support: f32,
    /// One over it.
    pub inverse_support: f32,
    /// Volume of a particle times the factor of the smoothing kernel.
    pub volume_factor: f32,
    /// Part of a full step of Jacobi's.
    pub relaxation: f32,
    /// Density at rest.
    pub rest_density: f32,
    /// 2 ν / support².
    pub viscosity: f32,
    /// As [`DfsphSettings::xsph`].
    pub xsph: f32,
    /// Neighbours below which a particle lies at a surface.
    pub fewest_neighbors: u32,
    /// As [`DfsphSettings::divergence_tolerance`].
    pub divergence_tolerance: f32,
    /// As [`DfsphSettings::density_tolerance`].
    pub density_tolerance: f32,
    /// As [`DfsphSettings::most_iterations`].
    pub most_iterations: u32,
    /// Workgroups that sum up excesses.
    pub n_parts: u32,
}

/// `DfsphProgress` in fluid.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct DfsphProgress {
    /// Iterations that are made.
    pub iterations: u32,
    /// 1 once no more are to be made.
    pub is_done: u32,
    /// Mean excess.
    pub mean: f32,
    /// Largest excess.
    pub largest: f32,
}

/// Incompressible fluids on a device.
pub(in crate::application::particles) struct GpuDfsph {
    gpu: Gpu,
    settings: DfsphSettings,
    signals: [f64; 2],
    longest_step: f64,
    fluid: Buffer<DfsphFluid>,
    kernels: Kernels,
    /// `[n + b]` velocities in supports a step, 0 for the boundary; w is the volume in parts of that of a particle.
    moving: Buffer<[f32; 4]>,
    /// `[n + b]` the same after viscosity, where there is any.
    dragged: Buffer<[f32; 4]>,
    /// `[n]` compression, factor, neighbours and excess; for densities the pressure in place of neighbours.
    packed: Buffer<[f32; 4]>,
    /// `[n + b]` what pressure pushes next, in supports squared a step squared; of the boundary its volume in parts of that of a particle.
    stiffness: Buffer<f32>,
    /// `[n_parts]` sums and largest of excesses.
    parts: Buffer<[f32; 2]>,
    progress: Buffer<DfsphProgress>,
    divergence: Solver,
    density: Solver,
    /// Whether structures and packings are those of the particles as they are.
    follows: bool,
}

struct Kernels {
    set_out: Arc<Pipeline>,
    fall: Arc<Pipeline>,
    take_up: Arc<Pipeline>,
    settle: Arc<Pipeline>,
    sum_excesses: Arc<Pipeline>,
}

/// One of the two solvers.
struct Solver {
    /// Whether it is that for fields without divergence.
    divergence: bool,
    conclude: Arc<Pipeline>,
    /// How it ended in the last step.
    last: DfsphProgress,
}

impl Solver {
    fn new(gpu: &Gpu, divergence: bool) -> Result<Self> {
        let module = "package::application::particles::dfsph::progress";
        let kernel = Kernel {
            features: &[("divergence", divergence)],
            ..Kernel::new(module, "conclude_iteration", &[Uniform, Read, ReadWrite], WORKGROUP)
        };
        Ok(Self { divergence, conclude: gpu.prepare(&kernel)?, last: DfsphProgress::zeroed() })
    }
}

impl Kernels {
    fn new(gpu: &Gpu) -> Result<Self> {
        let (constants, module) =
            ([("WORKGROUP", f64::from(WORKGROUP))], "package::application::particles::dfsph::advance");
        let kernel = |entry, accesses| {
            gpu.prepare(&Kernel { constants: &constants, ..Kernel::new(module, entry, accesses, WORKGROUP) })
        };
        let progress = "package::application::particles::dfsph::progress";
        // The same for both solvers.
        let sums = Kernel {
            features: &[("divergence", false)],
            ..Kernel::new(progress, "sum_excesses", &[Uniform, Read, ReadWrite], WORKGROUP)
        };
        Ok(Self {
            set_out: kernel("set_out", &[Uniform, Read, Read, Read, ReadWrite, ReadWrite])?,
            fall: kernel("fall", &[Uniform, Read, ReadWrite])?,
            take_up: kernel("take_up", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            settle: kernel("settle", &[Uniform, Read, Read, ReadWrite, ReadWrite, Read, ReadWrite])?,
            sum_excesses: gpu.prepare(&sums)?,
        })
    }
}

impl GpuDfsph {
    pub(in crate::application::particles) fn new(
        gpu: &Gpu,
        settings: &DfsphSettings,
        scene: &ParticleScene,
        state: &GpuState,
    ) -> Result<Self> {
        let (of, n) = (&settings.fluid, state.n_moving);
        let lattice = Lattice::new(of, settings.smoothing, scene.dimensions);
        let n_parts = (n as u32).div_ceil(WORKGROUP);
        let fluid = DfsphFluid {
            gravity: scene.gravity.as_vec3().to_array(),
            n_particles: n as u32,
            support: of.support as f32,
            inverse_support: (1.0 / of.support) as f32,
            volume_factor: (lattice.volume * settings.smoothing.norm(scene.dimensions, of.support)) as f32,
            relaxation: lattice.relaxation as f32,
            rest_density: of.rest_density as f32,
            viscosity: (2.0 * settings.viscosity / of.support.powi(2)) as f32,
            xsph: settings.xsph as f32,
            fewest_neighbors: fewest_neighbors(scene.dimensions),
            divergence_tolerance: settings.divergence_tolerance as f32,
            density_tolerance: settings.density_tolerance as f32,
            most_iterations: settings.most_iterations,
            n_parts,
        };
        let volumes = boundary_volumes(settings, &lattice, scene)?;
        let boundary = volumes.iter().map(|&volume| [0.0, 0.0, 0.0, volume]);
        let moving: Vec<[f32; 4]> = std::iter::repeat_n([0.0, 0.0, 0.0, 1.0], n).chain(boundary).collect();
        let stiffness: Vec<f32> = std::iter::repeat_n(0.0, n).chain(volumes).collect();
        let is_viscous = settings.viscosity > 0.0 || settings.xsph > 0.0;
        Ok(Self {
            settings: *settings,
            signals: stable_way(settings, scene),
            longest_step: longest_step(of, scene),
            fluid: gpu.uniform("incompressible fluid", &fluid)?,
            kernels: Kernels::new(gpu)?,
            dragged: gpu.upload("velocities after viscosity", if is_viscous { &moving } else { &[] })?,
            moving: gpu.upload("velocities of a step", &moving)?,
            packed: gpu.buffer("packings of particles", n)?,
            stiffness: gpu.upload("stiffness of particles", &stiffness)?,
            parts: gpu.buffer("excesses of density", n_parts.max(1) as usize)?,
            progress: gpu.buffer("progress of a solver", 1)?,
            divergence: Solver::new(gpu, true)?,
            density: Solver::new(gpu, false)?,
            follows: false,
            gpu: gpu.clone(),
        })
    }

    /// Records a visitor of this folder.
    fn visit(
        &self,
        recorder: &mut Recorder,
        around: &GpuNeighborhood,
        module: &'static str,
        is_divergence: bool,
        bindings: &[(Access, Bind)],
    ) -> Result<()> {
        let features =
            [("wendland", self.settings.smoothing == SmoothingKernel::Wendland), ("divergence", is_divergence)];
        let bindings = [&[(Uniform, (&self.fluid).into())], bindings].concat();
        around.record_visit(recorder, &ParticleVisitor { module, features: &features, bindings: &bindings })
    }

    /// Makes structures follow the particles, and records how these are packed.
    fn follow(&mut self, recorder: &mut Recorder, state: &GpuState, around: &mut GpuNeighborhood) -> Result<()> {
        around.follow(recorder, state)?;
        recorder.commands().stage("pack");
        let bindings = [
            (Read, (&self.stiffness).into()),
            (ReadWrite, (&self.packed).into()),
            (ReadWrite, (&state.densities).into()),
        ];
        self.visit(recorder, around, "package::application::particles::dfsph::pack", false, &bindings)?;
        self.follows = true;
        Ok(())
    }

    /// Records an iteration of a solver, which does nothing once the solver is done.
    fn iterate(
        &self,
        recorder: &mut Recorder,
        state: &GpuState,
        around: &GpuNeighborhood,
        solver: &Solver,
    ) -> Result<()> {
        let progress = || (Read, (&self.progress).into());
        recorder.commands().stage("rates");
        let bindings = [
            (Read, (&self.moving).into()),
            progress(),
            (ReadWrite, (&self.packed).into()),
            (ReadWrite, (&self.stiffness).into()),
        ];
        let module = "package::application::particles::dfsph::rates";
        self.visit(recorder, around, module, solver.divergence, &bindings)?;
        let summed = [(&self.fluid).into(), (&self.packed).into(), (&self.parts).into()];
        let concluded = [(&self.fluid).into(), (&self.parts).into(), (&self.progress).into()];
        let commands = recorder.commands().stage("excess");
        commands.dispatch(&self.kernels.sum_excesses, &summed, Workgroups::Covering(state.n_moving as u64));
        commands.dispatch(&solver.conclude, &concluded, Workgroups::Count(1));
        self.push(recorder, around)
    }

    /// Records a push by the stiffness there is, unless a solver is done.
    fn push(&self, recorder: &mut Recorder, around: &GpuNeighborhood) -> Result<()> {
        recorder.commands().stage("push");
        let progress = (Read, (&self.progress).into());
        let bindings = [(Read, (&self.stiffness).into()), progress, (ReadWrite, (&self.moving).into())];
        self.visit(recorder, around, "package::application::particles::dfsph::push", false, &bindings)
    }

    /// Records a start from the pressures of the last step.
    fn start(
        &self,
        recorder: &mut Recorder,
        state: &GpuState,
        around: &GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        let taken = [
            (&self.fluid).into(),
            clock.into(),
            (&state.pressures).into(),
            (&self.packed).into(),
            (&self.stiffness).into(),
        ];
        let covering = Workgroups::Covering(state.n_moving as u64);
        recorder.commands().stage("take up").dispatch(&self.kernels.take_up, &taken, covering);
        // The solver before is done, and would be idle.
        recorder.commands().clear(&self.progress);
        self.push(recorder, around)
    }

    /// Lets a solver run until it is done; how it ended is read back. As many iterations as in the last step are submitted at once.
    fn solve(
        &self,
        recorder: &mut Recorder,
        state: &GpuState,
        around: &GpuNeighborhood,
        solver: &Solver,
    ) -> Result<DfsphProgress> {
        recorder.commands().clear(&self.progress);
        let mut together = solver.last.iterations + 1;
        loop {
            for _ in 0..together.min(TOGETHER) {
                self.iterate(recorder, state, around, solver)?;
            }
            recorder.submit()?;
            let progress = self.gpu.read(&self.progress)?[0];
            if progress.is_done == 1 {
                return Ok(progress);
            }
            together = (progress.iterations / 2).max(2);
        }
    }

    /// Records viscosity and gravity.
    fn accelerate(
        &mut self,
        recorder: &mut Recorder,
        state: &GpuState,
        around: &GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        if self.settings.viscosity > 0.0 || self.settings.xsph > 0.0 {
            recorder.commands().stage("viscosity");
            let bindings = [(Read, (&self.moving).into()), (Read, clock.into()), (ReadWrite, (&self.dragged).into())];
            self.visit(recorder, around, "package::application::particles::dfsph::drag", false, &bindings)?;
            std::mem::swap(&mut self.moving, &mut self.dragged);
        }
        let falling = [(&self.fluid).into(), clock.into(), (&self.moving).into()];
        let covering = Workgroups::Covering(state.n_moving as u64);
        recorder.commands().stage("fall").dispatch(&self.kernels.fall, &falling, covering);
        Ok(())
    }
}

/// How far a particle may move in a stable step, and the speed that is added to that of the fastest to ask for its time: never more than
/// the rule on the CPU gives, the same from rest and for fast ones, between them four fifths at least. Laminar viscosity counts as a speed.
fn stable_way(settings: &DfsphSettings, scene: &ParticleScene) -> [f64; 2] {
    let way = settings.fluid.spacing;
    let half = 0.5 * settings.fluid.support;
    let spreads = 0.5 * half * half / settings.viscosity;
    [way, (scene.gravity.length() * way).sqrt().max(way / spreads)]
}

/// `[b]` volumes of the boundary in parts of that of a particle, as on the CPU.
fn boundary_volumes(settings: &DfsphSettings, lattice: &Lattice, scene: &ParticleScene) -> Result<Vec<f32>> {
    let masses = boundary_masses(&settings.fluid, settings.smoothing, scene)?;
    let of_mass = |mass: f64| lattice.wall_volume(mass / settings.fluid.rest_density) / lattice.volume;
    Ok(masses.into_iter().map(|mass| of_mass(mass) as f32).collect())
}

impl GpuModel for GpuDfsph {
    fn record_step(
        &mut self,
        recorder: &mut Recorder,
        state: &mut GpuState,
        around: &mut GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        if !self.follows {
            self.follow(recorder, state, around)?;
        }
        self.follows = false;
        let covering = || Workgroups::Covering(state.n_moving as u64);
        let starts = [
            (&self.fluid).into(),
            clock.into(),
            (&state.velocities).into(),
            (&self.packed).into(),
            (&self.moving).into(),
            (&state.neighbors).into(),
        ];
        recorder.commands().stage("set out").dispatch(&self.kernels.set_out, &starts, covering());
        self.divergence.last = self.solve(recorder, state, around, &self.divergence)?;
        self.accelerate(recorder, state, around, clock)?;
        self.start(recorder, state, around, clock)?;
        self.density.last = self.solve(recorder, state, around, &self.density)?;
        let settled = [
            (&self.fluid).into(),
            clock.into(),
            (&self.moving).into(),
            (&state.velocities).into(),
            (&state.positions).into(),
            (&self.packed).into(),
            (&state.pressures).into(),
        ];
        recorder.commands().stage("settle").dispatch(&self.kernels.settle, &settled, covering());
        self.follow(recorder, state, around)
    }

    fn can_repeat(&self) -> bool {
        false
    }

    fn forget(&mut self) {
        self.follows = false;
    }

    fn signals(&self) -> [f64; 2] {
        self.signals
    }

    fn longest_step(&self) -> f64 {
        self.longest_step
    }

    fn iterations(&self) -> u32 {
        self.divergence.last.iterations + self.density.last.iterations
    }

    fn density_error(&self) -> Option<[f64; 2]> {
        Some([self.density.last.mean.into(), self.density.last.largest.into()])
    }
}
