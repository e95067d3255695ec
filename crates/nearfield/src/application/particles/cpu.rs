//! A simulation on the CPU, in double precision.

use std::time::Instant;

use rayon::prelude::*;

use super::dem::CpuDem;
use super::dfsph::CpuDfsph;
use super::images::Images;
use super::neighborhood::Neighborhood;
use super::pbf::CpuPbf;
use super::reach::Reach;
use super::simulate::{same_order, same_particles};
use super::state::State;
use super::wcsph::CpuWcsph;
use super::{ParticleModel, ParticleScene, Particles, SearchTime, Simulate, SimulationSettings, StepReport, TimeStep};
use crate::application::Watch;
use crate::geometry::validate::MAX_COORDINATE;
use crate::{Error, Result};

/// What a model on the CPU does.
pub(super) trait CpuModel: Send + Sync {
    /// Makes one step. The structures follow the positions when the model says so.
    ///
    /// - `step`: how far it leads; a model with a rule for stability was asked before
    fn step(&mut self, state: &mut State, around: &mut Neighborhood, step: f64) -> Result<StepDone>;

    /// The longest stable step as the particles are now; infinite for models without such a rule.
    fn stable_step(&self, _state: &State) -> f64 {
        f64::INFINITY
    }
}

/// What a step has done.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StepDone {
    /// How far it led.
    pub(super) step: f64,
    /// Pairs that act on each other, both ways counted.
    pub(super) neighbors: u64,
    /// Iterations of solvers.
    pub(super) iterations: u32,
    /// Mean and largest compression of a fluid, in parts of its rest density.
    pub(super) density_error: [f64; 2],
}

/// A simulation on the CPU, in double precision.
pub struct Simulation {
    scene: ParticleScene,
    settings: SimulationSettings,
    state: State,
    /// What there was before the step that is under way.
    last_good: State,
    around: Neighborhood,
    model: Box<dyn CpuModel>,
    step: u64,
    time: f64,
    /// Of the finished steps of a call that is under way or has failed.
    reports: Vec<StepReport>,
}

impl Simulation {
    /// A simulation of the scene from its start.
    ///
    /// # Errors
    /// As [`ParticleScene::validate`] and [`SimulationSettings::validate`].
    pub fn new(scene: &ParticleScene, settings: &SimulationSettings) -> Result<Self> {
        scene.validate()?;
        settings.validate()?;
        let reach = Reach::of(&scene.model);
        let state = State::new(scene, reach.radii().len());
        let mut classes = state.classes.clone();
        if let Some(last) = classes.last_mut() {
            last.end = state.positions.len();
        }
        let images = Images::new(scene.domain, scene.periodic);
        let around = Neighborhood::new(settings.search, settings.deterministic, scene.domain, images, classes, reach);
        let model: Box<dyn CpuModel> = match &scene.model {
            ParticleModel::Dem(dem) => Box::new(CpuDem::new(dem, scene)),
            ParticleModel::Pbf(pbf) => Box::new(CpuPbf::new(pbf, scene)),
            ParticleModel::Wcsph(wcsph) => Box::new(CpuWcsph::new(wcsph, scene)),
            ParticleModel::Dfsph(dfsph) => Box::new(CpuDfsph::new(dfsph, scene)),
        };
        Ok(Self {
            scene: scene.clone(),
            settings: *settings,
            last_good: state.clone(),
            state,
            around,
            model,
            step: 0,
            time: 0.0,
            reports: Vec::new(),
        })
    }

