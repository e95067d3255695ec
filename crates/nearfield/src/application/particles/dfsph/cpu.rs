//! A step of incompressible fluids on the CPU.

use glam::DVec3;
use rayon::prelude::*;

use super::{DfsphSettings, fewest_neighbors, longest_step};
use crate::Result;
use crate::application::particles::cpu::{CpuModel, StepDone};
use crate::application::particles::fluid::{Lattice, Weights, density_error, masses};
use crate::application::particles::neighborhood::{Neighborhood, Row};
use crate::application::particles::state::State;
use crate::application::particles::{Dimensions, ParticleScene};

/// Particles of a task.
const TASK: usize = 1 << 10;
/// Iterations of the solver for densities, at least.
const FEWEST_ITERATIONS: u32 = 2;
/// Σ|∇C|² in parts of 1 / support² below which a particle is not pressed: nothing near it could give way.
const LEAST_STIFFNESS: f64 = 1e-6;
/// Part of the last step's pressures that a step starts from. Pressures that alternate from particle to particle are answered by hardly any
/// compression, and would stay: in a column of a hundred layers 0.9 leaves three fifths of the speeds that 1 leaves, at a third more iterations.
const KEPT: f64 = 0.9;
/// Filling below which a particle starts from no pressure: it lies in spray or at a surface.
const THINNEST: f64 = 0.9;
/// Most of p Δt² / ρ that a step starts from, in supports squared.
const LARGEST_START: f64 = 0.25;
/// Part of an iteration's change of pressure that the next one repeats (Polyak1964). In a column of a hundred layers 0.8 takes less than half of
/// the iterations that 0 takes.
const MOMENTUM: f64 = 0.8;

/// Incompressible fluids on the CPU.
pub(in crate::application::particles) struct CpuDfsph {
    settings: DfsphSettings,
    weights: Weights,
    dimensions: Dimensions,
    lattice: Lattice,
    gravity: DVec3,
    /// The longest stable step, however slow particles are.
    longest_step: f64,
    /// Neighbours below which a particle lies at a surface, where divergence is not corrected.
    fewest_neighbors: u32,
    /// `[b]` volumes of the boundary, which the first step finds.
    boundary: Option<Vec<f64>>,
}

/// How a particle is packed.
#[derive(Debug, Clone, Copy, Default)]
struct Packing {
    /// Σ V W without the particle itself; with it the density in parts of that at rest.
    filling: f64,
    gradient: DVec3,
    squares: f64,
    neighbors: u32,
}

/// What the solvers know of all particles while these stand still.
struct Solver<'a> {
    model: &'a CpuDfsph,
    around: &'a Neighborhood,
    positions: &'a [DVec3],
    /// `[b]`
    boundary: &'a [f64],
    packings: Vec<Packing>,
    /// `[n]` 1 / (|Σ V ∇W|² + Σ |V ∇W|²), the factor α of Bender2017 in parts of the density.
    factors: Vec<f64>,
    step: f64,
}

/// How a solver ended.
struct Solved {
    iterations: u32,
    density_error: [f64; 2],
}

impl CpuDfsph {
    pub(in crate::application::particles) fn new(settings: &DfsphSettings, scene: &ParticleScene) -> Self {
        Self {
            settings: *settings,
            weights: Weights::new(&settings.fluid, settings.smoothing, scene),
            dimensions: scene.dimensions,
            lattice: Lattice::new(&settings.fluid, settings.smoothing, scene.dimensions),
            gravity: scene.gravity,
            longest_step: longest_step(&settings.fluid, scene),
            fewest_neighbors: fewest_neighbors(scene.dimensions),
            boundary: None,
        }
    }

    /// `[b]` volumes of the boundary: Akinci2012's masses in parts of the density at rest, by the factor of flat walls.
    fn boundary_volumes(&self, state: &State, around: &Neighborhood) -> Result<Vec<f64>> {
        let fluid = &self.settings.fluid;
        let masses = masses(fluid, self.settings.smoothing, self.dimensions, state, around)?;
        Ok(masses[state.n_moving()..].iter().map(|mass| self.lattice.wall_volume(mass / fluid.rest_density)).collect())
    }

    /// Volume of a neighbour.
    #[inline]
    fn volume(&self, boundary: &[f64], n: usize, j: usize) -> f64 {
        if j < n { self.lattice.volume } else { boundary[j - n] }
    }

    /// `[n]` densities in parts of that at rest.
    fn fillings(&self, state: &State, around: &Neighborhood, boundary: &[f64]) -> Result<Vec<f64>> {
        let (n, positions) = (state.n_moving(), &state.positions);
        let mut sums = around.fold(|i, row, sum: f64| {
            if i >= n {
                return sum;
            }
            let neighbors = self.weights.neighbors(positions, i, row);
            neighbors
                .fold(sum, |sum, (j, _, distance)| sum + self.volume(boundary, n, j) * self.weights.value(distance))
        })?;
        sums.truncate(n);
        sums.iter_mut().for_each(|sum| *sum += self.own_filling());
        Ok(sums)
    }

