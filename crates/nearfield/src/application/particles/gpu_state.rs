//! Particles on a device: in blocks by class, the boundary behind them.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use super::state::State;
use super::{Dimensions, ParticleModel, ParticleScene, Particles};
use crate::curve::{Curve, Domain, GpuCurveOrder};
use crate::geometry::Aabb;
use crate::geometry::validate::MAX_COORDINATE;
use crate::gpu::{Access, Buffer, Commands, Gpu, Kernel, Pipeline, Workgroups};
use crate::structure::DevicePoint;
use crate::{Error, Result};

use Access::{Read, ReadWrite, Uniform};

/// Invocations of a workgroup of kernels that have one for each particle.
pub(super) const WORKGROUP: u32 = 256;

/// `ParticleBlock` in reorder.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct ParticleBlock {
    /// Place of the first particle.
    pub first: u32,
    /// Particles.
    pub count: u32,
    /// Unused.
    pub padding_0: u32,
    /// Unused.
    pub padding_1: u32,
}

/// Particles on a device.
pub(super) struct GpuState {
    /// `[n + b]` xyz relative to the middle of the domain, and the particle's number as bits.
    pub(super) positions: Buffer<DevicePoint>,
    /// `[n + b]` xyz and the class as bits. The boundary rests.
    pub(super) velocities: Buffer<[f32; 4]>,
    /// `[n + b]` densities of fluids.
    pub(super) densities: Buffer<f32>,
    /// `[n]` pressures of incompressible fluids, empty for others.
    pub(super) pressures: Buffer<f32>,
    /// `[n]` neighbours that acted on each particle in the last step.
    pub(super) neighbors: Buffer<u32>,
    /// `[n]` the index that the caller knows them by.
    ids: Buffer<u32>,
    /// What the next step writes velocities to, and reorders write everything to.
    pub(super) moved_velocities: Buffer<[f32; 4]>,
    moved_positions: Buffer<DevicePoint>,
    moved_densities: Buffer<f32>,
    moved_pressures: Buffer<f32>,
    moved_ids: Buffer<u32>,
    kept: Kept,
    /// `[n_classes]` of those that move.
    pub(super) classes: Vec<Range<usize>>,
    /// Particles that move.
    pub(super) n_moving: usize,
    has_densities: bool,
    has_pressures: bool,
    middle: DVec3,
    reorder: Option<Reorder>,
}

/// The state before the steps that are under way.
struct Kept {
    positions: Buffer<DevicePoint>,
    velocities: Buffer<[f32; 4]>,
    densities: Buffer<f32>,
    pressures: Buffer<f32>,
}

/// What it takes to put the particles of each class into the order of a curve.
struct Reorder {
    curve: GpuCurveOrder,
    domain: Domain,
    order: Buffer<u32>,
    blocks: Vec<(Buffer<ParticleBlock>, Buffer<DevicePoint>)>,
    motion: Arc<Pipeline>,
    names: Arc<Pipeline>,
    pressures: Arc<Pipeline>,
}

impl GpuState {
    /// The particles of a scene, put into blocks by class.
    pub(super) fn new(gpu: &Gpu, scene: &ParticleScene, n_classes: usize) -> Result<Self> {
        let state = State::new(scene, n_classes);
        let middle = middle_of(scene);
        let (n, n_moving) = (state.positions.len(), state.n_moving());
        let has_pressures = matches!(scene.model, ParticleModel::Dfsph(_));
        let n_pressures = if has_pressures { n_moving } else { 0 };
        let buffers = |what| gpu.buffer::<[f32; 4]>(what, n);
        let new = Self {
            positions: buffers("positions")?,
            velocities: buffers("velocities")?,
            densities: gpu.buffer("densities", n)?,
            pressures: gpu.buffer("pressures", n_pressures)?,
            neighbors: gpu.upload("neighbors of particles", &vec![0; n_moving])?,
            ids: gpu.buffer("indices of particles", n_moving)?,
            moved_velocities: buffers("moved velocities")?,
            moved_positions: buffers("moved positions")?,
            moved_densities: gpu.buffer("moved densities", n)?,
            moved_pressures: gpu.buffer("moved pressures", n_pressures)?,
            moved_ids: gpu.buffer("moved indices of particles", n_moving)?,
            kept: Kept {
                positions: buffers("kept positions")?,
                velocities: buffers("kept velocities")?,
                densities: gpu.buffer("kept densities", n)?,
                pressures: gpu.buffer("kept pressures", n_pressures)?,
            },
            classes: state.classes.clone(),
            n_moving,
            has_densities: scene.model.is_fluid(),
            has_pressures,
            middle,
            reorder: None,
        };
        new.send(gpu, &state, scene)?;
        Ok(new)
    }

