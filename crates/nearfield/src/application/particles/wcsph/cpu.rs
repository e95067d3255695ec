//! A step of weakly compressible fluids on the CPU.

use glam::DVec3;
use rayon::prelude::*;

use super::WcsphSettings;
use crate::Result;
use crate::application::particles::cpu::{CpuModel, StepDone};
use crate::application::particles::fluid::{Weights, density_error, masses};
use crate::application::particles::neighborhood::{Neighborhood, Row};
use crate::application::particles::state::State;
use crate::application::particles::{Dimensions, ParticleScene, TimeStep};

/// Particles of a task.
const TASK: usize = 1 << 10;

/// Weakly compressible fluids on the CPU.
pub(in crate::application::particles) struct CpuWcsph {
    settings: WcsphSettings,
    weights: Weights,
    dimensions: Dimensions,
    mass: f64,
    gravity: DVec3,
    time_step: TimeStep,
    /// `[b]` volumes of the boundary, which the first step finds.
    boundary: Option<Vec<f64>>,
}

/// The particles in the sums of a step.
struct Sums<'a> {
    model: &'a CpuWcsph,
    positions: &'a [DVec3],
    /// `[n]`
    flows: Vec<Flow>,
    /// `[b]`
    boundary: &'a [f64],
}

/// What others need to know of a particle.
#[derive(Debug, Clone, Copy)]
struct Flow {
    velocity: DVec3,
    density: f64,
    /// 1 / ρ.
    inverse: f64,
    pressure: f64,
}

/// What those around a particle do to it.
#[derive(Debug, Clone, Copy, Default)]
struct Pushed {
    acceleration: DVec3,
    neighbors: u32,
}

impl WcsphSettings {
    /// p of a density.
    fn pressure(&self, density: f64) -> f64 {
        let stiffness = self.sound_speed * self.sound_speed * self.fluid.rest_density / self.exponent;
        stiffness * ((density / self.fluid.rest_density).powf(self.exponent) - 1.0)
    }

    /// The smoothing length: half the support.
    pub(super) fn smoothing_length(&self) -> f64 {
        0.5 * self.fluid.support
    }

    /// Speed of signals in the fluid at rest: that of sound, and what artificial viscosity asks for.
    pub(super) fn signal_speed(&self) -> f64 {
        self.sound_speed * (1.0 + 0.6 * self.artificial_viscosity)
    }

    /// Half the time in which laminar viscosity spreads over a smoothing length; infinite without it.
    pub(super) fn viscous_step(&self) -> f64 {
        0.5 * self.smoothing_length() * self.smoothing_length() / self.viscosity
    }
}

impl CpuWcsph {
    pub(in crate::application::particles) fn new(settings: &WcsphSettings, scene: &ParticleScene) -> Self {
        Self {
            settings: *settings,
            weights: Weights::new(&settings.fluid, settings.smoothing, scene),
            dimensions: scene.dimensions,
            mass: settings.fluid.mass(scene.dimensions),
            gravity: scene.gravity,
            time_step: scene.time_step,
            boundary: None,
        }
    }

    /// `[b]` volumes of the boundary: Akinci2012's masses in parts of the density at rest.
    fn boundary_volumes(&self, state: &State, around: &Neighborhood) -> Result<Vec<f64>> {
        let fluid = &self.settings.fluid;
        let masses = masses(fluid, self.settings.smoothing, self.dimensions, state, around)?;
        Ok(masses[state.n_moving()..].iter().map(|mass| mass / fluid.rest_density).collect())
    }

    /// The step that these accelerations allow, at most `step`.
    fn limited(&self, step: f64, pushed: &[Pushed]) -> f64 {
        let TimeStep::Cfl { factor, least, .. } = self.time_step else { return step };
        let largest2 = pushed.par_iter().map(|pushed| pushed.acceleration.length_squared()).reduce(|| 0.0, f64::max);
        let of_forces = factor * (self.settings.smoothing_length() / largest2.sqrt()).sqrt();
        step.min(of_forces.max(least))
    }
}