    /// What a particle adds to its own density.
    fn own_filling(&self) -> f64 {
        self.lattice.volume * self.weights.value(0.0)
    }
}

impl Packing {
    fn of(
        solver: &CpuDfsph,
        positions: &[DVec3],
        boundary: &[f64],
        n: usize,
        i: usize,
        row: Row<'_>,
        own: Self,
    ) -> Self {
        solver.weights.neighbors(positions, i, row).fold(own, |mut own, (j, offset, distance)| {
            let volume = solver.volume(boundary, n, j);
            let gradient = volume * solver.weights.slope(distance) * offset;
            own.filling += volume * solver.weights.value(distance);
            own.gradient += gradient;
            // Walls do not give way.
            own.squares += if j < n { gradient.length_squared() } else { 0.0 };
            own.neighbors += 1;
            own
        })
    }
}

impl<'a> Solver<'a> {
    fn new(
        model: &'a CpuDfsph,
        around: &'a Neighborhood,
        state: &'a State,
        boundary: &'a [f64],
        step: f64,
    ) -> Result<Self> {
        let (n, positions) = (state.n_moving(), state.positions.as_slice());
        let mut packings = around
            .fold(|i, row, own| if i < n { Packing::of(model, positions, boundary, n, i, row, own) } else { own })?;
        packings.truncate(n);
        let least = LEAST_STIFFNESS / model.settings.fluid.support.powi(2);
        let factor = |packing: &mut Packing| {
            packing.filling += model.own_filling();
            let stiffness = packing.gradient.length_squared() + packing.squares;
            if stiffness > least { stiffness.recip() } else { 0.0 }
        };
        let factors = packings.par_iter_mut().with_min_len(TASK).map(factor).collect();
        Ok(Self { model, around, positions, boundary, packings, factors, step })
    }

    fn n(&self) -> usize {
        self.packings.len()
    }

    /// `[n]` rates at which densities grow, in parts of that at rest.
    fn rates(&self, velocities: &[DVec3]) -> Result<Vec<f64>> {
        let (n, weights) = (self.n(), &self.model.weights);
        let mut rates = self.around.fold(|i, row, rate: f64| {
            if i >= n {
                return rate;
            }
            weights.neighbors(self.positions, i, row).fold(rate, |rate, (j, offset, distance)| {
                let relative = if j < n { velocities[i] - velocities[j] } else { velocities[i] };
                rate + self.model.volume(self.boundary, n, j) * weights.slope(distance) * relative.dot(offset)
            })
        })?;
        rates.truncate(n);
        Ok(rates)
    }

    /// Lets pressures push for the step.
    ///
    /// - `stiffness`: `[n]` κ / ρ of each, in parts of the density
    fn push(&self, stiffness: &[f64], velocities: &mut [DVec3]) -> Result<()> {
        let (n, weights) = (self.n(), &self.model.weights);
        let pushes = self.around.fold(|i, row, push: DVec3| {
            if i >= n {
                return push;
            }
            weights.neighbors(self.positions, i, row).fold(push, |push, (j, offset, distance)| {
                let both = if j < n { stiffness[i] + stiffness[j] } else { stiffness[i] };
                push + self.model.volume(self.boundary, n, j) * both * weights.slope(distance) * offset
            })
        })?;
        let moving = velocities.par_iter_mut().zip(&pushes).with_min_len(TASK);
        moving.for_each(|(velocity, push)| *velocity -= self.step * *push);
        Ok(())
    }

    /// `[n]` κ / ρ that a step starts from, given the last step's pressures; velocities are pushed by them.
    fn start(&self, pressures: &[f64], velocities: &mut [DVec3]) -> Result<Vec<f64>> {
        let fluid = &self.model.settings.fluid;
        if pressures.is_empty() {
            return Ok(vec![0.0; self.n()]);
        }
        let largest = LARGEST_START * (fluid.support / self.step).powi(2);
        let of_last = |(packing, pressure): (&Packing, &f64)| {
            let is_thin = packing.filling < THINNEST;
            if is_thin { 0.0 } else { (KEPT * pressure / fluid.rest_density).min(largest) }
        };
        let start: Vec<f64> = self.packings.par_iter().zip(pressures).with_min_len(TASK).map(of_last).collect();
        self.push(&start, velocities)?;
        Ok(start)
    }

