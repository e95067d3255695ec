//! A scene, and the rows of the ways to simulate it.

use nearfield::application::particles::{BuiltinOptions, ParticleScene, ParticleSearch, builtin_scene};

use super::check::{self, Reference};
use super::original;
use super::timing::{self, Timed};
use super::ways::{Way, devices};
use crate::Result;
use crate::paper::lab::Lab;
use crate::paper::rows::{Row, Sheet};

/// Fewest steps of a run.
const FEWEST_STEPS: f64 = 10.0;
/// Share of a row's time that its timed steps may take; the rest is for checks, warm-up and copies.
const TIMED_SHARE: f64 = 0.6;

/// What is measured: the row's words and the scene.
pub struct Case {
    /// The start.
    pub scene: ParticleScene,
    /// Particles in the paper.
    pub paper_particles: usize,
    /// What else was varied.
    pub setting: String,
    /// A radius by the domain's diagonal; 0 where the paper names none.
    pub r_over_l: f64,
    /// Steps of a whole run.
    pub steps: u32,
}

/// What the rows of a case on one device share.
#[derive(Default)]
pub struct Shared {
    /// From the start of the scene.
    early: Option<Reference>,
    /// From where the first run has ended.
    late: Option<(ParticleScene, Reference)>,
    first: Option<Timed>,
}

/// Share of the budget that a row may take at most, where the same search has rows to come: with a larger one they would be left out.
const LARGEST_SHARE: f64 = 0.06;

/// Shares what is left of the budget among the rows that are still to come.
pub struct Pace<'a> {
    lab: &'a Lab,
    rows: usize,
    largest_share: f64,
}

impl<'a> Pace<'a> {
    /// Of an experiment with so many rows, some of them of one search.
    pub fn new(lab: &'a Lab, rows: usize) -> Self {
        Self { lab, rows, largest_share: LARGEST_SHARE }
    }

    /// Of an experiment in which each row is of another search.
    pub fn of_searches(lab: &'a Lab, rows: usize) -> Self {
        Self { lab, rows, largest_share: 1.0 }
    }

    /// Seconds of the next row.
    pub fn next_share(&mut self) -> f64 {
        let seconds = self.lab.left().max(0.0) / self.rows.max(1) as f64;
        self.rows = self.rows.saturating_sub(1);
        seconds.min(self.largest_share * self.lab.budget)
    }
}

/// Steps of a run for the paper's.
pub fn steps(lab: &Lab, paper_steps: u32) -> u32 {
    (f64::from(paper_steps) * lab.scale.min(1.0)).round().max(FEWEST_STEPS) as u32
}

/// A built-in scene with about so many particles.
///
/// # Errors
/// As [`builtin_scene`].
pub fn scene(name: &str, particles: usize) -> Result<ParticleScene> {
    let particles = u32::try_from(particles)?;
    Ok(builtin_scene(name, &BuiltinOptions { particles: Some(particles), ..BuiltinOptions::default() })?)
}

/// The paper's numbers of particles that differ at this scale; where several are the same, the largest stands for all.
pub fn sizes(lab: &Lab, paper_particles: &[usize]) -> Vec<usize> {
    let mut sizes: Vec<usize> = Vec::new();
    for &n in paper_particles {
        if sizes.last().is_some_and(|&last| lab.points(last) == lab.points(n)) {
            sizes.pop();
        }
        sizes.push(n);
    }
    sizes
}

impl Case {
    /// A row without a value, in steps a second.
    pub fn row(&self, lab: &Lab, on_gpu: bool, method: String) -> Row {
        Row {
            device: lab.device(on_gpu),
            paper_points: self.paper_particles,
            points: self.scene.particles.len(),
            dimension: self.scene.dimensions.number() as usize,
            setting: self.setting.clone(),
            r_over_l: self.r_over_l,
            radius: self.scene.model.largest_reach(),
            mean_neighbors: None,
            method,
            quantity: "steps a second",
            unit: "steps/s",
            value: None,
            device_milliseconds: None,
            paper: None,
            recall: None,
            runs: 0,
            note: String::new(),
        }
    }