    /// Writes other particles into the memory there is.
    fn send(&self, gpu: &Gpu, state: &State, scene: &ParticleScene) -> Result<()> {
        let n = state.positions.len();
        let point = |(i, p): (usize, &DVec3)| (*p - self.middle).as_vec3().extend(f32::from_bits(i as u32)).to_array();
        let positions: Vec<DevicePoint> = state.positions.iter().enumerate().map(point).collect();
        let at_rest = [0.0; 4];
        let mut velocities = vec![at_rest; n];
        for (i, (to, velocity)) in velocities.iter_mut().zip(&state.velocities).enumerate() {
            *to = velocity.as_vec3().extend(f32::from_bits(state.class_of(i) as u32)).to_array();
        }
        let rest_density = scene.model.rest_density() as f32;
        let mut densities = vec![rest_density; n];
        densities.iter_mut().zip(&state.densities).for_each(|(to, &density)| *to = density as f32);
        for buffer in [&self.positions, &self.moved_positions, &self.kept.positions] {
            gpu.write(buffer, 0, &positions)?;
        }
        for buffer in [&self.velocities, &self.moved_velocities, &self.kept.velocities] {
            gpu.write(buffer, 0, &velocities)?;
        }
        for buffer in [&self.densities, &self.moved_densities, &self.kept.densities] {
            gpu.write(buffer, 0, &densities)?;
        }
        if self.has_pressures {
            let mut pressures = vec![0.0; self.n_moving];
            pressures.iter_mut().zip(&state.pressures).for_each(|(to, &pressure)| *to = pressure as f32);
            for buffer in [&self.pressures, &self.moved_pressures, &self.kept.pressures] {
                gpu.write(buffer, 0, &pressures)?;
            }
        }
        gpu.write(&self.ids, 0, &state.ids)?;
        gpu.write(&self.moved_ids, 0, &state.ids)
    }

    /// Goes on from other particles of the scene.
    pub(super) fn replace(&mut self, gpu: &Gpu, scene: &ParticleScene) -> Result<()> {
        let state = State::new(scene, self.classes.len());
        self.classes.clone_from(&state.classes);
        self.reorder = None;
        self.send(gpu, &state, scene)
    }

