//! What a simulation did, as lines for people and as one JSON object for programs.

use std::path::Path;

use nearfield::application::particles::{Measures, ParticleScene, SimulationSettings};
use serde_json::{Value, json};

use crate::exit::Failure;
use crate::options::Common;
use crate::report::{self, grouped, rounded, short};
use crate::simulate_measures::Measured;

/// Everything worth telling.
pub(crate) struct Told<'a> {
    pub(crate) scene: &'a ParticleScene,
    pub(crate) settings: &'a SimulationSettings,
    pub(crate) device: String,
    pub(crate) measured: &'a Measured,
    /// Seconds that steps took, and pictures.
    pub(crate) seconds: f64,
    pub(crate) picture_seconds: f64,
    pub(crate) output: &'a Path,
    pub(crate) video: bool,
    pub(crate) notes: Vec<String>,
}

impl Told<'_> {
    pub(crate) fn tell(&self, json: bool, common: &Common) -> Result<(), Failure> {
        if json {
            return report::print_json(&self.json());
        }
        if common.quiet {
            return Ok(());
        }
        report::print(&self.lines())
    }

    fn json(&self) -> Value {
        let measured = self.measured;
        let [mean, max] = measured.worst_compression();
        let ends = measured.ends();
        let of = |m: &Measures| {
            json!({
                "kinetic_energy": m.kinetic_energy,
                "potential_energy": m.potential_energy,
                "momentum": m.momentum.to_array(),
                "max_speed": m.max_speed,
                "mean_position": m.mean_position.to_array(),
                "outside": m.outside,
            })
        };
        json!({
            "scene": self.scene.name,
            "model": self.scene.model.name(),
            "dimensions": self.scene.dimensions.number(),
            "particles": self.scene.particles.len(),
            "boundary": self.scene.boundary.len(),
            "device": self.device,
            "search": self.settings.search.to_string(),
            "deterministic": self.settings.deterministic,
            "step": ends.map(|[_, last]| last.step()),
            "time": ends.map(|[_, last]| last.time()),
            "steps": measured.steps(),
            "frames": measured.frames(),
            "seconds": rounded(self.seconds),
            "picture_seconds": rounded(self.picture_seconds),
            "steps_per_second": measured.steps_a_second(self.seconds),
            "mean_neighbors": measured.mean_neighbors(),
            "mean_iterations": measured.mean_iterations(),
            "mean_compression_worst": mean,
            "max_compression_worst": max,
            "rebuilds": measured.rebuilds(),
            "start": ends.map(|[first, _]| of(&first.measures)),
            "end": ends.map(|[_, last]| of(&last.measures)),
            "output": self.output.display().to_string(),
            "notes": self.notes,
        })
    }

    fn lines(&self) -> String {
        let (measured, scene) = (self.measured, self.scene);
        let few = |value: f64| format!("{}{}", if value < 0.0 { "-" } else { "" }, short(value.abs() as f32, 4));
        let boundary = match scene.boundary.len() {
            0 => String::new(),
            n => format!(" and {} of walls", grouped(n as u64)),
        };
        let n = grouped(scene.particles.len() as u64);
        let mut rows = vec![("scene", format!("{}, {}, {n} particles{boundary}", scene.name, scene.model.name()))];
        let speed = measured.steps_a_second(self.seconds);
        rows.extend([
            ("device", format!("{}, neighbours by {}", self.device, self.settings.search)),
            ("steps", format!("{} in {} s, {} a second", grouped(measured.steps()), few(self.seconds), few(speed))),
            (
                "neighbours",
                format!("{} on average, {} rebuilds", few(measured.mean_neighbors()), grouped(measured.rebuilds())),
            ),
        ]);
        if scene.model.is_fluid() {
            let [mean, max] = measured.worst_compression().map(|part| few(100.0 * part));
            let iterations = few(measured.mean_iterations());
            rows.push((
                "compression",
                format!("mean at most {mean} %, of a particle at most {max} %, {iterations} iterations a step"),
            ));
        }
        if let Some([first, last]) = measured.ends() {
            let (from, to) = (&first.measures, &last.measures);
            rows.push(("time", format!("{} to {}", few(first.time()), few(last.time()))));
            let kinetic = format!("kinetic {} to {}", few(from.kinetic_energy), few(to.kinetic_energy));
            let potential = format!("potential {} to {}", few(from.potential_energy), few(to.potential_energy));
            let change = few(to.energy() - from.energy());
            rows.push(("energy", format!("{kinetic}, {potential}, together {change} more")));
            let vector = |v: [f64; 3]| v.map(few).join(" ");
            let momentum = format!("{} to {}", vector(from.momentum.to_array()), vector(to.momentum.to_array()));
            rows.push(("momentum", momentum));
            rows.push(("outside", format!("{} particles at the end", grouped(to.outside))));
        }
        let film = if self.video { ", film.png" } else { "" };
        let frames = grouped(measured.frames());
        let took = few(self.picture_seconds);
        rows.push((
            "written",
            format!("{frames} frames in {took} s, measures.csv, checkpoint.npz{film} in {}", self.output.display()),
        ));
        rows.extend(self.notes.iter().map(|note| ("note", note.clone())));
        rows.iter().map(|(name, value)| format!("{name:<13}{value}\n")).collect()
    }
}
