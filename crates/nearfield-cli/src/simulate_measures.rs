//! Numbers of a simulation, a row a frame, and one of the last sound step where it ends early: `measures.csv`.

use std::io::{self, Write};

use nearfield::application::particles::{Measures, Particles, Simulate, StepReport};

use crate::exit::Failure;
use crate::simulate_folder::Folder;
use crate::simulate_scene::frame_at;

/// Names of the columns.
const COLUMNS: &str = "step,time,time_step,kinetic_energy,potential_energy,momentum_x,momentum_y,momentum_z,max_speed,\
                       mean_neighbors,iterations,mean_compression,max_compression,outside,rebuilds,steps_per_second";

/// What is known of the particles at a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Row {
    pub(crate) measures: Measures,
    pub(crate) last: StepReport,
    step: u64,
    time: f64,
    rebuilds: u64,
}

/// Everything that was measured.
#[derive(Debug, Default)]
pub(crate) struct Measured {
    /// Rows of the file before this run.
    earlier: Vec<String>,
    rows: Vec<String>,
    first: Option<Row>,
    latest: Option<Row>,
    last_frame: u64,
    steps: u64,
    neighbors: f64,
    iterations: u64,
    rebuilds: u64,
    worst: [f64; 2],
    /// Steps and seconds at the last frame.
    at_frame: (u64, f64),
}

impl Row {
    pub(crate) fn of(simulation: &dyn Simulate, particles: &Particles, last: StepReport, rebuilds: u64) -> Self {
        let measures = Measures::of(simulation.scene(), particles);
        Self { measures, last, step: simulation.step(), time: simulation.time(), rebuilds }
    }

    fn line(&self, steps_a_second: f64) -> String {
        let (measures, last) = (&self.measures, &self.last);
        let numbers = [
            self.time,
            last.time_step,
            measures.kinetic_energy,
            measures.potential_energy,
            measures.momentum.x,
            measures.momentum.y,
            measures.momentum.z,
            measures.max_speed,
            last.mean_neighbors,
        ];
        let numbers: Vec<String> = numbers.iter().map(|number| format!("{number:e}")).collect();
        let [mean, max] = last.density_error;
        let (step, iterations, outside, rebuilds) = (self.step, last.iterations, measures.outside, self.rebuilds);
        let numbers = numbers.join(",");
        format!("{step},{numbers},{iterations},{mean:e},{max:e},{outside},{rebuilds},{steps_a_second:.3}")
    }
}

impl Measured {
    /// Nothing so far; where a simulation goes on, the rows of its file up to there.
    pub(crate) fn start(folder: &Folder, simulation: &dyn Simulate, goes_on: bool, rate: f64) -> Result<Self, Failure> {
        let mut measured = Self { last_frame: frame_at(simulation.time(), rate), ..Self::default() };
        let path = folder.measures();
        if goes_on && path.exists() {
            let io = |source| Failure::Read(path.clone(), nearfield::Error::Io { path: path.clone(), source });
            let text = std::fs::read_to_string(&path).map_err(io)?;
            let is_before = |line: &&str| {
                let step = line.split(',').next().and_then(|step| step.parse::<u64>().ok());
                step.is_some_and(|step| step <= simulation.step())
            };
            measured.earlier = text.lines().filter(is_before).map(str::to_owned).collect();
        }
        let particles = simulation.particles().map_err(Failure::Search)?;
        measured.first = Some(Row::of(simulation, &particles, StepReport::default(), 0));
        measured.latest = measured.first;
        Ok(measured)
    }

    /// Counts steps.
    pub(crate) fn count(&mut self, reports: &[StepReport]) {
        for report in reports {
            self.steps += 1;
            self.neighbors += report.mean_neighbors;
            self.iterations += u64::from(report.iterations);
            self.rebuilds += u64::from(report.rebuilds);
            self.worst = [0, 1].map(|i| self.worst[i].max(report.density_error[i]));
        }
    }

    /// A row more, after so many seconds of steps.
    pub(crate) fn push(&mut self, row: Row, frame: u64, seconds: f64) {
        let (steps, before) = self.at_frame;
        let speed = if seconds > before { (self.steps - steps) as f64 / (seconds - before) } else { 0.0 };
        self.rows.push(row.line(speed));
        (self.latest, self.last_frame, self.at_frame) = (Some(row), frame, (self.steps, seconds));
    }

    /// The file.
    pub(crate) fn write(&self, w: &mut dyn Write) -> io::Result<()> {
        writeln!(w, "{COLUMNS}")?;
        self.earlier.iter().chain(&self.rows).try_for_each(|row| writeln!(w, "{row}"))
    }

    /// At the start and at the last frame.
    pub(crate) fn ends(&self) -> Option<[Row; 2]> {
        Some([self.first?, self.latest?])
    }

    pub(crate) fn frames(&self) -> u64 {
        self.rows.len() as u64
    }

    pub(crate) fn last_frame(&self) -> u64 {
        self.last_frame
    }

    pub(crate) fn steps(&self) -> u64 {
        self.steps
    }

    pub(crate) fn rebuilds(&self) -> u64 {
        self.rebuilds
    }

    pub(crate) fn steps_a_second(&self, seconds: f64) -> f64 {
        if seconds > 0.0 { self.steps as f64 / seconds } else { 0.0 }
    }

    /// Means over the steps.
    pub(crate) fn mean_neighbors(&self) -> f64 {
        self.neighbors / self.steps.max(1) as f64
    }

    pub(crate) fn mean_iterations(&self) -> f64 {
        self.iterations as f64 / self.steps.max(1) as f64
    }

    /// The largest mean and the largest compression of all steps.
    pub(crate) fn worst_compression(&self) -> [f64; 2] {
        self.worst
    }
}

impl Row {
    pub(crate) fn step(&self) -> u64 {
        self.step
    }

    pub(crate) fn time(&self) -> f64 {
        self.time
    }
}
