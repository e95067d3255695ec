//! A step of position-based fluids on the CPU.

use glam::DVec3;
use rayon::prelude::*;

use super::rest::{AtRest, boundary_volumes};
use super::{PbfSettings, stable_way, walls};
use crate::Result;
use crate::application::particles::cpu::{CpuModel, StepDone};
use crate::application::particles::fluid::density_error;
use crate::application::particles::neighborhood::{Neighborhood, Row};
use crate::application::particles::state::State;
use crate::application::particles::{Dimensions, ParticleScene};

/// Particles of a task.
const TASK: usize = 1 << 10;

/// Position-based fluids on the CPU.
pub(in crate::application::particles) struct CpuPbf {
    settings: PbfSettings,
    rest: AtRest,
    dimensions: Dimensions,
    /// Within which centres stay.
    walls: [DVec3; 2],
    gravity: DVec3,
    signals: [f64; 2],
    /// `[b]` volumes of the boundary, which the first step finds.
    boundary: Option<Vec<f64>>,
}

/// The particles in the rounds of a step.
pub(super) struct Rounds<'a> {
    pub(super) rest: &'a AtRest,
    pub(super) n_moving: usize,
    /// `[n + b]` where they are.
    pub(super) positions: &'a [DVec3],
    /// `[n + b]` where they were searched.
    searched: &'a [DVec3],
    /// `[b]`
    boundary: &'a [f64],
}

/// What a particle's constraint sums up over its neighbours.
#[derive(Debug, Clone, Copy, Default)]
struct Constraint {
    /// Σ V W without the particle itself.
    values: f64,
    /// ∇ᵢCᵢ.
    gradient: DVec3,
    /// Σ |∇ₖCᵢ|² of the others that move.
    squares: f64,
    neighbors: u32,
}

impl CpuPbf {
    pub(in crate::application::particles) fn new(settings: &PbfSettings, scene: &ParticleScene) -> Self {
        Self {
            settings: *settings,
            rest: AtRest::new(settings, scene.dimensions),
            dimensions: scene.dimensions,
            walls: walls(settings, scene),
            gravity: scene.gravity,
            signals: stable_way(settings, scene),
            boundary: None,
        }
    }

    /// The nearest place between the walls; what is not a number stays so.
    fn keep_inside(&self, position: DVec3) -> DVec3 {
        if position.is_nan() { position } else { position.clamp(self.walls[0], self.walls[1]) }
    }

    /// Moves all as if they were alone, but between the walls.
    fn predict(&self, state: &mut State, step: f64) {
        let n = state.n_moving();
        let moving = state.positions[..n].par_iter_mut().zip(&mut state.velocities);
        moving.with_min_len(TASK).for_each(|(position, velocity)| {
            *velocity += self.gravity * step;
            let free = *position + *velocity * step;
            *position = self.keep_inside(free);
            if *position != free {
                *velocity += (*position - free) / step;
            }
        });
    }
}

impl Rounds<'_> {
    /// Neighbours of a particle: their index, the way from them to it, and its length.
    #[inline]
    fn neighbors(&self, i: usize, row: Row<'_>) -> impl Iterator<Item = (usize, DVec3, f64)> {
        let (at, searched) = (self.positions[i], self.searched[i]);
        let support2 = self.rest.support * self.rest.support;
        row.iter().filter_map(move |j| {
            let offset = at - self.positions[j];
            let dist2 = offset.length_squared();
            let acts = j != i && dist2 < support2 && searched.distance_squared(self.searched[j]) < support2;
            acts.then(|| (j, offset, dist2.sqrt()))
        })
    }

    /// Those that move.
    #[inline]
    pub(super) fn moving_neighbors(&self, i: usize, row: Row<'_>) -> impl Iterator<Item = (usize, DVec3, f64)> {
        self.neighbors(i, row).filter(|&(j, ..)| j < self.n_moving)
    }

    /// Of a particle, for a share of its neighbours.
    fn constraint(&self, i: usize, row: Row<'_>, mut sums: Constraint) -> Constraint {
        for (j, offset, distance) in self.neighbors(i, row) {
            let moves = j < self.n_moving;
            let volume = if moves { self.rest.volume } else { self.boundary[j - self.n_moving] };
            let gradient = volume * self.rest.gradient(offset, distance);
            sums.values += volume * self.rest.value(distance);
            sums.gradient += gradient;
            sums.squares += if moves { gradient.length_squared() } else { 0.0 };
            sums.neighbors += 1;
        }
        sums
    }

    /// Δx of a particle, for a share of its neighbours.
    fn displacement(&self, lambdas: &[f64], i: usize, row: Row<'_>, mut sum: DVec3) -> DVec3 {
        for (j, offset, distance) in self.neighbors(i, row) {
            let weight = match j.checked_sub(self.n_moving) {
                None => self.rest.volume * (lambdas[i] + lambdas[j] + self.rest.tensile(distance)),
                Some(of_boundary) => self.boundary[of_boundary] * lambdas[i],
            };
            sum += weight * self.rest.gradient(offset, distance);
        }
        sum
    }
}

