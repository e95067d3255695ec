//! A step of weakly compressible fluids on a device.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::WcsphSettings;
use crate::Result;
use crate::application::particles::fluid::boundary_masses;
use crate::application::particles::gpu::{GpuModel, ParticleClock};
use crate::application::particles::gpu_neighborhood::{GpuNeighborhood, ParticleVisitor, Recorder};
use crate::application::particles::gpu_state::{GpuState, WORKGROUP};
use crate::application::particles::{ParticleScene, SmoothingKernel, TimeStep};
use crate::gpu::{Access, Bind, Buffer, Gpu, Kernel, Pipeline, Workgroups};

use Access::{Read, ReadWrite, Uniform};

/// `WcsphFluid` in fluid.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct WcsphFluid {
    /// Acceleration of all.
    pub gravity: [f32; 3],
    /// Particles that move.
    pub n_particles: u32,
    /// Gravity times the support, in c².
    pub deepening: [f32; 3],
    /// γ.
    pub exponent: f32,
    /// The support.
    pub support: f32,
    /// One over it.
    pub inverse_support: f32,
    /// Volume of a particle times the factor of the smoothing kernel.
    pub volume_factor: f32,
    /// Density at rest.
    pub rest_density: f32,
    /// c.
    pub sound_speed: f32,
    /// One over it.
    pub inverse_sound_speed: f32,
    /// α / (2 c).
    pub artificial_viscosity: f32,
    /// ν / (c² support).
    pub viscosity: f32,
    /// δ.
    pub density_diffusion: f32,
    /// Speed of signals in the fluid at rest.
    pub signal_speed: f32,
    /// The longest step that laminar viscosity allows.
    pub viscous_step: f32,
    /// Part of the longest stable step.
    pub step_factor: f32,
    /// The shortest step.
    pub least_step: f32,
    /// Workgroups that look for limits.
    pub n_parts: u32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
}

/// `WcsphLimits` in fluid.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct WcsphLimits {
    /// The largest squared acceleration.
    pub acceleration2: f32,
    /// The largest squared speed.
    pub speed2: f32,
    /// The largest excess of density.
    pub excess: f32,
}

/// Weakly compressible fluids on a device: two passes over the neighbours a step.
pub(in crate::application::particles) struct GpuWcsph {
    signals: [f64; 2],
    is_wendland: bool,
    fluid: Buffer<WcsphFluid>,
    kernels: Kernels,
    /// Of scenes whose steps follow the particles.
    limits: Option<Limits>,
    /// `[n + b]` velocities; w is the excess of density in parts of that at rest. Of the boundary 0, and its volume in parts of that of a
    /// particle.
    flows: Buffer<[f32; 4]>,
    /// `[n]` in ρ₀ c².
    pressures: Buffer<f32>,
    /// `[n]` without gravity.
    accelerations: Buffer<[f32; 4]>,
}

struct Kernels {
    set_out: Arc<Pipeline>,
    kick: Arc<Pipeline>,
    settle: Arc<Pipeline>,
}

/// What it takes to find how far a step may lead.
struct Limits {
    find: Arc<Pipeline>,
    apply: Arc<Pipeline>,
    /// `[n_parts]`
    parts: Buffer<WcsphLimits>,
}

impl Kernels {
    fn new(gpu: &Gpu) -> Result<Self> {
        let (constants, module) =
            ([("WORKGROUP", f64::from(WORKGROUP))], "package::application::particles::wcsph::advance");
        let kernel = |entry, accesses| {
            gpu.prepare(&Kernel { constants: &constants, ..Kernel::new(module, entry, accesses, WORKGROUP) })
        };
        Ok(Self {
            set_out: kernel("set_out", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
            kick: kernel("kick", &[Uniform, Read, Read, ReadWrite])?,
            settle: kernel("settle", &[Uniform, Read, Read, ReadWrite, ReadWrite])?,
        })
    }
}

impl Limits {
    fn new(gpu: &Gpu, n_parts: u32) -> Result<Self> {
        let module = "package::application::particles::wcsph::limit";
        let kernel = |entry, accesses| gpu.prepare(&Kernel::new(module, entry, accesses, WORKGROUP));
        Ok(Self {
            find: kernel("find_limits", &[Uniform, Read, Read, ReadWrite])?,
            apply: kernel("limit_step", &[Uniform, Read, ReadWrite])?,
            parts: gpu.buffer("limits of a step", n_parts.max(1) as usize)?,
        })
    }
}

impl GpuWcsph {
    pub(in crate::application::particles) fn new(
        gpu: &Gpu,
        settings: &WcsphSettings,
        scene: &ParticleScene,
        state: &GpuState,
    ) -> Result<Self> {
        let n = state.n_moving;
        let fluid = numbers(settings, scene, n as u32);
        let mass = settings.fluid.mass(scene.dimensions);
        let volumes = boundary_masses(&settings.fluid, settings.smoothing, scene)?;
        let boundary = volumes.into_iter().map(|of_wall| [0.0, 0.0, 0.0, (of_wall / mass) as f32]);
        let flows: Vec<[f32; 4]> = std::iter::repeat_n([0.0; 4], n).chain(boundary).collect();
        let limits = match scene.time_step {
            TimeStep::Fixed(_) => None,
            TimeStep::Cfl { .. } => Some(Limits::new(gpu, fluid.n_parts)?),
        };
        Ok(Self {
            signals: [settings.smoothing_length(), settings.signal_speed()],
            is_wendland: settings.smoothing == SmoothingKernel::Wendland,
            fluid: gpu.uniform("weakly compressible fluid", &fluid)?,
            kernels: Kernels::new(gpu)?,
            limits,
            flows: gpu.upload("flows of particles", &flows)?,
            pressures: gpu.buffer("pressures of particles", n)?,
            accelerations: gpu.buffer("accelerations of particles", n)?,
        })
    }

