//! What the rows share: the device, the sets with the answers they must give, meshes and scans.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Instant;

use nearfield::gpu::{Buffer, Gpu};
use nearfield::structure::DevicePoint;
use nearfield::{KdTreeSettings, Vec3};

use crate::Result;
use crate::applications::Workshop;
use crate::applications::original::TABLE_3;
use crate::applications::scans::Scan;
use crate::check::Expected;
use crate::device::device_points;
use crate::measure::Effort;
use crate::paper::lab::Lab;
use crate::provenance::{Device, Machine};
use crate::rays::meshes::{Source, data_folder};
use crate::rays::speed::{Bunny, SIDE};
use crate::sets::Set;

/// Fewest points of a set that was scaled down.
const FEWEST: usize = 2000;

/// A set of points with what is expected of it, made when first asked for.
pub(super) struct Points {
    /// Kind and number.
    pub(super) set: Set,
    /// They themselves.
    pub(super) points: Vec<Vec3>,
    /// The set's radius.
    pub(super) radius: f32,
    expected: OnceCell<Expected>,
}

impl Points {
    /// The right counts and some of the right rows.
    ///
    /// # Errors
    /// As [`Expected::of`].
    pub(super) fn expected(&self) -> Result<&Expected> {
        if let Some(expected) = self.expected.get() {
            return Ok(expected);
        }
        let expected = Expected::of(&self.points, self.radius)?;
        Ok(self.expected.get_or_init(|| expected))
    }

    /// A copy on the device.
    ///
    /// # Errors
    /// `OutOfDeviceMemory`.
    pub(super) fn upload(&self, gpu: &Gpu) -> Result<Buffer<DevicePoint>> {
        Ok(gpu.upload("points", &device_points(&self.points))?)
    }
}

/// The device and what was made for it so far.
pub(super) struct Bench {
    /// The device that is measured.
    pub(super) gpu: Gpu,
    /// Folder of the meshes.
    pub(super) data: PathBuf,
    machine: Machine,
    scale: f64,
    budget: f64,
    begin: Instant,
    sets: Vec<Rc<Points>>,
    bunny: Option<Rc<Bunny>>,
    workshop: Option<Rc<Workshop>>,
    scan: Option<Rc<Scan>>,
}

impl Bench {
    /// On a machine with a GPU.
    ///
    /// # Errors
    /// A machine without; a scale or a budget that means nothing.
    pub(super) fn new(machine: &Machine, scale: f64, budget: f64, data: Option<&Path>) -> Result<Self> {
        if !(scale > 0.0 && scale <= 1.0) {
            return Err(format!("--scale {scale} is not usable: expected above 0 and at most 1").into());
        }
        if !(budget >= 0.0) {
            return Err(format!("--budget {budget} is not usable: expected seconds, 0 or more").into());
        }
        let Device::Gpu(gpu) = &machine.device else {
            return Err("these targets are of a GPU, and the device is the CPU: name a GPU by --device".into());
        };
        Ok(Self {
            gpu: gpu.clone(),
            data: data_folder(data),
            machine: machine.clone(),
            scale,
            budget,
            begin: Instant::now(),
            sets: Vec::new(),
            bunny: None,
            workshop: None,
            scan: None,
        })
    }

    /// Seconds since the beginning.
    pub(super) fn seconds(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }

    /// Seconds of the budget that are left.
    pub(super) fn left(&self) -> f64 {
        self.budget - self.seconds()
    }

    /// A number of points at this scale.
    pub(super) fn scaled(&self, n: usize) -> usize {
        if self.scale == 1.0 { n } else { ((n as f64 * self.scale) as usize).clamp(FEWEST.min(n), n) }
    }

    /// How often something short is timed.
    pub(super) fn effort(&self) -> Effort {
        if self.machine.is_hardware_gpu() {
            // A card that was idle takes some tenths of a second to raise its clocks.
            Effort { warm_up: 0.3, runs: 21, seconds: 1.0 }
        } else {
            Effort { warm_up: 0.0, runs: 2, seconds: 1.0 }
        }
    }

    /// How often something is timed that takes tenths of a second.
    pub(super) fn short_effort(&self) -> Effort {
        Effort { runs: self.effort().runs.min(5), seconds: 2.0, ..self.effort() }
    }

    /// A set by its name at scale 1, such as "uniform-1m".
    ///
    /// # Errors
    /// A name that is none.
    pub(super) fn set(&mut self, name: &str) -> Result<Rc<Points>> {
        let whole: Set = name.parse()?;
        let set = Set { n: self.scaled(whole.n), ..whole };
        if let Some(known) = self.sets.iter().find(|known| known.set == set) {
            return Ok(known.clone());
        }
        let points = Points { set, points: set.points(), radius: set.radius(), expected: OnceCell::new() };
        let points = Rc::new(points);
        self.sets.push(points.clone());
        Ok(points)
    }

    /// The Stanford bunny with its rays.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(super) fn bunny(&mut self) -> Result<Rc<Bunny>> {
        if let Some(bunny) = &self.bunny {
            return Ok(bunny.clone());
        }
        let side = ((SIDE as f64 * self.scale.sqrt()).round() as usize).max(16);
        let bunny = Bunny::new(&Source::new(Some(&self.data), self.scale), &KdTreeSettings::default(), side)?;
        Ok(self.bunny.insert(Rc::new(bunny)).clone())
    }

    /// What the experiments of papers are made with, around this device.
    ///
    /// # Errors
    /// What opening the CPU returns.
    pub(super) fn workshop(&mut self) -> Result<Rc<Workshop>> {
        if let Some(workshop) = &self.workshop {
            return Ok(workshop.clone());
        }
        let lab = Lab::around(&self.machine, self.scale, self.budget)?;
        Ok(self.workshop.insert(Rc::new(Workshop { lab, data: self.data.clone() })).clone())
    }

    /// The samples of the distance fields.
    ///
    /// # Errors
    /// As [`Scan::new`].
    pub(super) fn scan(&mut self) -> Result<Rc<Scan>> {
        if let Some(scan) = &self.scan {
            return Ok(scan.clone());
        }
        let workshop = self.workshop()?;
        let scan = Scan::new(&workshop, TABLE_3[0].file, TABLE_3[0].points, 0.0)?;
        Ok(self.scan.insert(Rc::new(scan)).clone())
    }
}
