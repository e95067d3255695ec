//! A step of grains on a device.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::{DemSettings, PairRule};
use crate::Result;
use crate::application::particles::gpu::{GpuModel, ParticleClock};
use crate::application::particles::gpu_neighborhood::{GpuNeighborhood, ParticleVisitor, Recorder};
use crate::application::particles::gpu_state::{GpuState, WORKGROUP, relative_domain};
use crate::application::particles::{Dimensions, ParticleScene};
use crate::gpu::{Access, Buffer, Gpu, Kernel, Pipeline, Workgroups};

use Access::{Read, ReadWrite, Uniform};

/// Where walls are that no particle meets.
const FAR: f32 = 1e30;

/// Quanta of sums in fixed point that the largest overlap is at least; see sum.wesl.
const QUANTA: f64 = 65_536.0;

/// `DemIntegrate` in integrate.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct DemIntegrate {
    /// Acceleration of all.
    pub gravity: [f32; 3],
    /// Particles.
    pub n_particles: u32,
    /// Lower corner of the domain relative to its middle.
    pub low: [f32; 3],
    /// What is left of a velocity.
    pub global_damping: f32,
    /// Upper corner.
    pub high: [f32; 3],
    /// Factor of the speed across a wall.
    pub wall_damping: f32,
    /// By class.
    pub radii: [[f32; 4]; 2],
}

/// `DemCollide` in collide.wesl, byte for byte.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub struct DemCollide {
    /// Centre relative to the middle of the domain, and radius, 0 for none.
    pub collider: [f32; 4],
    /// By class.
    pub radii: [[f32; 4]; 2],
    /// As [`DemSettings::spring`].
    pub spring: f32,
    /// As [`DemSettings::damping`].
    pub damping: f32,
    /// As [`DemSettings::shear`].
    pub shear: f32,
    /// As [`DemSettings::attraction`].
    pub attraction: f32,
    /// Number of the rule.
    pub pair_rule: u32,
    /// 1 where all radii are the same.
    pub one_class: u32,
    /// Of sums in fixed point.
    pub quantum: f32,
    /// One over it.
    pub inverse_quantum: f32,
}

/// Grains on a device.
pub(in crate::application::particles) struct GpuDem {
    integrate: Arc<Pipeline>,
    integration: Buffer<DemIntegrate>,
    collisions: Buffer<DemCollide>,
}

impl GpuDem {
    pub(in crate::application::particles) fn new(
        gpu: &Gpu,
        settings: &DemSettings,
        scene: &ParticleScene,
        state: &GpuState,
    ) -> Result<Self> {
        let mut domain = relative_domain(scene);
        if scene.dimensions == Dimensions::Two {
            // The plane has no walls across it.
            (domain.min.z, domain.max.z) = (-FAR, FAR);
        }
        let mut radii = [[0.0; 4]; 2];
        settings.radii.iter().enumerate().for_each(|(class, &radius)| radii[class / 4][class % 4] = radius as f32);
        let integration = DemIntegrate {
            gravity: scene.gravity.as_vec3().to_array(),
            n_particles: state.n_moving as u32,
            low: domain.min.to_array(),
            global_damping: settings.global_damping as f32,
            high: domain.max.to_array(),
            wall_damping: settings.wall_damping as f32,
            radii,
        };
        let collider = settings.collider.map_or([0.0; 4], |ball| {
            let center: Vec3 = (ball.center - state.middle()).as_vec3();
            center.extend(ball.radius as f32).to_array()
        });
        // Of an overlap as large as can be, and of two that move by their reach in a step.
        let reach = settings.largest_reach();
        let fastest = reach / scene.time_step.most();
        let largest_push =
            ((settings.spring + settings.attraction.abs()) * reach).max((settings.damping + settings.shear) * fastest);
        let quantum = if largest_push > 0.0 { largest_push / QUANTA } else { 1.0 };
        let collide = DemCollide {
            collider,
            radii,
            spring: settings.spring as f32,
            damping: settings.damping as f32,
            shear: settings.shear as f32,
            attraction: settings.attraction as f32,
            pair_rule: PairRule::ALL.iter().position(|&rule| rule == settings.pair_rule).unwrap_or(0) as u32,
            one_class: u32::from(settings.radii.len() == 1),
            quantum: quantum as f32,
            inverse_quantum: (1.0 / quantum) as f32,
        };
        let kernel = Kernel {
            constants: &[("WORKGROUP", WORKGROUP as f64)],
            ..Kernel::new(
                "package::application::particles::dem::integrate",
                "integrate",
                &[Uniform, Read, ReadWrite, ReadWrite],
                WORKGROUP,
            )
        };
        Ok(Self {
            integrate: gpu.prepare(&kernel)?,
            integration: gpu.uniform("motion of grains", &integration)?,
            collisions: gpu.uniform("collisions of grains", &collide)?,
        })
    }
}

impl GpuModel for GpuDem {
    fn record_step(
        &mut self,
        recorder: &mut Recorder,
        state: &mut GpuState,
        around: &mut GpuNeighborhood,
        clock: &Buffer<ParticleClock>,
    ) -> Result<()> {
        let motion = [(&self.integration).into(), clock.into(), (&state.positions).into(), (&state.velocities).into()];
        let covering = Workgroups::Covering(state.n_moving as u64);
        recorder.commands().stage("integrate").dispatch(&self.integrate, &motion, covering);
        around.follow(recorder, state)?;
        recorder.commands().stage("collide");
        let visitor = ParticleVisitor {
            module: "package::application::particles::dem::collide",
            features: &[],
            bindings: &[
                (Uniform, (&self.collisions).into()),
                (Read, (&state.velocities).into()),
                (ReadWrite, (&state.moved_velocities).into()),
                (ReadWrite, (&state.neighbors).into()),
            ],
        };
        around.record_visit(recorder, &visitor)?;
        std::mem::swap(&mut state.velocities, &mut state.moved_velocities);
        Ok(())
    }
}
