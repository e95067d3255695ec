//! `nearfield-bench grid`: the experiments of Accel on its uniform grid, redone with measured neighbours, checked
//! answers and full lists.
//!
//! - [`variants`]: brute force and grid on CPU and GPU over particles and neighbours;
//! - [`on_gpu`]: brute force and grid on the GPU around 10,000 particles, and over neighbours;
//! - [`stages`]: where the time of the GPU goes;
//! - [`memory`]: what the grid adds to the points, by radius;
//! - [`claims`]: whether what Accel says of each figure held, computed from the rows.
//!
//! Each appends rows to a CSV file of its own and skips points that stand there for this device, commit and scale.
//! Source: the README of Accel (Newlin and Rerucha). Differs: lists are complete, where Accel cuts them at a number the
//! caller gives; brute force lists too; its particles were a mesh of its own, ours fill a cube evenly.

pub mod claims;
pub mod memory;
pub mod method;
pub mod on_gpu;
pub mod rows;
pub mod stages;
pub mod variants;

use std::path::{Path, PathBuf};
use std::time::Instant;

use nearfield::Vec3;
use nearfield::geometry::generate::{CloudKind, cloud};
use nearfield::gpu::{DeviceChoice, Gpu};

use crate::measure::Effort;
use crate::provenance::{COMMIT, Device, Machine, processor};
use crate::sets::SEED;
use crate::{Error, Result};
use method::{Case, Method};
use rows::{Point, Row, Rows};

/// Timed runs of a point, and the seconds after which there are no more.
const EFFORT: Effort = Effort { warm_up: 0.05, runs: 7, seconds: 1.0 };

/// Arguments of the subcommand.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The GPU of the experiments: auto, gpu, gpu:N or part of a device name; cpu leaves those with a GPU out
    #[arg(long, default_value = "auto")]
    pub device: DeviceChoice,
    /// Numbers of particles are those of a large GPU times this
    #[arg(long, default_value_t = 1.0)]
    pub scale: f64,
    /// Seconds after which no further point is begun; a later run goes on from there
    #[arg(long, default_value_t = 600.0)]
    pub budget: f64,
    /// Folder of the CSV files, the plots and claims.md
    #[arg(short, long)]
    pub output: PathBuf,
    /// Only write the plots and claims.md anew from the rows that are there
    #[arg(long)]
    pub claims: bool,
}

/// Runs the experiments, then draws the plots and writes the claims.
///
/// # Errors
/// `NoDevice`; a setting outside its range; what a build or a query returns; an answer that is wrong; a file that
/// cannot be read or written.
pub fn run(arguments: &Arguments) -> Result<()> {
    let lab = Lab::open(arguments)?;
    std::fs::create_dir_all(&arguments.output)
        .map_err(|error| Error::from(format!("{}: {error}", arguments.output.display())))?;
    if !arguments.claims {
        for (name, measure) in [
            ("memory", memory::measure as fn(&Lab) -> Result<()>),
            ("stages", stages::measure),
            ("gpu methods", on_gpu::measure),
            ("variants", variants::measure),
        ] {
            measure(&lab)?;
            println!("{name}: measured, {:.0} s so far", lab.begin.elapsed().as_secs_f64());
        }
    }
    memory::plot(&lab)?;
    stages::plot(&lab)?;
    on_gpu::plot(&lab)?;
    variants::plot(&lab)?;
    claims::write(&lab)
}

/// What the experiments share: devices, scale, budget and folder.
pub struct Lab {
    gpu: Option<Machine>,
    cpu: Machine,
    scale: f64,
    begin: Instant,
    budget: f64,
    folder: PathBuf,
}

