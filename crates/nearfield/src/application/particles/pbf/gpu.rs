//! A step of position-based fluids on a device.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::rest::{AtRest, boundary_volumes};
use super::{PbfSettings, stable_way, walls};
use crate::Result;
use crate::application::particles::ParticleScene;
use crate::application::particles::fluid::boundary_alone;
use crate::application::particles::gpu::{GpuModel, ParticleClock};
use crate::application::particles::gpu_neighborhood::{GpuNeighborhood, ParticleVisitor, Recorder};
use crate::application::particles::gpu_state::{GpuState, WORKGROUP};
use crate::gpu::{Access, Bind, Buffer, Gpu, Kernel, Pipeline, Workgroups};

use Access::{Read, ReadWrite, Uniform};

/// `PbfFluid` in fluid.wesl, byte for byte. Lengths but for the walls and the support are in supports.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct PbfFluid {
    /// Lower corner within which centres stay, relative to the middle of the domain.
    pub low: [f32; 3],
    /// Particles that move.
    pub n_particles: u32,
    /// Upper corner.
    pub high: [f32; 3],
    /// The support.
    pub support: f32,
    /// Acceleration of all.
    pub gravity: [f32; 3],
    /// One over the support.
    pub inverse_support: f32,
    /// Volume of a particle times the factor of poly6.
    pub value_factor: f32,
    /// Volume of a particle times the factor of spiky.
    pub gradient_factor: f32,
    /// ε of the constraint.
    pub relaxation: f32,
    /// Of the artificial pressure, by the fourth power of poly6 without its factor.
    pub tensile: f32,
    /// Density at rest.
    pub rest_density: f32,
    /// As [`PbfSettings::xsph`].
    pub xsph: f32,
    /// As [`PbfSettings::vorticity`].
    pub vorticity: f32,
    /// Workgroups that sum up compressions.
    pub n_parts: u32,
}

/// Position-based fluids on a device.
pub(in crate::application::particles) struct GpuPbf {
    gpu: Gpu,
    settings: PbfSettings,
    signals: [f64; 2],
    fluid: Buffer<PbfFluid>,
    predict: Arc<Pipeline>,
    settle: Arc<Pipeline>,
    sum_compressions: Arc<Pipeline>,
    /// `[n + b]` places in the rounds; w is the volume in parts of that of a particle.
    places: Buffer<[f32; 4]>,
    /// `[n + b]` the same places; w is λ, at the end the rest density over the density, and of the boundary its volume.
    constrained: Buffer<[f32; 4]>,
    /// `[n]` vorticity and its length, where it is confined.
    curls: Buffer<[f32; 4]>,
    /// `[n_parts]` sums of compressions.
    parts: Buffer<f32>,
    n_parts: u32,
    iterations: u32,
}

impl GpuPbf {
    pub(in crate::application::particles) fn new(
        gpu: &Gpu,
        settings: &PbfSettings,
        scene: &ParticleScene,
        state: &GpuState,
    ) -> Result<Self> {
        let rest = AtRest::new(settings, scene.dimensions);
        let [low, high] = walls(settings, scene).map(|corner| (corner - state.middle()).as_vec3().to_array());
        let n_parts = (state.n_moving as u32).div_ceil(WORKGROUP);
        let fluid = PbfFluid {
            low,
            n_particles: state.n_moving as u32,
            high,
            support: rest.support as f32,
            gravity: scene.gravity.as_vec3().to_array(),
            inverse_support: (1.0 / rest.support) as f32,
            value_factor: rest.value_factor() as f32,
            gradient_factor: rest.gradient_factor() as f32,
            relaxation: (rest.relaxation * rest.support.powi(2)) as f32,
            tensile: (rest.tensile_factor() / rest.support.powi(2)) as f32,
            rest_density: rest.rest_density as f32,
            xsph: settings.xsph as f32,
            vorticity: settings.vorticity as f32,
            n_parts,
        };
        let (constants, module) =
            ([("WORKGROUP", f64::from(WORKGROUP))], "package::application::particles::pbf::predict");
        let kernel = |entry, accesses| {
            gpu.prepare(&Kernel { constants: &constants, ..Kernel::new(module, entry, accesses, WORKGROUP) })
        };
        let compression = "package::application::particles::pbf::compression";
        let sums = Kernel::new(compression, "sum_compressions", &[Uniform, Read, ReadWrite], WORKGROUP);
        let places = places(gpu, settings, &rest, scene, state)?;
        let n_curls = if settings.vorticity > 0.0 { state.n_moving } else { 1 };
        Ok(Self {
            settings: *settings,
            signals: stable_way(settings, scene),
            fluid: gpu.uniform("position-based fluid", &fluid)?,
            predict: kernel("predict", &[Uniform, Read, ReadWrite, ReadWrite, ReadWrite])?,
            settle: kernel("settle", &[Uniform, Read, ReadWrite])?,
            sum_compressions: gpu.prepare(&sums)?,
            constrained: gpu.upload("constrained particles", &places)?,
            places: gpu.upload("places of particles", &places)?,
            curls: gpu.buffer("vorticity of particles", n_curls)?,
            parts: gpu.buffer("compressions", n_parts.max(1) as usize)?,
            n_parts,
            iterations: 0,
            gpu: gpu.clone(),
        })
    }

    /// Records a visitor of this folder.
    fn visit(
        &self,
        recorder: &mut Recorder,
        around: &GpuNeighborhood,
        module: &'static str,
        features: &[(&str, bool)],
        bindings: &[(Access, Bind)],
    ) -> Result<()> {
        let bindings = [&[(Uniform, (&self.fluid).into())], bindings].concat();
        around.record_visit(recorder, &ParticleVisitor { module, features, bindings: &bindings })
    }