    /// Number of particles with the boundary.
    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }

    /// Records a copy of the state, to come back to.
    pub(super) fn record_keep(&self, commands: &mut Commands) {
        commands
            .stage("keep")
            .copy(&self.positions, &self.kept.positions)
            .copy(&self.velocities, &self.kept.velocities);
        if self.has_densities {
            commands.copy(&self.densities, &self.kept.densities);
        }
        if self.has_pressures {
            commands.copy(&self.pressures, &self.kept.pressures);
        }
    }

    /// Brings back what was kept.
    pub(super) fn restore(&mut self, gpu: &Gpu) -> Result<()> {
        let mut commands = gpu.commands("restore particles");
        commands.copy(&self.kept.positions, &self.positions).copy(&self.kept.velocities, &self.velocities);
        if self.has_densities {
            commands.copy(&self.kept.densities, &self.densities);
        }
        if self.has_pressures {
            commands.copy(&self.kept.pressures, &self.pressures);
        }
        commands.submit()
    }

    /// Records a new order of the particles of each class, along Hilbert's curve.
    pub(super) fn record_reorder(&mut self, gpu: &Gpu, commands: &mut Commands, scene: &ParticleScene) -> Result<()> {
        if self.n_moving == 0 {
            return Ok(());
        }
        let reorder = match self.reorder.take() {
            Some(reorder) => reorder,
            None => self.prepare_reorder(gpu, scene)?,
        };
        for (class, (block, points)) in self.classes.iter().zip(&reorder.blocks) {
            let n = class.len();
            if n == 0 {
                continue;
            }
            commands.copy_from(&self.positions, class.start, points);
            reorder.curve.record(commands, &reorder.domain, points, &reorder.order, n)?;
            let covering = || Workgroups::Covering(n as u64);
            let motion = [
                block.into(),
                (&reorder.order).into(),
                (&self.positions).into(),
                (&self.velocities).into(),
                (&self.moved_positions).into(),
                (&self.moved_velocities).into(),
            ];
            let names = [
                block.into(),
                (&reorder.order).into(),
                (&self.ids).into(),
                (&self.densities).into(),
                (&self.moved_ids).into(),
                (&self.moved_densities).into(),
            ];
            commands.stage("reorder").dispatch(&reorder.motion, &motion, covering());
            commands.dispatch(&reorder.names, &names, covering());
            if self.has_pressures {
                let (from, to) = ((&self.pressures).into(), (&self.moved_pressures).into());
                let pressures = [block.into(), (&reorder.order).into(), from, to];
                commands.dispatch(&reorder.pressures, &pressures, covering());
            }
        }
        self.reorder = Some(reorder);
        std::mem::swap(&mut self.positions, &mut self.moved_positions);
        std::mem::swap(&mut self.velocities, &mut self.moved_velocities);
        std::mem::swap(&mut self.ids, &mut self.moved_ids);
        std::mem::swap(&mut self.densities, &mut self.moved_densities);
        std::mem::swap(&mut self.pressures, &mut self.moved_pressures);
        Ok(())
    }

    fn prepare_reorder(&self, gpu: &Gpu, scene: &ParticleScene) -> Result<Reorder> {
        let largest = self.classes.iter().map(Range::len).max().unwrap_or(0);
        let block = |class: &Range<usize>| {
            let (first, count) = (class.start as u32, class.len() as u32);
            let block = ParticleBlock { first, count, padding_0: 0, padding_1: 0 };
            Ok((gpu.uniform("block of particles", &block)?, gpu.buffer("particles of a class", class.len())?))
        };
        let pipeline = |entry, accesses: &[Access]| {
            gpu.prepare(&Kernel {
                constants: &[("WORKGROUP", WORKGROUP as f64)],
                ..Kernel::new("package::application::particles::reorder", entry, accesses, WORKGROUP)
            })
        };
        let two_arrays = [Uniform, Read, Read, Read, ReadWrite, ReadWrite];
        Ok(Reorder {
            curve: GpuCurveOrder::new(gpu, Curve::Hilbert, largest)?,
            domain: Domain::of_bounds(&relative_domain(scene)),
            order: gpu.buffer("order of particles", largest)?,
            blocks: self.classes.iter().map(block).collect::<Result<_>>()?,
            motion: pipeline("reorder_motion", &two_arrays)?,
            names: pipeline("reorder_names", &two_arrays)?,
            pressures: pipeline("reorder_pressures", &[Uniform, Read, Read, ReadWrite])?,
        })
    }

    /// The particles by the caller's index, read back.
    pub(super) fn particles(&self, gpu: &Gpu) -> Result<Particles> {
        let n = self.n_moving;
        let positions = gpu.read_range(&self.positions, 0..n)?;
        let velocities = gpu.read_range(&self.velocities, 0..n)?;
        let densities = if self.has_densities { gpu.read_range(&self.densities, 0..n)? } else { Vec::new() };
        let pressures = if self.has_pressures { gpu.read_range(&self.pressures, 0..n)? } else { Vec::new() };
        let mut particles = Particles::at_rest(vec![DVec3::ZERO; n]);
        particles.densities = vec![0.0; densities.len()];
        particles.pressures = vec![0.0; pressures.len()];
        for (place, id) in gpu.read(&self.ids)?.into_iter().enumerate() {
            let (id, [x, y, z, _], [u, v, w, class]) = (id as usize, positions[place], velocities[place]);
            particles.positions[id] = Vec3::new(x, y, z).as_dvec3() + self.middle;
            particles.velocities[id] = Vec3::new(u, v, w).as_dvec3();
            particles.classes[id] = class.to_bits() as u8;
            if let Some(&density) = densities.get(place) {
                particles.densities[id] = density.into();
            }
            if let Some(&pressure) = pressures.get(place) {
                particles.pressures[id] = pressure.into();
            }
        }
        Ok(particles)
    }

    /// What is wrong in a step, if a particle is not where it can be or too fast: the first by index, found on the host.
    pub(super) fn first_bad(&self, gpu: &Gpu, step: u64, max_speed: f64) -> Result<Option<Error>> {
        let particles = self.particles(gpu)?;
        let is_bad = |&i: &usize| {
            let (position, speed) = (particles.positions[i], particles.velocities[i].length());
            !(position.abs().max_element() <= f64::from(MAX_COORDINATE) && speed <= max_speed && speed.is_finite())
        };
        Ok((0..particles.len()).find(is_bad).map(|i| Error::BlowUp {
            step,
            particle: i as u64,
            position: particles.positions[i].to_array(),
            speed: particles.velocities[i].length(),
            limit: max_speed,
        }))
    }

    /// The index that the caller knows a particle by.
    pub(super) fn id(&self, gpu: &Gpu, place: u32) -> Result<u32> {
        Ok(gpu.read_range(&self.ids, place as usize..place as usize + 1)?[0])
    }

    /// The middle of the domain, which positions are relative to.
    pub(super) fn middle(&self) -> DVec3 {
        self.middle
    }
}

/// The domain of a scene relative to its middle.
pub(super) fn relative_domain(scene: &ParticleScene) -> Aabb {
    let ([low, high], middle) = (scene.domain, middle_of(scene));
    Aabb::new((low - middle).as_vec3(), (high - middle).as_vec3())
}

/// What positions are relative to: the middle of the domain, in the plane where the scene is.
fn middle_of(scene: &ParticleScene) -> DVec3 {
    let middle = 0.5 * (scene.domain[0] + scene.domain[1]);
    if scene.dimensions == Dimensions::Two { middle.with_z(0.0) } else { middle }
}