    /// Records a visitor of this folder.
    fn visit(
        &self,
        recorder: &mut Recorder,
        around: &GpuNeighborhood,
        module: &'static str,
        bindings: &[(Access, Bind)],
    ) -> Result<()> {
        let features = [("wendland", self.is_wendland)];
        let bindings = [&[(Uniform, (&self.fluid).into())], bindings].concat();
        around.record_visit(recorder, &ParticleVisitor { module, features: &features, bindings: &bindings })
    }

    /// Records that the clock's step becomes one that sound, viscosity and forces allow.
    fn limit(&self, recorder: &mut Recorder, covering: Workgroups, clock: &Buffer<ParticleClock>) {
        let Some(limits) = &self.limits else { return };
        let fluid = || (&self.fluid).into();
        let found = [fluid(), (&self.flows).into(), (&self.accelerations).into(), (&limits.parts).into()];
        let commands = recorder.commands().stage("limit");
        commands.dispatch(&limits.find, &found, covering);
        commands.dispatch(&limits.apply, &[fluid(), (&limits.parts).into(), clock.into()], Workgroups::Count(1));
    }
}

/// What the kernels know of the fluid.
fn numbers(settings: &WcsphSettings, scene: &ParticleScene, n_particles: u32) -> WcsphFluid {
    let (of, sound) = (&settings.fluid, settings.sound_speed);
    let norm = settings.smoothing.norm(scene.dimensions, of.support);
    let (step_factor, least_step) = match scene.time_step {
        TimeStep::Fixed(step) => (1.0, step),
        TimeStep::Cfl { factor, least, .. } => (factor, least),
    };
    WcsphFluid {
        gravity: scene.gravity.as_vec3().to_array(),
        n_particles,
        deepening: (scene.gravity * of.support / (sound * sound)).as_vec3().to_array(),
        exponent: settings.exponent as f32,
        support: of.support as f32,
        inverse_support: (1.0 / of.support) as f32,
        volume_factor: (of.mass(scene.dimensions) / of.rest_density * norm) as f32,
        rest_density: of.rest_density as f32,
        sound_speed: sound as f32,
        inverse_sound_speed: (1.0 / sound) as f32,
        artificial_viscosity: (0.5 * settings.artificial_viscosity / sound) as f32,
        viscosity: (settings.viscosity / (sound * sound * of.support)) as f32,
        density_diffusion: settings.density_diffusion as f32,
        signal_speed: settings.signal_speed() as f32,
        viscous_step: settings.viscous_step().min(1e30) as f32,
        step_factor: step_factor as f32,
        least_step: least_step as f32,
        n_parts: n_particles.div_ceil(WORKGROUP),
        padding_0: 0,
        padding_1: 0,
    }
}

impl GpuModel for GpuWcsph {
    fn record_step(
        &mut self,
        recorder: &mut Recorder,
        state: &mut GpuState,
        around: &mut GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        let covering = || Workgroups::Covering(state.n_moving as u64);
        let fluid = || (&self.fluid).into();
        let flows = || (&self.flows).into();
        let starts =
            [fluid(), (&state.velocities).into(), (&state.densities).into(), flows(), (&self.pressures).into()];
        recorder.commands().stage("set out").dispatch(&self.kernels.set_out, &starts, covering());
        around.follow(recorder, state)?;
        recorder.commands().stage("push");
        let pushed = [
            (Read, flows()),
            (Read, (&self.pressures).into()),
            (ReadWrite, (&self.accelerations).into()),
            (ReadWrite, (&state.neighbors).into()),
        ];
        self.visit(recorder, around, "package::application::particles::wcsph::push", &pushed)?;
        self.limit(recorder, covering(), clock);
        let kicked = [fluid(), clock.into(), (&self.accelerations).into(), flows()];
        recorder.commands().stage("kick").dispatch(&self.kernels.kick, &kicked, covering());
        recorder.commands().stage("rate");
        let rates = [(Read, flows()), (Read, clock.into()), (ReadWrite, (&state.densities).into())];
        self.visit(recorder, around, "package::application::particles::wcsph::rate", &rates)?;
        let settled = [fluid(), clock.into(), flows(), (&state.velocities).into(), (&state.positions).into()];
        recorder.commands().stage("settle").dispatch(&self.kernels.settle, &settled, covering());
        Ok(())
    }

    /// What the fluid at rest allows, at most: `limit` knows how dense it is.
    fn signals(&self) -> [f64; 2] {
        self.signals
    }
}