    /// Records λ of all, or the densities at the end.
    fn constrain(
        &self,
        recorder: &mut Recorder,
        state: &GpuState,
        around: &GpuNeighborhood,
        clock: Option<&Buffer<ParticleClock>>,
    ) -> Result<()> {
        let mut bindings = vec![
            (Read, (&self.places).into()),
            (ReadWrite, (&self.constrained).into()),
            (ReadWrite, (&state.densities).into()),
        ];
        if let Some(clock) = clock {
            bindings.extend([
                (ReadWrite, (&state.neighbors).into()),
                (ReadWrite, (&state.velocities).into()),
                (Read, clock.into()),
            ]);
        }
        recorder.commands().stage("constrain");
        let module = "package::application::particles::pbf::lambda";
        self.visit(recorder, around, module, &[("last", clock.is_some())], &bindings)
    }

    fn displace(&self, recorder: &mut Recorder, around: &GpuNeighborhood) -> Result<()> {
        recorder.commands().stage("displace");
        let bindings = [(Read, (&self.constrained).into()), (ReadWrite, (&self.places).into())];
        self.visit(recorder, around, "package::application::particles::pbf::displace", &[], &bindings)
    }

    /// Mean compression as the last constraints found it, read back.
    fn mean_compression(&self, recorder: &mut Recorder, state: &GpuState) -> Result<f64> {
        let binds = [(&self.fluid).into(), (&state.densities).into(), (&self.parts).into()];
        let covering = Workgroups::Covering(state.n_moving as u64);
        recorder.commands().stage("compression").dispatch(&self.sum_compressions, &binds, covering);
        recorder.submit()?;
        let parts = self.gpu.read_range(&self.parts, 0..self.n_parts as usize)?;
        Ok(parts.into_iter().map(f64::from).sum::<f64>() / state.n_moving.max(1) as f64)
    }

    /// Records vorticity confinement and viscosity.
    fn finish(
        &self,
        recorder: &mut Recorder,
        state: &mut GpuState,
        around: &GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        let constrained = || (Read, (&self.constrained).into());
        if self.settings.vorticity > 0.0 {
            recorder.commands().stage("vorticity");
            let velocities = (&state.velocities).into();
            let bindings = [constrained(), (Read, velocities), (Read, clock.into()), (ReadWrite, (&self.curls).into())];
            self.visit(recorder, around, "package::application::particles::pbf::curl", &[], &bindings)?;
            let velocities = (&state.velocities).into();
            let bindings = [constrained(), (Read, (&self.curls).into()), (Read, clock.into()), (ReadWrite, velocities)];
            self.visit(recorder, around, "package::application::particles::pbf::confine", &[], &bindings)?;
        }
        if self.settings.xsph > 0.0 {
            recorder.commands().stage("viscosity");
            let (from, to) = ((&state.velocities).into(), (&state.moved_velocities).into());
            let bindings = [constrained(), (Read, from), (Read, clock.into()), (ReadWrite, to)];
            self.visit(recorder, around, "package::application::particles::pbf::average", &[], &bindings)?;
            std::mem::swap(&mut state.velocities, &mut state.moved_velocities);
        }
        Ok(())
    }
}

/// `[n + b]` places for the rounds to start from: of those that move none yet, of the boundary where it is, with its volumes in parts of that of
/// a particle.
fn places(
    gpu: &Gpu,
    settings: &PbfSettings,
    rest: &AtRest,
    scene: &ParticleScene,
    state: &GpuState,
) -> Result<Vec<[f32; 4]>> {
    let mut places = vec![[0.0; 4]; state.len()];
    if scene.boundary.is_empty() {
        return Ok(places);
    }
    let (alone, around) = boundary_alone(scene, rest.support)?;
    let volumes = boundary_volumes(settings, rest, scene.dimensions, &alone, &around)?;
    // Places as the device has them, to the bit.
    let positions = gpu.read_range(&state.positions, state.n_moving..state.len())?;
    for (place, ([x, y, z, _], volume)) in places[state.n_moving..].iter_mut().zip(positions.into_iter().zip(volumes)) {
        *place = [x, y, z, (volume / rest.volume) as f32];
    }
    Ok(places)
}

impl GpuModel for GpuPbf {
    fn record_step(
        &mut self,
        recorder: &mut Recorder,
        state: &mut GpuState,
        around: &mut GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        let covering = || Workgroups::Covering(state.n_moving as u64);
        let fluid = || (&self.fluid).into();
        let motion =
            [fluid(), clock.into(), (&state.positions).into(), (&state.velocities).into(), (&self.places).into()];
        recorder.commands().stage("predict").dispatch(&self.predict, &motion, covering());
        around.follow(recorder, state)?;
        let mut iterations = 0;
        while iterations < self.settings.most_iterations {
            self.constrain(recorder, state, around, None)?;
            if iterations >= self.settings.iterations
                && self.mean_compression(recorder, state)? <= self.settings.tolerance
            {
                break;
            }
            self.displace(recorder, around)?;
            iterations += 1;
        }
        self.constrain(recorder, state, around, Some(clock))?;
        let settled = [fluid(), (&self.places).into(), (&state.positions).into()];
        let covering = covering();
        self.finish(recorder, state, around, clock)?;
        recorder.commands().stage("settle").dispatch(&self.settle, &settled, covering);
        self.iterations = iterations;
        Ok(())
    }

    fn can_repeat(&self) -> bool {
        self.settings.iterations == self.settings.most_iterations
    }

    fn signals(&self) -> [f64; 2] {
        self.signals
    }

    fn iterations(&self) -> u32 {
        self.iterations
    }
}