impl AtRest {
    /// Density of a particle with these sums, in parts of that at rest.
    fn filling(&self, sums: &Constraint) -> f64 {
        sums.values + self.volume * self.value(0.0)
    }

    fn lambda(&self, sums: &Constraint) -> f64 {
        let compression = (self.filling(sums) - 1.0).max(0.0);
        -compression / (sums.squares + sums.gradient.length_squared() + self.relaxation)
    }
}

impl CpuPbf {
    /// The rounds: moves particles until they are nowhere too dense, or as often as may be. Densities are those at the end.
    fn solve(
        &self,
        state: &mut State,
        around: &Neighborhood,
        searched: &[DVec3],
        boundary: &[f64],
    ) -> Result<StepDone> {
        let (n, rest) = (state.n_moving(), &self.rest);
        let mut done = StepDone::default();
        loop {
            let rounds = Rounds { rest, n_moving: n, positions: &state.positions, searched, boundary };
            let mut sums = around.fold(|i, row, sums| if i < n { rounds.constraint(i, row, sums) } else { sums })?;
            sums.truncate(n);
            done.density_error = density_error(sums.iter().map(|sums| rest.filling(sums)));
            let is_enough =
                done.iterations >= self.settings.iterations && done.density_error[0] <= self.settings.tolerance;
            if is_enough || done.iterations == self.settings.most_iterations {
                done.neighbors = sums.iter().map(|sums| u64::from(sums.neighbors)).sum();
                state.densities = sums.iter().map(|sums| rest.rest_density * rest.filling(sums)).collect();
                return Ok(done);
            }
            let lambdas: Vec<f64> = sums.iter().map(|sums| rest.lambda(sums)).collect();
            let ways =
                around.fold(|i, row, sum| if i < n { rounds.displacement(&lambdas, i, row, sum) } else { sum })?;
            let moving = state.positions[..n].par_iter_mut().zip(&ways).with_min_len(TASK);
            moving.for_each(|(position, way)| *position = self.keep_inside(*position + *way));
            done.iterations += 1;
        }
    }
}

impl CpuModel for CpuPbf {
    fn step(&mut self, state: &mut State, around: &mut Neighborhood, step: f64) -> Result<StepDone> {
        self.predict(state, step);
        around.follow(&state.positions)?;
        if self.boundary.is_none() {
            self.boundary = Some(boundary_volumes(&self.settings, &self.rest, self.dimensions, state, around)?);
        }
        let boundary = self.boundary.as_deref().unwrap_or_default();
        let searched = state.positions.clone();
        let done = self.solve(state, around, &searched, boundary)?;
        let State { positions, velocities, densities, .. } = state;
        // (x* − x) / Δt, of which the prediction has given v already: only what the rounds have added is divided, so a particle that
        // nothing touches keeps its velocity to the bit, however short the step.
        let moved = velocities.par_iter_mut().zip(&*positions).zip(&searched).with_min_len(TASK);
        moved.for_each(|((velocity, position), from)| *velocity += (*position - *from) / step);
        let rounds = Rounds { rest: &self.rest, n_moving: velocities.len(), positions, searched: &searched, boundary };
        if self.settings.vorticity > 0.0 {
            let pushes = rounds.confine_vorticity(around, velocities, densities)?;
            add(velocities, self.settings.vorticity * step, &pushes);
        }
        if self.settings.xsph > 0.0 {
            let differences = rounds.average_velocities(around, velocities, densities)?;
            add(velocities, self.settings.xsph, &differences);
        }
        Ok(StepDone { step, ..done })
    }

    /// The step in which the fastest particle, as it falls, moves by 0.4 of its diameter at most.
    fn stable_step(&self, state: &State) -> f64 {
        let speed = state.velocities.iter().map(|velocity| velocity.length_squared()).fold(0.0, f64::max).sqrt();
        let [way, falling] = self.signals;
        way / (falling + speed)
    }
}

fn add(velocities: &mut [DVec3], factor: f64, changes: &[DVec3]) {
    velocities.iter_mut().zip(changes).for_each(|(velocity, change)| *velocity += factor * *change);
}