    fn make_step(&mut self) -> Result<StepReport> {
        let every = u64::from(self.settings.reorder_every);
        if every > 0 && self.step.is_multiple_of(every) {
            self.state.reorder()?;
            self.around.forget();
        }
        self.last_good.clone_from(&self.state);
        let step = match self.scene.time_step {
            TimeStep::Fixed(step) => step,
            TimeStep::Cfl { factor, least, most } => (factor * self.model.stable_step(&self.state)).clamp(least, most),
        };
        let before = self.around.rebuilds();
        let done = self.model.step(&mut self.state, &mut self.around, step);
        // Where particles could not be searched, why is more than that.
        let done = self.check().and(done);
        let done = done.inspect_err(|_| {
            self.state.clone_from(&self.last_good);
            self.around.forget();
        })?;
        self.step += 1;
        self.time += done.step;
        let rebuilds = self.around.rebuilds() - before;
        let n = self.state.n_moving().max(1) as f64;
        Ok(StepReport {
            step: self.step,
            time: self.time,
            time_step: done.step,
            mean_neighbors: done.neighbors as f64 / n,
            iterations: done.iterations,
            density_error: done.density_error,
            rebuilds: rebuilds as u32,
        })
    }

    /// Whether all particles are where they can be, and slow enough.
    fn check(&self) -> Result<()> {
        let limit2 = self.settings.max_speed * self.settings.max_speed;
        let is_bad = |&i: &usize| {
            let (position, velocity) = (self.state.positions[i], self.state.velocities[i]);
            let density = self.state.densities.get(i).copied().unwrap_or(1.0);
            let is_near = position.abs().max_element() <= f64::from(MAX_COORDINATE);
            let is_fluid = density > 0.0 && density.is_finite();
            !(is_near && velocity.is_finite() && velocity.length_squared() <= limit2 && is_fluid)
        };
        let Some(place) = (0..self.state.n_moving()).into_par_iter().filter(is_bad).min_by_key(|&i| self.state.ids[i])
        else {
            return Ok(());
        };
        Err(Error::BlowUp {
            step: self.step + 1,
            particle: self.state.ids[place].into(),
            position: self.state.positions[place].to_array(),
            speed: self.state.velocities[place].length(),
            limit: self.settings.max_speed,
        })
    }
}

impl Simulate for Simulation {
    fn scene(&self) -> &ParticleScene {
        &self.scene
    }

    fn device(&self) -> String {
        format!("cpu ({} threads)", rayon::current_num_threads())
    }

    fn advance(&mut self, steps: u32, watch: &mut Watch<'_>) -> Result<Vec<StepReport>> {
        self.reports.clear();
        for done in 0..steps {
            watch.report("simulating", done.into(), steps.into())?;
            let report = self.make_step()?;
            self.reports.push(report);
        }
        Ok(self.take_reports())
    }

    fn take_reports(&mut self) -> Vec<StepReport> {
        std::mem::take(&mut self.reports)
    }

    fn time_search(&mut self) -> Result<SearchTime> {
        let start = Instant::now();
        let counted = self.around.count(&self.state.positions, self.state.n_moving());
        // The next step does not go on from what was left half done.
        let neighbors = counted.inspect_err(|_| self.around.forget())?;
        Ok(SearchTime { seconds: start.elapsed().as_secs_f64(), neighbors })
    }

    fn step(&self) -> u64 {
        self.step
    }

    fn time(&self) -> f64 {
        self.time
    }

    fn particles(&self) -> Result<Particles> {
        Ok(self.state.particles())
    }

    fn resume(&mut self, particles: &Particles, step: u64, time: f64) -> Result<()> {
        let order: Vec<u32> = (0..particles.len() as u32).collect();
        self.resume_in_order(particles, &order, step, time)
    }

    fn order(&self) -> Result<Vec<u32>> {
        Ok(self.state.ids.clone())
    }

    fn resume_in_order(&mut self, particles: &Particles, order: &[u32], step: u64, time: f64) -> Result<()> {
        let mut scene = self.scene.clone();
        scene.particles.clone_from(particles);
        scene.validate_under_way()?;
        same_particles(&self.scene.particles, particles)?;
        same_order(order, particles.len())?;
        self.state = State::in_order(&scene, self.state.classes.len(), order.to_vec());
        self.last_good.clone_from(&self.state);
        self.around.forget();
        self.reports.clear();
        (self.step, self.time) = (step, time);
        Ok(())
    }
}