    /// Checks one way against the others from the start of the scene, times its run, and checks it from where the first way's run ended.
    ///
    /// # Errors
    /// As the simulation; a wrong answer.
    pub fn time(&self, lab: &Lab, way: Way, seconds: f64, shared: &mut Shared) -> Result<(Row, Timed)> {
        let scene = &self.scene;
        // What a way refuses it refuses before the reference is made for it.
        drop(way.open(lab, scene, true)?);
        if shared.early.is_none() {
            shared.early = Some(Reference::of(lab, scene, way.on_gpu)?);
        }
        let checked = shared.early.as_ref().map(|reference| reference.check(lab, scene, way)).transpose()?;
        let timed = timing::run(lab, way, scene, self.steps, TIMED_SHARE * seconds)?;
        check::sane(&timed.end)?;
        match &shared.first {
            Some(first) => check::close(scene, &timed, first)?,
            None => {
                let later = ParticleScene { particles: timed.particles.clone(), ..scene.clone() };
                let reference = Reference::of(lab, &later, way.on_gpu)?;
                shared.late = Some((later, reference));
                shared.first = Some(timed.clone());
            }
        }
        if let Some((later, reference)) = &shared.late {
            reference.check(lab, later, way)?;
        }
        let cut = if timed.steps < self.steps {
            format!("{} of {} steps in the time of a row", timed.steps, self.steps)
        } else {
            format!("{} steps", timed.steps)
        };
        let note = format!(
            "{cut}; {} rebuilds; {}, before and after the run; at the end energy {:.4e}, of which kinetic {:.4e}, momentum {:.2e}",
            timed.rebuilds,
            checked.unwrap_or_default(),
            timed.end.energy(),
            timed.end.kinetic_energy,
            timed.end.momentum.length()
        );
        let row = Row {
            mean_neighbors: Some(timed.mean_neighbors),
            runs: timed.steps as usize,
            value: Some(timed.rate()),
            note,
            ..self.row(lab, way.on_gpu, way.name())
        };
        Ok((row, timed))
    }

    /// Rows of the times of stages on the device, from where a run has ended.
    ///
    /// # Errors
    /// As the simulation.
    pub fn stages(&self, lab: &Lab, way: Way, row: &Row, timed: &Timed) -> Result<Vec<Row>> {
        let later = ParticleScene { particles: timed.particles.clone(), ..self.scene.clone() };
        let stages = timing::stages(lab, way, &later)?;
        let all = stages.iter().map(|(_, microseconds)| microseconds).sum();
        let names: Vec<&str> = stages.iter().map(|(name, _)| *name).collect();
        let note = format!("{}; the device's clock, median of steps after the run", names.join(", "));
        let mut rows = vec![row.of("stages of a step on the device", "us").value(all).note(note)];
        rows.extend(stages.iter().map(|(name, value)| row.of("stage", "us").value(*value).note(*name)));
        Ok(if stages.is_empty() { Vec::new() } else { rows })
    }
}

/// Rows of all cases by all searches, device after device; `finish` may add to a row.
///
/// # Errors
/// A wrong answer; what a simulation does not refuse but fails at; a file that cannot be written.
pub fn all(
    lab: &Lab,
    sheet: &mut Sheet<'_>,
    cases: &[Case],
    searches: &[ParticleSearch],
    mut finish: impl FnMut(&Case, Way, Row, &Timed) -> Result<Vec<Row>>,
) -> Result<()> {
    let mut pace = Pace::new(lab, devices(lab).len() * cases.len() * searches.len());
    for &on_gpu in devices(lab) {
        for case in cases {
            let mut shared = Shared::default();
            for &search in searches {
                let way = Way { search, on_gpu };
                let seconds = pace.next_share();
                sheet.attempt(case.row(lab, on_gpu, way.name()), || {
                    let (row, timed) = case.time(lab, way, seconds, &mut shared)?;
                    finish(case, way, row, &timed)
                })?;
            }
        }
    }
    Ok(())
}

/// Steps of a run as the paper makes them, at this scale.
pub fn paper_steps(lab: &Lab) -> u32 {
    steps(lab, original::STEPS)
}
