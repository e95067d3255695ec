//! What the experiments share: devices, scale, budget, folder, and the points they begin with.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::time::Instant;

use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, Gpu};
use nearfield::{Aabb, Vec3};

use super::Arguments;
use super::rows::Row;
use crate::measure::Effort;
use crate::provenance::{COMMIT, Device, Machine, processor};
use crate::sets::SEED;
use crate::{Error, Result};

/// The points fill a cube from -1 to 1, as the paper's; its diagonal is the paper's L.
pub const L: f64 = 2.0 * 1.732_050_807_568_877_2;
/// No experiment has fewer points: below, trees have too few levels to show anything.
const FEWEST: usize = 2000;

/// The name of an experiment, as the command line takes it.
///
/// # Errors
/// Says which names there are.
pub fn one_of(names: &[&str], text: &str) -> std::result::Result<String, String> {
    if names.contains(&text) { Ok(text.to_owned()) } else { Err(format!("expected one of {}", names.join(", "))) }
}

/// Devices, scale, budget and folder.
pub struct Lab {
    gpu: Option<Machine>,
    /// All threads of the host.
    pub cpu: Machine,
    /// Numbers of points are the paper's times this.
    pub scale: f64,
    /// Seconds of an experiment.
    pub budget: f64,
    begin: Cell<Instant>,
    folder: PathBuf,
}

impl Lab {
    /// Opens the devices and makes the folder.
    ///
    /// # Errors
    /// `NoDevice`; a scale or budget that is not positive; a folder that cannot be made.
    pub fn open(arguments: &Arguments) -> Result<Self> {
        let Arguments { device, scale, budget, output, .. } = arguments;
        Self::new(device, *scale, *budget, output)
    }

    /// As [`Lab::open`], for experiments of other modules.
    ///
    /// # Errors
    /// As [`Lab::open`].
    pub fn new(device: &DeviceChoice, scale: f64, budget: f64, output: &Path) -> Result<Self> {
        if !(scale > 0.0 && scale <= 100.0) {
            return Err(format!("--scale {scale} is not usable: expected above 0 and at most 100").into());
        }
        if budget.is_nan() || budget < 0.0 {
            return Err(format!("--budget {budget} is not usable: expected seconds, 0 or more").into());
        }
        std::fs::create_dir_all(output).map_err(|error| Error::from(format!("{}: {error}", output.display())))?;
        let chosen = Machine::open(device)?;
        Ok(Self {
            gpu: matches!(chosen.device, Device::Gpu(_)).then_some(chosen),
            cpu: Machine::open(&DeviceChoice::Cpu)?,
            scale,
            budget,
            begin: Cell::new(Instant::now()),
            folder: output.to_path_buf(),
        })
    }

    /// Around a device that is open, for those who write no files: of the paper's numbers times `scale`, within so many seconds.
    ///
    /// # Errors
    /// What opening the CPU returns.
    pub(crate) fn around(machine: &Machine, scale: f64, budget: f64) -> Result<Self> {
        Ok(Self {
            gpu: matches!(machine.device, Device::Gpu(_)).then(|| machine.clone()),
            cpu: Machine::open(&DeviceChoice::Cpu)?,
            scale,
            budget,
            begin: Cell::new(Instant::now()),
            folder: PathBuf::new(),
        })
    }

    /// A file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The GPU, where one is measured.
    pub fn gpu(&self) -> Option<&Gpu> {
        match &self.gpu.as_ref()?.device {
            Device::Gpu(gpu) => Some(gpu),
            Device::Cpu => None,
        }
    }

    /// Name of the GPU, or of the CPU.
    pub fn device(&self, on_gpu: bool) -> String {
        let machine = if on_gpu { self.gpu.as_ref().unwrap_or(&self.cpu) } else { &self.cpu };
        machine.name.clone()
    }

    /// Lets the budget begin anew.
    pub fn begin_experiment(&self) {
        self.begin.set(Instant::now());
    }

    /// Whether the budget of the experiment is spent.
    pub fn is_over(&self) -> bool {
        self.left() <= 0.0
    }

    /// Seconds that the experiment has left.
    pub fn left(&self) -> f64 {
        self.budget - self.begin.get().elapsed().as_secs_f64()
    }

    /// How often something short is timed.
    pub fn effort(&self) -> Effort {
        let on_hardware = self.gpu.as_ref().is_some_and(Machine::is_hardware_gpu);
        let seconds = (self.budget / 40.0).clamp(0.0, 2.0);
        Effort { warm_up: if on_hardware { 0.3 } else { 0.0 }, runs: 15, seconds }
    }

    /// Seconds that one method may take for the steps of one point of a chart; at least one step is made.
    pub fn seconds_a_point(&self, points_of_chart: usize) -> f64 {
        self.budget / points_of_chart.max(1) as f64
    }

    /// Number of points for the paper's number.
    pub fn points(&self, paper_points: usize) -> usize {
        ((paper_points as f64 * self.scale).round() as usize).max(FEWEST)
    }

    /// Lines under a plot, and over the summary.
    pub fn caption(&self) -> Vec<String> {
        let gpu = self.gpu.as_ref().map_or("none".to_owned(), |gpu| format!("{} ({})", gpu.name, gpu.driver));
        vec![
            format!("GPU: {gpu}. CPU: {}, {}", processor(), self.cpu.name),
            format!(
                "Nearfield commit {COMMIT}, scale {}. Crosses: Xing2017 on its GTX 660 Ti, at its numbers of points.",
                self.scale
            ),
        ]
    }
}

/// Points where an experiment begins.
pub struct Spot {
    /// Number of points in the paper.
    pub paper_points: usize,
    /// Uniform in the cube.
    pub points: Vec<Vec3>,
    /// By how much lengths are longer than the paper's, so that a ball holds as many points.
    pub stretch: f64,
}

impl Spot {
    /// The points for the paper's number of points.
    pub fn new(lab: &Lab, paper_points: usize) -> Self {
        let n = lab.points(paper_points);
        let points = cloud(CloudKind::Uniform, n, SEED).points.iter().map(|p| *p * 2.0 - 1.0).collect();
        Self { paper_points, points, stretch: (paper_points as f64 / n as f64).cbrt() }
    }

    /// A length here for the paper's in diagonals.
    pub fn length(&self, paper_length_over_l: f64) -> f32 {
        (paper_length_over_l * L * self.stretch) as f32
    }

    /// A row without a value.
    pub fn row(&self, device: String, setting: &str, r_over_l: f64, method: &str) -> Row {
        let points = [self.paper_points, self.points.len()];
        Row::new(device, points, setting, [r_over_l, self.length(r_over_l).into()], method)
    }
}

/// The cube that points never leave.
pub fn cube() -> Aabb {
    Aabb::new(Vec3::splat(-1.0), Vec3::splat(1.0))
}

/// The paper's numbers of points that differ at this scale, each with its points.
pub fn spots(lab: &Lab, paper_points: &[usize]) -> Vec<Spot> {
    let mut spots: Vec<Spot> = Vec::new();
    for &n in paper_points {
        // Where the floor makes several the same, the largest of them stands for all.
        if spots.last().is_some_and(|spot| spot.points.len() == lab.points(n)) {
            spots.pop();
        }
        spots.push(Spot::new(lab, n));
    }
    spots
}