    /// Takes compression over the step out of the velocities until its mean is small enough.
    ///
    /// - `pressures`: `[n]` κ / ρ that push already; at the end those of one more iteration. Without them compression is pushed away, but
    ///   nothing is taken back
    /// - `excess`: of a particle and the rate at which its density grows: what the step would add, in parts of the density at rest
    fn solve(
        &self,
        velocities: &mut [DVec3],
        mut pressures: Option<&mut [f64]>,
        excess: impl Fn(usize, f64) -> f64 + Sync,
        tolerance: f64,
        fewest: u32,
    ) -> Result<Solved> {
        let by_step2 = self.model.lattice.relaxation / (self.step * self.step);
        let mut changes = vec![0.0; self.n()];
        let mut iterations = 0;
        loop {
            let rates = self.rates(velocities)?;
            let excesses: Vec<f64> = rates.par_iter().enumerate().map(|(i, &rate)| excess(i, rate)).collect();
            let density_error = density_error(excesses.iter().map(|excess| 1.0 + excess));
            let answers = excesses.par_iter().zip(&self.factors).map(|(excess, factor)| excess * factor * by_step2);
            let answered = changes.par_iter_mut().zip(answers).with_min_len(TASK);
            match pressures.as_deref_mut() {
                Some(pressures) => answered.zip(pressures).for_each(|((change, answer), pressure)| {
                    let before = *pressure;
                    *pressure = (before + answer + MOMENTUM * *change).max(0.0);
                    *change = *pressure - before;
                }),
                None => answered.for_each(|(change, answer)| *change = answer.max(0.0)),
            }
            let is_done = iterations >= fewest && density_error[0] <= tolerance;
            if is_done || iterations == self.model.settings.most_iterations {
                return Ok(Solved { iterations, density_error });
            }
            self.push(&changes, velocities)?;
            iterations += 1;
        }
    }

    /// Gravity and viscosity.
    fn accelerate(&self, velocities: &mut [DVec3]) -> Result<()> {
        let (n, weights, settings) = (self.n(), &self.model.weights, &self.model.settings);
        if settings.viscosity > 0.0 || settings.xsph > 0.0 {
            let before = &*velocities;
            let changes = self.around.fold(|i, row, change: DVec3| {
                if i >= n {
                    return change;
                }
                weights.neighbors(self.positions, i, row).fold(change, |change, (j, _, distance)| {
                    let volume = self.model.volume(self.boundary, n, j);
                    let relative = if j < n { before[i] - before[j] } else { before[i] };
                    let laminar = 2.0 * settings.viscosity * weights.slope(distance) * self.step;
                    // Walls do not drag by XSPH, which is no force.
                    let average = if j < n { settings.xsph * weights.value(distance) } else { 0.0 };
                    change + volume * (laminar - average) * relative
                })
            })?;
            velocities.iter_mut().zip(&changes).for_each(|(velocity, change)| *velocity += *change);
        }
        velocities.iter_mut().for_each(|velocity| *velocity += self.step * self.model.gravity);
        Ok(())
    }
}

impl CpuModel for CpuDfsph {
    fn step(&mut self, state: &mut State, around: &mut Neighborhood, step: f64) -> Result<StepDone> {
        let n = state.n_moving();
        around.follow(&state.positions)?;
        if self.boundary.is_none() {
            self.boundary = Some(self.boundary_volumes(state, around)?);
        }
        let boundary = self.boundary.as_deref().unwrap_or_default();
        let mut velocities = state.velocities.clone();
        let solver = Solver::new(self, around, state, boundary, step)?;
        let packings = &solver.packings;
        let settings = &self.settings;
        let diverges = |i: usize, rate: f64| {
            let is_inside = packings[i].neighbors >= self.fewest_neighbors;
            if is_inside { step * rate } else { 0.0 }
        };
        let divergence = solver.solve(&mut velocities, None, diverges, settings.divergence_tolerance, 1)?;
        solver.accelerate(&mut velocities)?;
        let mut pressures = solver.start(&state.pressures, &mut velocities)?;
        let is_dense = |i: usize, rate: f64| packings[i].filling + step * rate - 1.0;
        let (tolerance, fewest) = (settings.density_tolerance, FEWEST_ITERATIONS);
        let density = solver.solve(&mut velocities, Some(&mut pressures), is_dense, tolerance, fewest)?;
        let neighbors = packings.iter().map(|packing| u64::from(packing.neighbors)).sum();

        let images = self.weights.images();
        let moving = state.positions[..n].par_iter_mut().zip(&velocities).with_min_len(TASK);
        moving.for_each(|(position, velocity)| *position = images.wrap(*position + step * *velocity));
        state.velocities = velocities;
        state.pressures = pressures.iter().map(|pressure| pressure * settings.fluid.rest_density).collect();
        around.follow(&state.positions)?;
        let fillings = self.fillings(state, around, boundary)?;
        state.densities = fillings.iter().map(|filling| filling * settings.fluid.rest_density).collect();
        let iterations = divergence.iterations + density.iterations;
        Ok(StepDone { step, neighbors, iterations, density_error: density.density_error })
    }

    /// The step in which the fastest particle, going on with gravity along its way, moves by its diameter, or half of that in which laminar
    /// viscosity spreads over half a support; in which √(p / ρ) at the foot of the fluid leads as far, if that is shorter.
    fn stable_step(&self, state: &State) -> f64 {
        let settings = &self.settings;
        let speed2 = state.velocities.iter().map(|velocity| velocity.length_squared()).fold(0.0, f64::max);
        let way = settings.fluid.spacing;
        // The positive root of g t² + v t = way, in the form that holds without gravity too.
        let moved = 2.0 * way / (speed2.sqrt() + (speed2 + 4.0 * self.gravity.length() * way).sqrt());
        let length = 0.5 * settings.fluid.support;
        moved.min(0.5 * length * length / settings.viscosity).min(self.longest_step)
    }
}