impl Lab {
    /// Opens the devices.
    ///
    /// # Errors
    /// `NoDevice`; a scale that is not positive.
    pub fn open(arguments: &Arguments) -> Result<Self> {
        if !(arguments.scale > 0.0 && arguments.scale <= 100.0) {
            return Err(format!("--scale {} is not usable: expected above 0 and at most 100", arguments.scale).into());
        }
        let chosen = Machine::open(&arguments.device)?;
        let gpu = matches!(chosen.device, Device::Gpu(_)).then_some(chosen);
        if gpu.is_none() {
            println!("no GPU: the experiments run on the CPU alone");
        }
        Ok(Self {
            gpu,
            cpu: Machine::open(&DeviceChoice::Cpu)?,
            scale: arguments.scale,
            begin: Instant::now(),
            budget: arguments.budget,
            folder: arguments.output.clone(),
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The rows of an experiment.
    fn rows(&self, name: &str) -> Result<Rows> {
        Rows::open(&self.path(name))
    }

    /// The rows of an experiment that belong to these devices, this commit and this scale.
    fn own_rows(&self, name: &str) -> Result<Vec<Row>> {
        let names = [Some(&self.cpu.name), self.gpu.as_ref().map(|gpu| &gpu.name)];
        let own = |row: &&Row| names.contains(&Some(&row.device)) && row.commit == COMMIT && row.scale == self.scale;
        Ok(self.rows(name)?.all().iter().filter(own).cloned().collect())
    }

    fn gpu(&self) -> Option<&Gpu> {
        match &self.gpu.as_ref()?.device {
            Device::Gpu(gpu) => Some(gpu),
            Device::Cpu => None,
        }
    }

    /// The machine a method runs on; `None` for the GPU where there is none.
    fn machine(&self, method: Method) -> Option<&Machine> {
        if method.on_gpu() { self.gpu.as_ref() } else { Some(&self.cpu) }
    }

    fn is_over(&self) -> bool {
        self.begin.elapsed().as_secs_f64() >= self.budget
    }

    /// Milliseconds that one run of one point may be expected to take: a fraction of the budget.
    fn point_limit(&self) -> f64 {
        self.budget * 1e3 / 40.0
    }

    /// Lines under a plot: devices and commit.
    fn caption(&self, more: &str) -> Vec<String> {
        let gpu = self.gpu.as_ref().map_or("none".to_owned(), |gpu| format!("{} ({})", gpu.name, gpu.driver));
        vec![
            format!("GPU: {gpu}"),
            format!("CPU: {}, {}", processor(), self.cpu.name),
            format!("Nearfield commit {COMMIT}, scale {}. {more}", self.scale),
        ]
    }

    /// A number of particles at this scale.
    fn scaled(&self, particles: usize) -> usize {
        ((particles as f64 * self.scale).round() as usize).max(64)
    }

    /// Accel's 10,000 particles; fewer at scales below a tenth, which are for trying the experiments out.
    fn ten_thousand(&self) -> usize {
        self.scaled(100_000).min(10_000)
    }

    /// Measures `methods` on one case that is not in the rows yet; false once the budget is spent.
    ///
    /// A method is left out, and said so, where its time at the case measured before foretells more than the limit.
    fn measure(&self, rows: &mut Rows, spot: &Spot<'_>, methods: &[Method]) -> Result<bool> {
        let mut case = None;
        for &method in methods {
            let Some(machine) = self.machine(method) else {
                continue;
            };
            let point = Point {
                device: &machine.name,
                commit: COMMIT,
                scale: self.scale,
                particles: spot.points.len(),
                radius: spot.radius,
                method: method.name(),
            };
            if rows.has(&point) {
                continue;
            }
            if self.is_over() {
                return Ok(false);
            }
            if let Some(foretold) = self.foretell(rows, &point, spot, method)
                && foretold > self.point_limit()
            {
                println!("{}, {} particles: left out, about {:.0} ms", method.name(), spot.points.len(), foretold);
                continue;
            }
            let case = match &case {
                Some(case) => case,
                None => case.insert(Case::new(spot.points, spot.radius)?),
            };
            let Some((measured, structure_bytes)) = method.measure(self.gpu(), case, EFFORT)? else {
                println!(
                    "{}, {} particles: left out, the list does not fit a binding",
                    method.name(),
                    spot.points.len()
                );
                continue;
            };
            let row = Row {
                device: machine.name.clone(),
                commit: COMMIT.to_owned(),
                scale: self.scale,
                particles: spot.points.len(),
                wanted_neighbors: spot.wanted,
                radius: spot.radius,
                mean_neighbors: case.expected.mean(),
                method: method.name().to_owned(),
                stage: String::new(),
                clock: String::new(),
                milliseconds: 0.0,
                runs: 0,
                points_bytes: 12 * spot.points.len() as u64,
                structure_bytes,
            };
            rows.append(method::rows(&row, &measured, method.on_gpu()))?;
        }
        Ok(true)
    }

    /// Milliseconds by the largest smaller number of particles with about as many neighbours.
    fn foretell(&self, rows: &Rows, point: &Point<'_>, spot: &Spot<'_>, method: Method) -> Option<f64> {
        let before = rows.all().iter().filter(|row| {
            (&*row.device, &*row.commit, &*row.method) == (point.device, point.commit, point.method)
                && row.stage == rows::TOTAL
                && row.wanted_neighbors == spot.wanted
                && row.particles < point.particles
        });
        let nearest = before.max_by_key(|row| row.particles)?;
        let growth = point.particles as f64 / nearest.particles as f64;
        Some(nearest.milliseconds * if method.is_brute_force() { growth * growth } else { growth })
    }
}

/// Where an experiment measures.
struct Spot<'a> {
    points: &'a [Vec3],
    radius: f32,
    wanted: f64,
}

/// Particles that fill the unit cube evenly.
fn particles(n: usize) -> Vec<Vec3> {
    cloud(CloudKind::Uniform, n, SEED).points
}

/// Radius of a ball that holds so many of n particles in the unit cube, away from its border.
fn radius_for(wanted: f64, n: usize) -> f32 {
    (wanted / n as f64 * 3.0 / (4.0 * std::f64::consts::PI)).cbrt() as f32
}

/// Ascending numbers of particles, none twice.
fn ascending(mut numbers: Vec<usize>) -> Vec<usize> {
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

fn save(path: &Path, text: &str) -> Result<()> {
    std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()).into())
}
