//! A step of grains on the CPU.

use glam::DVec3;
use rayon::prelude::*;

use super::{DemSettings, PairRule};
use crate::Result;
use crate::application::particles::ParticleScene;
use crate::application::particles::cpu::{CpuModel, StepDone};
use crate::application::particles::neighborhood::Neighborhood;
use crate::application::particles::state::State;

/// Grains on the CPU.
pub(in crate::application::particles) struct CpuDem {
    settings: DemSettings,
    domain: [DVec3; 2],
    gravity: DVec3,
    /// Axes that have walls.
    axes: usize,
}

/// What a particle has received from those around it.
#[derive(Debug, Clone, Copy, Default)]
struct Received {
    impulse: DVec3,
    contacts: u32,
}

impl CpuDem {
    pub(in crate::application::particles) fn new(settings: &DemSettings, scene: &ParticleScene) -> Self {
        Self {
            settings: settings.clone(),
            domain: scene.domain,
            gravity: scene.gravity,
            axes: scene.dimensions.number() as usize,
        }
    }

    /// Moves a particle of radius `radius` and keeps it between the walls.
    fn integrate(&self, position: &mut DVec3, velocity: &mut DVec3, radius: f64, step: f64) {
        *velocity = (*velocity + self.gravity * step) * self.settings.global_damping;
        *position += *velocity * step;
        let [low, high] = [self.domain[0] + radius, self.domain[1] - radius];
        for axis in 0..self.axes {
            if position[axis] > high[axis] {
                position[axis] = high[axis];
                velocity[axis] *= self.settings.wall_damping;
            }
            if position[axis] < low[axis] {
                position[axis] = low[axis];
                velocity[axis] *= self.settings.wall_damping;
            }
        }
    }
}

impl DemSettings {
    /// What one particle receives in a step from a ball at `to_other`, that moves with `other - own` velocity `relative`; none beyond
    /// `reach`. Twin of `push` in collide.wesl.
    #[inline]
    fn push(&self, to_other: DVec3, relative: DVec3, reach: f64) -> Option<DVec3> {
        let distance = to_other.length();
        if !(distance < reach) {
            return None;
        }
        // Two at one place have no direction: they only share their motion.
        let normal = if distance > 0.0 { to_other / distance } else { DVec3::ZERO };
        let tangential = relative - relative.dot(normal) * normal;
        let overlap = -self.spring * (reach - distance);
        Some(overlap * normal + self.damping * relative + self.shear * tangential + self.attraction * to_other)
    }
}

impl CpuModel for CpuDem {
    fn step(&mut self, state: &mut State, around: &mut Neighborhood, step: f64) -> Result<StepDone> {
        for (class, &radius) in state.classes.clone().into_iter().zip(&self.settings.radii) {
            let moving = state.positions[class.clone()].par_iter_mut().zip(&mut state.velocities[class]);
            moving
                .with_min_len(1 << 10)
                .for_each(|(position, velocity)| self.integrate(position, velocity, radius, step));
        }
        around.follow(&state.positions)?;
        let (positions, velocities) = (&state.positions, &state.velocities);
        let (settings, rule) = (&self.settings, self.settings.pair_rule);
        let mut radius_of = Vec::with_capacity(positions.len());
        for (class, &radius) in state.classes.iter().zip(&settings.radii) {
            radius_of.resize(class.end, radius);
        }
        let received = around.fold(|i, row, mut received: Received| {
            let (own, at, velocity) = (radius_of[i], positions[i], velocities[i]);
            for j in row.iter().filter(|&j| j != i) {
                let reach = rule.reach(own, radius_of[j]);
                if let Some(push) = settings.push(positions[j] - at, velocities[j] - velocity, reach) {
                    received.impulse += push;
                    received.contacts += 1;
                }
            }
            received
        })?;
        let collide = |(i, (velocity, received)): (usize, (&mut DVec3, &Received))| {
            let mut impulse = received.impulse;
            if let Some(ball) = &settings.collider {
                let reach = PairRule::Contact.reach(radius_of[i], ball.radius);
                let to_ball = ball.center - positions[i];
                let push = settings.push(to_ball, -*velocity, reach);
                // The ball does not attract.
                impulse += push.map_or(DVec3::ZERO, |push| push - settings.attraction * to_ball);
            }
            *velocity += impulse;
        };
        let velocities = state.velocities.par_iter_mut().zip(&received).enumerate();
        velocities.with_min_len(1 << 10).for_each(collide);
        let neighbors = received.iter().map(|received| u64::from(received.contacts)).sum();
        Ok(StepDone { step, neighbors, ..StepDone::default() })
    }
}