impl Sums<'_> {
    fn of<'a>(model: &'a CpuWcsph, state: &'a State, boundary: &'a [f64]) -> Sums<'a> {
        let flow = |(&velocity, &density): (&DVec3, &f64)| Flow {
            velocity,
            density,
            inverse: density.recip(),
            pressure: model.settings.pressure(density),
        };
        let flows = state.velocities.par_iter().zip(&state.densities).with_min_len(TASK).map(flow).collect();
        Sums { model, positions: &state.positions, flows, boundary }
    }

    /// Forces by mass on a particle that moves, from a share of its neighbours.
    fn push(&self, i: usize, row: Row<'_>, mut pushed: Pushed) -> Pushed {
        let CpuWcsph { settings, weights, mass, gravity, .. } = self.model;
        let own = self.flows[i];
        let length = settings.smoothing_length();
        let artificial = settings.artificial_viscosity * settings.sound_speed * length;
        let softening = 0.01 * length * length;
        for (j, offset, distance) in weights.neighbors(self.positions, i, row) {
            pushed.neighbors += 1;
            let slope = weights.slope(distance);
            let other = self.flows.get(j);
            let relative = other.map_or(own.velocity, |other| own.velocity - other.velocity);
            let approach = relative.dot(offset);
            let mean_density = other.map_or(own.density, |other| 0.5 * (own.density + other.density));
            let mut along = 0.0;
            if approach < 0.0 {
                along = -artificial * approach / ((distance * distance + softening) * mean_density);
            }
            let Some(other) = other else {
                // A wall has the pressure that the fluid beside it has, more by what lies deeper, and it never pulls.
                let deeper = -own.density * gravity.dot(offset);
                let volume = self.boundary[j - self.flows.len()];
                along = along * own.density + (2.0 * own.pressure + deeper).max(0.0) * own.inverse;
                pushed.acceleration += volume * slope * (2.0 * settings.viscosity * relative - along * offset);
                continue;
            };
            along += (own.pressure + other.pressure) * own.inverse * other.inverse;
            let viscous = settings.viscosity * (own.inverse + other.inverse);
            pushed.acceleration += mass * slope * (viscous * relative - along * offset);
        }
        pushed
    }

    /// dρ/dt of a particle that moves with `velocities`, from a share of its neighbours.
    fn rate(&self, velocities: &[DVec3], i: usize, row: Row<'_>, mut rate: f64) -> f64 {
        let CpuWcsph { settings, weights, mass, gravity, .. } = self.model;
        let (own, velocity) = (self.flows[i], velocities[i]);
        let diffusion = 2.0 * settings.density_diffusion * settings.smoothing_length() * settings.sound_speed;
        let hydrostatic = settings.fluid.rest_density / (settings.sound_speed * settings.sound_speed);
        for (j, offset, distance) in weights.neighbors(self.positions, i, row) {
            let slope = weights.slope(distance);
            let Some(other) = self.flows.get(j) else {
                let volume = self.boundary[j - self.flows.len()];
                rate += own.density * volume * slope * velocity.dot(offset);
                continue;
            };
            let volume = mass * other.inverse;
            let approach = (velocity - velocities[j]).dot(offset);
            let excess = other.density - own.density + hydrostatic * gravity.dot(offset);
            rate += volume * slope * (own.density * approach - diffusion * excess);
        }
        rate
    }
}

impl CpuModel for CpuWcsph {
    fn step(&mut self, state: &mut State, around: &mut Neighborhood, step: f64) -> Result<StepDone> {
        let n = state.n_moving();
        if state.densities.len() != n {
            state.densities = vec![self.settings.fluid.rest_density; n];
        }
        around.follow(&state.positions)?;
        if self.boundary.is_none() {
            self.boundary = Some(self.boundary_volumes(state, around)?);
        }
        let sums = Sums::of(self, state, self.boundary.as_deref().unwrap_or_default());
        let mut pushed = around.fold(|i, row, pushed| if i < n { sums.push(i, row, pushed) } else { pushed })?;
        pushed.truncate(n);
        pushed.par_iter_mut().with_min_len(TASK).for_each(|pushed| pushed.acceleration += self.gravity);
        let step = self.limited(step, &pushed);
        let mut velocities = state.velocities.clone();
        let moving = velocities.par_iter_mut().zip(&pushed).with_min_len(TASK);
        moving.for_each(|(velocity, pushed)| *velocity += step * pushed.acceleration);
        let rates = around.fold(|i, row, rate| if i < n { sums.rate(&velocities, i, row, rate) } else { rate })?;
        state.velocities = velocities;
        let State { positions, velocities, densities, .. } = state;
        densities.iter_mut().zip(&rates).for_each(|(density, rate)| *density += step * rate);
        let images = self.weights.images();
        let moving = positions[..n].par_iter_mut().zip(velocities).with_min_len(TASK);
        moving.for_each(|(position, velocity)| *position = images.wrap(*position + step * *velocity));
        let neighbors = pushed.iter().map(|pushed| u64::from(pushed.neighbors)).sum();
        let rest_density = self.settings.fluid.rest_density;
        let density_error = density_error(densities.iter().map(|density| density / rest_density));
        Ok(StepDone { step, neighbors, iterations: 0, density_error })
    }

    /// The time that sound and the fastest particle together take for a smoothing length, or half of that in which laminar viscosity
    /// spreads over it. What forces allow is found in the step, when they are known.
    fn stable_step(&self, state: &State) -> f64 {
        let settings = &self.settings;
        let speed2 = state.velocities.iter().map(|velocity| velocity.length_squared()).fold(0.0, f64::max);
        let densest = state.densities.iter().copied().fold(settings.fluid.rest_density, f64::max);
        let stiffening = (densest / settings.fluid.rest_density).powf(0.5 * (settings.exponent - 1.0));
        let sound = settings.signal_speed() * stiffening.max(1.0);
        (settings.smoothing_length() / (sound + speed2.sqrt())).min(settings.viscous_step())
    }
}
